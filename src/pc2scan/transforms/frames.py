"""The frames of a recording: the usual names, the transforms of each over time, as in tf2's caches, and their trees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.rigid import are_accepted, interpolate_poses

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pc2scan.core.rigid import Pose

#: Usual names of a robot's frame, whose z is up; the first that exists is used.
BODIES = ("base_link", "base_footprint")

#: Frames that a robot moves in (REP 105, and LOAM's and FAST-LIO's); the frames below them move with the robot.
WORLDS = ("odom", "map", "world", "earth", "camera_init")

#: Why a transform is rejected.
ACCEPTED, NO_CHILD, NO_PARENT, SELF, NOT_FINITE, ZERO, DENORMALIZED = range(7)
REASONS = {
    NO_CHILD: "TF_NO_CHILD_FRAME_ID: child_frame_id is empty",
    NO_PARENT: "TF_NO_FRAME_ID: frame_id is empty",
    SELF: "TF_SELF_TRANSFORM: frame_id and child_frame_id are the same",
    NOT_FINITE: "TF_NAN_INPUT: a component is NaN or infinite",
    ZERO: "TF_DENORMALIZED_QUATERNION: the quaternion is zero",
    DENORMALIZED: "TF_DENORMALIZED_QUATERNION: the squared norm of the quaternion differs from 1 by 0.01 or more",
}


@dataclass(frozen=True, slots=True, eq=False)
class FrameHistory:
    """The transforms ``parent_from_child`` of one child frame, in the order of their stamps.

    Attributes
    ----------
    child
        Index of the frame in `TransformBuffer.frames`.
    static
        Whether the only transform is valid at any time.
    received
        Number of accepted transforms, repeated stamps and overwritten static ones included.
    size
        Number of samples: one at least.
    sole_parent
        The parent, or -1 if it changes.
    first_ns, last_ns
        Earliest and latest stamp.
    stamps_ns
        (N,) int64, increasing.
    poses
        (N, 7) float64: translation x, y, z in metres, then quaternion x, y, z, w, as published.
    parents
        (N,) int32, indices of frames.
    changed
        Indices of the samples that have another parent than the one before; the first sample is among them.
    """

    child: int
    static: bool
    received: int
    size: int
    sole_parent: int
    first_ns: int
    last_ns: int
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    parents: NDArray[np.int32]
    changed: NDArray[np.intp]

    @classmethod
    def of(
        cls,
        child: int,
        stamps_ns: NDArray[np.int64],
        poses: NDArray[np.float64],
        parents: NDArray[np.int32],
        received: int = 0,
        *,
        static: bool = False,
    ) -> FrameHistory:
        """Return the history of arrays in the order of their stamps, which become read-only."""
        for column in (stamps_ns, poses, parents):
            column.flags.writeable = False
        changed = np.flatnonzero(np.diff(parents, prepend=-1))
        sole_parent = int(parents[0]) if len(changed) == 1 else -1
        ends = int(stamps_ns[0]), int(stamps_ns[-1])
        return cls(child, static, received, len(stamps_ns), sole_parent, *ends, stamps_ns, poses, parents, changed)

    @property
    def extent(self) -> NDArray[np.float64]:
        """By how much each of the seven numbers of the poses varies at most."""
        extent: NDArray[np.float64] = np.ptp(self.poses, axis=0)
        return extent

    def during(self, begin_ns: int, end_ns: int) -> FrameHistory:
        """Return what lookups in an interval need; in it, the parent does not change.

        Where the parent changes at other times, they are the samples of the interval, the one before it and the one
        after it. The last one before a change is valid until the change, unchanged; it is there twice.
        """
        if self.static or self.sole_parent >= 0 or begin_ns < self.first_ns:
            return self
        changes = self.stamps_ns[self.changed]
        change = int(changes.searchsorted(begin_ns, "right"))
        first = max(int(self.stamps_ns.searchsorted(begin_ns)) - 1, self.changed.item(change - 1))
        stop = int(self.stamps_ns.searchsorted(end_ns, "right")) + 1
        until_ns = None
        if change < changes.size and stop > self.changed[change]:
            stop, until_ns = self.changed.item(change), changes.item(change) - 1
        stamps, poses = self.stamps_ns[first:stop], self.poses[first:stop]
        if until_ns is not None and stamps[-1] < until_ns:
            stamps, poses = np.append(stamps, until_ns), np.append(poses, poses[-1:], axis=0)
        return FrameHistory.of(self.child, stamps, poses, np.full(stamps.size, self.parents[first]), self.received)

    def gap_ns(self, stamp_ns: int | None) -> int:
        """Return how far a stamp is outside: negative before the first sample, positive after the last."""
        if self.static or stamp_ns is None:
            return 0
        return min(stamp_ns - self.first_ns, 0) or max(stamp_ns - self.last_ns, 0)

    def between_ns(self, stamp_ns: int) -> int:
        """Return the time from the last sample before a stamp to the next one; 0 at a sample, and outside."""
        if self.static or not self.first_ns < stamp_ns < self.last_ns:
            return 0
        older = self._older(stamp_ns)
        begin_ns, end_ns = self.stamps_ns[older : older + 2].tolist()
        return end_ns - begin_ns if begin_ns < stamp_ns else 0

    def _older(self, stamp_ns: int | None) -> int:
        """Return the index of the sample at a stamp or before it, or of the first one; None asks for the latest."""
        if self.static or stamp_ns is None or stamp_ns >= self.last_ns:
            return len(self.stamps_ns) - 1
        return max(int(self.stamps_ns.searchsorted(stamp_ns, "right")) - 1, 0)

    def parent_at(self, stamp_ns: int | None) -> int:
        """Return the index of the parent at a stamp, or the latest; outside the history, the nearest known one."""
        return self.sole_parent if self.sole_parent >= 0 else int(self.parents[self._older(stamp_ns)])

    def pose_at(self, stamp_ns: int | None) -> Pose:
        """Return ``parent_from_child`` at a stamp, or the latest; outside the history, the nearest known one."""
        older = self._older(stamp_ns)
        first = self._pose(older)
        if self.static or stamp_ns is None or older + 1 == len(self.stamps_ns):
            return first
        # The first sample has no older one; a stamp before it is within the tolerance.
        if stamp_ns <= self.first_ns or (self.sole_parent < 0 and self.parents[older] != self.parents[older + 1]):
            return first
        begin_ns, end_ns = self.stamps_ns[older : older + 2].tolist()
        ratio = _float_seconds(stamp_ns - begin_ns) / _float_seconds(end_ns - begin_ns)
        return interpolate_poses(first, self._pose(older + 1), ratio)

    def _pose(self, sample: int) -> Pose:
        x, y, z, i, j, k, r = self.poses[sample].tolist()
        return (x, y, z, i, j, k, r)

    def changes_within(self, begin_ns: int, end_ns: int) -> bool:
        """Whether it gets another parent after the first of two stamps, up to the second."""
        changes = self.stamps_ns[self.changed[1:]]
        return not self.static and bool(((changes > begin_ns) & (changes <= end_ns)).any())

    def all_parents(self) -> list[int]:
        """Return every parent that it had, in the order of time."""
        return list(dict.fromkeys(self.parents[self.changed].tolist()))


def time_order(stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the indices that sort stamps; the first of equal ones."""
    order = stamps_ns.argsort(kind="stable")
    ordered = stamps_ns[order]
    return order[np.concatenate(([True], ordered[1:] != ordered[:-1]))]


