"""The routes of a conversion: what is declared in the destination, and what is done with each connection's messages."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pc2scan.bags.formats import FORMATS
from pc2scan.bags.latching import is_latched, is_static
from pc2scan.errors import MessageError, RecordingError
from pc2scan.messages.definitions import definition
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import LATCHED_QOS, NEW_ID, ChunkRule, Connection

from .conversion import converter
from .topic_report import TopicReport

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Buffer, Definition, Writer
    from pc2scan.tf.options import FrameOptions

    from .combine.combiner import Combiner
    from .conversion import Conversion, EncodedMessage
    from .declarations import Declarations
    from .options import ConvertOptions
    from .plan import Combination, Route, RouteTask
    from .report import Report
    from .scan_spec import ScanSpec

#: Maximum number of fields that are compiled for re-encoding. Each takes about a millisecond and 7 kB; large robots
#: have thousands.
_MAX_COMPILED_FIELDS = 20_000


@dataclass(slots=True)
class TargetTopic:
    """A topic of the destination that the converted messages of a route are written to.

    ``handle`` is the writer's; -1 if another topic leads the scans. ``place`` is the index of its messages in the
    result of ``convert``. ``used`` is whether its messages are the points that give scans their ranges. ``sample`` is
    the first message; all others have the same geometry. ``combiner`` makes one scan of several messages; None if each
    message is one scan. ``points`` is the output of the points behind the scans that ``combiner`` makes.
    """

    handle: int
    report: TopicReport
    place: int
    used: bool = False
    sample: bytes = b""
    combiner: Combiner | None = None
    points: TargetTopic | None = None


@dataclass(slots=True)
class OpenRoute:
    """The route of one source connection's messages, declared in the destination.

    ``convert`` and ``encode`` are the work on a message; None if there is none. Results of ``convert`` go to
    ``outputs``; an error goes to none. Messages of ``shrinks_from`` bytes and more become smaller by it. ``report`` is
    the entry of messages that are not converted; each output has another one. ``messages`` counts the messages that
    were read.
    """

    connection: Connection
    report: TopicReport | None = None
    convert: Callable[[Buffer], Sequence[EncodedMessage | MessageError]] | None = None
    encode: Callable[[Buffer], Buffer] | None = None
    outputs: list[TargetTopic] = field(default_factory=list)
    passing_handle: int = -1
    shrinks_from: int = sys.maxsize
    messages: int = 0

    @property
    def reports(self) -> Sequence[TopicReport]:
        """The report's entries that count its messages."""
        return [output.report for output in self.outputs] if self.report is None else [self.report]

    @property
    def writes(self) -> bool:
        """Whether messages go to the destination; otherwise they are only counted."""
        return self.passing_handle >= 0 or bool(self.outputs)

    @property
    def lasts(self) -> bool:
        """Whether its messages are latched, so that those from before the cut are still valid in it."""
        return is_latched(self.connection)


def open_routes(
    routes: Iterable[Route],
    conversions: Mapping[ScanSpec | Combination, Conversion],
    target: Destination,
    same_kind: bool,
    options: ConvertOptions,
    declared: Declarations,
    report: Report,
) -> dict[int, OpenRoute]:
    """Collect the connections of the destination, and prepare the work on each source connection.

    ``same_kind`` is whether the source is in the same kind of container as the destination. Until `bind` is called, the
    routes' handles are indices in ``declared``.
    """
    opened: dict[int, OpenRoute] = {}
    compiled: dict[tuple[str, Definition], int] = {}
    entries: dict[tuple[object, ...], TopicReport] = {}
    combiners: dict[Combination, Combiner] = {}

    def shared(entry: TopicReport) -> TopicReport:
        """Return the report's entry; publishers of one topic share it if their messages are handled alike."""
        key = (entry.topic, entry.msgtype, entry.target, entry.action, entry.note, entry.spec)
        return entries.setdefault(key, entry)

    for route in routes:
        connection = route.connection
        topic, msgtype = connection.topic, connection.ros_type
        made = opened[connection.id] = OpenRoute(connection)
        passing = TopicReport(topic, msgtype, topic, "passed") if route.passes else None
        if passing is not None:
            _prepare_passing(made, passing, target, same_kind, options, declared, compiled)
        if not route.tasks:
            made.report = shared(passing or TopicReport(topic, msgtype, None, "skipped"))
            continue
        source, written = connection.serialization, target.serialization
        chosen = [conversions[task.key] for task in route.tasks]
        made.convert = converter(chosen, topic, source, written, msgtype)
        made.shrinks_from = sum(conversion.shrinks_from for conversion in chosen)
        for place, (task, conversion) in enumerate(zip(route.tasks, chosen, strict=True)):
            combiner = combiner_of(combiners, task, conversion, written)
            leads = task.combination is None or task.combination.sources[0] == topic
            for name in task.targets:
                handle = declared.add(_publisher_like(connection, name, conversion.made_type, target)) if leads else -1
                kept = made.passing_handle >= 0
                action = "converted" if leads else "joined"
                entry = TopicReport(topic, msgtype, name, action, clouds_kept=kept, spec=task.spec)
                if passing is not None and passing.lost:
                    entry.note, entry.lost = passing.note, True
                made.outputs.append(TargetTopic(handle, shared(entry), place, combiner=combiner))
                if combiner is not None and task.combination is not None:
                    combiner.reports[task.combination.sources.index(topic)] = made.outputs[-1].report
            if (name := task.spec.keep_used) and leads:
                handle = declared.add(_publisher_like(connection, name, POINTCLOUD2, target))
                note = f"the points that the beams of {', '.join(task.targets)} read"
                entry = TopicReport(topic, msgtype, name, "added", note)
                points = TargetTopic(handle, shared(entry), place, used=True, combiner=combiner)
                made.outputs[-1].points = points
                made.outputs.append(points)
    report.topics += entries.values()
    return opened


