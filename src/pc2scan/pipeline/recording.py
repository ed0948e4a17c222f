"""A recording as the destination of a conversion: its topics, and the writing of items."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.bags.formats import FORMATS
from pc2scan.errors import MessageError, RecordingError, UnwritableError
from pc2scan.messages.definitions import definition
from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import LATCHED_QOS, NEW_ID, ChunkRule, Connection, StoredChunk

from .conversion import ConvertedMessage
from .declarations import Declarations
from .topic_report import TopicReport

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping

    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Buffer, Definition, Writer
    from pc2scan.tf.options import FrameOptions

    from .items import Item, OpenRoute
    from .levelling import LevelFrames
    from .options import ConvertOptions
    from .tally import Tally

#: Maximum number of fields that are compiled for re-encoding. Each takes about a millisecond and 7 kB; large robots
#: have thousands.
_MAX_COMPILED_FIELDS = 20_000


class RecordingTopics:
    """The topics of a recording that is to be written, collected before they are declared.

    Parameters
    ----------
    target
        The recording.
    same_kind
        Whether the source is in the same kind of container.
    options
        The options of the conversion.

    Notes
    -----
    Until `declare` is called, handles are places among the topics that were added.
    """

    def __init__(self, target: Destination, options: ConvertOptions, *, same_kind: bool) -> None:
        self.target = target
        self._same_kind = same_kind
        self._options = options
        self._declarations = Declarations()
        #: The fields of all types that were compiled for re-encoding; their number is bounded.
        self._compiled: dict[tuple[str, Definition], int] = {}

    def add(self, connection: Connection) -> int:
        """Add a connection; return its handle."""
        return self._declarations.add(connection)

    def add_like(self, source: Connection, topic: str, msgtype: str) -> int:
        """Add a topic with the QoS profile, latching and caller id of a source's; return its handle."""
        target = self.target
        text, digest = definition(msgtype, target.ros_version)
        same = source.ros_version == target.ros_version
        return self.add(
            Connection(
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
        )

    def add_passing(self, connection: Connection, entry: TopicReport) -> tuple[int, Callable[[Buffer], Buffer] | None]:
        """Add a connection that passes through, re-encoded if the destination is of the other ROS version.

        Parameters
        ----------
        entry
            Its entry in the report, which is changed if its messages are re-encoded, or cannot pass.

        Returns
        -------
        int, callable
            Its handle, -1 if its messages cannot pass; and what re-encodes a message, None if nothing does.
        """
        target, options = self.target, self._options
        foreign = connection.ros_version is None
        # The same kind of container can store the message as it is, even if its type is unknown.
        as_it_is = (self._same_kind and (foreign or options.repair)) or (foreign and target.format.holds_any)
        defined_already = connection.definition.data or options.repair
        if as_it_is or (connection.ros_version == target.ros_version and defined_already):
            return self.add(connection), None
        # Imported only for recordings without definitions, or for another ROS version.
        from pc2scan.messages.transcode import DEFAULT_DISTRO, transcoder, with_definition  # noqa: PLC0415

        distro = options.ros_distro or DEFAULT_DISTRO
        if connection.ros_version == target.ros_version:
            return self.add(with_definition(connection, distro)), None
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
                self._compiled[connection.msgtype, connection.definition] = transcoding.fields
                if sum(self._compiled.values()) > _MAX_COMPILED_FIELDS:
                    raise RecordingError(
                        f"its types have more than {_MAX_COMPILED_FIELDS} fields in all, too many to re-encode",
                        hint="`drop` or `keep` chooses among the topics",
                    )
                entry.action, entry.note = "re-encoded", "; ".join(transcoding.notes)
                return self.add(transcoding.connection), transcoding.encode
        if options.on_error == "fail" and connection.message_count != 0:
            error.topic = connection.topic
            raise error
        entry.note, entry.lost = error.message, True
        entry.action, entry.target = "skipped", None
        return -1, None

    def declare(self, writer: Writer, routes: Iterable[OpenRoute]) -> list[int]:
        """Declare all topics, and give the routes the writer's handles; return the handle of each topic."""
        handles = self._declarations.declare(writer, one_a_topic=self.target.format.one_a_topic)
        for route in routes:
            if route.passing_handle >= 0:
                route.passing_handle = handles[route.passing_handle]
            for output in route.outputs:
                if output.handle >= 0:
                    output.handle = handles[output.handle]
        return handles


def _holding_any() -> str:
    """Return the suffixes of files that hold messages of every encoding."""
    return " or ".join(entry.suffix for entry in FORMATS.values() if entry.holds_any)


def write_items(items: Generator[Item | StoredChunk], writer: Writer, tally: Tally, levels: LevelFrames | None) -> None:
    """Write the items of a conversion, and count them.

    Parameters
    ----------
    levels
        Writes the frames of level scans.
    """
    for item in items:
        if isinstance(item, StoredChunk):
            writer.write_chunk(item)
            tally.count_chunk(item)
        else:
            tally.count(item, _write(item, writer, levels))


def _write(item: Item, writer: Writer, levels: LevelFrames | None) -> Mapping[int, MessageError]:
    """Write an item; return what the destination cannot store, as `Tally.count` takes it."""
    log_time_ns, publish_time_ns, sequence = item.log_time_ns, item.publish_time_ns, item.sequence
    refused: dict[int, MessageError] = {}
    if item.passing is not None:
        try:
            writer.write(item.route.passing_handle, log_time_ns, item.passing, publish_time_ns, sequence)
        except UnwritableError as err:
            # Its scans are not written, either: both are of a time that the destination cannot store.
            return dict.fromkeys(range(-1, len(item.results)), err)
    for place, (output, result) in enumerate(item.results):
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
            refused[place] = err
    return refused


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
