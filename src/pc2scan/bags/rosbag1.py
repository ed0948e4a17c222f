"""The ROS 1 bag container, format 2.0.

A bag is a line of magic and a run of records; a record is a header of named fields and a body, each behind
a uint32 length. Messages lie in chunks, in which records are packed and compressed together. Behind the
chunks stands the index: every connection, and for every chunk its place, times and counts.

::

    #ROSBAG V2.0
    BAG HEADER                         padded to 4096 bytes; says where the index is
    CHUNK { CONNECTION | MESSAGE }*    followed by an INDEX DATA record for each connection in it
    ...
    CONNECTION ...                     the index
    CHUNK INFO ...

The reader takes chunks one at a time, when they are due, and finds their messages by walking through them.
It never looks at the INDEX DATA records: they hold nothing that the chunk does not, and some recorders get
their length wrong.

Source: http://wiki.ros.org/Bags/Format/2.0, and where that is silent, what ROS 1's own reader accepts.
"""

from __future__ import annotations

import os
import struct
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, permutations
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import DestinationError, OutputError, RecordingError

from .model import Connection, Definition, RawMessage, Summary, ros1_type
from .segments import Segment, in_time_order

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from .model import Attachment, Buffer, Metadata

__all__ = ["MAGIC", "Rosbag1Reader", "Rosbag1Writer"]

#: How every ROS 1 bag begins, of this format and of older ones.
MAGIC = b"#ROSBAG V"

_FIRST_LINE = b"#ROSBAG V2.0\n"
_COMPRESSIONS = ("none", "bz2", "lz4")

_MESSAGE, _BAG_HEADER, _INDEX_DATA, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_KINDS = {
    _MESSAGE: "message",
    _BAG_HEADER: "bag header",
    _INDEX_DATA: "index data",
    _CHUNK: "chunk",
    _CHUNK_INFO: "chunk info",
    _CONNECTION: "connection",
}

#: Fields of a connection's header that have a place of their own in `Connection`.
_OWN_FIELDS = frozenset({"callerid", "latching", "md5sum", "message_definition", "topic", "type"})

_UINT32_MAX = 0xFFFF_FFFF
_SECOND_NS = 1_000_000_000
_READ_AHEAD = 4096

_REINDEX = "The bag is damaged or was never closed. ROS 1's 'rosbag reindex' can rebuild its index."
_DAMAGED = "The bag is damaged. Copy it again from where it was recorded, or try ROS 1's 'rosbag reindex'."

_uint32 = struct.Struct("<I")
_uint64 = struct.Struct("<Q")
_pair = struct.Struct("<II")
_triple = struct.Struct("<III")


class _Damaged(Exception):  # noqa: N818  # it never leaves this module
    """Bytes that break the format; the reader adds the place and makes it a RecordingError."""


# ------------------------------------------------------------------------------------------------ records


def _fields(raw: Buffer) -> dict[bytes, bytes]:
    """Take a header apart: each field is a uint32 length and ``name=value``."""
    raw = bytes(raw)
    fields = {}
    position = 0
    while position < len(raw):
        start = position + 4
        if start > len(raw):
            raise _Damaged(f"a header of {len(raw)} bytes ends inside a field's length")
        (size,) = _uint32.unpack_from(raw, position)
        position = start + size
        if position > len(raw):
            raise _Damaged(f"a header field of {size} bytes does not fit into its header of {len(raw)} bytes")
        name, equals, value = raw[start:position].partition(b"=")
        if not equals:
            raise _Damaged(f"the header field {name[:40]!r} has no '='")
        fields[name] = value
    return fields


def _field(fields: Mapping[bytes, bytes], name: str, size: int | None = None) -> bytes:
    """One field that must be there, of ``size`` bytes if given."""
    value = fields.get(name.encode())
    if value is None:
        raise _Damaged(f"a record's header has no field '{name}'")
    if size is not None and len(value) != size:
        raise _Damaged(f"the header field '{name}' has {len(value)} bytes, {size} are needed")
    return value


def _uint32_field(fields: Mapping[bytes, bytes], name: str) -> int:
    value: int = _uint32.unpack(_field(fields, name, 4))[0]
    return value


def _uint64_field(fields: Mapping[bytes, bytes], name: str) -> int:
    value: int = _uint64.unpack(_field(fields, name, 8))[0]
    return value


