"""Reading MCAP files, one chunk at a time."""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import TYPE_CHECKING

from mcap import records
from mcap.opcode import Opcode

from pc2scan.errors import DamageError

from .crc32 import crc32
from .damage import DamageLog
from .mcap_chunks import ChunkSegment, payload, with_payload
from .mcap_contents import find_contents, find_declarations
from .mcap_copies import agreed, whole_by_content, whole_by_index
from .mcap_records import MESSAGE, OP_MESSAGE, RECORD, RecordFile, parse, split
from .model import (
    Attachment,
    Connection,
    Definition,
    Metadata,
    RawMessage,
    StoredChunk,
    Summary,
    declared_counts,
)
from .qos import latches
from .reader import Reader
from .segments import standing_alone, units_of
from .zstd import is_frame, unpacked_messages

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from .damage import Damage
    from .mcap_contents import Contents
    from .model import ChunkRule
    from .segments import Segment
    from .units import Item, Unit

__all__ = ["McapReader"]

_SERIALIZATION_OF_SCHEMA = {"ros1msg": "ros1", "ros2msg": "cdr", "ros2idl": "cdr"}

_SERIALIZATION_OF_PROFILE = {"ros1": "ros1", "ros2": "cdr"}


class McapReader(Reader):
    """An open MCAP file; see `pc2scan.bags.reader.Reader`.

    Channels become connections one to one: two channels of one topic stay two. Types, definitions
    and metadata are passed on as recorded, whatever the profile.

    Parameters
    ----------
    path
        The file.
    verify
        Whether to compare the CRCs of the summary, the chunks and the attachments, where recorded. That
        of the data section as a whole is not compared: it would need everything to be read.
    strict
        Whether damage is an error; otherwise it is read around, and told by `damage`.

    Raises
    ------
    RecordingError
        If the file cannot be read or is not MCAP.
    DamageError
        With ``strict``, if it is cut off or contradicts itself. Damage inside chunks is found when they are read.
    """

    def __init__(self, path: Path, *, verify: bool = True, strict: bool = False) -> None:
        self._file = RecordFile(path)
        self._log = DamageLog(strict=strict)
        self._verify = verify
        self._bytes_read = 0
        self._connections: tuple[Connection, ...] = ()
        try:
            try:
                self._contents = find_contents(self._file, verify=verify)
            except DamageError as err:
                from .mcap_recovery import recovered_contents  # noqa: PLC0415  # only damaged files pay for it

                self._contents = recovered_contents(self._file, err, self._log, verify=verify)
            find_declarations(self._file, self._contents, self._records, self._log)
            self._connections = tuple(_connections(self._contents, self._file, self._log))
        except BaseException:
            self._file.close()
            raise
        self._summary = _summary(self._contents, self._file.size)

    @property
    def path(self) -> Path:
        """Where it was opened."""
        return self._file.path

    @property
    def connections(self) -> Sequence[Connection]:
        """One for each channel, in the order of the summary or, without one, of the file."""
        return self._connections

    @property
    def summary(self) -> Summary:
        """What is known without reading messages."""
        return self._summary

    @property
    def bytes_read(self) -> int:
        """Bytes of the segments loaded so far; those read twice count twice."""
        return self._bytes_read

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> list[Unit]:
        """Chunks, and runs of records outside chunks, by start; see `pc2scan.bags.reader.Reader`.

        Without verifying, chunks whose message indexes tell everything are not decompressed where they are whole.
        """
        known = {connection.id: connection for connection in self._connections}
        wanted = known
        if connections is not None:
            wanted = {connection.id: known[connection.id] for connection in connections if connection.id in known}
        ids = None if connections is None else frozenset(wanted)
        first = 0 if start_ns is None else start_ns
        stop = 1 << 64 if stop_ns is None else stop_ns
        if ids is not None and not ids:
            return []
        rule = rule if rule and rule.container == "mcap" else None
        segments = [s for s in self._contents.segments if s.may_hold(ids, start_ns, stop_ns)]
        alone = standing_alone(segments, rule, start_ns, stop_ns) if rule else frozenset()
        blindly: frozenset[int] = frozenset()
        if rule and alone and not self._verify and not self._packs(segments[0]):
            blindly = agreed(self._contents, rule)

        intolerant = DamageLog(strict=True)

        def sound(segment: Segment, data: memoryview) -> list[RawMessage]:
            found, others, size = _messages_in(data, wanted, first, stop)
            if size != len(data):
                raise self._file.damage(
                    f"the records from byte {segment.offset} on are sound for {size} of {len(data)} bytes"
                )
            if unknown := others - known.keys():
                raise self._file.damage(
                    f"channel {min(unknown)} has messages near byte {segment.offset}, but is not declared"
                )
            return found

        def load(segment: Segment, callback: Callable[[RawMessage], Item], *, whole: bool) -> list[Item] | StoredChunk:
            self._bytes_read += segment.length
            seen: StoredChunk | memoryview | None = None
            if rule and whole and isinstance(segment, ChunkSegment):
                # What is damaged is not copied.
                with suppress(DamageError):
                    if segment.connection_ids and segment.connection_ids <= blindly:
                        seen = whole_by_index(self._file, segment, rule)
                    seen = seen or whole_by_content(self._file, segment, rule, verify=self._verify)
            if isinstance(seen, StoredChunk):
                return seen

            def taken(data: memoryview) -> list[Item]:
                unpacked = unpacked_messages(sound(segment, data), intolerant, segment.offset, self._file.path)
                return list(map(callback, unpacked))

            # What is damaged is read again, to see what is left of it.
            with suppress(DamageError):
                return with_payload(self._file, segment, taken, verify=self._verify) if seen is None else taken(seen)
            data, problem = self._prefix(segment)
            found = []
            try:
                if problem is None:
                    found = sound(segment, data)
            except DamageError as err:
                problem = err
            if problem is not None:
                left = self._salvaged(segment, data, problem)
                found = [m for m in left if m.connection.id in wanted and first <= m.log_time_ns < stop]
            return list(map(callback, unpacked_messages(found, self._log, segment.offset, self._file.path)))

        return units_of(segments, load, alone, self._file)

    def _prefix(self, segment: Segment) -> tuple[memoryview, DamageError | None]:
        """A segment's records as far as they can be decompressed, and why that is not all."""
        try:
            return payload(self._file, segment, verify=self._verify), None
        except DamageError as err:
            if self._log.strict:
                raise
            from .mcap_recovery import payload_prefix  # noqa: PLC0415

            return payload_prefix(self._file, segment, err)

    def _packs(self, segment: Segment) -> bool:
        """Whether messages are zstd frames of their own; one segment tells for all."""
        data, _ = self._prefix(segment)
        known = {connection.id: connection for connection in self._connections}
        return any(map(is_frame, _messages_in(data, known, 0, 1 << 64)[0]))

    def _records(self, chunk: Segment) -> Iterator[tuple[int, memoryview]]:
        """A chunk's records, as far as they can be read."""
        data, problem = self._prefix(chunk)
        if problem is None:
            try:
                return iter(list(split(data, chunk.offset, self._file)))
            except DamageError as err:
                problem = err
        from .mcap_recovery import salvaged_records  # noqa: PLC0415

        self._salvaged(chunk, data, problem)
        return salvaged_records(data)

    def _salvaged(self, segment: Segment, data: memoryview, problem: DamageError) -> list[RawMessage]:
        """Take note of a damaged segment, and find the messages that are left of it."""
        if self._log.strict:
            raise problem
        from .mcap_recovery import salvaged_messages  # noqa: PLC0415

        known = {connection.id: connection for connection in self._connections}
        is_chunk = isinstance(segment, ChunkSegment)
        span = (segment.start_ns, segment.end_ns) if is_chunk and 0 < segment.start_ns <= segment.end_ns else None
        left = salvaged_messages(data, known, span)
        missing = max(segment.uncompressed_size - len(data), 0) + left.bytes_lost
        last = left.messages[-1].log_time_ns if left.messages and len(data) < segment.uncompressed_size else None
        self._log.note(
            problem,
            offset=segment.record_offset if isinstance(segment, ChunkSegment) else segment.offset,
            bytes_lost=missing,
            messages_lost=left.strangers if left.strangers and not missing else None if missing else 0,
            first_ns=segment.start_ns if last is None else last,
            last_ns=segment.end_ns,
        )
        return left.messages

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What is damaged, as far as it was read."""
        return self._log.found

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count by the statistics, or for a part of the time by message indexes; see `pc2scan.bags.reader.Reader`."""
        declared = declared_counts(connections) if start_ns is None and stop_ns is None else {}
        ids = frozenset(connection.id for connection in connections) - declared.keys()
        if not ids:
            return declared
        from .mcap_counts import counts_between  # noqa: PLC0415  # only topics that are skipped need it

        return declared | counts_between(self._file, self._contents.segments, ids, start_ns, stop_ns)

    def attachments(self) -> Iterator[Attachment]:
        """Attachments in the order of the file, each read when it is asked for."""
        for offset in sorted(self._contents.attachments):
            content = self._file.record(offset, Opcode.ATTACHMENT)
            try:
                record = parse(records.Attachment, content, offset, self._file)
                # The CRC is behind the data, which are behind two times, two strings and their own length.
                texts = len(record.name.encode()) + len(record.media_type.encode())
                covered = 8 + 8 + 4 + 4 + texts + 8 + len(record.data)
                (crc,) = struct.unpack_from("<I", content, covered)
            except DamageError as err:
                self._log.note(err, offset=offset, bytes_lost=len(content))
                continue
            if self._verify and crc and (actual := crc32(memoryview(content)[:covered])) != crc:
                self._log.note(
                    self._file.damage(f"attachment {record.name!r} has CRC {actual:08x}, recorded is {crc:08x}"),
                    offset=offset,
                )
            yield Attachment(record.name, record.media_type, record.log_time, record.create_time, record.data)

    def metadata(self) -> Iterator[Metadata]:
        """Metadata records in the order of the file."""
        for offset in sorted(self._contents.metadata):
            content = self._file.record(offset, Opcode.METADATA)
            try:
                record = parse(records.Metadata, content, offset, self._file)
            except DamageError as err:
                self._log.note(err, offset=offset, bytes_lost=len(content))
                continue
            yield Metadata(record.name, record.metadata)

    def close(self) -> None:
        """Release the file."""
        self._file.close()


