"""Corrects messages as they are read, for everything else: stamps of another clock, and coordinates in another unit.

What a lidar on its own clock has recorded is read with corrected stamps: the look ahead, lookups of transforms, scans
and kept clouds all have these. Points' own times move along.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.advice.clocks import MOTIONS, Clocks, moving
from pc2scan.advice.survey import Span, Survey
from pc2scan.bags.merged import ChangedReader
from pc2scan.bags.opening import open_recordings
from pc2scan.bags.topics import by_topic, find_topic, types_by_topic
from pc2scan.errors import DecodeError, UsageError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.pointcloud2 import POINTCLOUD2, CloudFields, encode_cloud, pack_cloud
from pc2scan.messages.stamps import STAMPED, move_times, set_stamp, stamp_in, writable
from pc2scan.request.spec import TRAJECTORY
from pc2scan.transforms.placing import FrameOptions
from pc2scan.transforms.reading import read_transforms

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from contextlib import ExitStack

    from pc2scan.advice.clocks import Clock
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, RawMessage
    from pc2scan.progress import Meter
    from pc2scan.request.spec import Request, StampOptions
    from pc2scan.transforms.reading import RecordedTransforms

#: An offset that takes stamps farther from those of the transforms by more than this is wrong.
_NOTABLE_NS = 1_000_000_000

_WHOLE = Span(None, None, 0)


def _moved(offset_ns: int | None, fields: Sequence[str], remarks: dict[str, None], message: RawMessage) -> RawMessage:
    """Return a message with its corrected stamp; one that cannot be decoded stays as it is.

    Parameters
    ----------
    offset_ns
        Nanoseconds to add; None: the stamp becomes the log time.
    fields
        Fields with the points' times, besides the usual ones.
    remarks
        Get one about a stamp that does not fit.
    """
    connection, copy = message.connection, bytearray(message.data)
    try:
        own_ns = stamp_in(copy, connection.serialization)
        stamp_ns = message.log_time_ns if offset_ns is None else own_ns + offset_ns
        if connection.ros_type in CLOUDS and stamp_ns != own_ns:
            # Before the stamp changes, which tells their unit.
            move_times(copy, connection.serialization, connection.ros_type, stamp_ns - own_ns, fields)
        fits = set_stamp(copy, connection.serialization, stamp_ns)
    except DecodeError:
        return message
    if not fits:
        remarks[f"{connection.topic}: its messages cannot hold the corrected stamps, and have the nearest time"] = None
    return message._replace(data=bytes(copy))


def corrected(
    reader: Reader,
    converted: Sequence[Connection],
    clock: StampOptions,
    tf_topics: Sequence[str],
    span: Span = _WHOLE,
    fields: Sequence[str] = (),
) -> tuple[Reader, list[str]]:
    """Return a recording with corrected stamps, and notes about offsets that were measured.

    Parameters
    ----------
    converted
        The connections whose messages are converted.
    clock
        How stamps are corrected.
    tf_topics
        The topics of the transforms, whose clock offsets are measured against; see `FrameOptions`.
    span
        The cut: offsets are measured in its first messages.
    fields
        Fields with the points' times, besides the usual ones.

    Raises
    ------
    TopicError
        If there is no topic of a name, or it has no stamps.
    """
    own = _named_topics(reader.connections, clock)
    offsets = dict.fromkeys((connection.topic for connection in converted), clock.offset_ns) | own
    topics = by_topic(
        connection for connection in reader.connections if connection.topic in offsets and _is_stamped(connection)
    )
    doubtful = {topic for topic, offset in offsets.items() if offset is None or abs(offset) > _NOTABLE_NS}
    wanted = [connection for topic, group in topics.items() if topic in doubtful for connection in group]
    notes: list[str] = []
    remarks: dict[str, None] = {}
    for topic, measured in (_measured(reader, wanted, tf_topics, span) if wanted else {}).items():
        offset_ns = round(measured.offset_ns / 1e6) * 1_000_000
        against = f"the stamps of {measured.other}" if measured.other else "the log times"
        if (given_ns := offsets[topic]) is None:
            offsets[topic] = offset_ns
            seconds, jitter = f"{offset_ns / 1e9:.3f}", f"{measured.jitter_ns / 1e9:.3f}"
            note = (
                f"{seconds} s, measured against {against} in its first messages, whose delays differ by {jitter} s; "
                f"`time_offset={topic}={seconds}s`"
            )
            notes.append(f"{topic}: time_offset is {note if offset_ns else f'0: its first stamps fit {against}'}")
        elif measured.other and abs(given_ns - offset_ns) > abs(offset_ns) + _NOTABLE_NS:
            without = f"are {abs(offset_ns) / 1e9:.3g} s off" if offset_ns else "fit"
            text = (
                f"{topic}: `time_offset` takes its stamps farther from those of {measured.other}: without it they "
                f"{without}, with it they are {abs(given_ns - offset_ns) / 1e9:.3g} s off; "
                f"`time_offset={topic}=auto` measures what corrects them"
            )
            remarks[text] = None
    # Stamps that are all 0 stay so.
    offsets |= {topic: 0 for topic, offset in offsets.items() if offset is None}
    if clock.by_log:
        offsets |= dict.fromkeys(offsets.keys() - own.keys())
    moved = {topic: partial(_moved, offset, fields, remarks) for topic, offset in offsets.items() if offset != 0}
    changes = {connection.id: moved[topic] for topic, group in topics.items() if topic in moved for connection in group}
    return (ChangedReader(reader, changes, remarks) if changes else reader), notes


def _measured(reader: Reader, wanted: Sequence[Connection], tf_topics: Sequence[str], span: Span) -> dict[str, Clock]:
    """Return the clocks of topics, compared with the moving transforms, or with the log times without any."""
    survey = Survey(reader, (), FrameOptions(tf_topics=tuple(tf_topics)), span)
    motion = [connection for connection in moving(reader.connections, tf_topics) if connection not in wanted]
    clocks = Clocks(survey, wanted, motion, MOTIONS)
    survey.read()
    return clocks.compare()


def corrected_transforms(
    reader: Reader, request: Request, stack: ExitStack, needed: Collection[str], meter: Meter | None = None
) -> tuple[RecordedTransforms, Sequence[Reader]]:
    """Return all transforms of a recording, and the opened recordings of ``tf_from``, which have some of them.

    Parameters
    ----------
    stack
        Closes these.
    needed
        Frames that they must have.
    meter
        Counts the bytes; None: nothing is reported.
    """
    others = open_recordings(request.frames.tf_from, stack, strict=request.strict)
    if request.clock:
        # Topics with poses may have an offset of their own.
        reader, _ = corrected(reader, [], request.clock, request.frames.tf_topics)
    return read_transforms([reader, *others], request.frames, needed=needed, meter=meter), others


def _is_stamped(connection: Connection) -> bool:
    return connection.ros_version is not None and connection.ros_type in (*CLOUDS, *STAMPED)


def _named_topics(connections: Sequence[Connection], clock: StampOptions) -> dict[str, int | None]:
    """Return the offsets of topics that have their own, by the names in the recording."""
    types = types_by_topic(connections)
    known = sorted({connection.topic for connection in connections if _is_stamped(connection)})
    return {
        find_topic(name, types, known, *CLOUDS, *sorted(STAMPED)): offset_ns
        for name, offset_ns in clock.by_topic.items()
        if name != TRAJECTORY
    }


#: Messages that have the coordinates as numbers; other messages are compressed, or have packets.
_TYPES = (
    *(POINTCLOUD2, "sensor_msgs/msg/PointCloud"),
    *("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg"),
)


def scaled(reader: Reader, factor: float) -> Reader:
    """Return a recording whose clouds have multiplied coordinates; the recording itself for a factor of 1.

    Raises
    ------
    UsageError
        If the factor is not positive, or no message has coordinates.
    """
    if factor == 1:
        return reader
    if not 0 < factor < math.inf:
        raise UsageError(
            f"`cloud_scale` is {factor:g}, it must be above 0", hint="for millimetres: `cloud_scale=0.001`"
        )
    clouds = [cloud for cloud in reader.connections if cloud.ros_type in _TYPES and cloud.ros_version is not None]
    if not clouds:
        raise UsageError("`cloud_scale` has no effect: no message has coordinates of points", path=reader.path)
    return ChangedReader(reader, {cloud.id: partial(_scaled, factor) for cloud in clouds})


def _scaled(factor: float, message: RawMessage) -> RawMessage:
    """Return a message with multiplied coordinates; one that cannot be decoded stays as it is."""
    connection, copy = message.connection, bytearray(message.data)
    try:
        points = CLOUDS[connection.ros_type](connection.serialization)(memoryview(copy))
        fields = points.fields
        axes = fields.cloud.xyz() if isinstance(fields, CloudFields) else points.xyz()
        with np.errstate(all="ignore"):
            if all(axis.dtype.kind == "f" for axis in axes):
                for axis in axes:
                    own = writable(copy, axis)
                    np.multiply(own, factor, out=own, dtype=np.float64, casting="same_kind")
            elif isinstance(fields, CloudFields):
                # Integers cannot hold metres.
                columns = {name: (axis * factor).astype(np.float32) for name, axis in zip("xyz", axes, strict=True)}
                cloud, width = pack_cloud(points.replace(columns, points.frame_id)), fields.cloud.width
                row_step = width * cloud.point_step
                cloud = replace(cloud, height=fields.cloud.height, width=width, row_step=row_step)
                return message._replace(data=encode_cloud(cloud, connection.serialization))
    except DecodeError:
        return message
    return message._replace(data=bytes(copy))
