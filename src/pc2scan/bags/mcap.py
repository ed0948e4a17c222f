"""MCAP files: a reader that loads one chunk at a time, and a writer.

The reader works in two steps. First it finds out what is where (`Contents`): from the summary at the end of
the file, and by a walk over the headers of the records that the summary does not account for. A file
without a summary is walked from end to end, in the same way. Then messages are read, from
segments: one for each chunk, and one for each run of messages outside chunks.

Source of the format: https://mcap.dev/spec and https://mcap.dev/spec/registry.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import TYPE_CHECKING, TypeVar

from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

from pc2scan.errors import DestinationError, OutputError, RecordingError

from .model import (
    Attachment,
    Connection,
    Definition,
    Metadata,
    RawMessage,
    Summary,
    normalized_type,
    ros1_type,
)
from .segments import Segment, in_time_order

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from .model import Buffer

__all__ = ["MAGIC", "McapReader", "McapWriter", "latches"]

#: The first and the last eight bytes of every file.
MAGIC = b"\x89MCAP0\r\n"

# Opcode and length of the content: how every record begins.
_RECORD = struct.Struct("<BQ")
# The same with a message's channel id, sequence, log time and publish time.
_MESSAGE = struct.Struct("<BQHIQQ")
# A chunk's first and last log time, uncompressed size, CRC, and the length of its compression's name.
_CHUNK = struct.Struct("<QQQII")
_UINT64 = struct.Struct("<Q")
_FOOTER_SIZE = _RECORD.size + 20
# No compression has a longer name; a longer one is garbage.
_MAX_COMPRESSION_NAME = 64
_CHUNK_HEAD_SIZE = _RECORD.size + _CHUNK.size + _MAX_COMPRESSION_NAME + _UINT64.size
# Plain integers: comparing an IntEnum member costs a method call for each message.
_OP_MESSAGE, _OP_CHUNK, _OP_MESSAGE_INDEX = 0x05, 0x06, 0x07

#: Messages outside chunks are read in stretches of about this size, bytes.
RUN_SIZE = 4 << 20

_TRANSIENT_LOCAL = re.compile(
    r"""\bdurability["']?[ \t]*:[ \t]*["']?(?:1|transient_local)\b""", re.IGNORECASE
)
_SERIALIZATION_OF_SCHEMA = {"ros1msg": "ros1", "ros2msg": "cdr", "ros2idl": "cdr"}
_SERIALIZATION_OF_PROFILE = {"ros1": "ros1", "ros2": "cdr"}
_REPAIR = "copy the recording again, or repair it with `mcap recover`"


def latches(qos: str) -> bool:
    r"""Whether any of rosbag2's ``offered_qos_profiles`` has the durability transient local.

    Profiles with keys missing occur, and YAML parsers that insist on all keys fail on them; here only
    this key matters. Its value is rmw's number (1) or, from ROS 2 Jazzy on, its name.

    >>> latches("- history: 1\n  durability: 1"), latches("- durability: volatile")
    (True, False)
    """
    return _TRANSIENT_LOCAL.search(qos) is not None


# --- Reading: the file and its records ---


class RecordFile:
    """A file that is read at given places; whatever fails is a `RecordingError`.

    Bytes are read, not mapped: a file that is truncated meanwhile gives an error and no SIGBUS.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor = -1
        try:
            self._descriptor = os.open(path, os.O_RDONLY)
            self.size = os.fstat(self._descriptor).st_size
        except OSError as err:
            self.close()
            raise self.error(f"cannot be opened: {err.strerror}") from err

    def close(self) -> None:
        """Release the file; reading afterwards is an error."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def error(self, message: str, hint: str | None = None) -> RecordingError:
        """Make an error that names this file."""
        return RecordingError(message, path=self.path, hint=hint)

    def read(self, offset: int, length: int) -> bytes:
        """Read exactly ``length`` bytes."""
        if offset + length > self.size:
            raise self.error(
                f"{length} bytes are declared from byte {offset} on, but the file has {self.size}", _REPAIR
            )
        try:
            data = os.pread(self._descriptor, length, offset)
            # One call returns 2 GiB at most.
            while len(data) < length and (
                more := os.pread(self._descriptor, length - len(data), offset + len(data))
            ):
                data += more
        except OSError as err:
            raise self.error(f"cannot be read at byte {offset}: {err.strerror}") from err
        except MemoryError as err:
            raise self.error(f"{length} bytes from byte {offset} on do not fit into memory") from err
        if len(data) < length:
            raise self.error(
                f"ended at byte {offset + len(data)} while it was read; it had {self.size} bytes when opened",
                "wait until the recording is complete",
            )
        return data

    def record(self, offset: int, opcode: Opcode) -> bytes:
        """Read the content of a record of a known kind."""
        actual, length = _RECORD.unpack(self.read(offset, _RECORD.size))
        if actual != opcode:
            raise self.error(
                f"a record of kind {opcode} ({opcode.name}) is declared at byte {offset}, found {actual}",
                _REPAIR,
            )
        return self.read(offset + _RECORD.size, length)


class _Fields(ReadDataStream):
    """The content of one record for the library's parsers, which take short reads for granted otherwise."""

    def __init__(self, content: Buffer) -> None:
        super().__init__(BytesIO())
        self._content = memoryview(content)

    def read(self, length: int) -> bytes:
        data = bytes(self._content[self._count : self._count + length])
        if len(data) < length:
            raise EndOfFile
        self._count += length
        return data


