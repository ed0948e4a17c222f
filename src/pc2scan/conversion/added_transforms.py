"""Writes the transforms that a conversion used, and that the recording does not have, into the destination.

Poses of a topic are written as transforms at the log times of their messages, those of a file at their stamps, both to
the topic with the moving transforms. The recording's own transforms of the same frames are left out of it: a frame has
one parent. Added static transforms go to ``/tf_static``, if the user wants that.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, cast

import numpy as np

from pc2scan.core.rule import NO_POINTS
from pc2scan.errors import MessageError
from pc2scan.messages.definitions import definition
from pc2scan.messages.poses import decode_pose
from pc2scan.messages.tfmessage import decode_transforms, encode_transforms
from pc2scan.model import MAX_ROSBAG2_NS as LAST_NS
from pc2scan.model import NEW_ID, TF_QOS, Connection, StoredChunk
from pc2scan.transforms.reading import tf_connections

from .plan import Output
from .report import TopicReport
from .steps import ConvertedMessage, as_it_is

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterator, Mapping, Sequence

    from pc2scan.advice.survey import Span
    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.core.rigid import Pose, TransformRow
    from pc2scan.model import Buffer, Writer
    from pc2scan.transforms.placing import FrameOptions, LevelTransform
    from pc2scan.transforms.sources import AddedPoses, Attachment, PoseReading

    from .declarations import RecordingTopics
    from .items import Item
    from .plan import Route


@dataclass(slots=True)
class AddedTopic:
    """A topic that one message is written to: its entry in the report, and the writer's handle."""

    report: TopicReport
    handle: int = -1


@dataclass(slots=True)
class TrajectoryWriter:
    """Writes the transforms of a trajectory, each before the first message that is logged later.

    Attributes
    ----------
    rows, count
        The transforms, by stamp, and how many they are.
    serialization
        That of the destination.
    report
        The report's entry that counts them.
    first_ns
        The time of the earliest transform: log times are not before.
    handle
        The writer's handle of their topic.
    """

    rows: Iterator[TransformRow]
    count: int
    serialization: str
    report: TopicReport
    first_ns: int
    handle: int = -1
    _next: TransformRow | None = None

    def __post_init__(self) -> None:
        self._next = next(self.rows, None)

    def write_until(self, log_time_ns: int, writer: Writer) -> None:
        """Write all transforms up to a log time."""
        while self._next is not None and self._next[2] <= log_time_ns:
            row, self._next = self._next, next(self.rows, None)
            time_ns = max(row[2], self.first_ns)
            # A stamp that the destination cannot store is far from any message.
            with suppress(MessageError):
                writer.write(self.handle, time_ns, encode_transforms([row], self.serialization), time_ns)
                self.report.messages_out += 1


def add_poses(
    reader: Reader,
    frames: FrameOptions,
    added: Sequence[AddedPoses],
    routes: Mapping[int, Route],
    entries: list[TopicReport],
    topics: RecordingTopics,
    span: Span,
) -> list[TrajectoryWriter]:
    """Let routes write poses as transforms, before the topics are declared; return what writes those of files.

    Parameters
    ----------
    reader, frames
        The source, and the options about transforms.
    added
        The poses that were used.
    routes, entries
        The routes, and the report's entries, which are changed.
    topics
        The topics of the destination.
    span
        The cut.
    """
    target = topics.target
    children = {name for poses in added for attachment in poses.attachments.values() for name in attachment.replaced}
    for connection in tf_connections(reader.connections, frames.tf_topics):
        route = routes[connection.id]
        if route.handle >= 0 and not connection.is_static:
            route.reencode = partial(_without, children, connection.serialization, target.serialization)
    shared = tf_connection(reader, frames, target)
    files: list[TrajectoryWriter] = []
    outputs: list[Output] = []
    for poses in added:
        if poses.reading is None:
            rows, count = _rows_in(poses, span, reader.summary.end_ns)
            entry = TopicReport(shared.topic, TFMESSAGE, shared.topic, "added", f"from {poses.name}")
            entries.append(entry)
            files.append(TrajectoryWriter(rows, count, target.serialization, entry, span.first_ns))
            continue
        for connection in poses.reading.connections:
            entry = TopicReport(connection.topic, connection.ros_type, shared.topic, "added", "its poses as transforms")
            entries.append(entry)
            route = routes[connection.id]
            if route.handle < 0 and route.report is not None:
                # Only counted until now.
                entries.remove(route.report)
                route.report = None
            step = partial(_as_transform, poses.reading, poses.attachments, connection, target.serialization)
            route.decode, route.steps = as_it_is, [(step,)]
            route.outputs.append(Output(None, shared.topic, report=entry))
            outputs.append(route.outputs[-1])
    topics.add(shared, *outputs, *files)
    return files


