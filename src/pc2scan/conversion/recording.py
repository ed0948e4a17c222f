"""A recording as the destination of a conversion: its topics, and the writing of items."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import MessageError, UnwritableError, UsageError
from pc2scan.messages.laserscan import LASERSCAN, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2, encode_cloud
from pc2scan.model import LATCHED_QOS, ChunkRule, StoredChunk

from .added_transforms import TFMESSAGE, AddedTrajectory, AddedTransforms, add_poses, between, tf_connection
from .combine.combiner import Combiner
from .combine.conversion import MessagesToScan
from .declarations import RecordingTopics, new_connection
from .items import NOTHING_REFUSED
from .report import TopicReport
from .steps import ConvertedMessage, decoder_of, serialised

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence

    from pc2scan.advice.survey import Span
    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Buffer, Writer

    from .items import Item, Tally
    from .plan import Plan, Route
    from .preparation import Preparation
    from .report import Report
    from .steps import Conversion


class OpenRecording(NamedTuple):
    """The routes of a conversion to a recording.

    Attributes
    ----------
    routes
        As for `pc2scan.conversion.engine.items_of`, without those that are counted already.
    levels
        Writes the frames of level scans; None if no scan is level.
    trajectory
        The transforms of a file; None without one.
    rule
        Which of the source's chunks can be copied whole; None: none.
    """

    routes: Mapping[int, Route]
    levels: AddedTransforms | None = None
    trajectory: AddedTrajectory | None = None
    rule: ChunkRule | None = None

    @property
    def first_scans(self) -> Sequence[tuple[TopicReport, Buffer]]:
        """The first scan of each output, with the output's entry in the report."""
        outputs = (output for route in self.routes.values() for output in route.outputs if output.first)
        return [
            (output.report, output.first)
            for output in outputs
            if output.spec is not None and output.spec.made_type == LASERSCAN
        ]


def open_routes(
    plan: Plan,
    conversions: Mapping[tuple[Any, str], Conversion],
    topics: RecordingTopics | None = None,
    finish: Callable[[str, ConvertedMessage], ConvertedMessage] | None = None,
) -> tuple[dict[int, Route], list[TopicReport]]:
    """Prepare the work on the messages of each connection.

    Parameters
    ----------
    conversions
        By the key of their outputs.
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
    opened: dict[int, Route] = {}
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
        opened[connection.id] = route
        topic, msgtype = connection.topic, connection.ros_type
        passing = None
        if route.passes and topics is not None:
            passing = TopicReport(topic, msgtype, topic, "passed")
            topics.add_passing(route, passing)
        if not route.outputs:
            route.report = shared(passing or TopicReport(topic, msgtype, None, "skipped"))
            continue
        chosen = {output.index: conversions[output.key] for output in route.outputs}
        spec = route.outputs[0].spec
        route.decode = decoder_of(msgtype, connection.serialization, spec.echo)
        route.steps = [conversion.steps(topic) for conversion in chosen.values()]
        form = connection.serialization if topics is None else topics.target.serialization
        encode = encode_cloud if spec.reverse else encode_laserscan
        route.finish = partial(serialised, encode, form) if finish is None else partial(finish, form)
        for output in route.outputs:
            conversion, leads = chosen[output.index], output.sources[:1] in ((), (topic,))
            if output.used:
                on = [each.target for each in route.outputs if each.index == output.index and not each.used]
                note = f"the points that the beams of {', '.join(on)} read"
                output.report = shared(TopicReport(topic, msgtype, output.target, "added", note))
            else:
                entry = TopicReport(topic, msgtype, output.target, "converted" if leads else "joined", spec=output.spec)
                entry.clouds_kept = route.handle >= 0
                if passing is not None and passing.lost:
                    entry.note, entry.lost = passing.note, True
                output.report = shared(entry)
                if isinstance(conversion, MessagesToScan) and conversion.grouper is not None:
                    if output.key not in combiners:
                        combiners[output.key] = Combiner(conversion, conversion.grouper(), route.finish)
                    output.combiner = combiners[output.key]
                    output.combiner.reports[output.sources.index(topic)] = output.report
            if leads and topics is not None:
                topics.add_like(
                    connection, output.target, POINTCLOUD2 if output.used else output.spec.made_type, output
                )
    return opened, list(entries.values())


def open_output(prepared: Preparation, target: Destination, writer: Writer | None, report: Report) -> OpenRecording:
    """Declare the topics of a recording, and write what comes before all messages; the report then has all topics.

    Parameters
    ----------
    writer
        Its writer; None in a dry run.
    """
    reader, options, span = prepared.reader, prepared.options, prepared.span
    frames, found = options.frames, prepared.found
    copying = target.same_chunks(reader.summary)
    if copying and writer is not None:
        writer.keep_ids(reader.connections)
    topics = RecordingTopics(target, options, same_kind=target.same_kind(reader.summary))
    routes, entries = open_routes(prepared.plan, prepared.conversions, topics)
    report.topics = entries
    entry = TopicReport("/tf_static", TFMESSAGE, "/tf_static", "added", "from `write_static_tf`")
    static = AddedTransforms(entry, target.serialization)
    if frames.write_static:
        # One more latched publisher.
        topics.add(new_connection(target, "/tf_static", TFMESSAGE, latching=True, qos=LATCHED_QOS), static)
    trajectory = levels = None
    if found is not None and found.poses and not options.only_scans:
        trajectory = add_poses(prepared, found.poses, routes, entries, topics)
    if any(spec.level for spec in prepared.plan.specs):
        connection = tf_connection(reader, frames, target)
        entry = TopicReport(connection.topic, connection.ros_type, connection.topic, "added", "from `level`")
        levels = AddedTransforms(entry, target.serialization)
        topics.add(connection, levels)
        entries.append(entry)
    prepared.tell(*topics.warnings)
    routes = count_skipped(routes, reader, span)
    if writer is None:
        return OpenRecording(routes, levels, trajectory)
    topics.declare(writer)
    if not options.only_scans:
        prepared.tell(*_copy_extras(reader, target, writer))
    if frames.write_static:
        earliest_ns, latest_ns = target.times_ns
        begin_ns = max(earliest_ns, min(span.first_ns, latest_ns))
        rows = [each.row(begin_ns) for each in (frames.static if found is None else found.static)]
        if not rows:
            raise UsageError("there is no added transform to write", hint="give one with `static_tf`, or with `urdf`")
        static.write(rows, begin_ns, begin_ns, writer)
        entries.append(static.report)
    rule = _chunk_rule(routes, target, writer) if copying else None
    return OpenRecording(routes, levels, trajectory, rule)


def write_items(items: Generator[Item | StoredChunk], writer: Writer, tally: Tally, recording: OpenRecording) -> None:
    """Write the items of a conversion, and count them.

    Parameters
    ----------
    recording
        The routes, and what writes transforms besides.
    """
    if recording.trajectory is not None:
        items = between(items, recording.trajectory, writer)
    for item in items:
        if isinstance(item, StoredChunk):
            writer.write_chunk(item)
            tally.count_chunk(item)
        else:
            tally.count(item, _write(item, writer, recording.levels))
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
    # What was latched before the cut would have been written, too.
    lasting = [route.connection for route in skipped if route.connection.is_latched]
    earlier = reader.counts(lasting, None, span.start_ns) if lasting and span.start_ns is not None else {}
    for route in skipped:
        (entry,) = route.reports
        before = earlier.get(route.connection.id, 0)
        entry.skip(counted.get(route.connection.id, 0) + (before if route.connection.is_static else min(before, 1)))
    return {key: route for key, route in routes.items() if key not in counted}