def _time_field(fields: Mapping[bytes, bytes], name: str) -> int:
    """One field with a time, as nanoseconds."""
    seconds, nanoseconds = _pair.unpack(_field(fields, name, 8))
    return int(seconds) * _SECOND_NS + int(nanoseconds)


def _kind(fields: Mapping[bytes, bytes]) -> int:
    return _field(fields, "op", 1)[0]


def _text(value: bytes) -> str:
    return value.decode("utf-8", "surrogateescape")


def _connection(fields: Mapping[bytes, bytes], body: Buffer) -> Connection:
    """Make a connection of its record. The body is a header of its own: the publisher's."""
    topic = _text(_field(fields, "topic"))
    header = _fields(body)
    texts = {_text(name): _text(value) for name, value in header.items() if name != b"message_definition"}
    metadata = {name: value for name, value in texts.items() if name not in _OWN_FIELDS}
    # What the publisher called the topic, and a latching that is not plainly "1", would otherwise be lost.
    if texts.get("topic", topic) != topic:
        metadata["topic"] = texts["topic"]
    if texts.get("latching", "1") != "1":
        metadata["latching"] = texts["latching"]
    definition = header.get(b"message_definition")
    return Connection(
        id=_uint32_field(fields, "conn"),
        topic=topic,
        msgtype=_text(_field(header, "type")),
        serialization="ros1",
        definition=Definition() if definition is None else Definition("ros1msg", definition),
        digest=texts.get("md5sum", ""),
        callerid=texts.get("callerid"),
        latching=texts.get("latching") == "1",
        metadata=metadata,
    )


# ------------------------------------------------------------------------------------------------- chunks


def _decompressed(data: bytes, compression: str, size: int) -> bytes:
    """Decompress a chunk that must come to ``size`` bytes; one byte more is never produced but to tell."""
    if compression == "none":
        return _checked(data, size)
    try:
        if compression == "bz2":
            import bz2  # noqa: PLC0415  # heavy

            bunzip2 = bz2.BZ2Decompressor()
            data, complete = bunzip2.decompress(data, size + 1), bunzip2.eof
        else:
            import lz4.frame  # noqa: PLC0415  # heavy

            # LZ4 allocates its limit at once, and cannot expand more than 255 times.
            unlz4 = lz4.frame.LZ4FrameDecompressor()
            data, complete = unlz4.decompress(data, min(size, 255 * len(data)) + 1), unlz4.eof
    except (OSError, RuntimeError, EOFError, MemoryError) as err:
        raise _Damaged(f"its {compression} data cannot be decompressed: {err}") from err
    if not complete and len(data) <= size:
        raise _Damaged(f"its {compression} data ends early, after {len(data)} of {size} bytes")
    return _checked(data, size)


def _checked(data: bytes, size: int) -> bytes:
    if len(data) != size:
        observed = f"more than {size}" if len(data) > size else str(len(data))
        raise _Damaged(f"it holds {observed} bytes when decompressed, {size} are declared")
    return data


def _record(data: memoryview, position: int) -> tuple[dict[bytes, bytes], int, int]:
    """Take a record of a chunk: its fields, and where its body starts and stops."""
    lengths = []
    for _ in range(2):
        if position + 4 > len(data):
            raise _Damaged(f"a record's length does not fit into the {len(data)} bytes of its chunk")
        (length,) = _uint32.unpack_from(data, position)
        lengths.append(position + 4)
        position += 4 + length
        lengths.append(position)
        if position > len(data):
            raise _Damaged(f"a record reaches to byte {position} of a chunk of {len(data)} bytes")
    header, header_stop, body, body_stop = lengths
    return _fields(data[header:header_stop]), body, body_stop


def _records(data: memoryview) -> Iterator[tuple[dict[bytes, bytes], memoryview]]:
    """All records of a chunk, as fields and body."""
    position = 0
    while position < len(data):
        fields, start, position = _record(data, position)
        yield fields, data[start:position]


class _Layout(NamedTuple):
    """A message record up to its body, its three fields in one of six orders.

    Everything but the values is literal, so that one `struct` call takes the record apart, and comparing the
    literals says whether it really was laid out so.
    """

    layout: struct.Struct
    literals: itemgetter[tuple[object, ...]]
    expected: tuple[bytes, ...]
    connection: int
    seconds: int


