"""The sources of transforms besides the topics of transforms: topics with poses, trajectories, and robots' models.

Poses say where one frame is in another one. They become transforms of the robot's tree: if the frame that has the poses
is mounted on another one (a lidar whose odometry is in the recording), the transforms are those of the frame at the
top, because a frame has only one parent in tf2. They replace the recording's own transforms of this frame.
"""

from __future__ import annotations

from array import array
from decimal import Decimal, InvalidOperation
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.bags.topics import find_topics, types_by_topic
from pc2scan.core.rigid import are_accepted, compose_poses
from pc2scan.errors import DecodeError, UsageError, name_list
from pc2scan.messages.poses import POSES, decode_pose
from pc2scan.text import counted

from .frames import top_of
from .text_files import open_bounded

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.core.rigid import Pose, TransformRow
    from pc2scan.model import Connection, RawMessage

    from .buffer import TransformBuffer
    from .builder import TransformBuilder
    from .static import RobotModel, StaticTransform

#: The frame of reference of odometry whose messages do not name it.
_UNNAMED = "odom"

#: The largest file: some million poses.
_MAX_BYTES = 500_000_000

#: Numbers of a line.
_COLUMNS = 8

#: Whole numbers from here on are nanoseconds: as seconds they would be after the year 5000.
_NANOSECONDS = 100_000_000_000

#: Stamps are before this: sums of them and offsets fit into 64 bits. It is in the year 2116.
_MOST_NS = 1 << 62

#: Characters of a line; a longer one has too many values.
_MAX_LINE = 1 << 16


class PoseTopic(NamedTuple):
    """A requested topic with poses.

    Attributes
    ----------
    topic
        Its name.
    parent, child
        The frames; empty: as the messages say.
    unnamed
        The frame that has the poses, if neither says: simple drivers leave names empty.
    """

    topic: str
    parent: str = ""
    child: str = ""
    unnamed: str = "base_link"

    @classmethod
    def parse(cls, text: str) -> PoseTopic:
        """Read ``TOPIC``, ``TOPIC:CHILD`` or ``TOPIC:PARENT:CHILD``.

        Raises
        ------
        UsageError
            If it is something else.
        """
        topic, *frames = text.split(":")
        if not topic or len(frames) > 2 or not all(frames):
            raise UsageError(
                f"`odom_topic` is {text!r}, it must be a topic, and may have frames",
                hint="write `odom_topic=/odom`; `odom_topic=/pose:base_link` names the frame that has the poses, "
                "`odom_topic=/pose:map:base_link` both frames",
            )
        parent, child = ("", *frames)[-2:] if frames else ("", "")
        return cls(topic, parent.removeprefix("/"), child.removeprefix("/"))

    def connections(self, connections: Sequence[Connection]) -> list[Connection]:
        """Return the connections of the topic.

        Raises
        ------
        TopicError
            If there is no such topic, or it has no poses.
        UsageError
            If it is several topics, or its messages do not name the frame that has the poses.
        """
        types = types_by_topic(connections)
        fitting = sorted(topic for topic, kinds in types.items() if not kinds.isdisjoint(POSES))
        if len(topics := find_topics(self.topic, types, fitting, *POSES)) > 1:
            raise UsageError(f"`odom_topic`: {self.topic} is {len(topics)} topics: {name_list(sorted(topics))}")
        own = [
            connection for connection in connections if connection.topic == topics[0] and connection.ros_type in POSES
        ]
        nameless = next((connection.ros_type for connection in own if not POSES[connection.ros_type]), None)
        if nameless is not None and not self.child:
            raise UsageError(
                f"`odom_topic`: {topics[0]} is {nameless}, whose messages do not name the frame that has the pose",
                hint=f"name it: `odom_topic={topics[0]}:base_link`",
            )
        return [connection for connection in own if connection.ros_version is not None]


