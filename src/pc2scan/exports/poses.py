"""Poses of the robot at the stamps of messages, from the transforms of a recording.

Poses are interpolated by tf2's rules (see `pc2scan.transforms.buffer`) and never extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pc2scan.advice.odometry import odometry_of
from pc2scan.errors import TransformError, UsageError, name_list
from pc2scan.text import did_you_mean
from pc2scan.transforms.reading import read_transforms

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.core.rigid import Rigid
    from pc2scan.progress import Meter
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import FrameOptions
    from pc2scan.transforms.sources import Attachment

#: Usual names of the robot's frame, the best one first.
_BASES = ("base_link", "base_footprint")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOptions:
    """The requested poses.

    Attributes
    ----------
    pose_frame
        The frame of reference of the poses, such as ``odom`` or ``map``.
    base_frame
        The frame that has these poses. Empty: found from the transforms (see `Poses`).
    odom_topic
        Topics whose poses are used as transforms: without ``pose_frame``, the poses are those of the first one.
    """

    pose_frame: str = ""
    base_frame: str = ""
    odom_topic: tuple[str, ...] = ()

    @property
    def is_requested(self) -> bool:
        """Whether poses are requested."""
        return bool(self.pose_frame or self.odom_topic)


@dataclass(frozen=True, slots=True)
class PosesAtStamp:
    """The poses of the robot, and of a message's sensor, at the message's stamp.

    Attributes
    ----------
    pose_frame, base_frame
        The frame of reference of the pose, and the frame that has it.
    robot
        The pose of ``base_frame`` in ``pose_frame``.
    """

    pose_frame: str
    base_frame: str
    robot: Rigid
    _buffer: TransformBuffer
    _sensor_frame: str
    _stamp_ns: int

    def sensor(self) -> Rigid:
        """Return the pose of the message's own frame in ``pose_frame``.

        Raises
        ------
        TransformError
            If there is no transform from ``base_frame`` to the message's frame.
        """
        mount = self._buffer.lookup(self.base_frame, self._sensor_frame, self._stamp_ns)
        return self.robot.compose(mount)


class Poses:
    """The poses of a recording.

    The base frame, if none is given: ``base_link``, or else ``base_footprint``, if it is between the pose frame and the
    message's frame; otherwise the frame farthest up that is fixed to the message's frame. With ``odom_topic`` alone it
    is the frame that its poses move.

    Parameters
    ----------
    options
        The requested poses.
    transforms
        All transforms of the recording.
    odometry
        What the poses of ``odom_topic`` became; None without.
    """

    def __init__(
        self,
        options: PoseOptions,
        transforms: TransformBuffer,
        odometry: Attachment | None = None,
    ) -> None:
        self._options = options
        self._transforms = transforms
        self._odometry = None if options.pose_frame else odometry
        self._bases: dict[str, str] = {}
        self.pose_frame = options.pose_frame.removeprefix("/") or ("" if odometry is None else odometry.parent)

    def at(self, sensor_frame: str, stamp_ns: int) -> PosesAtStamp:
        """Return the poses at the stamp of a message.

        Raises
        ------
        TransformError
            If there is no pose at the stamp, or the stamp is 0.
        """
        if stamp_ns == 0:
            raise TransformError("its stamp is 0, so the robot's pose is unknown", stamp_ns=0)
        base = self._base_of(sensor_frame)
        robot = self._transforms.lookup(self.pose_frame, base, stamp_ns)
        return PosesAtStamp(self.pose_frame, base, robot, self._transforms, sensor_frame, stamp_ns)

    def doubts(self) -> Iterator[str]:
        """Yield what may be wrong with the poses that were read."""
        for base in dict.fromkeys(self._bases.values()):
            if doubt := odometry_of(self._transforms, self.pose_frame, base).doubt:
                yield doubt

    def _base_of(self, sensor_frame: str) -> str:
        found = self._bases.get(sensor_frame)
        if found is None:
            found = self._options.base_frame.removeprefix("/") or (
                "" if self._odometry is None else self._odometry.frame
            )
            self._bases[sensor_frame] = found = found or find_base(self._transforms, self.pose_frame, sensor_frame)
        return found


def find_base(transforms: TransformBuffer, pose_frame: str, sensor_frame: str) -> str:
    """Return the robot's frame, between a frame that it moves in and one of its sensors; see `Poses`."""
    frame = sensor_frame.removeprefix("/")
    below, fixed = [frame], frame
    is_fixed = True
    while (history := transforms.history(frame)) is not None:
        frame = transforms.frames[history.parent_at(None)]
        if frame == pose_frame or frame in below:
            break
        below.append(frame)
        is_fixed &= history.static
        fixed = frame if is_fixed else fixed
    if len(below) == 1 and frame not in transforms.frames:
        # The frame has no transforms, for example a level frame that was made for the scans.
        below += transforms.frames
    return next((name for name in _BASES if name in below), fixed)


def open_poses(
    readers: Sequence[Reader],
    frames: FrameOptions,
    options: PoseOptions,
    meter: Meter | None = None,
) -> tuple[Poses, list[str]]:
    """Read the poses of recordings; return them and warnings.

    Parameters
    ----------
    readers
        The source first, then the recordings of ``tf_from``.
    frames
        The source of transforms.
    options
        The requested poses.
    meter
        Counts the bytes; None: nothing is reported.

    Raises
    ------
    UsageError
        If a frame or the topic does not exist, or if it is not clear which transforms to use.
    RecordingError
        If the topic has no poses.
    """
    if options.base_frame and frames.odometry:
        unnamed = options.base_frame.removeprefix("/")
        frames = replace(frames, odometry=tuple(each._replace(unnamed=unnamed) for each in frames.odometry))
    needed = (options.pose_frame, options.base_frame)
    found = read_transforms(readers, frames, needed=needed, meter=meter)
    known = set(found.buffer.frames)
    for option, name in (("pose_frame", options.pose_frame), ("base_frame", options.base_frame)):
        if name and name.removeprefix("/") not in known:
            near = did_you_mean(name, sorted(known))
            hint = f"{near} frames: {name_list(sorted(known))}".strip()
            if not known:
                hint = "the recording has no transforms; `odom_topic` uses the poses of an odometry topic"
            raise UsageError(f"`{option}`: no transforms have the frame {name!r}", path=readers[0].path, hint=hint)
    own = next((each for added in found.poses if added.reading for each in added.attachments.values()), None)
    return Poses(options, found.buffer, own), [*found.warnings, *found.notes]
