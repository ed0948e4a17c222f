"""Poses of the robot at the stamps of messages, from the transforms of a recording or from its odometry messages.

Poses are interpolated by tf2's rules (see `pc2scan.tf.buffer`) and never extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.bags.topics import find_topics
from pc2scan.errors import DecodeError, RecordingError, TransformError, UsageError, name_list
from pc2scan.messages.odometry import ODOMETRY, decode_odometry
from pc2scan.text import counted
from pc2scan.tf.builder import TransformBuilder
from pc2scan.tf.reading import read_transforms

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.core.rigid import Rigid
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.placing import FrameOptions

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
        A nav_msgs/Odometry topic with the poses, which is used instead of the transforms.
    """

    pose_frame: str = ""
    base_frame: str = ""
    odom_topic: str = ""

    def __post_init__(self) -> None:
        if self.pose_frame and self.odom_topic:
            raise UsageError("`pose_frame` and `odom_topic` are two sources of poses; give only one of them")
        if self.base_frame and not self.is_requested:
            raise UsageError("`base_frame` needs `pose_frame` or `odom_topic`")

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
    message's frame; otherwise the frame farthest up that is fixed to the message's frame. With odometry messages it is
    their ``child_frame_id``.

    Parameters
    ----------
    options
        The requested poses.
    transforms
        All transforms of the recording.
    odometry
        The poses of odometry messages, as transforms; None if the poses are those of the transforms.
    frames
        ``header.frame_id`` and ``child_frame_id`` of odometry messages.
    """

    def __init__(
        self,
        options: PoseOptions,
        transforms: TransformBuffer,
        odometry: TransformBuffer | None = None,
        frames: tuple[str, str] = ("", ""),
    ) -> None:
        self._options = options
        self._transforms = transforms
        self._odometry = odometry
        self._odometry_frames = frames
        self._bases: dict[str, str] = {}
        self.pose_frame = options.pose_frame.removeprefix("/") or frames[0]

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
        if self._odometry is None:
            robot = self._transforms.lookup(self.pose_frame, base, stamp_ns)
        else:
            child = self._odometry_frames[1]
            robot = self._odometry.lookup(self.pose_frame, child, stamp_ns)
            if base != child:
                robot = robot.compose(self._transforms.lookup(child, base, stamp_ns))
        return PosesAtStamp(self.pose_frame, base, robot, self._transforms, sensor_frame, stamp_ns)

    def _base_of(self, sensor_frame: str) -> str:
        found = self._bases.get(sensor_frame)
        if found is None:
            found = self._options.base_frame.removeprefix("/") or self._odometry_frames[1]
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


def open_poses(readers: Sequence[Reader], frames: FrameOptions, options: PoseOptions) -> tuple[Poses, list[str]]:
    """Read the poses of recordings; return them and warnings.

    Parameters
    ----------
    readers
        The source first, then the recordings of ``tf_from``.
    frames
        The source of transforms.
    options
        The requested poses.

    Raises
    ------
    UsageError
        If a frame or the topic does not exist, or if it is not clear which transforms to use.
    RecordingError
        If the topic has no poses.
    """
    transforms, warnings = read_transforms(readers, frames)
    if options.odom_topic:
        odometry, names, further = _read_odometry(readers[0], options)
        return Poses(options, transforms, odometry, names), [*warnings, *further]
    known = set(transforms.frames)
    for option, name in (("pose_frame", options.pose_frame), ("base_frame", options.base_frame)):
        if name and name.removeprefix("/") not in known:
            from pc2scan.text import did_you_mean  # noqa: PLC0415  # only for errors

            near = did_you_mean(name, sorted(known))
            hint = f"{near} frames: {name_list(sorted(known))}".strip()
            if not known:
                hint = "the recording has no transforms; `odom_topic` reads poses from a nav_msgs/Odometry topic"
            raise UsageError(f"`{option}`: no transforms have the frame {name!r}", path=readers[0].path, hint=hint)
    return Poses(options, transforms), warnings


def _read_odometry(reader: Reader, options: PoseOptions) -> tuple[TransformBuffer, tuple[str, str], list[str]]:
    """Read odometry messages as transforms, with the names of their frames."""
    types: dict[str, set[str]] = {}
    for connection in reader.connections:
        types.setdefault(connection.topic, set()).add(connection.ros_type)
    fitting = sorted(topic for topic, kinds in types.items() if ODOMETRY in kinds)
    if len(topics := find_topics(options.odom_topic, types, fitting, ODOMETRY)) > 1:
        raise UsageError(f"`odom_topic`: {options.odom_topic} is {len(topics)} topics: {name_list(sorted(topics))}")
    topic = topics[0]
    connections = [each for each in reader.connections if each.topic == topic and each.ros_version is not None]
    builder, frames, wrong = TransformBuilder(), None, 0
    for message in reader.messages(connections):
        try:
            row = decode_odometry(message.data, message.connection.serialization)
        except DecodeError:
            wrong += 1
            continue
        parent, child, *pose = row
        if frames is None:
            # Simple drivers leave names empty; the requested base frame is then the robot's.
            frames = (parent.removeprefix("/") or "odom", child.removeprefix("/") or options.base_frame or _BASES[0])
        builder.add([(frames[0], frames[1], *pose)], static=False)  # type: ignore[list-item]
    if frames is None:
        raise RecordingError("has no poses", path=reader.path, topic=topic)
    buffer = builder.build()
    texts = [f"{topic}: {counted(wrong, 'message')} cannot be decoded"] if wrong else []
    texts += [f"{topic}: {counted(each.count, 'pose')} not usable: {each.reason}" for each in buffer.rejections]
    return buffer, frames, texts