class PoseReading:
    """The poses of a topic, while it is read.

    Parameters
    ----------
    request
        The topic.
    connections
        Its connections, for the output.

    Attributes
    ----------
    topic
        Its name.
    """

    def __init__(self, request: PoseTopic, connections: Sequence[Connection]) -> None:
        self.topic = connections[0].topic if connections else request.topic
        self.connections = connections
        self._request = request
        #: By the frames: stamps, and seven numbers a pose.
        self._poses: dict[tuple[str, str], tuple[array[int], array[float]]] = {}
        self._wrong = 0

    def frames_of(self, parent: str, child: str) -> tuple[str, str]:
        """Return the frames of the poses of a message with these frames."""
        return (
            self._request.parent or parent.removeprefix("/") or _UNNAMED,
            self._request.child or child.removeprefix("/") or self._request.unnamed,
        )

    def add(self, message: RawMessage) -> None:
        """Add the pose of a message, or count it if it cannot be decoded."""
        connection = message.connection
        try:
            row = decode_pose(message.data, connection.serialization, connection.ros_type)
        except DecodeError:
            self._wrong += 1
            return
        parent, child, stamp_ns, *pose = row
        stamps, poses = self._poses.setdefault(self.frames_of(parent, child), (array("q"), array("d")))
        stamps.append(stamp_ns)
        poses.extend(pose)

    def finish(self) -> tuple[list[Trajectory], list[str]]:
        """Return the poses by their frames, and warnings."""
        texts = [f"{self.topic}: {counted(self._wrong, 'message')} cannot be decoded"] if self._wrong else []
        trajectories = [
            Trajectory(self.topic, *frames, np.frombuffer(stamps, np.int64), np.frombuffer(poses).reshape(-1, 7))
            for frames, (stamps, poses) in self._poses.items()
        ]
        return trajectories, texts


class PoseAttachment(NamedTuple):
    """How poses become transforms of the robot's tree.

    Attributes
    ----------
    parent, frame
        The frames of the transforms.
    child_from_frame
        The pose of ``frame`` in the frame that has the poses; None if they are the same.
    replaced
        The frames whose recorded transforms they replace: ``frame``, and ``parent`` if it is below ``frame``, as where
        the two were swapped.
    """

    parent: str
    frame: str
    child_from_frame: Pose | None
    replaced: tuple[str, ...]

    def row(self, stamp_ns: int, pose: Pose) -> TransformRow:
        """Return the transform of a pose."""
        pose = pose if self.child_from_frame is None else compose_poses(pose, self.child_from_frame)
        return (self.parent, self.frame, stamp_ns, *pose)


class AddedPoses(NamedTuple):
    """Poses of a topic or a file that became transforms.

    Attributes
    ----------
    name
        The topic or the file.
    reading
        The topic; None for a file.
    trajectories
        The poses.
    attachments
        How they became transforms, by the frames of the poses.
    """

    name: str
    reading: PoseReading | None
    trajectories: Sequence[Trajectory]
    attachments: Mapping[tuple[str, str], PoseAttachment]


def attach(buffer: TransformBuffer, parent: str, child: str) -> PoseAttachment:
    """Return the frame that the poses of a frame move: the topmost one that it is fixed to.

    Parameters
    ----------
    buffer
        All other transforms.
    parent, child
        The frames of the poses.
    """
    frame = child
    for above in buffer.above(child):
        if above == parent or not buffer.is_rigid(above, child):
            break
        frame = above
    replaced: tuple[str, ...] = (frame, parent) if buffer.above(parent)[:1] == [frame] else (frame,)
    return PoseAttachment(parent, frame, None if frame == child else buffer.lookup(child, frame, 0).pose, replaced)


def add_trajectory(builder: TransformBuilder, trajectory: Trajectory, attachment: PoseAttachment) -> None:
    """Add the transforms that a trajectory's poses are."""
    poses = trajectory.poses
    if attachment.child_from_frame is not None:
        moved = compose_poses(tuple(poses.T), attachment.child_from_frame)
        poses = np.stack([np.broadcast_to(np.asarray(pose), len(poses)) for pose in moved], axis=1)
    builder.add_poses(attachment.parent, attachment.frame, trajectory.stamps_ns, poses)


def joints_to_add(models: Iterable[RobotModel], pairs: Iterable[tuple[str, str]]) -> Iterator[StaticTransform]:
    """Yield the fixed joints of models that connect frames which nothing else connects.

    Parameters
    ----------
    pairs
        Parent and child of all other transforms, which have precedence.
    """
    tops: dict[str, str] = {}
    children = set()
    for parent, child in pairs:
        children.add(child)
        tops[top_of(tops, child)] = top_of(tops, parent)
    for model in models:
        for joint in model.joints:
            parent, child = joint.parent.removeprefix("/"), joint.child.removeprefix("/")
            if child not in children and top_of(tops, parent) != top_of(tops, child):
                children.add(child)
                tops[top_of(tops, child)] = top_of(tops, parent)
                yield joint