def _messages_in(
    data: memoryview, wanted: Mapping[int, Connection], start_ns: int, stop_ns: int
) -> tuple[list[RawMessage], set[int], int]:
    """Scan records for messages.

    Returns
    -------
    tuple[list[RawMessage], set[int], int]
        The wanted messages in the order of the file, the other channels met, and how many bytes were sound.
    """
    found: list[RawMessage] = []
    others: set[int] = set()
    append, unpack = found.append, MESSAGE.unpack_from
    # The class's own constructor takes twice as long, and this is where readers of small messages wait.
    new: Callable[[type[RawMessage], tuple[object, ...]], RawMessage] = tuple.__new__
    size = len(data)
    last = size - MESSAGE.size
    position = 0
    while position <= last:
        opcode, length, channel_id, sequence, log_time_ns, publish_time_ns = unpack(data, position)
        following = position + 9 + length
        if following > size:
            return found, others, position
        if opcode == OP_MESSAGE:
            if length < 22:
                return found, others, position
            connection = wanted.get(channel_id)
            if connection is None:
                others.add(channel_id)
            elif start_ns <= log_time_ns < stop_ns:
                data_view = data[position + 31 : following]
                append(new(RawMessage, (connection, log_time_ns, data_view, publish_time_ns, sequence)))
        position = following
    # What is left is too short for a message, but may be another record.
    while position + 9 <= size and data[position] != OP_MESSAGE:
        following = position + 9 + RECORD.unpack_from(data, position)[1]
        if following > size:
            break
        position = following
    return found, others, position


