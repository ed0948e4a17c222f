"""A recording as the destination of a conversion: its topics, and the writing of items."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from pc2scan.bags.formats import FORMATS
from pc2scan.bags.qos import merge_qos
from pc2scan.bags.topics import unheard
from pc2scan.errors import MessageError, RecordingError, UnwritableError, UsageError
from pc2scan.messages.clouds import CLOUDS, SCANS, to_pointcloud2, written_as_pointcloud2
from pc2scan.messages.definitions import definition
from pc2scan.messages.laserscan import LASERSCAN, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2, encode_cloud
from pc2scan.model import LATCHED_QOS, NEW_ID, SERIALIZATIONS, TF_QOS, ChunkRule, Connection, Definition, StoredChunk
from pc2scan.transforms.reading import tf_connections

from .added_transforms import TFMESSAGE, AddedTransforms, as_transform, between, rows_in, without
from .combine.contributions import MessagesToScan
from .engine import NOTHING_REFUSED, Combiner
from .plan import Output
from .report import TopicReport
from .steps import ConvertedMessage, Steps, as_it_is, serialised

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from types import ModuleType

    from pc2scan.advice.survey import Span
    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Writer
    from pc2scan.request.spec import Request
    from pc2scan.transforms.placing import FrameOptions
    from pc2scan.transforms.sources import AddedPoses

    from .engine import Item, Items, Tally
    from .plan import Plan, Route
    from .preparation import Preparation
    from .report import Report
    from .steps import Conversion


def equip_routes(
    plan: Plan,
    conversions: Mapping[tuple[Any, str], Conversion],
    topics: RecordingTopics | None = None,
    finish: Callable[[str, ConvertedMessage], ConvertedMessage] | None = None,
) -> tuple[dict[int, Route], list[TopicReport]]:
    """Return the routes with what decodes, converts and encodes the messages of each connection.

    Parameters
    ----------
    conversions
        See `Preparation`.
    topics
        The topics of the recording that results are written to, serialised. None: no message passes as it is.
    finish
        Without a recording, the last step: takes the serialisation of the source and a result.

    Returns
    -------
    dict, list of TopicReport
        The routes by the id of their connection, and the report's entries: publishers of one topic share one if their
        messages are handled alike.
    """
    equipped: dict[int, Route] = {}
    entries: dict[tuple[object, ...], TopicReport] = {}
    combiners: dict[tuple[Any, str], Combiner] = {}

    def shared(entry: TopicReport) -> TopicReport:
        key = (entry.topic, entry.msgtype, entry.target, entry.action, entry.note, entry.spec)
        return entries.setdefault(key, entry)

    for route in plan.routes:
        connection = route.connection
        if topics is None:
            route.outputs = [output for output in route.outputs if not output.used]
            if not route.outputs:
                continue
        equipped[connection.id] = route
        topic, msgtype = connection.topic, connection.ros_type
        passing = None
        if route.passes and topics is not None:
            passing = TopicReport(topic, msgtype, topic, "passed")
            topics.add_passing(route, passing)
        if not route.outputs:
            route.report = shared(passing or TopicReport(topic, msgtype, None, "skipped"))
            continue
        chosen = {output.index: conversions[output.spec, output.joined] for output in route.outputs}
        spec = route.outputs[0].spec
        own = connection.serialization
        route.decode = SCANS[msgtype](own, spec.echo) if msgtype in SCANS else CLOUDS[msgtype](own)
        route.steps = [conversion.steps(topic) for conversion in chosen.values()]
        form = own if topics is None else SERIALIZATIONS[topics.target.ros_version]
        encode = encode_cloud if spec.reverse else encode_laserscan
        route.encode = partial(serialised, encode, form) if finish is None else partial(finish, form)
        for output in route.outputs:
            conversion, leads = chosen[output.index], output.sources[:1] in ((), (topic,))
            if output.used:
                on = [other.target for other in route.outputs if other.index == output.index and not other.used]
                note = f"the points that the beams of {', '.join(on)} read"
                output.report = shared(TopicReport(topic, msgtype, output.target, "added", note))
            else:
                entry = TopicReport(topic, msgtype, output.target, "converted" if leads else "joined")
                entry.spec, entry.scan = output.spec, output.spec.name
                entry.clouds_kept = route.handle >= 0
                if passing is not None and passing.lost:
                    entry.note, entry.lost = passing.note, True
                output.report = shared(entry)
                if isinstance(conversion, MessagesToScan) and conversion.grouper is not None:
                    key = output.spec, output.joined
                    if key not in combiners:
                        combiners[key] = Combiner(conversion, conversion.grouper(), route.encode)
                    output.combiner = combiners[key]
                    output.combiner.reports[output.sources.index(topic)] = output.report
            if leads and topics is not None:
                makes_clouds = output.used or output.spec.reverse
                topics.add_like(connection, output.target, POINTCLOUD2 if makes_clouds else LASERSCAN, output)
    return equipped, list(entries.values())


def declare_output(prepared: Preparation, target: Destination, writer: Writer | None, report: Report) -> None:
    """Declare the topics of a recording, and write what comes before all messages.

    Then ``prepared`` has the routes, and the report all topics.

    Parameters
    ----------
    writer
        Its writer; None in a dry run.
    """
    reader, request, span = prepared.reader, prepared.request, prepared.span
    frames, recorded = request.frames, prepared.recorded
    copying = target.same_chunks(reader.summary)
    if copying and writer is not None:
        writer.keep_ids(reader.connections)
    topics = RecordingTopics(target, request, same_kind=target.same_kind(reader.summary))
    routes, entries = equip_routes(prepared.plan, prepared.conversions, topics)
    report.topics = entries
    entry = TopicReport("/tf_static", TFMESSAGE, "/tf_static", "added", "from `write_static_tf`")
    static = AddedTransforms(entry, SERIALIZATIONS[target.ros_version])
    if frames.write_static:
        # One more latched publisher.
        topics.add(new_connection(target, "/tf_static", TFMESSAGE, latching=True, qos=LATCHED_QOS), static)
    if recorded is not None and recorded.poses and not request.only_scans:
        prepared.trajectory = add_poses(prepared, recorded.poses, routes, entries, topics)
    if any(spec.level for spec in prepared.plan.specs):
        connection = tf_connection(reader, frames, target)
        entry = TopicReport(connection.topic, connection.ros_type, connection.topic, "added", "from `level`")
        prepared.levels = AddedTransforms(entry, SERIALIZATIONS[target.ros_version])
        topics.add(connection, prepared.levels)
        entries.append(entry)
    prepared.tell(*(f"{what}; {cure}" for what, cure in unheard(connection for connection, _ in topics.added)))
    prepared.routes = count_skipped(routes, reader, span)
    if writer is None:
        return
    declare(writer, topics.added, one_a_topic=target.format.is_directory)
    if reader.has_extras and not request.only_scans:
        prepared.tell(*_copy_extras(reader, target, writer))
    if frames.write_static:
        earliest_ns, latest_ns = target.times_ns
        begin_ns = max(earliest_ns, min(span.first_ns, latest_ns))
        rows = [transform.row(begin_ns) for transform in (frames.static if recorded is None else recorded.static)]
        if not rows:
            raise UsageError("there is no added transform to write", hint="give one with `static_tf`, or with `urdf`")
        static.write(rows, begin_ns, begin_ns, writer)
        entries.append(static.report)
    if copying:
        prepared.rule = _chunk_rule(prepared.routes, target, writer)


def write_items(items: Items, writer: Writer, tally: Tally, prepared: Preparation) -> None:
    """Write the items of a conversion, and count them."""
    if prepared.trajectory is not None:
        items = prepared.trajectory(items, writer)
    for item in items:
        if isinstance(item, StoredChunk):
            writer.write_chunk(item)
            tally.count_chunk(item)
        else:
            tally.count(item, _write(item, writer, prepared.levels))
        # Frees the item before the next one is made.
        del item


def _write(item: Item, writer: Writer, levels: AddedTransforms | None) -> Mapping[int, MessageError]:
    """Write an item; return what the destination cannot store, as `Tally.count` takes it."""
    log_time_ns, publish_time_ns, sequence = item.log_time_ns, item.publish_time_ns, item.sequence
    refused: dict[int, MessageError] | None = None
    if item.passing is not None:
        try:
            writer.write(item.route.handle, log_time_ns, item.passing, publish_time_ns, sequence)
        except UnwritableError as err:
            # Its scans are not written, either: both are of a time that the destination cannot store.
            return dict.fromkeys(range(-1, len(item.results)), err)
    for number, (output, result) in enumerate(item.results):
        if not isinstance(result, ConvertedMessage) or output.handle < 0:
            continue
        message = result.used if output.used else result.message
        try:
            if levels is not None and result.level is not None:
                # Before the scan, so that its frame is known when the recording is replayed.
                levels.write_level(result.level, log_time_ns, publish_time_ns, writer)
            if message is not None:
                writer.write(output.handle, log_time_ns, message, publish_time_ns, sequence)
        except UnwritableError as err:
            refused = {**(refused or {}), number: err}
    return refused or NOTHING_REFUSED


def _chunk_rule(routes: Mapping[int, Route], target: Destination, writer: Writer) -> ChunkRule:
    """Return which of the source's chunks can be copied whole, after everything is declared in the destination."""
    untouched = frozenset(
        route.connection.id
        for route in routes.values()
        if not route.steps and route.reencode is None and route.handle == route.connection.id
    )
    return ChunkRule(
        target.file_format.name, target.chunk_compressions, untouched, writer.declarations(), target.times_ns[1]
    )