def _float_seconds(duration_ns: int) -> float:
    """Return seconds as ``ros::Duration::toSec`` rounds them."""
    seconds, nanoseconds = divmod(duration_ns, 1_000_000_000)
    return seconds + 1e-9 * nanoseconds


@dataclass(frozen=True, slots=True)
class RejectedTransforms:
    """Rejected transforms of one pair of frames and one reason.

    Attributes
    ----------
    child, parent
        Frame names, a leading slash stripped.
    stamp_ns
        Stamp of the first one.
    reason
        tf2's name for the reason, and an explanation.
    count
        How many were rejected.
    """

    child: str
    parent: str
    stamp_ns: int
    reason: str
    count: int


def reason_of_names(parent: str, child: str) -> int:
    """Return why a pair of frames, leading slashes stripped, is rejected, or `ACCEPTED`."""
    if not child:
        return NO_CHILD
    if not parent:
        return NO_PARENT
    return SELF if parent == child else ACCEPTED


def reasons_of(poses: NDArray[np.float64], reasons: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return why each transform is rejected, or `ACCEPTED`; ``reasons`` are those of the names alone."""
    finite = np.isfinite(poses).all(axis=1)
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        zero = ~poses[:, 3:].any(axis=1)
    return np.select(
        [reasons != ACCEPTED, ~finite, zero, ~are_accepted(poses[:, 3:])],
        [reasons, NOT_FINITE, ZERO, DENORMALIZED],
        ACCEPTED,
    ).astype(np.int32)


class FrameInfo(NamedTuple):
    """Statistics of one child frame.

    Attributes
    ----------
    child
        The frame.
    parents
        Every parent that it had, in the order of time.
    static
        Whether its transform is valid at any time.
    transforms
        Number of samples that are kept.
    received
        Number of accepted transforms, repeated stamps and overwritten static ones included.
    first_ns, last_ns
        Earliest and latest stamp.
    rate_hz
        Mean rate of the samples; None for fewer than two, or a static frame.
    largest_gap_ns
        Longest time between two neighbouring samples; None if there is no rate.
    largest_gap_at_ns
        Stamp at which that gap begins.
    """

    child: str
    parents: tuple[str, ...]
    static: bool
    transforms: int
    received: int
    first_ns: int
    last_ns: int
    rate_hz: float | None
    largest_gap_ns: int | None
    largest_gap_at_ns: int | None


class Tree(NamedTuple):
    """Frames that are connected at some time of the recording.

    Attributes
    ----------
    roots
        Frames without a parent, sorted. More than one if a child changed from one tree to another; none
        if the frames form a loop.
    frames
        All frames, the roots included, sorted.
    """

    roots: tuple[str, ...]
    frames: tuple[str, ...]


def frame_info(link: FrameHistory, names: Sequence[str]) -> FrameInfo:
    """Return the statistics of one child frame; ``names`` are those of all frames."""
    count, stamps_ns = link.size, link.stamps_ns
    gaps = np.diff(stamps_ns)
    widest = int(gaps.argmax()) if count > 1 else 0
    return FrameInfo(
        child=names[link.child],
        parents=tuple(names[parent] for parent in link.all_parents()),
        static=link.static,
        transforms=count,
        received=link.received,
        first_ns=link.first_ns,
        last_ns=link.last_ns,
        rate_hz=(count - 1) * 1e9 / (link.last_ns - link.first_ns) if count > 1 else None,
        largest_gap_ns=int(gaps[widest]) if count > 1 else None,
        largest_gap_at_ns=stamps_ns.item(widest) if count > 1 else None,
    )


def top_of(tops: dict[str, str], frame: str) -> str:
    """Return the frame that stands for the tree of a frame: ``tops`` leads from each frame towards it (union-find)."""
    tops.setdefault(frame, frame)
    while tops[frame] != frame:
        tops[frame] = frame = tops[tops[frame]]
    return frame


def trees_of(names: Sequence[str], histories: Sequence[FrameHistory | None]) -> tuple[Tree, ...]:
    """Return the connected frames, the largest tree first.

    Parameters
    ----------
    names
        Names of all frames.
    histories
        Their transforms, in the same order; None for a frame that is never a child.
    """
    tops: dict[str, str] = {}
    for link in filter(None, histories):
        for parent in sorted(link.all_parents()):
            tops[top_of(tops, names[link.child])] = top_of(tops, names[parent])
    members: dict[str, list[int]] = {}
    for frame, name in enumerate(names):
        members.setdefault(top_of(tops, name), []).append(frame)
    trees = (
        Tree(
            roots=tuple(sorted(names[frame] for frame in frames if histories[frame] is None)),
            frames=tuple(sorted(names[frame] for frame in frames)),
        )
        for frames in members.values()
    )
    return tuple(sorted(trees, key=lambda tree: (-len(tree.frames), tree.frames)))
