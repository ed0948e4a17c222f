"""Collects the transforms of a recording for the buffer."""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass, field
from itertools import islice, pairwise
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.errors import RecordingError

from .buffer import TransformBuffer
from .frames import ACCEPTED, REASONS, FrameHistory, RejectedTransforms, reason_of_names, reasons_of, time_order

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from numpy.typing import NDArray

    from pc2scan.core.rigid import TransformRow

    _Columns = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int32]]

#: Groups of rejected transforms that are reported one by one; all are counted.
MAX_REJECTIONS = 100

#: Limits of frames, and of pairs of a child and a parent; each takes about a kilobyte. Robots have hundreds.
MAX_FRAMES = 100_000
MAX_PAIRS = 200_000

#: How many transforms are sorted into their frames at a time.
_AT_ONCE = 8_192


@dataclass(slots=True, eq=False)
class _Child:
    """The accepted transforms of a child frame.

    Attributes
    ----------
    is_static
        Whether its first transform is: then only the last one counts.
    received
        Their number.
    parts
        Stamps, poses and numbers of the parents, in the order of their arrival.
    """

    is_static: bool
    received: int = 0
    parts: list[_Columns] = field(default_factory=list)

    def append(self, columns: _Columns) -> None:
        """Add transforms. Parts are joined with others of their size, so that their memory is used again early."""
        self.parts.append(columns)
        while len(self.parts) > 1 and len(self.parts[-1][0]) >= len(self.parts[-2][0]):
            self.parts[-2:] = [_joined(self.parts[-2:])]

    def sorted(self) -> _Columns:
        """Return the transforms in the order of their stamps, which replace the parts; the first one of each stamp."""
        stamps, poses, parents = _joined(self.parts)
        if not (stamps[1:] > stamps[:-1]).all():
            order = time_order(stamps)
            stamps, poses, parents = stamps[order], poses[order], parents[order]
        self.parts = [(stamps, poses, parents)]
        return self.parts[0]


def _joined(parts: list[_Columns]) -> _Columns:
    stamps, poses, parents = (np.concatenate(column) for column in zip(*parts, strict=True))
    return stamps, poses, parents