def _copy_extras(reader: Reader, target: Destination, writer: Writer) -> list[str]:
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


def count_skipped(routes: Mapping[int, Route], reader: Reader, span: Span) -> dict[int, Route]:
    """Count the messages of routes that write nothing, if the source's index has their numbers.

    Returns
    -------
    dict[int, Route]
        All other routes: those that write, and those whose messages must be read to be counted.
    """
    skipped = [route for route in routes.values() if not route.writes]
    counted = reader.counts([route.connection for route in skipped], span.start_ns, span.stop_ns) if skipped else {}
    # Messages that were latched before the cut would have been written, too.
    lasting = [route.connection for route in skipped if route.connection.is_latched]
    earlier = reader.counts(lasting, None, span.start_ns) if lasting and span.start_ns is not None else {}
    for route in skipped:
        (entry,) = route.reports
        before = earlier.get(route.connection.id, 0)
        entry.skip(counted.get(route.connection.id, 0) + (before if route.connection.is_static else min(before, 1)))
    return {key: route for key, route in routes.items() if key not in counted}


def add_poses(
    prepared: Preparation,
    added: Sequence[AddedPoses],
    routes: Mapping[int, Route],
    entries: list[TopicReport],
    topics: RecordingTopics,
) -> Callable[..., Items] | None:
    """Let routes write poses as transforms, before the topics are declared; return what writes those of a trajectory.

    Parameters
    ----------
    added
        The poses that were used.
    routes, entries
        The routes, and the report's entries, which are changed.
    topics
        The topics of the destination.
    """
    reader, frames, form = prepared.reader, prepared.request.frames, SERIALIZATIONS[topics.target.ros_version]
    children = {name for poses in added for attachment in poses.attachments.values() for name in attachment.replaced}
    for connection in tf_connections(reader.connections, frames.tf_topics):
        route = routes[connection.id]
        if route.handle >= 0 and not connection.is_static:
            route.reencode = partial(without, children, connection.serialization, form)
    shared = tf_connection(reader, frames, topics.target)
    trajectory = None
    owners: list[Output | AddedTransforms] = []
    for poses in added:
        if poses.reading is None:
            entry = TopicReport(shared.topic, TFMESSAGE, shared.topic, "added", f"from {poses.name}")
            entries.append(entry)
            owners.append(topic := AddedTransforms(entry, form))
            rows = rows_in(poses, prepared.span, reader.summary.end_ns)
            trajectory = partial(between, rows, topic, prepared.span.first_ns)
            continue
        for connection in poses.reading.connections:
            entry = TopicReport(connection.topic, connection.ros_type, shared.topic, "added", "its poses as transforms")
            entries.append(entry)
            route = routes[connection.id]
            if route.handle < 0 and route.report is not None:
                # Only counted until now.
                entries.remove(route.report)
                route.report = None
            step = partial(as_transform, poses.reading, poses.attachments, connection, form)
            route.decode, route.steps = as_it_is, [Steps(project=step)]
            route.outputs.append(Output(None, shared.topic, report=entry))
            owners.append(route.outputs[-1])
    topics.add(shared, *owners)
    return trajectory