_Record = TypeVar("_Record", bound=records.McapRecord)


def _parse(kind: type[_Record], content: Buffer, offset: int, file: RecordFile) -> _Record:
    """Parse a record's content; ``offset`` is its place in the file, for the error."""
    try:
        parsed: _Record = kind.read(_Fields(content))  # type: ignore[attr-defined]
    except (EndOfFile, struct.error, UnicodeDecodeError) as err:
        raise file.error(
            f"the {kind.__name__} record at byte {offset} ({len(content)} bytes) contradicts its own lengths",
            _REPAIR,
        ) from err
    return parsed


def _split(data: memoryview, origin: int, file: RecordFile) -> Iterator[tuple[int, memoryview]]:
    """Split a sequence of records into opcodes and contents; ``origin`` is its place, for the error."""
    position = 0
    while position < len(data):
        start = position + _RECORD.size
        if start > len(data):
            break
        opcode, length = _RECORD.unpack_from(data, position)
        position = start + length
        if position > len(data):
            break
        yield opcode, data[start:position]
    if position != len(data):
        raise file.error(f"the records from byte {origin} on do not end after {len(data)} bytes", _REPAIR)


# --- Reading: what is where ---


@dataclass(frozen=True, slots=True)
class ChunkSegment(Segment):
    """A chunk. `crc` is that of a chunk whose header was read, else 0; loading goes by the header itself.

    Attributes
    ----------
    record_offset
        Where the chunk's record begins in the file.
    """

    record_offset: int = 0


@dataclass(slots=True)
class Contents:
    """What is where in a file, however that was found out.

    Attributes
    ----------
    profile
        The header's.
    schemas, channels
        By id, in the order found.
    segments
        Chunks and runs of messages outside chunks, in the order found.
    attachments, metadata
        Where these records begin in the file.
    statistics
        The summary's, if it has them.
    counts
        Messages by channel, as far as they were counted.
    all_counted
        Whether `counts` tells of every message.
    channels_listed
        Whether the summary repeats the channels.
    """

    profile: str = ""
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    segments: list[Segment] = field(default_factory=list)
    attachments: list[int] = field(default_factory=list)
    metadata: list[int] = field(default_factory=list)
    statistics: records.Statistics | None = None
    counts: Counter[int] = field(default_factory=Counter)
    all_counted: bool = True
    channels_listed: bool = False

    def declare(self, opcode: int, content: Buffer, offset: int, file: RecordFile) -> None:
        """Remember a Schema or a Channel; other records are ignored. The first of an id is kept."""
        if opcode == Opcode.SCHEMA:
            schema = _parse(records.Schema, content, offset, file)
            # "A Schema record with an id of zero is invalid and should be ignored."
            if schema.id:
                self.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = _parse(records.Channel, content, offset, file)
            self.channels.setdefault(channel.id, channel)


def find_contents(file: RecordFile, *, verify: bool = True) -> Contents:
    """Find out what is where in a complete file.

    Parameters
    ----------
    file
        The open file.
    verify
        Whether to compare CRCs, of the summary and of the chunks that have to be opened.

    Raises
    ------
    RecordingError
        If the file is not MCAP, is cut off, or contradicts itself.
    """
    contents = Contents()
    start = read_header(file, contents)
    end, accounted = _read_summary(file, contents, verify=verify)
    Walk(file, contents, accounted).run(start, end)
    find_declarations(file, contents, verify=verify)
    return contents


def read_header(file: RecordFile, contents: Contents) -> int:
    """Check the magic, note the profile, and return where the first record behind the header begins."""
    magic = file.read(0, min(len(MAGIC), file.size))
    if magic != MAGIC:
        raise file.error(
            f"is not an MCAP file: it begins with {magic.hex(' ') or 'nothing'}, expected {MAGIC.hex(' ')}"
        )
    content = file.record(len(MAGIC), Opcode.HEADER)
    contents.profile = _parse(records.Header, content, len(MAGIC), file).profile
    return len(MAGIC) + _RECORD.size + len(content)


def _read_summary(file: RecordFile, contents: Contents, *, verify: bool) -> tuple[int, dict[int, int]]:
    """Read what the end of the file tells.

    Returns
    -------
    tuple[int, dict[int, int]]
        Where the data section ends, and for each chunk of it that the summary accounts for, its place
        and the place of the record to look at next.
    """
    footer_offset = file.size - len(MAGIC) - _FOOTER_SIZE
    tail = file.read(footer_offset, _FOOTER_SIZE + len(MAGIC)) if footer_offset > len(MAGIC) else b""
    opcode, length = _RECORD.unpack_from(tail) if tail else (0, 0)
    if not tail.endswith(MAGIC) or opcode != Opcode.FOOTER or length != _FOOTER_SIZE - _RECORD.size:
        raise file.error(
            f"has no footer at the end of its {file.size} bytes: the recording was cut off", _REPAIR
        )
    footer = _parse(records.Footer, tail[_RECORD.size : _FOOTER_SIZE], footer_offset, file)
    start = footer.summary_start
    if start == 0:
        return footer_offset, {}
    if not len(MAGIC) <= start <= footer_offset:
        raise file.error(
            f"the footer places the summary at byte {start}, allowed is up to {footer_offset}", _REPAIR
        )
    data = file.read(start, footer_offset - start)
    if verify and footer.summary_crc:
        # The footer counts too, up to the CRC itself.
        actual = zlib.crc32(tail[: _FOOTER_SIZE - 4], zlib.crc32(data))
        if actual != footer.summary_crc:
            raise file.error(
                f"the summary's CRC is {actual:08x}, recorded is {footer.summary_crc:08x}", _REPAIR
            )
    accounted: dict[int, int] = {}
    for kind, content in _split(memoryview(data), start, file):
        if kind == Opcode.CHUNK_INDEX:
            chunk, following = _indexed_chunk(content, start, file)
            contents.segments.append(chunk)
            contents.all_counted = False
            accounted[chunk.record_offset] = following
        elif kind == Opcode.STATISTICS:
            contents.statistics = _parse(records.Statistics, content, start, file)
        else:
            # Attachments and metadata are found by the walk: it costs little, and the index that @mcap/core
            # 2.2.2 writes for files without chunks has wrong offsets.
            contents.declare(kind, content, start, file)
    if len(accounted) != len(contents.segments):
        raise file.error("the summary's index names a chunk twice", _REPAIR)
    contents.channels_listed = bool(contents.channels)
    return start, accounted