def combiner_of(
    combiners: dict[Combination, Combiner], task: RouteTask, conversion: Conversion, serialization: str
) -> Combiner | None:
    """Return the `Combiner` that makes one scan of several messages; all routes of a combination share it."""
    if task.combination is None:
        return None
    from .combine.combiner import Combiner  # noqa: PLC0415
    from .combine.conversion import MessagesToScan  # noqa: PLC0415  # few scans are made of several messages

    if not isinstance(conversion, MessagesToScan) or conversion.grouper is None:
        return None
    if task.combination not in combiners:
        combiners[task.combination] = Combiner(conversion, serialization)
    return combiners[task.combination]


def bind(routes: Iterable[OpenRoute], handles: Sequence[int]) -> None:
    """Replace the routes' indices by the writer's handles, after everything is declared."""
    for route in routes:
        if route.passing_handle >= 0:
            route.passing_handle = handles[route.passing_handle]
        for output in route.outputs:
            if output.handle >= 0:
                output.handle = handles[output.handle]


def count_skipped(
    routes: Mapping[int, OpenRoute], reader: Reader, start_ns: int | None, stop_ns: int | None
) -> dict[int, OpenRoute]:
    """Count the messages of routes that write nothing, if the source's index has their numbers.

    Returns
    -------
    dict[int, OpenRoute]
        All other routes: those that write, and those whose messages must be read to be counted.
    """
    skipped = [route for route in routes.values() if not route.writes]
    counted = reader.counts([route.connection for route in skipped], start_ns, stop_ns) if skipped else {}
    # What was latched before the cut would have been written, too.
    lasting = [route.connection for route in skipped if route.lasts]
    earlier = reader.counts(lasting, None, start_ns) if lasting and start_ns is not None else {}
    for route in skipped:
        (entry,) = route.reports
        before = earlier.get(route.connection.id, 0)
        entry.skip(
            counted.get(route.connection.id, 0) + (before if is_static(route.connection.topic) else min(before, 1))
        )
    return {key: route for key, route in routes.items() if key not in counted}