def _layout(order: Sequence[bytes]) -> _Layout:
    pieces = {
        b"conn": (b"\x09\0\0\0conn=", "I"),
        b"op": (b"\x04\0\0\0op=\x02", ""),
        b"time": (b"\x0d\0\0\0time=", "II"),
    }
    code = "<"
    literal = b"\x26\0\0\0"  # the length of the header: 38 bytes in any order
    expected = []
    for name in order:
        more, values = pieces[name]
        literal += more
        if values:
            expected.append(literal)
            code += f"{len(literal)}s{values}"
            literal = b""
    expected.append(literal)
    code += f"{len(literal)}sI"
    if order.index(b"conn") < order.index(b"time"):
        return _Layout(struct.Struct(code), itemgetter(0, 2, 5), tuple(expected), 1, 3)
    return _Layout(struct.Struct(code), itemgetter(0, 3, 5), tuple(expected), 4, 1)


_LAYOUTS = {order: _layout(order) for order in permutations((b"conn", b"op", b"time"))}
_USUAL_LAYOUT = _LAYOUTS[b"conn", b"op", b"time"]


def _messages(
    chunk: bytes,
    wanted: Mapping[int, Connection | None],
    start_ns: int | None,
    stop_ns: int | None,
) -> list[RawMessage]:
    """Find the messages of a decompressed chunk.

    Parameters
    ----------
    chunk
        Its records; the messages' data are views into it.
    wanted
        For every connection that there is, itself, or None if its messages are to be passed over.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``.

    Raises
    ------
    _Damaged
        If a record does not fit, is no message or connection, or is of a connection not in ``wanted``.
    """
    data = memoryview(chunk)
    end = len(data)
    low = 0 if start_ns is None else start_ns
    high = (_UINT32_MAX + 8) * _SECOND_NS if stop_ns is None else stop_ns
    messages = []
    layout, literals, expected, at_connection, at_seconds = current = _USUAL_LAYOUT
    prefix = layout.size
    position = 0
    while position < end:
        values = layout.unpack_from(data, position) if position + prefix <= end else None
        if values and literals(values) == expected:
            identity = values[at_connection]
            stamp = values[at_seconds] * _SECOND_NS + values[at_seconds + 1]
            start = position + prefix
            position = start + values[6]
            if position > end:
                raise _Damaged(f"a message reaches to byte {position} of a chunk of {end} bytes")
        else:
            fields, start, stop = _record(data, position)
            # A writer keeps to its order of fields: follow it, and look at this record again.
            other = _LAYOUTS.get(tuple(fields), current)
            if other is not current and _kind(fields) == _MESSAGE:
                layout, literals, expected, at_connection, at_seconds = current = other
                continue
            position = stop
            if _kind(fields) == _CONNECTION:
                continue
            if _kind(fields) != _MESSAGE:
                raise _Damaged(
                    f"a record of kind {_kind(fields)} lies where only messages and connections may"
                )
            identity = _uint32_field(fields, "conn")
            stamp = _time_field(fields, "time")
        try:
            connection = wanted[identity]
        except KeyError:
            raise _Damaged(
                f"it has a message of connection {identity}, which the index does not know"
            ) from None
        if connection is not None and low <= stamp < high:
            messages.append(RawMessage(connection, stamp, data[start:position], stamp))
    return messages


# --------------------------------------------------------------------------------------------------- file