def tf_connection(reader: Reader, frames: FrameOptions, target: Destination) -> Connection:
    """Return the connection of new transforms: one more publisher of the topic that has the moving ones."""
    moving = [c for c in tf_connections(reader.connections, frames.tf_topics) if not c.is_static]
    if not moving:
        return new_connection(target, "/tf", TFMESSAGE, qos=TF_QOS)
    first = moving[0]
    if first.ros_version == target.ros_version and first.definition.data:
        # ROS 1 has two types with the same layout; all publishers of a topic have the same type.
        declared = first.definition, first.digest
        return new_connection(target, first.topic, first.msgtype, declared, qos=TF_QOS)
    return new_connection(target, first.topic, TFMESSAGE, qos=TF_QOS)


#: Maximum number of fields that are compiled for re-encoding. Each takes about a millisecond and 7 kB; large robots
#: have thousands.
_MAX_COMPILED_FIELDS = 20_000


def declare(writer: Writer, topics: Sequence[tuple[Connection, Sequence[HasHandle]]], *, one_a_topic: bool) -> None:
    """Declare topics, before the first message is written, and set the writer's handles.

    Parameters
    ----------
    writer
        The writer of the destination.
    topics
        The connection of each, and who writes to it.
    one_a_topic
        Whether the publishers of a topic share a connection, as in rosbag2's recordings: programs that read these
        find a topic by its name, and use the first connection of this name.
    """
    groups: Iterable[list[int]] = ([place] for place in range(len(topics)))
    if one_a_topic:
        publishers: dict[tuple[str, str, str], dict[int, Connection]] = {}
        for place, (connection, _) in enumerate(topics):
            plain = connection.in_utf8
            msgtype = plain.ros_type if plain.serialization == "cdr" else plain.msgtype
            publishers.setdefault((plain.topic, msgtype, plain.serialization), {})[place] = connection
        groups = sorted(group for connections in publishers.values() for group in _by_layout(connections))
    for group in groups:
        connections = [topics[place][0] for place in group]
        handle = writer.add_connection(connections[0] if len(group) == 1 else _merge_connections(connections))
        for owner in (owner for place in group for owner in topics[place][1]):
            owner.handle = handle


