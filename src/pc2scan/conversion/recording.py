"""A recording as the destination of a conversion: its topics, and the writing of items."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import MessageError, UnwritableError, UsageError
from pc2scan.messages.definitions import definition
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import LATCHED_QOS, NEW_ID, ChunkRule, Connection, StoredChunk

from .declarations import RecordingTopics
from .items import NOTHING_REFUSED
from .report import TopicReport
from .routes import count_skipped, open_routes
from .steps import ConvertedMessage

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping, Sequence

    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Buffer, Writer
    from pc2scan.request.options import ConvertOptions
    from pc2scan.transforms.static import StaticTransform

    from .added_transforms import TrajectoryWriter
    from .combine.combiner import Combiner
    from .items import Item, OpenRoute, Output, Tally
    from .levelling import LevelFrames
    from .plan import Plan
    from .preparation import Preparation


class OpenRecording(NamedTuple):
    """The routes of a conversion to a recording.

    Attributes
    ----------
    routes, combiners
        As for `pc2scan.conversion.engine.items_of`, without those that are counted already.
    entries
        The report's entries of all topics.
    levels
        Writes the frames of level scans; None if no scan is level.
    trajectories
        Write the transforms of files.
    rule
        Which of the source's chunks can be copied whole; None: none.
    warnings
        What the recording cannot store.
    """

    routes: Mapping[int, OpenRoute]
    combiners: Mapping[Output, Combiner]
    entries: list[TopicReport]
    levels: LevelFrames | None
    trajectories: Sequence[TrajectoryWriter]
    rule: ChunkRule | None
    warnings: Sequence[str]

    @property
    def first_scans(self) -> Sequence[tuple[TopicReport, Buffer]]:
        """The first scan of each output, with the output's entry in the report."""
        outputs = (output for route in self.routes.values() for output in route.outputs if output.first)
        return [
            (output.report, output.first)
            for output in outputs
            if output.report.spec is not None and output.report.spec.made_type == LASERSCAN
        ]


def open_output(
    reader: Reader,
    plan: Plan,
    prepared: Preparation,
    target: Destination,
    options: ConvertOptions,
    writer: Writer | None,
) -> OpenRecording:
    """Declare the topics of a recording, and write what comes before all messages.

    Parameters
    ----------
    writer
        Its writer; None in a dry run.
    """
    span, frames, warnings = prepared.span, options.frames, list[str]()
    copying = target.same_chunks(reader.summary)
    if copying and writer is not None:
        writer.keep_ids(reader.connections)
    topics = RecordingTopics(target, options, same_kind=target.same_kind(reader.summary))
    opened = open_routes(plan.routes, prepared.conversions, topics)
    entries = opened.entries
    added = topics.add(_static_connection(target)) if frames.write_static else None
    trajectories: list[TrajectoryWriter] = []
    if prepared.found is not None and prepared.found.poses and not options.only_scans:
        from .added_transforms import add_poses  # noqa: PLC0415  # few conversions add poses

        trajectories = add_poses(reader, frames, prepared.found.poses, opened, topics, span)
    levels = _level_frames(reader, topics, options) if any(spec.level for spec in plan.specs) else None
    warnings += topics.warnings
    handles = [] if writer is None else topics.declare(writer, opened.by_id.values())
    if levels is not None:
        entries.append(levels.report)
    if writer is not None:
        if levels is not None:
            levels.handle = handles[levels.handle]
        for each in trajectories:
            each.handle = handles[each.handle]
    routes = count_skipped(opened.by_id, reader, span.start_ns, span.stop_ns)
    if writer is None:
        return OpenRecording(routes, opened.combiners, entries, levels, trajectories, None, warnings)
    if not options.only_scans:
        warnings += _copy_extras(reader, target, writer)
    if added is not None:
        earliest_ns, latest_ns = target.times_ns
        begin_ns = max(earliest_ns, min(span.first_ns, latest_ns))
        static = frames.static if prepared.found is None else prepared.found.static
        entries.append(_write_static(static, begin_ns, handles[added], target, writer))
    rule = _chunk_rule(routes, target, writer) if copying else None
    return OpenRecording(routes, opened.combiners, entries, levels, trajectories, rule, warnings)


