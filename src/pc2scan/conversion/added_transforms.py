"""Writes the transforms that a conversion used, and that the recording does not have, into the destination.

Poses of a topic are written as transforms at the log times of their messages, those of a file at their stamps, both to
the topic with the moving transforms. The recording's own transforms of the same frames are left out of it: a frame has
one parent. Added static transforms go to ``/tf_static``, if the user wants that.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, cast

import numpy as np

from pc2scan.core.rule import NO_POINTS
from pc2scan.errors import MessageError
from pc2scan.messages.poses import decode_pose
from pc2scan.messages.tfmessage import decode_transforms, encode_transforms
from pc2scan.model import StoredChunk

from .steps import ConvertedMessage

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from pc2scan.advice.survey import Span
    from pc2scan.core.rigid import Pose, TransformRow
    from pc2scan.model import Buffer, Connection, Writer
    from pc2scan.transforms.placing import LevelTransform
    from pc2scan.transforms.sources import AddedPoses, PoseAttachment, PoseReading

    from .engine import Items
    from .report import TopicReport


TFMESSAGE = "tf2_msgs/msg/TFMessage"


@dataclass(slots=True)
class AddedTransforms:
    """A topic that transforms are added to.

    Attributes
    ----------
    report
        The report's entry that counts the messages.
    serialization
        The destination's.
    handle
        The writer's handle.
    """

    report: TopicReport
    serialization: str
    handle: int = -1
    _written: set[tuple[str, int]] = field(default_factory=set)

    def write(self, rows: Sequence[TransformRow], log_time_ns: int, publish_time_ns: int, writer: Writer) -> None:
        """Write a message with transforms.

        Raises
        ------
        UnwritableError
            If the destination cannot store it.
        """
        writer.write(self.handle, log_time_ns, encode_transforms(rows, self.serialization), publish_time_ns)
        self.report.messages_out += 1

    def write_level(self, level: LevelTransform, log_time_ns: int, publish_time_ns: int, writer: Writer) -> None:
        """Write the transform of a level frame, unless it was written for another scan of this frame and stamp."""
        name_and_stamp = level.row[1], level.row[2]
        if name_and_stamp not in self._written:
            self.write([level.row], log_time_ns, publish_time_ns, writer)
            self._written.add(name_and_stamp)


def between(rows: Iterator[TransformRow], topic: AddedTransforms, first_ns: int, items: Items, writer: Writer) -> Items:
    """Yield items, and write each transform before the first that is logged later; the others at the end.

    Parameters
    ----------
    rows
        The transforms, by stamp.
    topic
        Where they are written, at their stamps, but not before ``first_ns``.
    """
    row = next(rows, None)
    for item in chain(items, [None]):
        while row is not None and not isinstance(item, StoredChunk) and (item is None or row[2] <= item.log_time_ns):
            time_ns = max(row[2], first_ns)
            # A stamp that the destination cannot store is far from any message.
            with suppress(MessageError):
                topic.write([row], time_ns, time_ns, writer)
            row = next(rows, None)
        if item is not None:
            yield item


def as_transform(
    reading: PoseReading,
    attachments: Mapping[tuple[str, str], PoseAttachment],
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


def without(children: Collection[str], source: str, target: str, data: Buffer) -> Buffer:
    """Return a message of transforms without the transforms of some frames."""
    rows = decode_transforms(data, source)
    return encode_transforms([row for row in rows if row[1].removeprefix("/") not in children], target)


def rows_in(added: AddedPoses, span: Span, end_ns: int | None) -> Iterator[TransformRow]:
    """Yield the transforms of a trajectory during the cut, by stamp, with the last one before and the first after.

    Rows are made one by one: a million of them would take half a gigabyte.
    """
    used = [track for track in added.trajectories if (track.parent, track.child) in added.attachments]
    stamps_ns = np.concatenate([np.empty(0, np.int64), *(track.stamps_ns for track in used)])
    owners = np.repeat(np.arange(len(used)), [len(track.stamps_ns) for track in used])
    order = np.argsort(stamps_ns, kind="stable")
    last_ns = min(bound_ns for bound_ns in (span.stop_ns, end_ns, 2**63 - 1) if bound_ns is not None)
    begin = max(0, int(np.searchsorted(stamps_ns, span.first_ns, "right", order)) - 1)
    places = order[begin : int(np.searchsorted(stamps_ns, last_ns, "right", order)) + 1]
    poses = np.concatenate([np.empty((0, 7)), *(track.poses for track in used)])
    for place in places:
        trajectory = used[owners[place]]
        attachment = added.attachments[trajectory.parent, trajectory.child]
        yield attachment.row(int(stamps_ns[place]), cast("Pose", tuple(poses[place].tolist())))