class Trajectory(NamedTuple):
    """Poses of one frame in another one.

    Attributes
    ----------
    name
        The file, or the topic.
    parent, child
        The frames: ``parent_from_child``.
    stamps_ns
        (N,) int64 nanoseconds, in the order of the file.
    poses
        (N, 7) float64: translation x, y, z in metres, rotation x, y, z, w as written.
    """

    name: str
    parent: str
    child: str
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]

    @property
    def first_ns(self) -> int:
        """The earliest stamp."""
        return int(self.stamps_ns.min())

    @property
    def last_ns(self) -> int:
        """The latest stamp."""
        return int(self.stamps_ns.max())

    def moved(self, offset_ns: int) -> Trajectory:
        """Return the same poses at other times: ``offset_ns`` is added to their stamps."""
        return self._replace(stamps_ns=self.stamps_ns + offset_ns) if offset_ns else self


def frames_of_trajectory(text: str) -> tuple[str, str]:
    """Read ``PARENT:CHILD``, the frames of a trajectory.

    Raises
    ------
    UsageError
        If it is something else, or both are the same.
    """
    parent, _, child = text.partition(":")
    if not parent or not child or ":" in child or parent.removeprefix("/") == child.removeprefix("/"):
        raise UsageError(
            f"`trajectory_frames` is {text!r}, it must be two frames",
            hint="write `trajectory_frames=odom:base_link` if the poses are those of base_link in odom; programs that "
            "match clouds usually write those of the lidar: `trajectory_frames=odom:LIDAR`",
        )
    return parent.removeprefix("/"), child.removeprefix("/")


def load_trajectory(path: Path, frames: tuple[str, str]) -> Trajectory:
    """Read a trajectory.

    Parameters
    ----------
    path
        A file in TUM's format. Empty lines, and what follows a ``#``, are ignored.
    frames
        The poses are those of the second frame in the first one.

    Raises
    ------
    UsageError
        If a file cannot be read, or a line is not a pose; the error has the line.
    """
    stamps, numbers, values = array("q"), array("q"), array("d")
    with open_bounded(path, _MAX_BYTES, "a trajectory") as file:
        for number, line in enumerate(iter(partial(file.readline, _MAX_LINE), ""), 1):
            words = line.partition("#")[0].replace(",", " ").split()
            if not words:
                continue
            if len(words) != _COLUMNS:
                message = f"line {number}: has {len(words)} values; a pose has {_COLUMNS}"
                raise UsageError(f"{message} (TUM: stamp x y z qx qy qz qw); evo_traj writes such files", path=path)
            stamps.append(_stamp(words[0], path, number))
            numbers.append(number)
            try:
                values.extend(map(float, words[1:]))
            except ValueError:
                raise UsageError(f"line {number}: {' '.join(words)[:80]!r} are not numbers", path=path) from None
    if not stamps:
        raise UsageError("has no pose", path=path)
    poses = np.array(values).reshape(-1, _COLUMNS - 1)
    if (wrong := np.flatnonzero(~np.isfinite(poses).all(axis=1))).size:
        raise UsageError(f"line {numbers[wrong[0]]}: has a number that is not finite", path=path)
    if (wrong := np.flatnonzero(~are_accepted(poses[:, 3:]))).size:
        shown = " ".join(f"{value:g}" for value in poses[wrong[0], 3:])
        raise UsageError(
            f"line {numbers[wrong[0]]}: the quaternion {shown} is not of unit length",
            path=path,
            hint="its order is qx qy qz qw; if that is right, normalise it",
        )
    return Trajectory(str(path), *frames, np.array(stamps), poses)


def _stamp(word: str, path: Path, number: int) -> int:
    """Return a stamp in nanoseconds: seconds, with all digits that are written, or nanoseconds."""
    try:
        value = Decimal(word)
        if value.is_finite() and abs(value) < _MOST_NS:
            stamp_ns = int(value if abs(value) >= _NANOSECONDS else (value * 1_000_000_000).to_integral_value())
            if abs(stamp_ns) < _MOST_NS:
                return stamp_ns
    except InvalidOperation:
        pass
    raise UsageError(
        f"line {number}: {word[:80]!r} is not a stamp", path=path, hint="seconds, or nanoseconds, since 1970"
    )
