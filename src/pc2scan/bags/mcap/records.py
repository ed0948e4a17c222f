"""Reads and parses the records of MCAP files, and finds the messages among them.

Source of the format: https://mcap.dev/spec and https://mcap.dev/spec/registry.
"""

from __future__ import annotations

import struct
from array import array
from enum import IntEnum
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from pc2scan.bags.damage import RECOVER
from pc2scan.bags.formats import FORMATS
from pc2scan.bags.loading import MAX_LISTED_ITEMS, LazyItems
from pc2scan.errors import DamageError
from pc2scan.files.compression import crc32
from pc2scan.files.source import SourceFile
from pc2scan.model import RawMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pc2scan.model import Buffer, Connection

    Messages = list[RawMessage] | LazyItems[RawMessage]


class Opcode(IntEnum):
    """The kinds of records."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


# The fields of each are in the order in which they are stored.


class Header(NamedTuple):
    """The first record."""

    profile: str
    library: str


class Footer(NamedTuple):
    """The last record."""

    summary_start: int
    summary_offset_start: int
    summary_crc: int


class Schema(NamedTuple):
    """A message definition."""

    id: int
    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
    """A topic of one publisher."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: Mapping[str, str]


class ChunkIndex(NamedTuple):
    """The position of a chunk, and of the message indexes after it, by channel."""

    message_start_time: int
    message_end_time: int
    chunk_start_offset: int
    chunk_length: int
    message_index_offsets: Mapping[int, int]
    message_index_length: int
    compression: str
    compressed_size: int
    uncompressed_size: int


class AttachmentRecord(NamedTuple):
    """A file in the recording. The CRC covers all other fields, or is 0."""

    log_time: int
    create_time: int
    name: str
    media_type: str
    data: bytes
    crc: int = 0


class AttachmentIndex(NamedTuple):
    """The position of an attachment."""

    offset: int
    length: int
    log_time: int
    create_time: int
    data_size: int
    name: str
    media_type: str


class Statistics(NamedTuple):
    """The numbers of messages, schemas, channels, attachments, metadata records and chunks."""

    message_count: int
    schema_count: int
    channel_count: int
    attachment_count: int
    metadata_count: int
    chunk_count: int
    message_start_time: int
    message_end_time: int
    channel_message_counts: Mapping[int, int]


class MetadataRecord(NamedTuple):
    """A metadata record: text by name."""

    name: str
    metadata: Mapping[str, str]


class MetadataIndex(NamedTuple):
    """The position of a metadata record."""

    offset: int
    length: int
    name: str


class SummaryOffset(NamedTuple):
    """The position of the records of a kind in the summary."""

    group_opcode: int
    group_start: int
    group_length: int


class DataEnd(NamedTuple):
    """The end of the data section, with its CRC or 0."""

    data_section_crc: int


Record: TypeAlias = (
    Header
    | Footer
    | Schema
    | Channel
    | ChunkIndex
    | AttachmentRecord
    | AttachmentIndex
    | Statistics
    | MetadataRecord
    | MetadataIndex
    | SummaryOffset
    | DataEnd
)

_Kind = TypeVar("_Kind", bound=Record)

#: How each is stored: its opcode, and its fields. ``B H I Q`` are unsigned numbers, as in `struct`; ``s`` is text;
#: ``x`` and ``X`` are bytes after their length of 32 and 64 bits; ``t`` and ``n`` are mappings of texts and numbers.
_FORMS: Mapping[type, tuple[Opcode, str]] = {
    Header: (Opcode.HEADER, "ss"),
    Footer: (Opcode.FOOTER, "QQI"),
    Schema: (Opcode.SCHEMA, "Hssx"),
    Channel: (Opcode.CHANNEL, "HHsst"),
    ChunkIndex: (Opcode.CHUNK_INDEX, "QQQQnQsQQ"),
    AttachmentRecord: (Opcode.ATTACHMENT, "QQssXI"),
    AttachmentIndex: (Opcode.ATTACHMENT_INDEX, "QQQQQss"),
    Statistics: (Opcode.STATISTICS, "QHIIIIQQn"),
    MetadataRecord: (Opcode.METADATA, "st"),
    MetadataIndex: (Opcode.METADATA_INDEX, "QQs"),
    SummaryOffset: (Opcode.SUMMARY_OFFSET, "BQQ"),
    DataEnd: (Opcode.DATA_END, "I"),
}

_NUMBERS = {code: struct.Struct(f"<{code}") for code in "BHIQ"}
#: The codes of a mapping's keys and values.
_PAIRS = {"t": "ss", "n": "HQ"}


def pack(record: Record) -> tuple[Opcode, bytes]:
    """Return a record's opcode and content.

    Raises
    ------
    struct.error
        If a number is negative or too large.
    """
    opcode, codes = _FORMS[type(record)]
    return opcode, b"".join(map(_stored_field, codes, record))


