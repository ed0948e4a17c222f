"""The options about frames, the frame in which a message is converted, the transform to it, and which way is up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from pc2scan.core.gravity import LONGEST_GAP_NS, Up, tilt, up_in, upright_rotation
from pc2scan.errors import TransformError, UnconnectedError, stamp_text

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from pc2scan.core.rigid import Rigid, TransformRow

    from .attitude import UpEstimate
    from .buffer import TransformBuffer
    from .sources import PoseTopic, Trajectory
    from .static import RobotModel, StaticTransform

#: The name of a level frame: the name of the frame that it is made from, and this suffix.
STABILIZED = "_stabilized"


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameOptions:
    """The options of a conversion about frames.

    Attributes
    ----------
    tf_topics
        Topics of the transforms; empty means ``/tf`` and ``/tf_static``, or those of the only namespace that has them.
    tf_from
        Further recordings to read transforms from.
    static
        Transforms that are added to the recording's.
    odometry
        Topics whose poses are used as transforms.
    trajectory
        Poses of a file that are used as transforms.
    model
        The robot's model; None: the recording's, if it has one.
    source_frame
        Replaces the ``frame_id`` of the messages to convert, if that is wrong or empty.
    write_static
        Whether to write the added static transforms to the destination's ``/tf_static``.
    """

    tf_topics: tuple[str, ...] = ()
    tf_from: tuple[Path, ...] = ()
    static: tuple[StaticTransform, ...] = ()
    odometry: tuple[PoseTopic, ...] = ()
    trajectory: Trajectory | None = None
    model: RobotModel | None = None
    source_frame: str = ""
    write_static: bool = False

    @property
    def adds_poses(self) -> bool:
        """Whether poses are added as transforms."""
        return bool(self.odometry) or self.trajectory is not None


class LevelFrame(NamedTuple):
    """A frame without roll and pitch, with the origin and the yaw of another frame.

    Attributes
    ----------
    frame
        The other frame.
    frame_from_level
        The rotation between the two.
    tilt
        The angle between the z axes of both, radians.
    """

    frame: str
    frame_from_level: Rigid
    tilt: float

    @property
    def name(self) -> str:
        """The name of the level frame."""
        return self.frame + STABILIZED

    def at(self, stamp_ns: int) -> LevelTransform:
        """Return the transform at a stamp: the level frame is a child of the other one."""
        row = (self.frame, self.name, stamp_ns, *self.frame_from_level.pose)
        return LevelTransform(row, self.tilt)


class LevelTransform(NamedTuple):
    """The transform of a level frame, as in a TFMessage, and its tilt, radians; see `LevelFrame`."""

    row: TransformRow
    tilt: float


class Placement(NamedTuple):
    """The output's ``frame_id``, and the transform to that frame (None if the message stays in its own).

    ``level`` is the output's frame, if it is made level.
    """

    frame_id: str
    target_from_source: Rigid | None
    level: LevelFrame | None = None


class Placer(NamedTuple):
    """The transforms of a conversion.

    Attributes
    ----------
    target_frame
        Empty if every message stays in its own frame.
    source_frame
        See `FrameOptions`.
    buffer
        None if nothing is transformed.
    tolerance_ns
        How far a stamp may be outside of the recorded transforms.
    up
        The direction of up, if messages are converted in a level frame. None: in the target frame itself.
    """

    target_frame: str = ""
    source_frame: str = ""
    buffer: TransformBuffer | None = None
    tolerance_ns: int = 0
    up: UpSource | None = None

    def place(self, frame_id: str, stamp_ns: int) -> Placement:
        """Return the frame and the transform for a message of this frame and stamp.

        Raises
        ------
        TransformError
            If there is no transform to the target frame at the stamp, or the direction of up is unknown.
        """
        target = self.target_frame
        transform = self.transform(target, frame_id, stamp_ns) if target else None
        target = target or self.source_frame or frame_id
        level = None if self.up is None else self.level(target, stamp_ns)
        if level is None:
            return Placement(target, transform)
        level_from_target = level.frame_from_level.inverse()
        return Placement(
            level.name, level_from_target if transform is None else level_from_target.compose(transform), level
        )

    def from_fixed(self, fixed: str, frame_id: str, stamp_ns: int) -> tuple[str, Rigid]:
        """Return the output's frame and the transform to it from a frame that does not move, at a scan's time.

        Parameters
        ----------
        fixed
            The frame that does not move.
        frame_id
            The frame of a message, which is used without a target frame.

        Raises
        ------
        TransformError
            As `place` does.
        """
        if self.buffer is None:
            raise ValueError("a fixed frame needs transforms")
        target = self.target_frame or self.source_frame or frame_id
        transform = self.buffer.lookup(target, fixed, stamp_ns, self.tolerance_ns)
        level = self.level(target, stamp_ns)
        if level is None:
            return target, transform
        return level.name, level.frame_from_level.inverse().compose(transform)

    def level(self, frame: str, stamp_ns: int) -> LevelFrame | None:
        """Return the level frame of a frame at a stamp; None if messages are not converted in one.

        Raises
        ------
        TransformError
            If the direction of up is unknown, or the recording has a frame of the level frame's name.
        """
        if self.up is None:
            return None
        up = self.up(frame, stamp_ns)
        level = LevelFrame(frame, upright_rotation(up), tilt(up))
        if self.buffer is not None and self.buffer.history(level.name) is not None:
            raise UnconnectedError(
                f"the recording already has a frame {level.name!r}, the name that `level` would use",
                stamp_ns=stamp_ns,
                hint=f"to use that frame, give `target_frame={level.name}` without `level`",
            )
        return level

    def transform(self, target: str, frame_id: str, stamp_ns: int) -> Rigid | None:
        """Return the transform from a message's frame to another frame at a stamp; None if they are the same.

        Raises
        ------
        TransformError
            If there is no transform to that frame at the stamp.
        """
        source = self.source_frame or frame_id
        # Source of the rule: upstream transforms only if the names differ; tf2 strips one leading slash.
        if self.buffer is None or target.removeprefix("/") == source.removeprefix("/"):
            return None
        return self.buffer.lookup(target, source, stamp_ns, self.tolerance_ns)

    def transform_stamp(self, frame_id: str, stamp_ns: int) -> int:
        """Return the stamp of the transform that `place` returns, in nanoseconds.

        That is the message's stamp; for the stamp 0, the time that `place` uses instead.

        Raises
        ------
        TransformError
            As `place` does.
        """
        if stamp_ns or self.buffer is None:
            return stamp_ns
        return self.buffer.latest_common_ns(self.target_frame, self.source_frame or frame_id)


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
        See `Placer`.
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
    estimate
        The directions of up in the IMU's frame; one at least.
    buffer, tolerance_ns
        See `Placer`.
    """

    estimate: UpEstimate
    buffer: TransformBuffer
    tolerance_ns: int = 0

    def __call__(self, frame: str, stamp_ns: int) -> Up:
        """Return up, interpolated linearly between two messages; see `UpSource`."""
        up: NDArray[np.float64] = self._up_of_imu(stamp_ns)
        if frame.removeprefix("/") == self.estimate.frame.removeprefix("/"):
            x, y, z = up.tolist()
        else:
            try:
                moved = self.buffer.lookup(frame, self.estimate.frame, stamp_ns, self.tolerance_ns)
            except TransformError as err:
                err.message = f"the IMU of {self.estimate.topic}: {err.message}"
                err.hint = (
                    f"say how it is mounted: `static_tf='{frame} {self.estimate.frame} 0 0 0 ROLL PITCH YAW'`; "
                    f"`imu={self.estimate.topic}:FRAME` corrects its frame"
                )
                raise
            x, y, z = (moved.matrix @ up).tolist()
        return (x, y, z)

    def _up_of_imu(self, stamp_ns: int) -> NDArray[np.float64]:
        """Return up in the IMU's frame, not of unit length."""
        topic, stamps, directions = self.estimate.topic, self.estimate.stamps_ns, self.estimate.directions
        at_ns = min(max(stamp_ns, int(stamps[0])), int(stamps[-1]))
        newer = int(stamps.searchsorted(at_ns))
        older = newer if stamps[newer] == at_ns else newer - 1
        begin_ns, end_ns = int(stamps[older]), int(stamps[newer])
        if abs(stamp_ns - at_ns) > self.tolerance_ns or end_ns - begin_ns > LONGEST_GAP_NS:
            near = " and ".join(map(stamp_text, dict.fromkeys((begin_ns, end_ns))))
            raise TransformError(
                f"the direction of up is not known at {stamp_text(stamp_ns)}: the nearest messages on {topic} are "
                f"at {near}, the tolerance is {stamp_text(self.tolerance_ns)} s, and the largest gap "
                f"{LONGEST_GAP_NS / 1e9:g} s",
                stamp_ns=stamp_ns,
                hint="`fixed_frame` levels by transforms instead; `transform_tolerance` allows messages farther away",
            )
        ratio = (at_ns - begin_ns) / max(end_ns - begin_ns, 1)
        between: NDArray[np.float64] = (1 - ratio) * directions[older] + ratio * directions[newer]
        # There is no direction between two opposite ones.
        return between if between.any() else directions[older]