def _by_layout(publishers: Mapping[int, Connection]) -> Iterable[list[int]]:
    """Group the publishers of a topic by the layout of their messages.

    Two definitions may have the same name; messages of one cannot be decoded with the other.
    """
    if len({(publisher.digest, publisher.definition) for publisher in publishers.values()}) == 1:
        return [list(publishers)]
    digests: dict[Definition, str] = {}
    for publisher in publishers.values():
        if publisher.digest:
            digests.setdefault(publisher.definition, publisher.digest)
    # A connection without a definition has the same topic and type as the others, so it joins the first group.
    digests[Definition()] = ""
    groups: dict[str, list[int]] = {}
    for place, publisher in publishers.items():
        if publisher.definition not in digests:
            digests[publisher.definition] = _layout(publisher)
        groups.setdefault(publisher.digest or digests[publisher.definition], []).append(place)
    unknown = groups.pop("", [])
    if not groups:
        return [unknown]
    first = min(groups, key=lambda name: groups[name])
    groups[first] = sorted(groups[first] + unknown)
    return groups.values()


def _transcode() -> ModuleType:
    """Return the module for definitions that differ, are missing, or are of another ROS version; few recordings do."""
    from pc2scan.messages import transcode  # noqa: PLC0415

    return transcode


def _layout(connection: Connection) -> str:
    """Return the type's hash, as ROS 2 computes it; an unreadable definition's text, without comments and space."""
    try:
        return str(_transcode().ros2_hash(connection.msgtype, connection.definition))
    except MessageError:
        return b" ".join(re.sub(rb"#[^\n]*", b"", connection.definition.data).split()).decode("utf-8", "replace")


def _merge_connections(publishers: Sequence[Connection]) -> Connection:
    """Return one connection for several publishers: the first, with the QoS profiles of all."""
    first = publishers[0]
    return replace(
        first,
        definition=next((own.definition for own in publishers if own.definition.data), first.definition),
        digest=next((publisher.digest for publisher in publishers if publisher.digest), ""),
        latching=any(publisher.latching for publisher in publishers),
        qos=merge_qos([publisher.qos for publisher in publishers]),
    )