class _File:
    """A bag's bytes by their place: what is not there is an error, never a short answer.

    Reads go through `os.pread`, not a memory map: a file that shrinks under a map kills the process, and the
    pages of a map count as the process's memory.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._fd = -1
        self._ahead_start = 0
        self._ahead = b""
        try:
            self._fd = os.open(path, os.O_RDONLY | getattr(os, "O_CLOEXEC", 0))
            self.size = os.fstat(self._fd).st_size
        except OSError as err:
            self.close()
            raise RecordingError(f"cannot be opened: {err.strerror}", path=path) from err

    def read(self, offset: int, length: int) -> bytes:
        """Read exactly ``length`` bytes."""
        if offset + length > self.size:
            raise _Damaged(
                f"{length} bytes are declared from byte {offset} on, the file has {self.size} bytes"
            )
        parts = []
        missing = length
        while missing:
            # One call is the rule; the system limits a call to 2 GiB, and may deliver less.
            try:
                part = os.pread(self._fd, missing, offset + length - missing)
            except OSError as err:
                raise RecordingError(f"cannot be read: {err.strerror}", path=self.path) from err
            if not part:
                at = offset + length - missing
                raise _Damaged(f"there is nothing at byte {at}: the file was cut while it was read")
            parts.append(part)
            missing -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def head(self, length: int) -> bytes:
        """Read the first bytes, fewer if there are fewer."""
        return self.read(0, min(length, self.size))

    def record(self, offset: int, kind: int) -> tuple[dict[bytes, bytes], int, int]:
        """Take a record that must be of a kind: its fields, and where its body starts and stops."""
        (length,) = _uint32.unpack(self._nearby(offset, 4))
        body = offset + 4 + length + 4
        fields = _fields(self._nearby(offset + 4, length))
        (length,) = _uint32.unpack(self._nearby(body - 4, 4))
        if _kind(fields) != kind:
            raise _Damaged(
                f"the record at byte {offset} is a {_KINDS.get(_kind(fields), _kind(fields))}, "
                f"a {_KINDS[kind]} should be there"
            )
        if body + length > self.size:
            raise _Damaged(
                f"the {_KINDS[kind]} at byte {offset} reaches to byte {body + length}, "
                f"the file has {self.size} bytes"
            )
        return fields, body, body + length

    def body(self, start: int, stop: int) -> bytes:
        """Read the body of a small record."""
        return self._nearby(start, stop - start)

    def close(self) -> None:
        """Release the file; reading is an error from then on."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def _nearby(self, offset: int, length: int) -> bytes:
        """Read a little, and ahead: an index is many small records in a row."""
        start = offset - self._ahead_start
        if start < 0 or start + length > len(self._ahead):
            ahead = min(max(length, _READ_AHEAD), max(self.size - offset, length))
            self._ahead = self.read(offset, ahead)
            self._ahead_start = offset
            start = 0
        return self._ahead[start : start + length]


# ------------------------------------------------------------------------------------------------- reader


@dataclass(frozen=True, slots=True)
class _Contents:
    """What a bag holds, whichever way it was found out."""

    connections: dict[int, Connection]
    segments: list[Segment]


def _payload(file: _File, segment: Segment) -> bytes:
    """Read and decompress a chunk."""
    data = file.read(segment.offset, segment.length)
    return _decompressed(data, segment.compression, segment.uncompressed_size)


def _segment(file: _File, chunk_pos: int) -> Segment:
    """Make a segment of a chunk's record, as yet without times and connections."""
    fields, start, stop = file.record(chunk_pos, _CHUNK)
    compression = _text(_field(fields, "compression"))
    if compression not in _COMPRESSIONS:
        raise RecordingError(
            f"the chunk at byte {chunk_pos} is compressed with {compression!r}, a ROS 1 bag knows "
            f"{', '.join(_COMPRESSIONS)}",
            path=file.path,
            hint="The bag is damaged or of a later format.",
        )
    size = _uint32_field(fields, "size")
    return Segment(start, stop - start, compression, size, crc=0, start_ns=0, end_ns=0)


def _with_times(file: _File, segment: Segment) -> Segment | None:
    """Find out a chunk's times by reading it; None if it has no messages."""
    records = _records(memoryview(_payload(file, segment)))
    stamps = [_time_field(fields, "time") for fields, _ in records if _kind(fields) == _MESSAGE]
    return replace(segment, start_ns=min(stamps), end_ns=max(stamps)) if stamps else None


def _find_connections(
    file: _File, segments: Sequence[Segment], missing: set[int]
) -> Iterator[tuple[int, Connection]]:
    """Look inside the chunks for connections that have messages and are not in the index."""
    for segment in segments:
        if not missing:
            return
        for fields, body in _records(memoryview(_payload(file, segment))):
            if _kind(fields) == _CONNECTION and _uint32_field(fields, "conn") in missing:
                connection = _connection(fields, body)
                missing.discard(connection.id)
                yield connection.id, connection
    if missing:
        raise _Damaged(f"connection {min(missing)} has messages and is described nowhere")


