"""Where the messages of each source connection go: what is declared in the destination, and the work on the way."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.bags.model import LATCHED_QOS, NEW_ID, ChunkRule, Connection
from pc2scan.errors import MessageError, RecordingError
from pc2scan.messages.definitions import definition
from pc2scan.messages.tfmessage import encode_transforms

from .frames import is_static
from .report import TopicReport

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from pc2scan.bags.model import Buffer, Definition, Writer
    from pc2scan.bags.reader import Reader
    from pc2scan.bags.registry import Destination

    from .conversion import Conversion, Converted
    from .frames import FrameOptions
    from .options import ConvertOptions
    from .plan import Route
    from .report import Report

__all__ = ["Lane", "carry_extras", "chunk_rule", "count_skipped", "open_lanes", "write_static"]

#: A field takes about a millisecond and 7 kB. Large robots have some thousand.
_MAX_COMPILED_FIELDS = 20_000


@dataclass(slots=True)
class Lane:
    """Where the messages of one source connection go.

    ``convert`` and ``encode`` are the work; None where there is none. The handles are the writer's. ``sample`` is the
    first converted message; all others have its geometry. Messages of ``shrinks_from`` bytes and more become smaller
    ones by ``convert``.
    """

    connection: Connection
    report: TopicReport
    convert: Callable[[Buffer], Converted] | None = None
    encode: Callable[[Buffer], Buffer] | None = None
    converted_handle: int = -1
    passing_handle: int = -1
    sample: bytes = b""
    shrinks_from: int = sys.maxsize

    @property
    def writes(self) -> bool:
        """Whether anything goes to the destination; otherwise messages are only counted."""
        return self.passing_handle >= 0 or self.converted_handle >= 0

    @property
    def lasts(self) -> bool:
        """Whether messages from before the cut are still valid in it."""
        return self.connection.latching or is_static(self.connection.topic)


def open_lanes(
    routes: Iterable[Route],
    conversion: Conversion,
    target: Destination,
    same_kind: bool,
    options: ConvertOptions,
    writer: Writer,
    report: Report,
) -> dict[int, Lane]:
    """Declare every connection of the destination and prepare the work on each of the source's.

    ``same_kind`` tells whether the source is in the same kind of container as the destination.
    """
    lanes: dict[int, Lane] = {}
    compiled: dict[tuple[str, Definition], int] = {}
    entries: dict[tuple[str | None, ...], TopicReport] = {}
    for route in routes:
        connection = route.connection
        topic = connection.topic
        action = "converted" if route.target else "passed" if route.passes else "left out"
        entry = TopicReport(topic, connection.ros_type, route.target or (topic if route.passes else None), action)
        lane = lanes[connection.id] = Lane(connection, entry)
        if route.passes:
            _prepare_passing(lane, target, same_kind, options, writer, compiled)
        if route.target:
            lane.convert = conversion.for_topic(connection.topic, connection.serialization, target.serialization)
            lane.shrinks_from = conversion.shrinks_from
            lane.converted_handle = writer.add_connection(
                _converted_connection(connection, route.target, conversion.target_type, target)
            )
            entry.clouds_kept = lane.passing_handle >= 0
        # Publishers of one topic share an entry if the same becomes of their messages.
        lane.report = entries.setdefault((topic, connection.msgtype, entry.target, entry.action, entry.note), entry)
    report.topics += entries.values()
    return lanes


def count_skipped(
    lanes: Mapping[int, Lane], reader: Reader, start_ns: int | None, stop_ns: int | None
) -> dict[int, Lane]:
    """Count the messages of the lanes that write nothing, as far as the source's index tells.

    Returns
    -------
    dict[int, Lane]
        All other lanes: those that write, and those whose messages have to be read to be counted.
    """
    skipped = [lane for lane in lanes.values() if not lane.writes]
    counted: dict[int, int] = {}
    # Latched messages from before the cut would have been written too.
    for lasts in (False, True):
        chosen = [lane.connection for lane in skipped if lane.lasts is lasts]
        if chosen:
            counted |= reader.counts(chosen, None if lasts else start_ns, stop_ns)
    for lane in skipped:
        lane.report.skip(counted.get(lane.connection.id, 0))
    return {key: lane for key, lane in lanes.items() if key not in counted}


def _prepare_passing(
    lane: Lane,
    target: Destination,
    same_kind: bool,
    options: ConvertOptions,
    writer: Writer,
    compiled: dict[tuple[str, Definition], int],
) -> None:
    """Declare a connection that passes through, re-encoded if the destination is of the other generation.

    ``compiled`` collects the fields of the types that were compiled for re-encoding, and bounds them.
    """
    connection = lane.connection
    entry = lane.report
    foreign = connection.generation is None
    # A container holds whatever the same kind of container held: nothing of it needs to be understood.
    as_it_is = (same_kind and (foreign or options.repair)) or (foreign and target.container == "mcap")
    defined_already = connection.definition.data or options.repair
    if as_it_is or (connection.generation == target.generation and defined_already):
        lane.passing_handle = writer.add_connection(connection)
        return
    # Only recordings that lack definitions, or change generation, pay for loading this.
    from pc2scan.messages.transcode import DEFAULT_DISTRO, defined, transcoder  # noqa: PLC0415

    distro = options.ros_distro or DEFAULT_DISTRO
    if connection.generation == target.generation:
        lane.passing_handle = writer.add_connection(defined(connection, distro))
        return
    if foreign:
        error: MessageError = MessageError(
            f"{connection.serialization or 'unspecified'} messages fit only into an .mcap file"
        )
    else:
        try:
            transcoding = transcoder(connection, target.generation, distro=distro)
        except MessageError as err:
            error = err
        else:
            compiled[connection.msgtype, connection.definition] = transcoding.fields
            if sum(compiled.values()) > _MAX_COMPILED_FIELDS:
                raise RecordingError(
                    f"its types have more than {_MAX_COMPILED_FIELDS} fields in all, too many to re-encode",
                    hint="--drop or --keep chooses among the topics",
                )
            lane.encode = transcoding.encode
            lane.passing_handle = writer.add_connection(transcoding.connection)
            if entry.action == "passed":
                entry.action = "re-encoded"
                entry.note = "; ".join(transcoding.notes)
            return
    if options.on_error == "fail" and connection.message_count != 0:
        error.topic = connection.topic
        raise error
    entry.note, entry.lost = error.message, True
    if entry.action != "converted":
        entry.action, entry.target = "left out", None


def _converted_connection(source: Connection, topic: str, msgtype: str, target: Destination) -> Connection:
    """The connection of converted messages: published as their source was."""
    text, digest = definition(msgtype, target.generation)
    same = source.generation == target.generation
    return Connection(
        id=NEW_ID,
        topic=topic,
        msgtype=msgtype,
        serialization=target.serialization,
        definition=text,
        digest=digest,
        callerid=source.callerid if target.generation == 1 else None,
        latching=source.latching,
        qos=source.qos if same else LATCHED_QOS if source.latching and target.generation == 2 else "",
    )


def chunk_rule(lanes: Mapping[int, Lane], target: Destination, writer: Writer) -> ChunkRule:
    """Which of the source's chunks can be copied whole, when everything has been declared in the destination."""
    untouched = frozenset(
        lane.connection.id
        for lane in lanes.values()
        if lane.convert is None and lane.encode is None and lane.passing_handle == lane.connection.id
    )
    return ChunkRule(target.chunks, target.chunk_compressions, untouched, writer.declarations(), target.times_ns[1])