def new_connection(
    target: Destination,
    topic: str,
    msgtype: str,
    declared: tuple[Definition, str] | None = None,
    *,
    callerid: str | None = "/pc2scan",
    latching: bool = False,
    qos: str = "",
) -> Connection:
    """Return a connection that a recording gets; ``declared`` has the definition and its digest, if they are known."""
    text, digest = declared or definition(msgtype, target.ros_version)
    if target.ros_version == 1:
        qos = ""
    else:
        callerid = None
    form = SERIALIZATIONS[target.ros_version]
    return Connection(NEW_ID, topic, msgtype, form, text, digest, callerid=callerid, latching=latching, qos=qos)


class HasHandle(Protocol):
    """Whatever writes to a topic by the writer's handle: a route, an output, added transforms."""

    handle: int


@dataclass(slots=True, eq=False)
class RecordingTopics:
    """The topics of a recording that is to be written, collected before they are declared.

    Parameters
    ----------
    target
        The recording.
    same_kind
        Whether the source is in the same kind of container.
    request
        The options of the conversion.

    Attributes
    ----------
    added
        The connection of each topic, and who has its ``handle``. Until they are declared, that is a place among them.
    """

    target: Destination
    request: Request
    same_kind: bool
    added: list[tuple[Connection, tuple[HasHandle, ...]]] = field(default_factory=list)
    #: The fields of all types that were compiled for re-encoding; their number is bounded.
    _compiled: dict[tuple[str, Definition], int] = field(default_factory=dict)

    def add(self, connection: Connection, *owners: HasHandle) -> None:
        """Add a connection, and set the handle of its owners."""
        for owner in owners:
            owner.handle = len(self.added)
        self.added.append((connection, owners))

    def add_like(self, source: Connection, topic: str, msgtype: str, owner: HasHandle) -> None:
        """Add a topic with the QoS profile, latching and caller id of a source's, and set the handle of its owner."""
        same, latched = source.ros_version == self.target.ros_version, source.is_latched
        qos = source.qos if same else LATCHED_QOS if latched else ""
        new = new_connection(self.target, topic, msgtype, callerid=source.callerid, latching=latched, qos=qos)
        self.add(new, owner)

    def add_passing(self, route: Route, entry: TopicReport) -> None:
        """Add a connection that passes through, re-encoded if the destination is of the other ROS version.

        The entry of the report says if its messages are re-encoded, or cannot pass.
        """
        target, request, connection = self.target, self.request, route.connection
        if request.clouds_as == "pointcloud2" and written_as_pointcloud2(connection):
            entry.action, entry.note = "re-encoded", "as PointCloud2"
            route.reencode = to_pointcloud2(connection, SERIALIZATIONS[target.ros_version])
            self.add_like(connection, connection.topic, POINTCLOUD2, route)
            return
        foreign = connection.ros_version is None
        # The same kind of container can store the message as it is, even if its type is unknown.
        as_it_is = (self.same_kind and (foreign or request.repair)) or (foreign and bool(target.format.profiles))
        defined_already = connection.definition.data or request.repair
        if as_it_is or (connection.ros_version == target.ros_version and defined_already):
            self.add(connection, route)
            return
        if connection.ros_version == target.ros_version:
            self.add(_transcode().with_definition(connection), route)
            return
        try:
            if foreign:
                holding = " or ".join(container.suffix for container in FORMATS.values() if container.profiles)
                form = connection.serialization or "unspecified"
                raise MessageError(f"{form} messages can only be stored in an {holding} file")
            transcoding = _transcode().transcoder(connection, target.ros_version)
        except MessageError as err:
            if request.strict and connection.message_count != 0:
                err.topic = connection.topic
                raise
            entry.note, entry.lost, entry.action, entry.target = err.message, True, "skipped", None
            return
        self._compiled[connection.msgtype, connection.definition] = transcoding.fields
        if sum(self._compiled.values()) > _MAX_COMPILED_FIELDS:
            raise RecordingError(
                f"its types have more than {_MAX_COMPILED_FIELDS} fields in all, too many to re-encode",
                hint="`drop` or `keep` chooses among the topics",
            )
        entry.action, entry.note = "re-encoded", "; ".join(transcoding.notes)
        route.reencode = transcoding.encode
        self.add(transcoding.connection, route)
