"""The direction of up in a frame at a stamp: by a frame whose z axis points up, or by an IMU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from pc2scan.core.gravity import LONGEST_GAP_NS, Up, up_in
from pc2scan.errors import TransformError, stamp_text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .buffer import TransformBuffer

#: Returns the direction of up in a frame at a stamp; a TransformError if it is unknown.
UpSource: TypeAlias = Callable[[str, int], Up]


@dataclass(frozen=True, slots=True)
class UpByFrame:
    """Up as the z axis of a frame that does not move.

    Attributes
    ----------
    fixed_frame
        The frame.
    buffer, tolerance_ns
        See `pc2scan.transforms.placing.Placer`.
    """

    fixed_frame: str
    buffer: TransformBuffer
    tolerance_ns: int = 0

    def __call__(self, frame: str, stamp_ns: int) -> Up:
        """Return up; see `UpSource`."""
        return up_in(self.buffer.lookup(self.fixed_frame, frame, stamp_ns, self.tolerance_ns).quaternion.tolist())


@dataclass(frozen=True, slots=True, eq=False)
class UpByImu:
    """Up as measured by an IMU, in its frame, at the stamps of its messages.

    Attributes
    ----------
    topic, imu_frame
        Topic and frame of the IMU.
    stamps_ns
        (N,) increasing, N > 0.
    directions
        (N, 3) directions of up in the IMU's frame.
    buffer, tolerance_ns
        See `pc2scan.transforms.placing.Placer`.
    """

    topic: str
    imu_frame: str
    stamps_ns: NDArray[np.int64]
    directions: NDArray[np.float64]
    buffer: TransformBuffer
    tolerance_ns: int = 0

    def __call__(self, frame: str, stamp_ns: int) -> Up:
        """Return up, interpolated linearly between two messages; see `UpSource`."""
        up: NDArray[np.float64] = self._up_of_imu(stamp_ns)
        if frame.removeprefix("/") == self.imu_frame.removeprefix("/"):
            x, y, z = up.tolist()
        else:
            try:
                moved = self.buffer.lookup(frame, self.imu_frame, stamp_ns, self.tolerance_ns)
            except TransformError as err:
                err.message = f"the IMU of {self.topic}: {err.message}"
                err.hint = (
                    f"say how it is mounted: `static_tf='{frame} {self.imu_frame} 0 0 0 ROLL PITCH YAW'`; "
                    f"`imu={self.topic}:FRAME` corrects its frame"
                )
                raise
            x, y, z = (moved.matrix @ up).tolist()
        return (x, y, z)

    def _up_of_imu(self, stamp_ns: int) -> NDArray[np.float64]:
        """Return up in the IMU's frame, not of unit length."""
        stamps = self.stamps_ns
        at_ns = min(max(stamp_ns, int(stamps[0])), int(stamps[-1]))
        newer = int(stamps.searchsorted(at_ns))
        older = newer if stamps[newer] == at_ns else newer - 1
        begin_ns, end_ns = int(stamps[older]), int(stamps[newer])
        if abs(stamp_ns - at_ns) > self.tolerance_ns or end_ns - begin_ns > LONGEST_GAP_NS:
            near = " and ".join(map(stamp_text, dict.fromkeys((begin_ns, end_ns))))
            raise TransformError(
                f"the direction of up is not known at {stamp_text(stamp_ns)}: the nearest messages on {self.topic} are "
                f"at {near}, the tolerance is {stamp_text(self.tolerance_ns)} s, and the largest gap "
                f"{LONGEST_GAP_NS / 1e9:g} s",
                stamp_ns=stamp_ns,
                hint="`fixed_frame` levels by transforms instead; `transform_tolerance` allows messages farther away",
            )
        ratio = (at_ns - begin_ns) / max(end_ns - begin_ns, 1)
        between: NDArray[np.float64] = (1 - ratio) * self.directions[older] + ratio * self.directions[newer]
        # There is no direction between two opposite ones.
        return between if between.any() else self.directions[older]