def carry_extras(reader: Reader, target: Destination, writer: Writer, report: Report) -> None:
    """Carry MCAP's attachments and metadata records where the destination has them."""
    carries = target.container == "mcap" or target.storage == "mcap"
    lost = 0
    for attachment in reader.attachments():
        if carries:
            writer.add_attachment(attachment)
        else:
            lost += 1
    for record in reader.metadata():
        # rosbag2 keeps a copy of metadata.yaml under this name; its writer makes a true one.
        if record.name == "rosbag2" and target.container != "mcap":
            continue
        if carries:
            writer.add_metadata(record)
        else:
            lost += 1
    if lost:
        report.warnings.append(
            f"{lost} MCAP attachments and metadata records are left out: the destination has no place for them"
        )


def write_static(frames: FrameOptions, log_time_ns: int, target: Destination, writer: Writer, report: Report) -> None:
    """Write the added transforms as one more latched publisher of /tf_static."""
    msgtype = "tf2_msgs/msg/TFMessage"
    text, digest = definition(msgtype, target.generation)
    serialization = target.serialization
    handle = writer.add_connection(
        Connection(
            id=NEW_ID,
            topic="/tf_static",
            msgtype=msgtype,
            serialization=serialization,
            definition=text,
            digest=digest,
            callerid="/pc2scan" if target.generation == 1 else None,
            latching=True,
            qos=LATCHED_QOS if target.generation == 2 else "",
        )
    )
    rows = [transform.row(log_time_ns) for transform in frames.static]
    writer.write(handle, log_time_ns, encode_transforms(rows, serialization), log_time_ns)
    report.topics.append(TopicReport("/tf_static", msgtype, "/tf_static", "added", "from --static-tf", messages_out=1))