def _indexed_chunk(content: memoryview, origin: int, file: RecordFile) -> tuple[ChunkSegment, int]:
    """Read a ChunkIndex; returns the chunk and where its message indexes end."""
    # Parsed here: the library's parser is many times slower, and a long recording has 100,000 of them.
    try:
        start_ns, end_ns, offset, length, offsets_size = struct.unpack_from("<QQQQI", content)
        position = 36 + offsets_size
        ids = frozenset(channel for channel, _ in struct.iter_unpack("<HQ", content[36:position]))
        message_index_size, name_size = struct.unpack_from("<QI", content, position)
        position += 12 + name_size
        compressed, uncompressed = struct.unpack_from("<QQ", content, position)
        name = str(content[position - name_size : position], "utf-8")
    except (struct.error, UnicodeDecodeError) as err:
        raise file.error(
            f"a ChunkIndex record in the summary at byte {origin} is malformed", _REPAIR
        ) from err
    chunk = ChunkSegment(
        offset=offset + _RECORD.size + _CHUNK.size + name_size + _UINT64.size,
        length=compressed,
        compression=name or "none",
        uncompressed_size=uncompressed,
        crc=0,
        start_ns=start_ns,
        end_ns=end_ns,
        # Nothing listed: either there are no message indexes or no messages.
        connection_ids=ids or None,
        record_offset=offset,
    )
    if chunk.offset + chunk.length > offset + length or offset + length > origin:
        raise file.error(
            f"the index places a chunk of {length} bytes at byte {offset}, the data ends at byte {origin}",
            _REPAIR,
        )
    return chunk, offset + length + message_index_size


def _chunk_at(data: Buffer, position: int, record_offset: int, file: RecordFile) -> ChunkSegment:
    """Read the header of the chunk whose record begins at ``data[position]``."""
    malformed = f"the chunk at byte {record_offset} has a malformed header"
    try:
        _, record_length = _RECORD.unpack_from(data, position)
        start_ns, end_ns, size, crc, name_size = _CHUNK.unpack_from(data, position + _RECORD.size)
        name_at = position + _RECORD.size + _CHUNK.size
        (length,) = _UINT64.unpack_from(data, name_at + min(name_size, _MAX_COMPRESSION_NAME))
        name = str(data[name_at : name_at + name_size], "utf-8")
    except (struct.error, UnicodeDecodeError) as err:
        raise file.error(malformed, _REPAIR) from err
    if name_size > _MAX_COMPRESSION_NAME:
        raise file.error(f"{malformed}: its compression has a name of {name_size} bytes", _REPAIR)
    head = _CHUNK.size + name_size + _UINT64.size
    if head + length > record_length:
        raise file.error(
            f"the chunk at byte {record_offset} declares {length} bytes of records in {record_length} bytes",
            _REPAIR,
        )
    return ChunkSegment(
        offset=record_offset + _RECORD.size + head,
        length=length,
        compression=name or "none",
        uncompressed_size=size,
        crc=crc,
        start_ns=start_ns,
        end_ns=end_ns,
        record_offset=record_offset,
    )


class _Window:
    """A stretch of the file that moves along with a walk, so that small records cost no system call each."""

    def __init__(self, file: RecordFile) -> None:
        self._file = file
        self._start = 0
        self.data = b""

    def locate(self, offset: int, length: int) -> int:
        """Return where in `data` the bytes from ``offset`` on are (as many as the file has of ``length``)."""
        position = offset - self._start
        length = min(length, self._file.size - offset)
        if position < 0 or position + length > len(self.data):
            # After a jump over a large record probably comes another one: little is read ahead.
            ahead = (1 << 18) if position <= len(self.data) else (1 << 12)
            self.data = self._file.read(offset, min(max(length, ahead), self._file.size - offset))
            self._start = offset
            position = 0
        return position


class _Run:
    """Messages one behind the other outside any chunk, while a walk collects them."""

    __slots__ = ("end", "end_ns", "ids", "start", "start_ns")

    def __init__(self, start: int, log_time_ns: int) -> None:
        self.start = self.end = start
        self.start_ns = self.end_ns = log_time_ns
        self.ids: set[int] = set()

    def add(self, channel_id: int, log_time_ns: int, end: int) -> None:
        self.ids.add(channel_id)
        self.end = end
        self.start_ns = min(self.start_ns, log_time_ns)
        self.end_ns = max(self.end_ns, log_time_ns)

    def segment(self) -> Segment:
        size = self.end - self.start
        return Segment(self.start, size, "none", size, 0, self.start_ns, self.end_ns, frozenset(self.ids))


