"""The transforms of one child frame over time, with the rules of tf2's ``TimeCache`` and ``StaticCache``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import interpolate_poses

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from pc2scan.core.rigid import Pose

#: A transform of a child frame: what is collected, and what a file has.
ROW = np.dtype([("stamp_ns", "<i8"), ("pose", "<f8", 7), ("parent", "<i4")])


@dataclass(frozen=True, slots=True, eq=False)
class FrameHistory(ABC):
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
    extent
        By how much each of the seven numbers of the poses varies at most.
    first_ns, last_ns
        Earliest and latest stamp.
    """

    child: int
    static: bool
    received: int
    size: int
    sole_parent: int
    extent: NDArray[np.float64]
    first_ns: int
    last_ns: int

    @abstractmethod
    def near(self, begin_ns: int, end_ns: int) -> Samples:
        """Return the samples of an interval, the one before it and the one after it, if there are any; or more."""

    @abstractmethod
    def parts(self) -> Iterable[Samples]:
        """Return all samples, some at a time."""

    @abstractmethod
    def all_stamps(self) -> NDArray[np.int64]:
        """Return the stamps of all samples, (N,) int64, increasing."""

    @abstractmethod
    def poses_of(self, samples: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the poses of samples, (K, 7), by their numbers, (K,)."""

    def during(self, begin_ns: int, end_ns: int) -> Samples:
        """Return what lookups in an interval need; in it, the parent does not change."""
        return self.near(begin_ns, end_ns).during(begin_ns, end_ns)

    def gap_ns(self, stamp_ns: int | None) -> int:
        """Return how far a stamp is outside: negative before the first sample, positive after the last."""
        if self.static or stamp_ns is None:
            return 0
        return min(stamp_ns - self.first_ns, 0) or max(stamp_ns - self.last_ns, 0)

    def between_ns(self, stamp_ns: int) -> int:
        """Return the time from the last sample before a stamp to the next one; 0 at a sample, and outside."""
        return self.near(stamp_ns, stamp_ns).between_ns(stamp_ns)

    def parent_at(self, stamp_ns: int | None) -> int:
        """Return the index of the parent at a stamp, or the latest; outside the history, the nearest known one."""
        at_ns = self.last_ns if stamp_ns is None else stamp_ns
        return self.sole_parent if self.sole_parent >= 0 else self.near(at_ns, at_ns).parent_at(stamp_ns)

    def pose_at(self, stamp_ns: int | None) -> Pose:
        """Return ``parent_from_child`` at a stamp, or the latest; outside the history, the nearest known one."""
        at_ns = self.last_ns if stamp_ns is None else stamp_ns
        return self.near(at_ns, at_ns).pose_at(stamp_ns)

    def changes(self) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Return the stamps from which on a parent is known, or another one, (K,) int64, increasing; these parents."""
        stamps, parents, before = [], [], -1
        for part in self.parts():
            changed = np.diff(part.parents, prepend=before) != 0
            stamps.append(part.stamps_ns[changed])
            parents.append(part.parents[changed])
            before = int(part.parents[-1])
        return np.concatenate(stamps), np.concatenate(parents)

    def all_parents(self) -> list[int]:
        """Return every parent that it had, in the order of time."""
        return [self.sole_parent] if self.sole_parent >= 0 else list(dict.fromkeys(self.changes()[1].tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class Samples(FrameHistory):
    """Transforms of a child frame in memory.

    Attributes
    ----------
    stamps_ns
        (N,) int64, increasing.
    poses
        (N, 7) float64: translation x, y, z in metres, then quaternion x, y, z, w, as published.
    parents
        (N,) int32, indices of frames.
    """

    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    parents: NDArray[np.int32]

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
    ) -> Samples:
        """Return copies of transforms, which are in the order of their stamps."""
        # Contiguous, as the loops need them.
        stamps_ns, poses = stamps_ns.copy(), poses.copy()
        for column in (stamps_ns, poses, parents):
            column.flags.writeable = False
        sole_parent = int(parents[0]) if (parents == parents[0]).all() else -1
        extent, ends = np.ptp(poses, axis=0), (int(stamps_ns[0]), int(stamps_ns[-1]))
        return cls(child, static, received, len(stamps_ns), sole_parent, extent, *ends, stamps_ns, poses, parents)

    @property
    def translations(self) -> NDArray[np.float64]:
        """(N, 3) float64, metres, a view."""
        return self.poses[:, :3]

    @property
    def quaternions(self) -> NDArray[np.float64]:
        """(N, 4) float64 x, y, z, w, a view."""
        return self.poses[:, 3:]

    def near(self, begin_ns: int, end_ns: int) -> Samples:  # noqa: ARG002
        """Return all samples."""
        return self

    def parts(self) -> Iterable[Samples]:
        """Return all samples at once."""
        return (self,)

    def all_stamps(self) -> NDArray[np.int64]:
        """Return the stamps of all samples, (N,) int64, increasing."""
        return self.stamps_ns

    def poses_of(self, samples: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the poses of samples, (K, 7), by their numbers, (K,)."""
        return self.poses[samples]

    def during(self, begin_ns: int, end_ns: int) -> Samples:  # noqa: ARG002
        """Return what lookups in an interval need; in it, the parent does not change.

        They are the samples from the last change of the parent until the next one, if a parent is known by then. The
        last of them is valid until the change, unchanged; it is there twice.
        """
        if self.static or self.sole_parent >= 0 or begin_ns < self.first_ns:
            return self
        changes, _ = self.changes()
        next_change = int(changes.searchsorted(begin_ns, "right"))
        begin = int(self.stamps_ns.searchsorted(changes[next_change - 1]))
        stamps, poses = self.stamps_ns[begin:], self.poses[begin:]
        if next_change < changes.size:
            until_ns = changes[next_change] - 1
            end = int(stamps.searchsorted(until_ns, "right"))
            stamps, poses = stamps[:end], poses[:end]
            if stamps[-1] < until_ns:
                stamps, poses = np.append(stamps, until_ns), np.append(poses, poses[-1:], axis=0)
        return replace(
            self,
            size=stamps.size,
            sole_parent=int(self.parents[begin]),
            first_ns=int(stamps[0]),
            last_ns=int(stamps[-1]),
            stamps_ns=stamps,
            poses=poses,
            parents=np.full(stamps.size, self.parents[begin]),
        )

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
        """Return the index of the parent at a stamp; outside the history, the nearest known one."""
        return self.sole_parent if self.sole_parent >= 0 else int(self.parents[self._older(stamp_ns)])

    def pose_at(self, stamp_ns: int | None) -> Pose:
        """Return ``parent_from_child`` at a stamp; outside the history, the nearest known one."""
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


def time_order(stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the indices that sort stamps; of several equal ones, the first."""
    order = stamps_ns.argsort(kind="stable")
    ordered = stamps_ns[order]
    return order[np.concatenate(([True], ordered[1:] != ordered[:-1]))]


def _float_seconds(duration_ns: int) -> float:
    """Return seconds as ``ros::Duration::toSec`` rounds them."""
    seconds, nanoseconds = divmod(duration_ns, 1_000_000_000)
    return seconds + 1e-9 * nanoseconds