def _read_bag_header(file: _File) -> tuple[int, int, int]:
    """Read where the index is, and how many connections and chunks it holds."""
    first = file.head(len(_FIRST_LINE))
    if first != _FIRST_LINE:
        if first.startswith((b"#ROSBAG V1", b"#ROSRECORD")):
            raise RecordingError(
                f"begins with {first!r}, only bags of format 2.0 can be read",
                path=file.path,
                hint="Rewrite it with ROS 1: rosbag fix OLD.bag NEW.bag",
            )
        raise RecordingError(
            f"begins with {first!r}, a ROS 1 bag begins with {_FIRST_LINE!r}", path=file.path, hint=_DAMAGED
        )
    fields, _, _ = file.record(len(_FIRST_LINE), _BAG_HEADER)
    if encryptor := _text(fields.get(b"encryptor", b"")):
        raise RecordingError(
            f"is encrypted ({encryptor}), only bags that are not can be read",
            path=file.path,
            hint="Decrypt it with ROS 1: rosbag decrypt FILE",
        )
    index_pos = _uint64_field(fields, "index_pos")
    if index_pos == 0:
        raise RecordingError("has no index: index_pos is 0", path=file.path, hint=_REINDEX)
    if index_pos > file.size:
        raise _Damaged(f"the index should be at byte {index_pos}, the file has {file.size} bytes")
    return index_pos, _uint32_field(fields, "conn_count"), _uint32_field(fields, "chunk_count")


def _read_index(file: _File) -> _Contents:
    """Find out what a bag holds from its index."""
    position, connection_count, chunk_count = _read_bag_header(file)
    connections: dict[int, Connection] = {}
    for _ in range(connection_count):
        fields, start, position = file.record(position, _CONNECTION)
        connection = _connection(fields, file.body(start, position))
        connections.setdefault(connection.id, connection)

    counts = dict.fromkeys(connections, 0)
    located = []
    # Most chunks have the same connections: one set serves them all.
    sets: dict[frozenset[int], frozenset[int]] = {}
    for _ in range(chunk_count):
        fields, start, position = file.record(position, _CHUNK_INFO)
        if (version := _uint32_field(fields, "ver")) != 1:
            raise _Damaged(f"a chunk info has version {version}, only 1 can be read")
        entries = _uint32_field(fields, "count")
        if 8 * entries > position - start:
            raise _Damaged(f"a chunk info of {position - start} bytes declares {entries} counts of 8 bytes")
        numbers = struct.unpack(f"<{2 * entries}I", file.body(start, start + 8 * entries))
        for identity, count in zip(numbers[::2], numbers[1::2], strict=True):
            counts[identity] = counts.get(identity, 0) + count
        ids = frozenset(numbers[::2])
        if ids:
            place = _uint64_field(fields, "chunk_pos")
            times = (_time_field(fields, "start_time"), _time_field(fields, "end_time"))
            located.append((place, *times, sets.setdefault(ids, ids)))

    segments = []
    for place, start_ns, end_ns, ids in located:
        segment = replace(_segment(file, place), start_ns=start_ns, end_ns=end_ns, connection_ids=ids)
        # Times that cannot be, and zeros of a recorder that did not know, are found out by looking.
        known = segment if start_ns <= end_ns and end_ns else _with_times(file, segment)
        if known:
            segments.append(known)
    connections.update(_find_connections(file, segments, set(counts) - set(connections)))
    return _Contents(
        {key: replace(connection, message_count=counts[key]) for key, connection in connections.items()},
        segments,
    )