class Walk:
    """The linear pass: from record header to record header, without reading what lies between.

    Parameters
    ----------
    file
        The open file.
    contents
        Is completed. If the pass fails it holds everything in front of the damage.
    accounted
        Chunks that are known already: their place, and the place of the record to look at next.
    """

    def __init__(
        self, file: RecordFile, contents: Contents, accounted: Mapping[int, int] | None = None
    ) -> None:
        self._file = file
        self._contents = contents
        self._accounted = accounted or {}
        self._run: _Run | None = None
        self._chunk: ChunkSegment | None = None
        self._indexed: Counter[int] = Counter()

    def run(self, offset: int, end: int) -> None:
        """Walk from the record at byte ``offset`` until DataEnd or byte ``end``.

        Raises
        ------
        RecordingError
            If a record reaches beyond ``end`` or is malformed.
        """
        accounted, window = self._accounted, _Window(self._file)
        unseen = len(accounted)
        complete = False
        try:
            while offset < end:
                if (following := accounted.get(offset)) is not None:
                    self._close()
                    unseen -= 1
                    if not offset < following <= end:
                        raise self._beyond(offset, following, end)
                    offset = following
                    continue
                position = window.locate(offset, _MESSAGE.size)
                if offset + _RECORD.size > end:
                    raise self._beyond(offset, offset + _RECORD.size, end)
                opcode, length = _RECORD.unpack_from(window.data, position)
                following = offset + _RECORD.size + length
                if following > end:
                    raise self._beyond(offset, following, end)
                if opcode == _OP_MESSAGE:
                    self._message(window.data, position, offset, following)
                elif opcode == Opcode.DATA_END:
                    break
                else:
                    self._other(opcode, window, offset, following)
                offset = following
            if unseen:
                raise self._file.error("the summary's index names places where no chunk begins", _REPAIR)
            complete = True
        finally:
            self._close(complete=complete)

    def _beyond(self, offset: int, following: int, end: int) -> RecordingError:
        return self._file.error(
            f"the record at byte {offset} ends at byte {following}, the data at byte {end}", _REPAIR
        )

    def _message(self, data: bytes, position: int, offset: int, following: int) -> None:
        if following - offset < _MESSAGE.size:
            raise self._file.error(
                f"the message at byte {offset} has {following - offset} bytes, at least 31 are needed"
            )
        _, _, channel_id, _, log_time_ns, _ = _MESSAGE.unpack_from(data, position)
        run = self._run
        if run is None or following - run.start > RUN_SIZE:
            self._close()
            run = self._run = _Run(offset, log_time_ns)
        run.add(channel_id, log_time_ns, following)
        self._contents.counts[channel_id] += 1

    def _other(self, opcode: int, window: _Window, offset: int, following: int) -> None:
        """Take note of a record that is not a message."""
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            # These may lie between messages of one run; loading the run steps over them.
            content = self._file.read(offset + _RECORD.size, following - offset - _RECORD.size)
            self._contents.declare(opcode, content, offset, self._file)
        elif opcode == _OP_MESSAGE_INDEX:
            position = window.locate(offset, _RECORD.size + 6) + _RECORD.size
            if following - offset < _RECORD.size + 6:
                raise self._file.error(f"the message index at byte {offset} is too short", _REPAIR)
            channel_id, size = struct.unpack_from("<HI", window.data, position)
            self._indexed[channel_id] += size // 16
        else:
            self._close()
            if opcode == _OP_CHUNK:
                position = window.locate(offset, min(_CHUNK_HEAD_SIZE, following - offset))
                self._chunk = _chunk_at(window.data, position, offset, self._file)
            elif opcode == Opcode.ATTACHMENT:
                self._contents.attachments.append(offset)
            elif opcode == Opcode.METADATA:
                self._contents.metadata.append(offset)

    def _close(self, *, complete: bool = True) -> None:
        """Finish the run or the chunk; message indexes are ``complete`` if another record follows."""
        contents = self._contents
        if self._run is not None:
            contents.segments.append(self._run.segment())
            self._run = None
        if self._chunk is not None:
            ids = frozenset(self._indexed) if complete and self._indexed else None
            contents.segments.append(replace(self._chunk, connection_ids=ids))
            contents.counts.update(self._indexed)
            contents.all_counted = contents.all_counted and ids is not None
            self._chunk = None
        self._indexed.clear()


def find_declarations(file: RecordFile, contents: Contents, *, verify: bool = True) -> None:
    """Look for channels and schemas inside chunks, as far as they were not found outside.

    Chunks are opened in the order of the file, first those with messages of unknown channels, and no
    more of them than needed. Without a summary, a channel that has no messages may stay unknown.
    """
    chunks = [segment for segment in contents.segments if isinstance(segment, ChunkSegment)]
    chunks.sort(key=lambda chunk: chunk.offset)
    used = frozenset[int]().union(*(s.connection_ids for s in contents.segments if s.connection_ids))
    all_used_known = all(segment.connection_ids is not None for segment in contents.segments)

    def complete() -> bool:
        """Whether every channel with messages and every schema of a channel is known."""
        channels = contents.channels
        if contents.statistics is not None:
            enough = len(channels) >= contents.statistics.channel_count
        else:
            enough = contents.channels_listed or all_used_known
        return (
            enough
            and used <= channels.keys()
            and all(c.schema_id in contents.schemas for c in channels.values() if c.schema_id)
        )

    def promising(chunk: ChunkSegment) -> bool:
        ids = chunk.connection_ids
        return not contents.channels_listed if ids is None else not ids <= contents.channels.keys()

    rest = []
    for chunk in chunks:
        if complete():
            return
        if promising(chunk):
            _declare_from(chunk, file, contents, verify=verify)
        else:
            rest.append(chunk)
    for chunk in rest:
        if complete():
            return
        _declare_from(chunk, file, contents, verify=verify)