def _level_frames(reader: Reader, topics: RecordingTopics, options: ConvertOptions) -> LevelFrames:
    """Return the writer of the level frames' transforms."""
    from .levelling import LevelFrames, tf_connection  # noqa: PLC0415  # only where scans are level

    connection = tf_connection(reader, options.frames, topics.target)
    entry = TopicReport(connection.topic, connection.ros_type, connection.topic, "added", "from `level`")
    return LevelFrames(topics.add(connection), topics.target.serialization, entry)


def write_items(items: Generator[Item | StoredChunk], writer: Writer, tally: Tally, recording: OpenRecording) -> None:
    """Write the items of a conversion, and count them.

    Parameters
    ----------
    recording
        The routes, and what writes transforms besides.
    """
    levels = recording.levels
    if recording.trajectories:
        from .added_transforms import between  # noqa: PLC0415  # few conversions add poses

        items = between(items, recording.trajectories, writer)
    for item in items:
        if isinstance(item, StoredChunk):
            writer.write_chunk(item)
            tally.count_chunk(item)
        else:
            tally.count(item, _write(item, writer, levels))
        # Frees the item before the next one is made.
        del item


def _write(item: Item, writer: Writer, levels: LevelFrames | None) -> Mapping[int, MessageError]:
    """Write an item; return what the destination cannot store, as `Tally.count` takes it."""
    log_time_ns, publish_time_ns, sequence = item.log_time_ns, item.publish_time_ns, item.sequence
    refused: dict[int, MessageError] | None = None
    if item.passing is not None:
        try:
            writer.write(item.route.passing_handle, log_time_ns, item.passing, publish_time_ns, sequence)
        except UnwritableError as err:
            # Its scans are not written, either: both are of a time that the destination cannot store.
            return dict.fromkeys(range(-1, len(item.results)), err)
    for number, (output, result) in enumerate(item.results):
        if not isinstance(result, ConvertedMessage) or output.handle < 0:
            continue
        try:
            if output.used:
                if result.used is not None:
                    writer.write(output.handle, log_time_ns, result.used, publish_time_ns, sequence)
                continue
            if levels is not None and result.level is not None:
                # Before the scan, so that its frame is known when the recording is replayed.
                levels.write(result.level, log_time_ns, publish_time_ns, writer)
            writer.write(output.handle, log_time_ns, result.message, publish_time_ns, sequence)
        except UnwritableError as err:
            refused = {**(refused or {}), number: err}
    return refused or NOTHING_REFUSED


def _chunk_rule(routes: Mapping[int, OpenRoute], target: Destination, writer: Writer) -> ChunkRule:
    """Return which of the source's chunks can be copied whole, after everything is declared in the destination."""
    untouched = frozenset(
        route.connection.id
        for route in routes.values()
        if not route.steps and route.reencode is None and route.passing_handle == route.connection.id
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


def _static_connection(target: Destination) -> Connection:
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


def _write_static(
    static: Sequence[StaticTransform], log_time_ns: int, handle: int, target: Destination, writer: Writer
) -> TopicReport:
    """Write the added transforms, and return what was written; ``handle`` is that of `_static_connection`."""
    if not static:
        raise UsageError("there is no added transform to write", hint="give one with `static_tf`, or with `urdf`")
    rows = [transform.row(log_time_ns) for transform in static]
    writer.write(handle, log_time_ns, encode_transforms(rows, target.serialization), log_time_ns)
    msgtype = "tf2_msgs/msg/TFMessage"
    return TopicReport("/tf_static", msgtype, "/tf_static", "added", "from `write_static_tf`", messages_out=1)
