"""Collects the transforms of a recording for the buffer."""

from __future__ import annotations

import struct
from array import array
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.errors import RecordingError

from .buffer import TransformBuffer
from .lookup_errors import ACCEPTED, REASONS, RejectedTransforms, reason_of_names, reasons_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from numpy.typing import NDArray

    from pc2scan.core.rigid import TransformRow

#: Groups of rejected transforms that are reported one by one; all are counted.
MAX_REJECTIONS = 100

#: Limits of frames, and of pairs of a child and a parent; each takes about a kilobyte. Robots have hundreds.
MAX_FRAMES = 100_000
MAX_PAIRS = 200_000


class TransformBuilder:
    """Collects transforms in the order of the recording; `build` turns them into a `TransformBuffer`.

    Needs 69 bytes a transform.
    """

    # Pair of frames, stamp_ns, whether static, and the pose.
    _RECORD = struct.Struct("<iq?7d")
    _DTYPE = np.dtype([("pair", "<i4"), ("stamp_ns", "<i8"), ("static", "?"), ("pose", "<f8", 7)])

    def __init__(self) -> None:
        self._records = bytearray()
        self._pairs: dict[tuple[str, str], int] = {}
        self._names: dict[str, int] = {}
        # Parent, child and, where the names alone rule it out, the reason; three numbers a pair.
        self._pair_table = array("i")

    def __len__(self) -> int:
        """Return the number of transforms that were added."""
        return len(self._records) // self._RECORD.size

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

    def add_poses(self, parent: str, child: str, stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> None:
        """Append transforms of one pair of frames: (N,) nanoseconds, and (N, 7) as in `add`."""
        pair = self._pairs.get((parent, child))
        records = np.zeros(len(stamps_ns), self._DTYPE)
        records["pair"] = self._add_pair(parent, child) if pair is None else pair
        records["stamp_ns"], records["pose"] = stamps_ns, poses
        self._records += records.tobytes()

    def remove(self, children: Collection[str]) -> None:
        """Remove all transforms to some frames, whose names are without a leading slash."""
        gone = [number for (_, child), number in self._pairs.items() if child.removeprefix("/") in children]
        if gone:
            records = np.frombuffer(self._records, self._DTYPE)
            self._records = bytearray(records[~np.isin(records["pair"], gone)].tobytes())

    def parents_of(self, children: Collection[str]) -> dict[str, str]:
        """Return which of some frames have transforms, and their parents, without leading slashes."""
        used = set(np.flatnonzero(np.bincount(np.frombuffer(self._records, self._DTYPE)["pair"])).tolist())
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
        """Sort the transforms and reject those that cannot be used. More may be added afterwards."""
        records = np.frombuffer(self._records, self._DTYPE)
        pairs = np.array(self._pair_table, np.int32).reshape(-1, 3)
        reasons = reasons_of(records["pose"], pairs[records["pair"], 2])
        rejections = self._rejections(records, pairs, reasons)
        good = np.flatnonzero(reasons == ACCEPTED)
        rejected = len(records) - len(good)
        del reasons
        frames, parents, children = self._renumber(pairs[records["pair"][good], :2])
        # A child is static if its first transform is.
        numbers, first = np.unique(children, return_index=True)
        is_static = np.zeros(len(frames), np.bool_)
        is_static[numbers] = records["static"][good][first]
        order = _time_order(children, records["stamp_ns"][good], is_static)
        received = np.bincount(children, minlength=len(frames))
        kept, parents, children = good[order], parents[order], children[order]
        offsets = np.searchsorted(children, np.arange(len(frames) + 1))
        # Freed before the poses are copied, which take more memory than all else.
        del good, order, children
        return TransformBuffer(
            frames=frames,
            rejections=rejections,
            rejected=rejected,
            _stamps_ns=_read_only(records["stamp_ns"][kept]),
            _poses=_read_only(records["pose"][kept]),
            _parents=_read_only(parents),
            _offsets=offsets,
            _static=is_static,
            _received=received,
            _numbers={name: number for number, name in enumerate(frames)},
        )

    def _renumber(self, used: NDArray[np.int32]) -> tuple[tuple[str, ...], NDArray[np.int32], NDArray[np.int32]]:
        """Return the names of the frames with accepted transforms, the only ones for tf2; parents, children."""
        occurs = np.zeros(len(self._names), dtype=np.bool_)
        occurs[used] = True
        numbers = (np.cumsum(occurs) - 1).astype(np.int32)
        names = (name for name, known in zip(self._names, occurs.tolist(), strict=True) if known)
        return tuple(names), numbers[used[:, 0]], numbers[used[:, 1]]

    def _rejections(
        self, records: NDArray[np.void], pairs: NDArray[np.int32], reasons: NDArray[np.int32]
    ) -> tuple[RejectedTransforms, ...]:
        bad = np.flatnonzero(reasons != ACCEPTED)
        causes = np.stack((records["pair"][bad], reasons[bad]), axis=1)
        groups, first, counts = np.unique(causes, axis=0, return_index=True, return_counts=True)
        names = list(self._names)
        rejections = []
        for group in np.argsort(first)[:MAX_REJECTIONS].tolist():
            pair, reason = groups[group].tolist()
            parent, child, _ = pairs[pair].tolist()
            stamp_ns = records["stamp_ns"].item(bad[first[group]])
            rejections.append(
                RejectedTransforms(names[child], names[parent], stamp_ns, REASONS[reason], counts.item(group))
            )
        return tuple(rejections)


def _time_order(
    children: NDArray[np.int32], stamps_ns: NDArray[np.int64], is_static: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return the indices of the transforms to keep, by child and stamp.

    A dynamic child keeps the first of its transforms with one stamp, a static child the last of all.
    """
    static = is_static[children]
    arrival = np.arange(len(children))
    stamps_ns = np.where(static, 0, stamps_ns)
    order = np.lexsort((np.where(static, -arrival, arrival), stamps_ns, children))
    changes = (np.diff(children[order]) != 0) | (np.diff(stamps_ns[order]) != 0)
    return order[np.concatenate(([True], changes))] if len(order) else order


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    values.flags.writeable = False
    return values