def _declare_from(chunk: ChunkSegment, file: RecordFile, contents: Contents, *, verify: bool) -> None:
    for opcode, content in _split(payload(file, chunk, verify=verify), chunk.offset, file):
        contents.declare(opcode, content, chunk.offset, file)


# --- Reading: messages ---


def payload(file: RecordFile, segment: Segment, *, verify: bool = True) -> memoryview:
    """Read a segment's records, decompressed.

    Raises
    ------
    RecordingError
        If the bytes are not there, do not decompress to the declared size, or fail their CRC.
    """
    if not isinstance(segment, ChunkSegment):
        return memoryview(file.read(segment.offset, segment.length))
    # The header in front of the payload comes with the same read. An index has no CRC; the header does.
    head = segment.offset - segment.record_offset
    data = memoryview(file.read(segment.record_offset, head + segment.length))
    chunk = _chunk_at(data, 0, segment.record_offset, file)
    if data[0] != _OP_CHUNK or _storage(chunk) != _storage(segment):
        raise file.error(
            f"the index and the chunk at byte {segment.record_offset} contradict each other", _REPAIR
        )
    unpacked = memoryview(_decompressed(data[head:], chunk, file))
    if verify and chunk.crc and (actual := zlib.crc32(unpacked)) != chunk.crc:
        raise file.error(
            f"the chunk at byte {chunk.record_offset} has CRC {actual:08x}, recorded is {chunk.crc:08x}",
            _REPAIR,
        )
    return unpacked


def _storage(segment: Segment) -> tuple[int, int, str, int]:
    return segment.offset, segment.length, segment.compression, segment.uncompressed_size


def _decompressed(data: memoryview, chunk: ChunkSegment, file: RecordFile) -> Buffer:
    """Decompress a chunk's payload into exactly the declared size."""
    size = chunk.uncompressed_size
    where = f"the chunk at byte {chunk.record_offset}"
    if size == 0:
        return b""
    if chunk.compression not in _DECOMPRESS:
        raise file.error(f"{where} has compression {chunk.compression!r}, known are none, lz4 and zstd")
    try:
        unpacked = _DECOMPRESS[chunk.compression](data, size)
    except (MemoryError, OverflowError) as err:
        raise file.error(f"{where} declares {size} bytes uncompressed, which do not fit into memory") from err
    except (ValueError, RuntimeError) as err:
        raise file.error(
            f"{where} cannot be decompressed to the declared {size} bytes: {err}", _REPAIR
        ) from err
    if len(unpacked) != size:
        raise file.error(f"{where} decompresses to {len(unpacked)} bytes, declared are {size}", _REPAIR)
    return unpacked


def _stored(data: memoryview, _size: int) -> Buffer:
    return data


def _from_lz4(data: memoryview, size: int) -> Buffer:
    import lz4.frame  # noqa: PLC0415  (only recordings that need it pay for it)

    decompressor = lz4.frame.LZ4FrameDecompressor()
    # One byte more than allowed, to tell "too long" from "just right".
    unpacked: bytes = decompressor.decompress(data, max_length=size + 1)
    if len(unpacked) > size:
        raise ValueError("there is more")
    if not decompressor.eof:
        raise ValueError(f"it ends after {len(unpacked)} bytes")
    return unpacked


def _from_zstd(data: memoryview, size: int) -> Buffer:
    import zstandard  # noqa: PLC0415  (only recordings that need it pay for it)

    try:
        # The size in the frame's own header would win over the limit given here.
        declared = zstandard.frame_content_size(data)
        if declared >= 0 and declared != size:
            raise ValueError(f"the compressed data declare {declared} bytes")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    except zstandard.ZstdError as err:
        raise ValueError(str(err)) from err


_DECOMPRESS: dict[str, Callable[[memoryview, int], Buffer]] = {
    "none": _stored,
    "lz4": _from_lz4,
    "zstd": _from_zstd,
}


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
    append, unpack = found.append, _MESSAGE.unpack_from
    # The class's own constructor takes twice as long, and this is where readers of small messages wait.
    new: Callable[[type[RawMessage], tuple[object, ...]], RawMessage] = tuple.__new__
    size = len(data)
    last = size - _MESSAGE.size
    position = 0
    while position <= last:
        opcode, length, channel_id, sequence, log_time_ns, publish_time_ns = unpack(data, position)
        following = position + 9 + length
        if following > size:
            return found, others, position
        if opcode == _OP_MESSAGE:
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
    while position + 9 <= size and data[position] != _OP_MESSAGE:
        following = position + 9 + _RECORD.unpack_from(data, position)[1]
        if following > size:
            break
        position = following
    return found, others, position


