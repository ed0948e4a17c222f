"""The transforms of one child frame over time, with the rules of tf2's ``TimeCache`` and ``StaticCache``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import interpolate_poses

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.core.rigid import Pose


@dataclass(frozen=True, slots=True, eq=False)
class FrameHistory:
    """The transforms ``parent_from_child`` of one child frame, in the order of their stamps.

    Attributes
    ----------
    child
        Index of the frame in `TransformBuffer.frames`.
    static
        Whether the only transform is valid at any time.
    stamps_ns
        (N,) int64, increasing, N > 0.
    poses
        (N, 7) float64: translation x, y, z in metres, then quaternion x, y, z, w, as published.
    parents
        (N,) int32, indices of frames.
    sole_parent
        The parent, or -1 if it changes.
    """

    child: int
    static: bool
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    parents: NDArray[np.int32]
    sole_parent: int
    first_ns: int
    last_ns: int

    @property
    def translations(self) -> NDArray[np.float64]:
        """(N, 3) float64, metres, a view."""
        return self.poses[:, :3]

    @property
    def quaternions(self) -> NDArray[np.float64]:
        """(N, 4) float64 x, y, z, w, a view."""
        return self.poses[:, 3:]

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
        """Return the index of the parent at a stamp; outside the history, the nearest known one."""
        return self.sole_parent if self.sole_parent >= 0 else int(self.parents[self._older(stamp_ns)])

    @property
    def changes_ns(self) -> NDArray[np.int64]:
        """(K,) int64, increasing: the stamps from which on a parent is known, or another one."""
        changes: NDArray[np.int64] = self.stamps_ns[np.diff(self.parents, prepend=-1) != 0]
        return changes

    def during(self, stamp_ns: int) -> FrameHistory:
        """Return the samples from the last change of the parent before a stamp until the next one.

        The last of them is valid until the change, unchanged; it is there twice.
        """
        if self.static or self.sole_parent >= 0:
            return self
        changes = self.changes_ns
        next_change = int(changes.searchsorted(stamp_ns, "right"))
        begin = int(self.stamps_ns.searchsorted(changes[next_change - 1])) if next_change else 0
        stamps, poses = self.stamps_ns[begin:], self.poses[begin:]
        if next_change < changes.size:
            end_ns = changes[next_change] - 1
            end = int(stamps.searchsorted(end_ns, "right"))
            stamps, poses = stamps[:end], poses[:end]
            if stamps[-1] < end_ns:
                stamps, poses = np.append(stamps, end_ns), np.append(poses, poses[-1:], axis=0)
        parents = np.full(stamps.size, self.parents[begin])
        return FrameHistory(self.child, False, stamps, poses, parents, int(parents[0]), int(stamps[0]), int(stamps[-1]))

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


def _float_seconds(duration_ns: int) -> float:
    """Return seconds as ``ros::Duration::toSec`` rounds them."""
    seconds, nanoseconds = divmod(duration_ns, 1_000_000_000)
    return seconds + 1e-9 * nanoseconds