def _connections(contents: Contents, file: RecordFile, log: DamageLog) -> Iterator[Connection]:
    for channel in contents.channels.values():
        schema = contents.schemas.get(channel.schema_id)
        if schema is None and channel.schema_id:
            missing = f"channel {channel.id} has schema {channel.schema_id}, which is not in the file"
            log.note(file.damage(missing), key=channel.id)
        yield _connection(channel, schema, contents)


def _connection(channel: records.Channel, schema: records.Schema | None, contents: Contents) -> Connection:
    metadata = channel.metadata
    encoding = schema.encoding if schema else ""
    serialization = (
        channel.message_encoding
        or _SERIALIZATION_OF_SCHEMA.get(encoding)
        or _SERIALIZATION_OF_PROFILE.get(contents.profile, "")
    )
    qos = metadata.get("offered_qos_profiles", "")
    ros1 = serialization == "ros1"
    return Connection(
        id=channel.id,
        topic=channel.topic,
        msgtype=schema.name if schema else "",
        serialization=serialization,
        definition=Definition(encoding, schema.data) if schema else Definition(),
        digest=metadata.get("topic_type_hash") or metadata.get("md5sum", ""),
        callerid=metadata.get("callerid"),
        latching=metadata.get("latching") in ("1", "true", "True") if ros1 else latches(qos),
        qos=qos,
        metadata=metadata,
        message_count=_message_count(channel.id, contents),
        schema_id=channel.schema_id,
    )


def _message_count(channel_id: int, contents: Contents) -> int | None:
    statistics = contents.statistics
    if statistics is None:
        return contents.counts[channel_id] if contents.all_counted else None
    # Writers may leave the counts by channel out.
    if statistics.message_count and not statistics.channel_message_counts:
        return None
    return statistics.channel_message_counts.get(channel_id, 0)


def _summary(contents: Contents, size_bytes: int) -> Summary:
    statistics = contents.statistics
    if statistics is not None:
        count: int | None = statistics.message_count
        times = (statistics.message_start_time, statistics.message_end_time) if count else None
    else:
        count = contents.counts.total() if contents.all_counted else None
        # A chunk without messages has both times zero.
        held = [s for s in contents.segments if s.connection_ids is not None or s.end_ns]
        times = (min(s.start_ns for s in held), max(s.end_ns for s in held)) if held else None
    return Summary(
        container="mcap",
        storage="",
        compression=tuple(sorted({segment.compression for segment in contents.segments})),
        size_bytes=size_bytes,
        message_count=count,
        start_ns=times[0] if times else None,
        end_ns=times[1] if times else None,
        profile=contents.profile,
    )