class Rosbag1Reader:
    """An open ROS 1 bag; a `Reader`.

    Opening reads the index and the headers of the chunks. Chunks are read and decompressed one at a time,
    when their first message is due, and their messages are views into them.

    Parameters
    ----------
    path
        A bag of format 2.0.

    Raises
    ------
    RecordingError
        If it cannot be opened, is of format 1.x, encrypted or without an index, or contradicts itself. While
        messages are read, if a chunk does.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = _File(path)
        self._bytes_read = 0
        try:
            self._contents = _read_index(self._file)
        except _Damaged as err:
            self.close()
            raise RecordingError(f"its index cannot be read: {err}", path=path, hint=_REINDEX) from err
        except BaseException:
            self.close()
            raise

    @property
    def path(self) -> Path:
        """Where it was opened."""
        return self._path

    @property
    def connections(self) -> Sequence[Connection]:
        """Every connection, in the order of the index; those that only chunks describe come last."""
        return tuple(self._contents.connections.values())

    @property
    def summary(self) -> Summary:
        """What the index tells."""
        segments = self._contents.segments
        return Summary(
            container="rosbag1",
            storage="",
            compression=tuple(sorted({segment.compression for segment in segments})),
            size_bytes=self._file.size,
            message_count=sum(connection.message_count or 0 for connection in self.connections),
            start_ns=min((segment.start_ns for segment in segments), default=None),
            end_ns=max((segment.end_ns for segment in segments), default=None),
        )

    @property
    def bytes_read(self) -> int:
        """Stored bytes of the chunks that the latest call of `messages` has read so far."""
        return min(self._bytes_read, self._file.size)

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[RawMessage]:
        """Messages in the order of log time; those of one log time in the order of the file.

        Parameters
        ----------
        connections
            Only messages of these; None means all. Chunks without any are not read.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.

        Yields
        ------
        RawMessage
            ``data`` is a view into the decompressed chunk, and keeps it alive.

        Raises
        ------
        RecordingError
            If a chunk cannot be read, decompressed or taken apart.
        """
        known = self._contents.connections
        ids = None if connections is None else frozenset(connection.id for connection in connections)
        wanted = {key: item if ids is None or key in ids else None for key, item in known.items()}
        self._bytes_read = 0

        def load(segment: Segment) -> list[RawMessage]:
            try:
                chunk = _payload(self._file, segment)
                self._bytes_read += segment.length
                return _messages(chunk, wanted, start_ns, stop_ns)
            except _Damaged as err:
                raise RecordingError(
                    f"the chunk with data at byte {segment.offset} cannot be read: {err}",
                    path=self._path,
                    hint=_DAMAGED,
                ) from err

        due = [segment for segment in self._contents.segments if segment.may_hold(ids, start_ns, stop_ns)]
        return in_time_order(due, load)

    def attachments(self) -> Iterator[Attachment]:
        """None: a ROS 1 bag has no attachments."""
        return iter(())

    def metadata(self) -> Iterator[Metadata]:
        """None: a ROS 1 bag has no metadata records."""
        return iter(())

    def close(self) -> None:
        """Release the file. Messages that were handed out stay valid."""
        self._file.close()


# ------------------------------------------------------------------------------------------------- writer


def _pack_fields(fields: Mapping[str, bytes]) -> bytes:
    """Put a header together, its fields in alphabetical order as ROS 1's recorder has them."""
    packed = [name.encode("utf-8", "surrogateescape") + b"=" + fields[name] for name in sorted(fields)]
    return b"".join(_uint32.pack(len(item)) + item for item in packed)


def _pack_header(kind: int, fields: Mapping[str, bytes]) -> bytes:
    """Put a record's header together, with its length."""
    header = _pack_fields({"op": bytes((kind,)), **fields})
    return _uint32.pack(len(header)) + header


def _pack_record(kind: int, fields: Mapping[str, bytes], body: bytes) -> bytes:
    return _pack_header(kind, fields) + _uint32.pack(len(body)) + body


def _pack_time(time_ns: int) -> bytes:
    return _pair.pack(*divmod(time_ns, _SECOND_NS))


def _pack_bag_header(index_pos: int, connection_count: int, chunk_count: int) -> bytes:
    """Put the bag header together; padding makes its length the same whatever the numbers."""
    fields = {
        "chunk_count": _uint32.pack(chunk_count),
        "conn_count": _uint32.pack(connection_count),
        "index_pos": _uint64.pack(index_pos),
    }
    # Header and padding make 4096 bytes together, not counting their two lengths.
    padding = 4096 - (len(_pack_header(_BAG_HEADER, fields)) - 4)
    return _pack_record(_BAG_HEADER, fields, b" " * padding)


def _pack_connection(identity: int, connection: Connection) -> bytes:
    """Put a connection's record together; the counterpart of `_connection`."""
    metadata = {name: value for name, value in connection.metadata.items() if name not in _OWN_FIELDS}
    header = {
        **metadata,
        "topic": connection.metadata.get("topic", connection.topic),
        "type": ros1_type(connection.msgtype),
        # ROS 1's word for any type.
        "md5sum": connection.digest or "*",
    }
    if connection.callerid is not None:
        header["callerid"] = connection.callerid
    if connection.latching:
        header["latching"] = "1"
    elif "latching" in connection.metadata:
        header["latching"] = connection.metadata["latching"]
    body = {name: value.encode("utf-8", "surrogateescape") for name, value in header.items()}
    body["message_definition"] = connection.definition.data
    topic = connection.topic.encode("utf-8", "surrogateescape")
    return _pack_record(_CONNECTION, {"conn": _uint32.pack(identity), "topic": topic}, _pack_fields(body))