class McapReader:
    """An open MCAP file; see `pc2scan.bags.model.Reader`.

    Channels become connections one to one: two channels of one topic stay two. Types, definitions
    and metadata are passed on as recorded, whatever the profile.

    Parameters
    ----------
    path
        The file.
    verify
        Whether to compare the CRCs of the summary, the chunks and the attachments, where recorded. That
        of the data section as a whole is not compared: it would need everything to be read.

    Raises
    ------
    RecordingError
        If the file cannot be read, is not MCAP, is cut off or contradicts itself. Damage inside chunks
        is found when they are read.
    """

    def __init__(self, path: Path, *, verify: bool = True) -> None:
        self._file = RecordFile(path)
        self._verify = verify
        self._bytes_read = 0
        try:
            self._contents = find_contents(self._file, verify=verify)
            self._connections = tuple(_connections(self._contents, self._file))
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

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[RawMessage]:
        """Messages by log time, those of one log time in the order of the file.

        Parameters
        ----------
        connections
            Only messages of these; None means all. Chunks without any are not read.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.

        Yields
        ------
        RawMessage
            Its data are a view into the decompressed chunk, which lives as long as the view.

        Raises
        ------
        RecordingError
            If a chunk is damaged, or a message belongs to no channel.
        """
        known = {connection.id: connection for connection in self._connections}
        wanted = known
        if connections is not None:
            wanted = {
                connection.id: known[connection.id] for connection in connections if connection.id in known
            }
        ids = None if connections is None else frozenset(wanted)
        first = 0 if start_ns is None else start_ns
        stop = 1 << 64 if stop_ns is None else stop_ns

        def load(segment: Segment) -> list[RawMessage]:
            data = payload(self._file, segment, verify=self._verify)
            self._bytes_read += segment.length
            found, others, sound = _messages_in(data, wanted, first, stop)
            if sound != len(data):
                raise self._file.error(
                    f"the records from byte {segment.offset} on are sound for {sound} of {len(data)} bytes",
                    _REPAIR,
                )
            if unknown := others - known.keys():
                raise self._file.error(
                    f"channel {min(unknown)} has messages near byte {segment.offset}, but is not declared",
                    _REPAIR,
                )
            return found

        if ids is None or ids:
            segments = [s for s in self._contents.segments if s.may_hold(ids, start_ns, stop_ns)]
            yield from in_time_order(segments, load)

    def attachments(self) -> Iterator[Attachment]:
        """Attachments in the order of the file, each read when it is asked for."""
        for offset in sorted(self._contents.attachments):
            content = self._file.record(offset, Opcode.ATTACHMENT)
            record = _parse(records.Attachment, content, offset, self._file)
            # The CRC is behind the data, which are behind two times, two strings and their own length.
            texts = len(record.name.encode()) + len(record.media_type.encode())
            covered = 8 + 8 + 4 + 4 + texts + 8 + len(record.data)
            (crc,) = struct.unpack_from("<I", content, covered)
            if self._verify and crc and (actual := zlib.crc32(memoryview(content)[:covered])) != crc:
                raise self._file.error(
                    f"attachment {record.name!r} has CRC {actual:08x}, recorded is {crc:08x}",
                    _REPAIR,
                )
            yield Attachment(record.name, record.media_type, record.log_time, record.create_time, record.data)

    def metadata(self) -> Iterator[Metadata]:
        """Metadata records in the order of the file."""
        for offset in sorted(self._contents.metadata):
            record = _parse(records.Metadata, self._file.record(offset, Opcode.METADATA), offset, self._file)
            yield Metadata(record.name, record.metadata)

    def close(self) -> None:
        """Release the file."""
        self._file.close()


def _connections(contents: Contents, file: RecordFile) -> Iterator[Connection]:
    for channel in contents.channels.values():
        schema = contents.schemas.get(channel.schema_id)
        if schema is None and channel.schema_id:
            raise file.error(
                f"channel {channel.id} has schema {channel.schema_id}, which is not in the file",
                _REPAIR,
            )
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


# --- Writing ---

_MAX_CHANNELS = 0xFFFF