def _stored_field(code: str, value: Any) -> bytes:
    if code in _NUMBERS:
        return _NUMBERS[code].pack(value)
    if code in _PAIRS:
        data = b"".join(part for pair in value.items() for part in map(_stored_field, _PAIRS[code], pair))
    else:
        data = value.encode() if code == "s" else value
    return _NUMBERS["Q" if code == "X" else "I"].pack(len(data)) + data


def unpack(kind: type[_Kind], content: Buffer) -> _Kind:
    """Read a record's content; further bytes are ignored.

    Raises
    ------
    struct.error
        If it is too short.
    UnicodeDecodeError
        If a text is not UTF-8.
    """
    values, position, content = [], 0, memoryview(content)
    for code in _FORMS[kind][1]:
        value, position = _read_field(code, content, position)
        values.append(value)
    return kind(*values)


def _read_field(code: str, content: memoryview, position: int) -> tuple[Any, int]:
    """Read a field; return it and the position after it."""
    number = _NUMBERS.get(code)
    if number is not None:
        return number.unpack_from(content, position)[0], position + number.size
    length, position = _read_field("Q" if code == "X" else "I", content, position)
    end = position + length
    if end > len(content):
        raise struct.error(f"{length} bytes are declared where there are {len(content) - position}")
    if code in _PAIRS:
        pairs = {}
        while position < end:
            key, position = _read_field(_PAIRS[code][0], content, position)
            pairs[key], position = _read_field(_PAIRS[code][1], content, position)
        return pairs, position
    data = bytes(content[position:end])
    return (data.decode() if code == "s" else data), end


#: The first and the last eight bytes of every file.
MAGIC = FORMATS["mcap"].magic
COMPRESSIONS = FORMATS["mcap"].compressions

# Opcode and length of the content: the beginning of every record.
RECORD = struct.Struct("<BQ")
# The same with a message's channel id, sequence, log time and publish time.
MESSAGE = struct.Struct("<BQHIQQ")
# A chunk's first and last log time, uncompressed size, CRC, and the length of its compression's name.
CHUNK = struct.Struct("<QQQII")
UINT64 = struct.Struct("<Q")

# Plain integers: comparing an IntEnum member costs a method call for each message.
OP_MESSAGE, OP_CHUNK, OP_MESSAGE_INDEX = 0x05, 0x06, 0x07

#: Bytes that are read at a time for a CRC.
_PIECE = 1 << 20

#: Opcodes from here on are for private records. Those between `Opcode` and these are for later specifications.
FIRST_PRIVATE = 0x80


def has_meaning(opcode: int) -> bool:
    """Whether an opcode is one of the specification or a private one."""
    return 0 < opcode <= Opcode.DATA_END or opcode >= FIRST_PRIVATE


class RecordFile(SourceFile):
    """Reads records of an MCAP file; all errors are `RecordingError`."""

    def damage(self, message: str) -> DamageError:
        """Return the error for a damaged file."""
        return DamageError(message, path=self.path, hint=RECOVER)

    def record(self, offset: int, opcode: Opcode) -> bytes:
        """Read the content of a record of a known kind."""
        actual, length = RECORD.unpack(self.read(offset, RECORD.size))
        if actual != opcode:
            raise self.damage(
                f"a record of kind {opcode} ({opcode.name}) is declared at byte {offset}, found {actual}",
            )
        return self.read(offset + RECORD.size, length)

    def crc(self, start: int, stop: int, value: int = 0) -> int:
        """Return the CRC-32 of a part of the file that follows what has the CRC ``value``."""
        for position in range(start, stop, _PIECE):
            value = crc32(self.read(position, min(_PIECE, stop - position)), value)
        return value


_Record = TypeVar("_Record", bound=Record)


def parse(kind: type[_Record], content: Buffer, offset: int, file: RecordFile) -> _Record:
    """Parse a record's content; ``offset`` is its place in the file, for the error."""
    try:
        return unpack(kind, content)
    except (struct.error, UnicodeDecodeError) as err:
        raise file.damage(
            f"the {kind.__name__} record at byte {offset} ({len(content)} bytes) contradicts its own lengths",
        ) from err


def split(data: memoryview, origin: int, file: RecordFile) -> Iterator[tuple[int, memoryview]]:
    """Split consecutive records into opcodes and contents; ``origin`` is their place, for the error."""
    position = 0
    while position < len(data):
        start = position + RECORD.size
        if start > len(data):
            break
        opcode, length = RECORD.unpack_from(data, position)
        position = start + length
        if position > len(data):
            break
        yield opcode, data[start:position]
    if position != len(data):
        raise file.damage(f"the records from byte {origin} on do not end after {len(data)} bytes")


def encode_record(record: Record) -> bytes:
    """Pack a record, its opcode and length included, and the CRC of an attachment."""
    opcode, content = pack(record)
    if isinstance(record, AttachmentRecord):
        content = content[:-4] + struct.pack("<I", crc32(content[:-4]))
    return RECORD.pack(opcode, len(content)) + content