def between(
    items: Generator[Item | StoredChunk], trajectories: Sequence[TrajectoryWriter], writer: Writer
) -> Generator[Item | StoredChunk]:
    """Yield items, and write transforms of files before each that is logged later; all others at the end."""
    for item in items:
        if not isinstance(item, StoredChunk):
            for trajectory in trajectories:
                trajectory.write_until(item.log_time_ns, writer)
        yield item
    for trajectory in trajectories:
        trajectory.write_until(LAST_NS, writer)


def _as_transform(
    reading: PoseReading,
    attachments: Mapping[tuple[str, str], Attachment],
    connection: Connection,
    serialization: str,
    data: Buffer,
) -> ConvertedMessage:
    """Return a message with the transform that a pose became."""
    parent, child, stamp_ns, *pose = decode_pose(data, connection.serialization, connection.ros_type)
    attachment = attachments.get(reading.frames_of(parent, child))
    rows = [] if attachment is None else [attachment.row(stamp_ns, cast("Pose", tuple(pose)))]
    message = encode_transforms(rows, serialization)
    return ConvertedMessage(message, NO_POINTS, empty=False, size=len(message))


def _without(children: Collection[str], source: str, target: str, data: Buffer) -> Buffer:
    """Return a message with transforms without those of some frames."""
    rows = decode_transforms(data, source)
    return encode_transforms([row for row in rows if row[1].removeprefix("/") not in children], target)


def _rows_in(added: AddedPoses, span: Span, end_ns: int | None) -> tuple[Iterator[TransformRow], int]:
    """Yield the transforms of a trajectory during the cut, by stamp, with the last one before and the first after.

    The second result is their number. Rows are made one by one: a million of them would take half a gigabyte.
    """
    used = [each for each in added.trajectories if (each.parent, each.child) in added.attachments]
    stamps_ns = np.concatenate([np.empty(0, np.int64), *(each.stamps_ns for each in used)])
    owners = np.repeat(np.arange(len(used)), [len(each.stamps_ns) for each in used])
    order = np.argsort(stamps_ns, kind="stable")
    last_ns = min(each for each in (span.stop_ns, end_ns, 2**63 - 1) if each is not None)
    begin = max(0, int(np.searchsorted(stamps_ns, span.first_ns, "right", order)) - 1)
    places = order[begin : int(np.searchsorted(stamps_ns, last_ns, "right", order)) + 1]
    poses = np.concatenate([np.empty((0, 7)), *(each.poses for each in used)])

    def row(place: int) -> TransformRow:
        trajectory = used[owners[place]]
        pose = cast("Pose", tuple(poses[place].tolist()))
        return added.attachments[trajectory.parent, trajectory.child].row(int(stamps_ns[place]), pose)

    return map(row, places), len(places)


TFMESSAGE = "tf2_msgs/msg/TFMessage"


def tf_connection(reader: Reader, frames: FrameOptions, target: Destination) -> Connection:
    """Return the connection of new transforms: one more publisher of the topic that has the moving ones."""
    moving = [c for c in tf_connections(reader.connections, frames.tf_topics) if not c.is_static]
    first = moving[0] if moving else None
    if first is not None and first.ros_version == target.ros_version and first.definition.data:
        # ROS 1 has two types with the same layout; all publishers of a topic have the same type.
        msgtype, text, digest = first.msgtype, first.definition, first.digest
    else:
        msgtype = TFMESSAGE
        text, digest = definition(msgtype, target.ros_version)
    return Connection(
        id=NEW_ID,
        topic="/tf" if first is None else first.topic,
        msgtype=msgtype,
        serialization=target.serialization,
        definition=text,
        digest=digest,
        callerid="/pc2scan" if target.ros_version == 1 else None,
        qos=TF_QOS if target.ros_version == 2 else "",
    )


@dataclass(slots=True)
class LevelFrames:
    """Writes the transforms of the level frames.

    Attributes
    ----------
    serialization
        The serialisation of the destination.
    report
        The report's entry that counts them.
    handle
        The writer's handle of `tf_connection`.
    """

    serialization: str
    report: TopicReport
    handle: int = -1
    _written: set[tuple[str, int]] = field(default_factory=set)

    def write(self, level: LevelTransform, log_time_ns: int, publish_time_ns: int, writer: Writer) -> None:
        """Write the transform of a scan, unless it was written for another scan of the same frame and stamp.

        Raises
        ------
        UnwritableError
            If the destination cannot store it.
        """
        _, name, stamp_ns, *_ = level.row
        if (name, stamp_ns) not in self._written:
            data = encode_transforms([level.row], self.serialization)
            writer.write(self.handle, log_time_ns, data, publish_time_ns)
            self._written.add((name, stamp_ns))
            self.report.messages_out += 1