class McapWriter:
    """An MCAP file being written, with CRCs, all indexes and a summary; see `pc2scan.bags.model.Writer`.

    The same calls write the same bytes: nothing of the machine or the moment is recorded.

    Parameters
    ----------
    path
        The file; it must not exist.
    compression
        ``none``, ``lz4`` or ``zstd``.
    profile
        ``ros2``, ``ros1`` or empty.
    chunk_size
        A chunk ends before it exceeds this many bytes, uncompressed. A message larger than that has a
        chunk of its own, so that readers of small topics need not read it.
    metadata
        Records to begin with.

    Raises
    ------
    DestinationError
        If MCAP knows no such compression.
    OutputError
        If the file exists or cannot be written (from every method).
    """

    def __init__(
        self,
        path: Path,
        compression: str = "zstd",
        profile: str = "ros2",
        chunk_size: int = 1 << 20,
        metadata: Iterable[Metadata] = (),
    ) -> None:
        if compression not in _COMPRESS:
            raise DestinationError(
                f"MCAP has no compression {compression!r}, allowed are {', '.join(_COMPRESS)}",
                path=path,
                hint="choose zstd, or lz4 for speed",
            )
        self._path = path
        self._compression = "" if compression == "none" else compression
        self._compress = _COMPRESS[compression]
        self._chunk_size = chunk_size
        self._offset = 0
        self._schemas: dict[tuple[str, str, bytes], records.Schema] = {}
        self._channels: list[records.Channel] = []
        self._counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        # What the summary will repeat or index, encoded.
        self._groups: dict[Opcode, list[bytes]] = {opcode: [] for opcode in _SUMMARY_GROUPS}
        self._chunk = _OpenChunk(BytesIO())
        try:
            self._file = path.open("xb")
        except OSError as err:
            raise self._failed(err) from err
        self._put(MAGIC, _encoded(records.Header(profile, "pc2scan")))
        for record in metadata:
            self.add_metadata(record)

    def add_connection(self, connection: Connection) -> int:
        """Declare a channel of its own for the connection; returns its id.

        The type is spelled as its serialization's ROS generation does. Metadata are the connection's; what it
        knows beyond them is added under the keys that rosbag2 and ``mcap convert`` use.

        Raises
        ------
        OutputError
            If there are 65535 channels already.
        """
        if len(self._channels) == _MAX_CHANNELS:
            raise OutputError(
                f"MCAP has room for {_MAX_CHANNELS} channels, one more is needed", path=self._path
            )
        # Declared outside the chunks: readers without the index find them without decompressing anything.
        channel = records.Channel(
            id=len(self._channels) + 1,
            topic=connection.topic,
            message_encoding=connection.serialization,
            metadata=_channel_metadata(connection),
            schema_id=self._schema_id(connection),
        )
        self._channels.append(channel)
        self._counts[channel.id] = 0
        self._declare(Opcode.CHANNEL, channel)
        return channel.id

    def _schema_id(self, connection: Connection) -> int:
        """Write the connection's schema unless the same is there; 0 stands for none."""
        name = _schema_name(connection)
        definition = connection.definition
        # A name without a definition is worth keeping: rosbag2 writes it for types that it cannot find.
        if not name and not definition.encoding:
            return 0
        key = (name, definition.encoding, definition.data)
        schema = self._schemas.get(key)
        if schema is None:
            schema = records.Schema(
                id=len(self._schemas) + 1, data=definition.data, encoding=definition.encoding, name=name
            )
            self._schemas[key] = schema
            self._declare(Opcode.SCHEMA, schema)
        return schema.id

    def _declare(self, opcode: Opcode, record: records.McapRecord) -> None:
        encoded = _encoded(record)
        self._put(encoded)
        self._groups[opcode].append(encoded)

    def write(
        self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0
    ) -> None:
        """Append a message; its data are copied.

        Raises
        ------
        OutputError
            If a time is negative or beyond 64 bits, or the sequence beyond 32.
        """
        try:
            head = _MESSAGE.pack(_OP_MESSAGE, 22 + len(data), handle, sequence, log_time_ns, publish_time_ns)
        except struct.error as err:
            raise OutputError(
                f"log time {log_time_ns} ns, publish time {publish_time_ns} ns or sequence {sequence} "
                "cannot be written: MCAP has unsigned numbers of 64, 64 and 32 bits",
                path=self._path,
                topic=self._channels[handle - 1].topic,
            ) from err
        self._counts[handle] += 1
        if self._chunk.size and self._chunk.size + len(head) + len(data) > self._chunk_size:
            self._finish_chunk()
        self._chunk.add(handle, log_time_ns, head, data)
        if self._chunk.size >= self._chunk_size:
            self._finish_chunk()

    def _finish_chunk(self) -> None:
        """Write the open chunk and its message indexes."""
        chunk = self._chunk
        if not chunk.size:
            return
        # The view must be gone before the next message is written into the buffer.
        with chunk.buffer.getbuffer() as whole, whole[: chunk.size] as data:
            crc = zlib.crc32(data)
            stored = self._compress(data)
            name = self._compression.encode()
            head_size = _CHUNK.size + len(name) + _UINT64.size
            offset = self._put(
                _RECORD.pack(_OP_CHUNK, head_size + len(stored)),
                _CHUNK.pack(chunk.first_ns, chunk.last_ns, chunk.size, crc, len(name)),
                name,
                _UINT64.pack(len(stored)),
                stored,
            )
            stored_size = len(stored)
        length = self._offset - offset
        places = {}
        for channel_id, entries in chunk.index.items():
            places[channel_id] = self._put(
                struct.pack("<BQHI", _OP_MESSAGE_INDEX, 6 + 8 * len(entries), channel_id, 8 * len(entries)),
                struct.pack(f"<{len(entries)}Q", *entries),
            )
        index = records.ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=self._compression,
            compressed_size=stored_size,
            message_end_time=chunk.last_ns,
            message_index_length=self._offset - offset - length,
            message_index_offsets=places,
            message_start_time=chunk.first_ns,
            uncompressed_size=chunk.size,
        )
        self._groups[Opcode.CHUNK_INDEX].append(_encoded(index))
        self._first_ns = chunk.first_ns if self._first_ns is None else min(self._first_ns, chunk.first_ns)
        self._last_ns = max(self._last_ns, chunk.last_ns)
        self._chunk = _OpenChunk(chunk.buffer)

    def add_attachment(self, attachment: Attachment) -> None:
        """Append an attachment, with CRC and index."""
        record = records.Attachment(
            create_time=attachment.create_time_ns,
            log_time=attachment.log_time_ns,
            name=attachment.name,
            media_type=attachment.media_type,
            data=attachment.data,
        )
        try:
            encoded = _encoded(record)
        except struct.error as err:
            raise OutputError(
                f"attachment {attachment.name!r} has log time {attachment.log_time_ns} ns and creation time "
                f"{attachment.create_time_ns} ns, MCAP has unsigned numbers of 64 bits",
                path=self._path,
            ) from err
        index = records.AttachmentIndex(
            offset=self._put(encoded),
            length=len(encoded),
            log_time=record.log_time,
            create_time=record.create_time,
            data_size=len(record.data),
            name=record.name,
            media_type=record.media_type,
        )
        self._groups[Opcode.ATTACHMENT_INDEX].append(_encoded(index))

    def add_metadata(self, metadata: Metadata) -> None:
        """Append a metadata record, with index."""
        encoded = _encoded(records.Metadata(metadata.name, dict(metadata.entries)))
        index = records.MetadataIndex(offset=self._put(encoded), length=len(encoded), name=metadata.name)
        self._groups[Opcode.METADATA_INDEX].append(_encoded(index))

    def finish(self) -> None:
        """Write the last chunk and the summary, and put everything on the disk."""
        self._finish_chunk()
        self._put(_encoded(records.DataEnd(0)))
        self._groups[Opcode.STATISTICS].append(_encoded(self._statistics()))
        start = position = self._offset
        summary, offsets = [], []
        for opcode, group in self._groups.items():
            if group:
                encoded = b"".join(group)
                summary.append(encoded)
                offsets.append(_encoded(records.SummaryOffset(opcode, position, len(encoded))))
                position += len(encoded)
        tail = b"".join((*summary, *offsets, _encoded(records.Footer(start, position, 0))))
        # The footer's last field is the CRC of the summary and of the footer in front of it.
        self._put(tail[:-4], struct.pack("<I", zlib.crc32(tail[:-4])), MAGIC)
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
        except OSError as err:
            raise self._failed(err) from err

    def abort(self) -> None:
        """Release the file; what was written is left for the caller to remove."""
        # Closing writes what is buffered, and there may be no room for it: the reason for aborting.
        with suppress(OSError):
            self._file.close()

    def _statistics(self) -> records.Statistics:
        return records.Statistics(
            attachment_count=len(self._groups[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(self._channels),
            channel_message_counts={channel_id: count for channel_id, count in self._counts.items() if count},
            chunk_count=len(self._groups[Opcode.CHUNK_INDEX]),
            message_count=sum(self._counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=len(self._groups[Opcode.METADATA_INDEX]),
            schema_count=len(self._schemas),
        )

    def _put(self, *parts: Buffer) -> int:
        """Write at the end of the file; returns where that was."""
        offset = self._offset
        try:
            self._file.writelines(parts)
        except OSError as err:
            raise self._failed(err) from err
        self._offset += sum(map(len, parts))
        return offset

    def _failed(self, err: OSError) -> OutputError:
        return OutputError(f"cannot be written: {err.strerror}", path=self._path)


class _OpenChunk:
    """The messages that will become the next chunk.

    Parameters
    ----------
    buffer
        Is written from its start on. All chunks share one: memory that the system has to provide anew for
        every chunk costs a third of the time that lz4 takes.
    """

    __slots__ = ("buffer", "first_ns", "index", "last_ns", "size")

    def __init__(self, buffer: BytesIO) -> None:
        buffer.seek(0)
        self.buffer = buffer
        self.size = 0
        self.first_ns = self.last_ns = 0
        # By channel: log time, offset, log time, offset...
        self.index: dict[int, list[int]] = {}

    def add(self, channel_id: int, log_time_ns: int, head: bytes, data: Buffer) -> None:
        """Append a message."""
        if not self.size:
            self.first_ns = self.last_ns = log_time_ns
        elif log_time_ns < self.first_ns:
            self.first_ns = log_time_ns
        elif log_time_ns > self.last_ns:
            self.last_ns = log_time_ns
        self.index.setdefault(channel_id, []).extend((log_time_ns, self.size))
        self.size += self.buffer.write(head) + self.buffer.write(data)


def _encoded(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    encoded: bytes = builder.end()  # type: ignore[no-untyped-call]
    return encoded


def _schema_name(connection: Connection) -> str:
    if connection.serialization == "ros1":
        return ros1_type(connection.msgtype)
    return normalized_type(connection.msgtype) if connection.serialization == "cdr" else connection.msgtype


def _channel_metadata(connection: Connection) -> dict[str, str]:
    """The connection's metadata, completed by what it knows from another container."""
    known = {}
    if connection.generation == 1:
        if connection.callerid is not None:
            known["callerid"] = connection.callerid
        if connection.latching:
            known["latching"] = "1"
        if connection.digest and "md5sum" not in connection.metadata:
            known |= {"md5sum": connection.digest, "topic": connection.topic}
    elif connection.generation == 2:
        if connection.qos:
            known["offered_qos_profiles"] = connection.qos
        if connection.digest.startswith("RIHS01_"):
            known["topic_type_hash"] = connection.digest
    return {**connection.metadata, **{k: v for k, v in known.items() if k not in connection.metadata}}


def _as_stored(data: memoryview) -> Buffer:
    return data


def _to_lz4(data: memoryview) -> Buffer:
    import lz4.frame  # noqa: PLC0415  (only recordings that need it pay for it)

    packed: bytes = lz4.frame.compress(data)
    return packed


def _to_zstd(data: memoryview) -> Buffer:
    import zstandard  # noqa: PLC0415  (only recordings that need it pay for it)

    return zstandard.ZstdCompressor().compress(data)


_COMPRESS: dict[str, Callable[[memoryview], Buffer]] = {
    "none": _as_stored,
    "lz4": _to_lz4,
    "zstd": _to_zstd,
}

# The order of the summary.
_SUMMARY_GROUPS = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)