# --- Messages ---

#: The first and the last log time that a message can have.
ANY_TIME = (0, (1 << 64) - 1)


class MessageScan(NamedTuple):
    """The result of scanning records for messages.

    Attributes
    ----------
    messages
        The wanted messages, in the order of the file.
    others
        Other channels with messages.
    size
        Number of sound bytes.
    astray
        Log time of a wanted message outside of the declared times.
    """

    messages: Messages
    others: set[int]
    size: int
    astray: int | None


def scan_messages(
    data: memoryview,
    wanted: Mapping[int, Connection],
    start_ns: int,
    stop_ns: int,
    span: tuple[int, int] = ANY_TIME,
    further: Callable[[int], None] | None = None,
) -> MessageScan:
    """Scan records for messages; those outside of ``span``, the declared log times, are skipped.

    ``further`` is called with the offset of every other record.
    """
    messages: list[RawMessage] = []
    others: set[int] = set()
    astray: int | None = None
    count = position = 0
    while position < len(data):
        more = _scan_stretch(data, wanted, start_ns, stop_ns, span, further, position)
        others |= more.others
        astray = more.astray if astray is None else astray
        count += len(more.messages)
        messages = [*messages, *more.messages] if count <= MAX_LISTED_ITEMS else []
        if more.size == position:
            break
        position = more.size
    if count <= MAX_LISTED_ITEMS:
        return MessageScan(messages, others, position, astray)
    start_ns, stop_ns = max(start_ns, span[0]), min(stop_ns, span[1] + 1)
    return MessageScan(_lazy_messages(data[:position], wanted, start_ns, stop_ns), others, position, astray)


def _lazy_messages(
    data: memoryview, wanted: Mapping[int, Connection], start_ns: int, stop_ns: int
) -> LazyItems[RawMessage]:
    """Return the messages among sound records, each created when it is needed."""
    times, places = array("Q"), array("Q")
    position, last = 0, len(data) - MESSAGE.size
    while position <= last:
        opcode, length, channel_id, _, log_time_ns, _ = MESSAGE.unpack_from(data, position)
        if opcode == OP_MESSAGE and channel_id in wanted and start_ns <= log_time_ns < stop_ns:
            times.append(log_time_ns)
            places.append(position)
        position += RECORD.size + length
    return LazyItems(times, places, partial(message_at, data, wanted), len(data))


def _scan_stretch(
    data: memoryview,
    wanted: Mapping[int, Connection],
    start_ns: int,
    stop_ns: int,
    span: tuple[int, int],
    further: Callable[[int], None] | None,
    position: int,
) -> MessageScan:
    """Scan records from an offset on, so few bytes that they have at most `MAX_LISTED_ITEMS` messages."""
    astray: int | None = None
    first_ns, last_ns = span
    # One comparison for cut and span; only if it fails, the two are distinguished.
    start_ns, stop_ns = max(start_ns, first_ns), min(stop_ns, last_ns + 1)
    found: list[RawMessage] = []
    others: set[int] = set()
    append, unpack = found.append, MESSAGE.unpack_from
    # The class's constructor takes twice as long, which matters for small messages.
    new: Callable[[type[RawMessage], tuple[object, ...]], RawMessage] = tuple.__new__
    size = len(data)
    last = min(size, position + MAX_LISTED_ITEMS * MESSAGE.size) - MESSAGE.size
    while position <= last:
        opcode, length, channel_id, sequence, log_time_ns, publish_time_ns = unpack(data, position)
        following = position + 9 + length
        if following > size:
            return MessageScan(found, others, position, astray)
        if opcode == OP_MESSAGE:
            if length < 22:
                return MessageScan(found, others, position, astray)
            connection = wanted.get(channel_id)
            if connection is None:
                others.add(channel_id)
            elif start_ns <= log_time_ns < stop_ns:
                data_view = data[position + 31 : following]
                append(new(RawMessage, (connection, log_time_ns, data_view, publish_time_ns, sequence)))
            elif not first_ns <= log_time_ns <= last_ns:
                astray = log_time_ns
        elif further is not None:
            further(position)
        position = following
    # The rest is too short for a message, but may be another record.
    while position + 9 <= size and data[position] != OP_MESSAGE:
        following = position + 9 + RECORD.unpack_from(data, position)[1]
        if following > size:
            break
        if further is not None:
            further(position)
        position = following
    return MessageScan(found, others, position, astray)


def message_at(data: memoryview, known: Mapping[int, Connection], place: int) -> RawMessage:
    """Return the message of a known channel that begins at a place."""
    _, length, channel_id, sequence, log_time_ns, publish_time_ns = MESSAGE.unpack_from(data, place)
    content = data[place + MESSAGE.size : place + RECORD.size + length]
    return RawMessage(known[channel_id], log_time_ns, content, publish_time_ns, sequence)