def _compressed(parts: Sequence[Buffer], compression: str) -> Sequence[Buffer]:
    """Compress a chunk so that ROS 1's own reader takes it."""
    if compression == "none":
        return parts
    data = b"".join(parts)
    if compression == "bz2":
        import bz2  # noqa: PLC0415  # heavy

        return [bz2.compress(data)]
    import lz4.frame  # noqa: PLC0415  # heavy

    # ROS 1's reader knows frames of independent blocks, without a content size and with a checksum,
    # and no others.
    return [
        lz4.frame.compress(
            data,
            block_size=lz4.frame.BLOCKSIZE_MAX1MB,
            block_linked=False,
            store_size=False,
            content_checksum=True,
        )
    ]


def _pack_index(handle: int, entries: list[tuple[int, int, int]]) -> bytes:
    """Put the index of one connection in one chunk together: times and places, by time."""
    return _pack_record(
        _INDEX_DATA,
        {"conn": _uint32.pack(handle), "count": _uint32.pack(len(entries)), "ver": _uint32.pack(1)},
        struct.pack(f"<{3 * len(entries)}I", *chain.from_iterable(sorted(entries))),
    )


def _pack_chunk_info(chunk: _OpenChunk, chunk_pos: int) -> bytes:
    """Put the entry of a chunk in the bag's index together."""
    fields = {
        "chunk_pos": _uint64.pack(chunk_pos),
        "count": _uint32.pack(len(chunk.index)),
        "end_time": _pack_time(chunk.end_ns),
        "start_time": _pack_time(chunk.start_ns),
        "ver": _uint32.pack(1),
    }
    counts = (_pair.pack(handle, len(entries)) for handle, entries in chunk.index.items())
    return _pack_record(_CHUNK_INFO, fields, b"".join(counts))


@dataclass(slots=True)
class _OpenChunk:
    """A chunk being filled.

    ``index`` has the seconds, nanoseconds and place of the messages of each connection.
    """

    parts: list[Buffer] = field(default_factory=list)
    size: int = 0
    index: dict[int, list[tuple[int, int, int]]] = field(default_factory=dict)
    start_ns: int = (_UINT32_MAX + 1) * _SECOND_NS
    end_ns: int = 0

    def append(self, part: Buffer) -> None:
        self.parts.append(part)
        self.size += len(part)