class TransformBuilder:
    """Collects transforms in the order of the recording; `build` turns them into a `TransformBuffer`.

    Accepted transforms of one child frame are together, in 68 bytes each.
    """

    # Pair of frames, stamp_ns, whether static, and the pose.
    _RECORD = struct.Struct("<iq?7d")
    _DTYPE = np.dtype([("pair", "<i4"), ("stamp_ns", "<i8"), ("static", "?"), ("pose", "<f8", 7)])

    def __init__(self) -> None:
        # What has arrived, but is not yet sorted into the frames.
        self._records = bytearray()
        self._pairs: dict[tuple[str, str], int] = {}
        self._names: dict[str, int] = {}
        # Parent, child and, where the names alone rule it out, the reason; three numbers a pair.
        self._pair_table = array("i")
        # The pairs with accepted transforms, and by pair and reason the first stamp and the number of rejected ones.
        self._accepted: set[int] = set()
        self._rejected: dict[tuple[int, int], list[int]] = {}
        self._children: dict[int, _Child] = {}

    def add(self, rows: Iterable[TransformRow], *, static: bool) -> None:
        """Append transforms in the order in which they were recorded.

        Parameters
        ----------
        rows
            ``(parent, child, stamp_ns, tx, ty, tz, qx, qy, qz, qw)``: ``parent_from_child`` in metres. Names
            and numbers may be anything; `build` rejects what is unusable.
        static
            Whether they come from a static topic (``/tf_static``) or from the user.

        Raises
        ------
        RecordingError
            If there are more frames than `MAX_FRAMES`, or more pairs than `MAX_PAIRS`.
        """
        pairs, pack = self._pairs, self._RECORD.pack
        for parent, child, stamp_ns, *pose in rows:
            pair = pairs.get((parent, child))
            if pair is None:
                pair = self._add_pair(parent, child)
            self._records += pack(pair, stamp_ns, static, *pose)
        if len(self._records) >= _AT_ONCE * self._RECORD.size:
            self._sort_in()

    def add_poses(self, parent: str, child: str, stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> None:
        """Append transforms of one pair of frames: (N,) nanoseconds, and (N, 7) as in `add`."""
        pair = self._pairs.get((parent, child))
        pair = self._add_pair(parent, child) if pair is None else pair
        for begin in range(0, len(stamps_ns), _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            records = np.zeros(len(stamps_ns[part]), self._DTYPE)
            records["pair"], records["stamp_ns"], records["pose"] = pair, stamps_ns[part], poses[part]
            self._records += records.tobytes()
            self._sort_in()

    def remove(self, children: Collection[str]) -> None:
        """Remove all transforms to some frames, whose names are without a leading slash."""
        self._sort_in()
        gone = {number for (_, child), number in self._pairs.items() if child.removeprefix("/") in children}
        self._accepted -= gone
        self._rejected = {key: group for key, group in self._rejected.items() if key[0] not in gone}
        for child in children:
            self._children.pop(self._names.get(child, -1), None)

    def parents_of(self, children: Collection[str]) -> dict[str, str]:
        """Return which of some frames have transforms, and their parents, without leading slashes."""
        self._sort_in()
        used = self._accepted.union(pair for pair, _ in self._rejected)
        pairs = ((p.removeprefix("/"), c.removeprefix("/")) for (p, c), number in self._pairs.items() if number in used)
        return {child: parent for parent, child in pairs if child in children}

    @property
    def pairs(self) -> Iterable[tuple[str, str]]:
        """Parent and child of all transforms, without leading slashes."""
        return ((parent.removeprefix("/"), child.removeprefix("/")) for parent, child in self._pairs)

    def _add_pair(self, parent: str, child: str) -> int:
        pair = self._pairs[parent, child] = len(self._pairs)
        parent, child = parent.removeprefix("/"), child.removeprefix("/")
        numbers = [self._names.setdefault(name, len(self._names)) for name in (parent, child)]
        if len(self._names) > MAX_FRAMES or len(self._pairs) > MAX_PAIRS:
            raise RecordingError(
                f"the transforms have more than {MAX_FRAMES:,} frames or {MAX_PAIRS:,} pairs of frames, "
                "more than any robot has",
                hint="choose the topics to read transforms from by `tf_topics`",
            )
        self._pair_table.extend((*numbers, reason_of_names(parent, child)))
        return pair

    def build(self) -> TransformBuffer:
        """Return the transforms that can be used, for lookups. More may be added afterwards."""
        self._sort_in()
        # Frames without accepted transforms are none for tf2.
        occurs = np.zeros(len(self._names), np.bool_)
        occurs[np.array(self._pair_table, np.int32).reshape(-1, 3)[list(self._accepted), :2]] = True
        numbers = (np.cumsum(occurs) - 1).astype(np.int32)
        frames = tuple(name for name, known in zip(self._names, occurs.tolist(), strict=True) if known)
        histories: list[FrameHistory | None] = [None] * len(frames)
        for number, child in self._children.items():
            index = numbers.item(number)
            stamps_ns, poses, parents = child.sorted()
            columns = (stamps_ns, poses, numbers[parents])
            histories[index] = FrameHistory.of(index, *columns, child.received, static=child.is_static)
        names = list(self._names)
        rejections = []
        for (pair, reason), (stamp_ns, count) in islice(self._rejected.items(), MAX_REJECTIONS):
            parent, of = self._pair_table[3 * pair : 3 * pair + 2]
            rejections.append(RejectedTransforms(names[of], names[parent], stamp_ns, REASONS[reason], count))
        return TransformBuffer(
            frames=frames,
            rejections=tuple(rejections),
            rejected=sum(count for _, count in self._rejected.values()),
            _histories=tuple(histories),
            _numbers={name: number for number, name in enumerate(frames)},
        )

    def _sort_in(self) -> None:
        """Sort what has arrived into the child frames; count what is rejected."""
        if not self._records:
            return
        records, self._records = np.frombuffer(self._records, self._DTYPE), bytearray()
        pairs = np.array(self._pair_table, np.int32).reshape(-1, 3)[records["pair"]]
        reasons = reasons_of(records["pose"], pairs[:, 2])
        bad = records[reasons != ACCEPTED]
        causes = zip(bad["pair"].tolist(), reasons[reasons != ACCEPTED].tolist(), strict=True)
        for cause, stamp_ns in zip(causes, bad["stamp_ns"].tolist(), strict=True):
            self._rejected.setdefault(cause, [stamp_ns, 0])[1] += 1
        chosen = np.flatnonzero(reasons == ACCEPTED)
        chosen = chosen[pairs[chosen, 1].argsort(kind="stable")]
        records, pairs = records[chosen], pairs[chosen]
        self._accepted.update(np.flatnonzero(np.bincount(records["pair"])).tolist())
        columns = records["stamp_ns"].copy(), records["pose"].copy(), pairs[:, 0].copy()
        ends = np.flatnonzero(np.diff(pairs[:, 1], append=-1)) + 1
        for begin, end in pairwise([0, *ends.tolist()]):
            number = int(pairs[begin, 1])
            child = self._children.get(number)
            if child is None:
                child = self._children[number] = _Child(bool(records["static"][begin]))
            child.received += end - begin
            stamps, poses, parents = (column[begin:end] for column in columns)
            if child.is_static:
                child.parts = [(stamps[-1:].copy(), poses[-1:].copy(), parents[-1:].copy())]
            else:
                child.append((stamps, poses, parents))