def _prepare_passing(
    route: OpenRoute,
    entry: TopicReport,
    target: Destination,
    same_kind: bool,
    options: ConvertOptions,
    declared: Declarations,
    compiled: dict[tuple[str, Definition], int],
) -> None:
    """Declare a connection that passes through, re-encoded if the destination is of the other ROS version.

    ``compiled`` collects the fields of all types that were compiled for re-encoding; their number is bounded.
    """
    connection = route.connection
    foreign = connection.ros_version is None
    # The same kind of container can store the message as it is, even if its type is unknown.
    as_it_is = (same_kind and (foreign or options.repair)) or (foreign and target.format.holds_any)
    defined_already = connection.definition.data or options.repair
    if as_it_is or (connection.ros_version == target.ros_version and defined_already):
        route.passing_handle = declared.add(connection)
        return
    # Imported only for recordings without definitions, or for another ROS version.
    from pc2scan.messages.transcode import DEFAULT_DISTRO, transcoder, with_definition  # noqa: PLC0415

    distro = options.ros_distro or DEFAULT_DISTRO
    if connection.ros_version == target.ros_version:
        route.passing_handle = declared.add(with_definition(connection, distro))
        return
    if foreign:
        error: MessageError = MessageError(
            f"{connection.serialization or 'unspecified'} messages can only be stored in an {_holding_any()} file"
        )
    else:
        try:
            transcoding = transcoder(connection, target.ros_version, distro=distro)
        except MessageError as err:
            error = err
        else:
            compiled[connection.msgtype, connection.definition] = transcoding.fields
            if sum(compiled.values()) > _MAX_COMPILED_FIELDS:
                raise RecordingError(
                    f"its types have more than {_MAX_COMPILED_FIELDS} fields in all, too many to re-encode",
                    hint="`drop` or `keep` chooses among the topics",
                )
            route.encode = transcoding.encode
            route.passing_handle = declared.add(transcoding.connection)
            entry.action = "re-encoded"
            entry.note = "; ".join(transcoding.notes)
            return
    if options.on_error == "fail" and connection.message_count != 0:
        error.topic = connection.topic
        raise error
    entry.note, entry.lost = error.message, True
    entry.action, entry.target = "skipped", None


def _holding_any() -> str:
    """Return the suffixes of files that hold messages of every encoding."""
    return " or ".join(entry.suffix for entry in FORMATS.values() if entry.holds_any)


def _publisher_like(
    source: Connection,
    topic: str,
    msgtype: str,
    target: Destination,
) -> Connection:
    """Return a connection of the destination with the QoS profile, latching and caller id of a source's."""
    text, digest = definition(msgtype, target.ros_version)
    same = source.ros_version == target.ros_version
    return Connection(
        id=NEW_ID,
        topic=topic,
        msgtype=msgtype,
        serialization=target.serialization,
        definition=text,
        digest=digest,
        callerid=source.callerid if target.ros_version == 1 else None,
        latching=source.latching,
        qos=source.qos if same else LATCHED_QOS if source.latching and target.ros_version == 2 else "",
    )


def chunk_rule(routes: Mapping[int, OpenRoute], target: Destination, writer: Writer) -> ChunkRule:
    """Return which of the source's chunks can be copied whole, after everything is declared in the destination."""
    untouched = frozenset(
        route.connection.id
        for route in routes.values()
        if route.convert is None and route.encode is None and route.passing_handle == route.connection.id
    )
    return ChunkRule(target.chunks, target.chunk_compressions, untouched, writer.declarations(), target.times_ns[1])


def copy_extras(reader: Reader, target: Destination, writer: Writer) -> list[str]:
    """Copy MCAP's attachments and metadata records if the destination can store them; return a warning if it cannot."""
    carries = target.file_format.has_extras
    lost = 0
    for attachment in reader.attachments():
        if carries:
            writer.add_attachment(attachment)
        else:
            lost += 1
    for record in reader.metadata():
        # rosbag2 stores a copy of metadata.yaml under this name; the writer of the destination creates a new one.
        if record.name == "rosbag2" and not target.format.has_extras:
            continue
        if carries:
            writer.add_metadata(record)
        else:
            lost += 1
    if not lost:
        return []
    return [f"{lost} MCAP attachments and metadata records are not copied: the destination cannot store them"]


def static_connection(target: Destination) -> Connection:
    """Return the connection of the added transforms: one more latched publisher of /tf_static."""
    msgtype = "tf2_msgs/msg/TFMessage"
    text, digest = definition(msgtype, target.ros_version)
    return Connection(
        id=NEW_ID,
        topic="/tf_static",
        msgtype=msgtype,
        serialization=target.serialization,
        definition=text,
        digest=digest,
        callerid="/pc2scan" if target.ros_version == 1 else None,
        latching=True,
        qos=LATCHED_QOS if target.ros_version == 2 else "",
    )


def write_static(
    frames: FrameOptions, log_time_ns: int, handle: int, target: Destination, writer: Writer
) -> TopicReport:
    """Write the added transforms, and return what was written; ``handle`` is that of `static_connection`."""
    rows = [transform.row(log_time_ns) for transform in frames.static]
    writer.write(handle, log_time_ns, encode_transforms(rows, target.serialization), log_time_ns)
    msgtype = "tf2_msgs/msg/TFMessage"
    return TopicReport("/tf_static", msgtype, "/tf_static", "added", "from `static_tf`", messages_out=1)