class Rosbag1Writer:
    """A ROS 1 bag being written; a `Writer`.

    One chunk is held in memory, and a small record for each that was written. The same calls make the
    same bytes.

    Parameters
    ----------
    path
        Must not exist.
    compression
        ``none``, ``bz2`` or ``lz4``.
    chunk_size
        Bytes of records after which a chunk is closed. A message that is larger has a chunk of its own.

    Raises
    ------
    DestinationError
        If ``path`` exists, or the compression is not one that bags know.
    OutputError
        If the file cannot be created; from every method, if it cannot be written.
    """

    def __init__(self, path: Path, compression: str = "lz4", chunk_size: int = 768 * 1024) -> None:
        if compression not in _COMPRESSIONS:
            raise DestinationError(
                f"a ROS 1 bag cannot be compressed with {compression}, only with {', '.join(_COMPRESSIONS)}",
                path=path,
                hint="Choose lz4 (fast) or bz2 (small), or write MCAP or rosbag2.",
            )
        self.path = path
        self._compression = compression
        self._chunk_size = chunk_size
        self._connections: list[bytes] = []
        # The part of a message's record before its time, for each connection.
        self._prefixes: list[bytes] = []
        self._chunk_infos: list[bytes] = []
        self._position = 0
        self._declared: set[int] = set()
        self._chunk = _OpenChunk()
        try:
            self._file = path.open("xb")
        except FileExistsError as err:
            raise DestinationError(
                "exists already", path=path, hint="Remove it, or choose another name."
            ) from err
        except OSError as err:
            raise OutputError(f"cannot be created: {err.strerror}", path=path) from err
        self._put(_FIRST_LINE, _pack_bag_header(0, 0, 0))

    def add_connection(self, connection: Connection) -> int:
        """Declare a connection; equal ones stay apart.

        Parameters
        ----------
        connection
            With serialization ``ros1``. Its id is ignored; a missing digest is written as ``*``; the
            definition is written byte for byte, and the type in ROS 1's spelling.

        Returns
        -------
        int
            The handle that `write` takes, and the connection's id in the bag: 0, 1, 2, ...

        Raises
        ------
        DestinationError
            If its messages are not serialised as ROS 1 does, or a metadata name has a ``=``.
        """
        if connection.serialization != "ros1":
            raise DestinationError(
                f"a ROS 1 bag holds messages serialised as 'ros1', these are {connection.serialization!r}",
                path=self.path,
                topic=connection.topic,
                hint="Convert them first, or write MCAP or rosbag2.",
            )
        for name in connection.metadata:
            if "=" in name:
                raise DestinationError(
                    f"the metadata name {name!r} has a '=', which a ROS 1 bag cannot hold",
                    path=self.path,
                    topic=connection.topic,
                )
        handle = len(self._connections)
        self._connections.append(_pack_connection(handle, connection))
        literals = _USUAL_LAYOUT.expected
        self._prefixes.append(b"%b%b%b" % (literals[0], _uint32.pack(handle), literals[1]))
        return handle

    def write(
        self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0
    ) -> None:
        """Append a message. ``data`` is not referred to after the call.

        Parameters
        ----------
        handle
            What `add_connection` returned.
        log_time_ns
            Nanoseconds since the epoch; whole seconds must fit 32 bits.
        data
            The serialised message.
        publish_time_ns, sequence
            Ignored: a ROS 1 bag has no place for them.

        Raises
        ------
        OutputError
            If the time or the message is more than the format can hold, or the file cannot be written.
        """
        del publish_time_ns, sequence
        seconds, nanoseconds = divmod(log_time_ns, _SECOND_NS)
        if not 0 <= seconds <= _UINT32_MAX:
            raise OutputError(
                f"log time {log_time_ns} ns is outside the 0 to {_UINT32_MAX} s that a ROS 1 bag can hold",
                path=self.path,
            )
        if isinstance(data, memoryview) and data.itemsize != 1:
            data = data.cast("B")
        declaration = b"" if handle in self._declared else self._connections[handle]
        needed = len(declaration) + _USUAL_LAYOUT.layout.size + len(data)
        if needed > _UINT32_MAX:
            raise OutputError(
                f"a message of {len(data)} bytes does not fit into a ROS 1 bag, whose chunks have at most "
                f"{_UINT32_MAX} bytes",
                path=self.path,
            )
        if self._chunk.size + needed > self._chunk_size:
            self._flush()
        chunk = self._chunk
        if declaration:
            self._declared.add(handle)
            chunk.append(declaration)
        chunk.index.setdefault(handle, []).append((seconds, nanoseconds, chunk.size))
        chunk.start_ns = min(chunk.start_ns, log_time_ns)
        chunk.end_ns = max(chunk.end_ns, log_time_ns)
        chunk.append(self._prefixes[handle] + _triple.pack(seconds, nanoseconds, len(data)))
        if chunk.size + len(data) >= self._chunk_size:
            chunk.append(data)
            self._flush()
        else:
            # A view would keep alive the whole chunk that it was read from, and may change under us.
            chunk.append(bytes(data))

    def add_attachment(self, attachment: Attachment) -> None:
        """Do nothing: a ROS 1 bag has no attachments."""

    def add_metadata(self, metadata: Metadata) -> None:
        """Do nothing: a ROS 1 bag has no metadata records."""

    def finish(self) -> None:
        """Write the open chunk and the index, complete the header, and put everything on the disk."""
        self._flush()
        index_pos = self._position
        self._put(*self._connections, *self._chunk_infos)
        header = _pack_bag_header(index_pos, len(self._connections), len(self._chunk_infos))
        try:
            self._file.seek(len(_FIRST_LINE))
            self._file.write(header)
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
        except OSError as err:
            raise self._failed(err) from err

    def abort(self) -> None:
        """Release the file; without its index it is not a bag."""
        # Closing writes what is buffered, and fails again where writing did.
        with suppress(OSError):
            self._file.close()

    def _flush(self) -> None:
        """Write the open chunk with its index, if it has anything in it."""
        chunk = self._chunk
        if not chunk.parts:
            return
        self._chunk = _OpenChunk()
        self._chunk_infos.append(_pack_chunk_info(chunk, self._position))
        stored = _compressed(chunk.parts, self._compression)
        header = {"compression": self._compression.encode(), "size": _uint32.pack(chunk.size)}
        length = sum(len(part) for part in stored)
        self._put(_pack_header(_CHUNK, header), _uint32.pack(length), *stored)
        self._put(*(_pack_index(handle, entries) for handle, entries in chunk.index.items()))

    def _put(self, *parts: Buffer) -> None:
        try:
            for part in parts:
                self._file.write(part)
                self._position += len(part)
        except OSError as err:
            raise self._failed(err) from err

    def _failed(self, err: OSError) -> OutputError:
        return OutputError(f"cannot be written: {err.strerror}", path=self.path)
