"""Decompresses the chunks of ROS 1 bags, and finds their records and messages.

Messages are found by walking through a chunk. The INDEX DATA records after it are not used: they have no further
information, and some recorders write wrong lengths.
"""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass, field
from itertools import permutations
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.lazy_items import MAX_LISTED_ITEMS, LazyItems
from pc2scan.errors import stamp_text
from pc2scan.files.compression import LZ4_MAGIC, CompressionError, decompress
from pc2scan.files.limits import allowed_bytes
from pc2scan.model import RawMessage, own_data

from .records import (
    CONNECTION,
    MESSAGE,
    SECOND_NS,
    UINT32,
    UINT32_MAX,
    FormatError,
    kind_of,
    parse_fields,
    time_field,
    uint32_field,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.files.source import BorrowedBytes
    from pc2scan.model import Buffer, Connection

    from .records import BagFile

#: Later than any time that a bag can hold.
_LATEST_NS = (UINT32_MAX + 8) * SECOND_NS


def payload(file: BagFile, segment: Segment) -> bytes:
    """Read and decompress a chunk."""
    return bytes(borrow_payload(file, segment).data)


def borrow_payload(file: BagFile, segment: Segment) -> BorrowedBytes:
    """Read and decompress a chunk; see `SourceFile.borrow`."""
    stored = file.borrow(segment.offset, segment.length)
    return stored._replace(data=memoryview(decompress_chunk(file, segment, stored.data)))


def decompress_chunk(file: BagFile, segment: Segment, data: Buffer) -> Buffer:
    """Decompress a chunk's ``data`` to its declared size."""
    compression, size = segment.compression, segment.uncompressed_size
    if size > (allowed := allowed_bytes(file.size)):
        raise FormatError(f"it declares {size} bytes, in a bag of {file.size} at most {allowed} may be")
    try:
        unpacked, complete = decompress(compression, data, size)
    except (CompressionError, MemoryError) as err:
        raise FormatError(f"its {compression} data cannot be decompressed: {err}") from err
    if not complete and len(unpacked) <= size:
        raise FormatError(f"its {compression} data ends early, {size} bytes are declared")
    if len(unpacked) != size:
        observed = f"more than {size}" if len(unpacked) > size else str(len(unpacked))
        raise FormatError(f"it holds {observed} bytes when decompressed, {size} are declared")
    return unpacked


def _record(data: memoryview, position: int) -> tuple[dict[bytes, bytes], int, int]:
    """Return a record of a chunk: its fields, and start and stop of its body."""
    lengths = []
    for _ in range(2):
        if position + 4 > len(data):
            raise FormatError(f"a record's length does not fit into the {len(data)} bytes of its chunk")
        (length,) = UINT32.unpack_from(data, position)
        lengths.append(position + 4)
        position += 4 + length
        lengths.append(position)
        if position > len(data):
            raise FormatError(f"a record reaches to byte {position} of a chunk of {len(data)} bytes")
    header, header_stop, body, body_stop = lengths
    return parse_fields(data[header:header_stop]), body, body_stop


def scan_records(data: memoryview) -> Iterator[tuple[dict[bytes, bytes], memoryview]]:
    """Yield all records of a chunk, as fields and body."""
    position = 0
    while position < len(data):
        fields, start, position = _record(data, position)
        yield fields, data[start:position]


class _Layout(NamedTuple):
    """A message record up to its body, its three fields in one of six orders.

    Everything but the values is literal: one `struct` call splits the record, and the literals show whether the record
    has this layout.
    """

    layout: struct.Struct
    literals: itemgetter[tuple[object, ...]]
    expected: tuple[bytes, ...]
    connection: int
    seconds: int


def _layout_of(order: Sequence[bytes]) -> _Layout:
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


_LAYOUTS = {order: _layout_of(order) for order in permutations((b"conn", b"op", b"time"))}

USUAL_LAYOUT = _LAYOUTS[b"conn", b"op", b"time"]


@dataclass(slots=True)
class Places:
    """Offsets of all messages in a chunk, and the connections that it describes.

    ``contradicts`` is true if the index describes one of these differently.
    """

    messages: list[int] = field(default_factory=list)
    described: set[int] = field(default_factory=set)
    contradicts: bool = False


def scan_messages(
    chunk: Buffer,
    wanted: Mapping[int, Connection | None],
    start_ns: int | None,
    stop_ns: int | None,
    *,
    span: tuple[int, int] | None = None,
    places: list[int] | None = None,
    describe: Callable[[Mapping[bytes, bytes], Buffer], object] | None = None,
) -> list[RawMessage] | LazyItems[RawMessage]:
    """Find the messages of a decompressed chunk.

    Parameters
    ----------
    chunk
        Its records; the messages' data are views into it.
    wanted
        Every connection by id, or None to skip its messages.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``.
    span
        The first and the last log time in the index, if it has them.
    places
        Gets the offset of every message, if given.
    describe
        Called with the fields and the body of each connection that the chunk describes.

    Raises
    ------
    FormatError
        If a record does not fit, is not a message or connection, or has a connection not in ``wanted``, or if a wanted
        message is outside of ``span``.
    """
    data = memoryview(chunk)
    end = len(data)
    low = 0 if start_ns is None else start_ns
    high = _LATEST_NS if stop_ns is None else stop_ns
    first, last = span or (0, _LATEST_NS)
    # One comparison for cut and span; only if it fails, the two are distinguished.
    low, high = max(low, first), min(high, last + 1)
    position, count = 0, 0
    messages: list[RawMessage] = []
    while position < end:
        position = _scan_stretch(data, wanted, (low, high), (first, last), position, messages, places, describe)
        if len(messages) + count > MAX_LISTED_ITEMS:
            count += len(messages)
            messages = []
    return _lazy_messages(data, wanted, low, high) if count else messages


def _scan_stretch(
    data: memoryview,
    wanted: Mapping[int, Connection | None],
    cut: tuple[int, int],
    span: tuple[int, int],
    position: int,
    messages: list[RawMessage],
    places: list[int] | None,
    describe: Callable[[Mapping[bytes, bytes], Buffer], object] | None,
) -> int:
    """Find messages from a place on, in so many bytes that they can be no more than `MAX_LISTED_ITEMS`.

    Returns
    -------
    int
        The place behind them.
    """
    (low, high), (first, last) = cut, span
    end = len(data)
    layout, literals, expected, at_connection, at_seconds = current = USUAL_LAYOUT
    prefix = layout.size
    stop = min(end, position + MAX_LISTED_ITEMS * prefix)
    while position < stop:
        origin = position
        values = layout.unpack_from(data, position) if position + prefix <= end else None
        if values and literals(values) == expected:
            identity = values[at_connection]
            stamp = values[at_seconds] * SECOND_NS + values[at_seconds + 1]
            start = position + prefix
            position = start + values[6]
            if position > end:
                raise FormatError(f"a message reaches to byte {position} of a chunk of {end} bytes")
        else:
            fields, start, following = _record(data, position)
            # Writers use one order of fields: use it from now on, and read this record again.
            other = _LAYOUTS.get(tuple(fields), current)
            if other is not current and kind_of(fields) == MESSAGE:
                layout, literals, expected, at_connection, at_seconds = current = other
                continue
            position = following
            if kind_of(fields) == CONNECTION:
                if describe is not None:
                    describe(fields, data[start:position])
                continue
            if kind_of(fields) != MESSAGE:
                raise FormatError(f"a record of kind {kind_of(fields)} is in it, allowed are messages and connections")
            identity = uint32_field(fields, "conn")
            stamp = time_field(fields, "time")
        try:
            connection = wanted[identity]
        except KeyError:
            raise FormatError(f"it has a message of connection {identity}, which is not in the index") from None
        if places is not None:
            places.append(origin)
        if connection is None:
            continue
        if low <= stamp < high:
            messages.append(RawMessage(connection, stamp, data[start:position], stamp))
        elif not first <= stamp <= last:
            raise FormatError(
                f"it has a message of log time {stamp_text(stamp)}, "
                f"declared are {stamp_text(first)} to {stamp_text(last)}"
            )
    return position


def _lazy_messages(
    data: memoryview, wanted: Mapping[int, Connection | None], start_ns: int, stop_ns: int
) -> LazyItems[RawMessage]:
    """Return the messages of a sound chunk, each created when it is needed."""
    found = MessagePlaces()
    layout, literals, expected, at_connection, at_seconds = USUAL_LAYOUT
    position, end = 0, len(data)
    while position < end:
        values = layout.unpack_from(data, position) if position + layout.size <= end else None
        if values and literals(values) == expected:
            identity = values[at_connection]
            stamp = values[at_seconds] * SECOND_NS + values[at_seconds + 1]
            start = position + layout.size
            position = start + values[6]
        else:
            fields, start, position = _record(data, position)
            if kind_of(fields) != MESSAGE:
                continue
            identity, stamp = uint32_field(fields, "conn"), time_field(fields, "time")
        if wanted[identity] is not None and start_ns <= stamp < stop_ns:
            found.add(identity, stamp, start, position)
    return found.lazy_messages(
        memoryview(own_data(data)), {key: item for key, item in wanted.items() if item is not None}
    )


class MessagePlaces:
    """Where messages of a chunk are."""

    def __init__(self) -> None:
        self._times = array("Q")
        self._ids, self._starts, self._stops = array("I"), array("I"), array("I")

    def add(self, identity: int, log_time_ns: int, start: int, stop: int) -> None:
        """Add one: its connection, its log time, and where its data are."""
        self._times.append(log_time_ns)
        for values, value in ((self._ids, identity), (self._starts, start), (self._stops, stop)):
            values.append(value)

    def lazy_messages(self, data: memoryview, known: Mapping[int, Connection]) -> LazyItems[RawMessage]:
        """Return the messages, each created when it is needed."""
        times, ids, starts, stops = self._times, self._ids, self._starts, self._stops

        def made(number: int) -> RawMessage:
            stamp = times[number]
            return RawMessage(known[ids[number]], stamp, data[starts[number] : stops[number]], stamp)

        return LazyItems(times, array("Q", range(len(times))), made, len(data) + 3 * ids.itemsize * len(ids))


# --- LZ4 frames ---
#
# ROS 1's own reader accepts only frames with independent blocks, no content size, and a checksum.
# Source: ``roslz4/src/lz4s.c`` in ros_comm, and https://github.com/lz4/lz4/blob/dev/doc/lz4_Frame_format.md.

#: Version 1, independent blocks, content checksum; no block checksums, content size or dictionary.
_FLAGS = 0b0110_0100
#: Blocks of at most 64 KiB, 256 KiB, 1 MiB, 4 MiB.
_BLOCK_SIZES = {0x40: 1 << 16, 0x50: 1 << 18, 0x60: 1 << 20, 0x70: 1 << 22}
_STORED = 0x8000_0000
_HEADER_SIZE = 7


def compress_lz4(data: Buffer) -> bytes:
    """Compress data into an LZ4 frame that ROS 1's own reader accepts."""
    import lz4.frame  # noqa: PLC0415  # heavy

    frame: bytes = lz4.frame.compress(
        data,
        block_size=lz4.frame.BLOCKSIZE_MAX1MB,
        block_linked=False,
        store_size=False,
        content_checksum=True,
    )
    return frame


def is_readable_lz4(data: Buffer) -> bool:
    """Whether these bytes are exactly one LZ4 frame that ROS 1's own reader accepts."""
    if len(data) < _HEADER_SIZE or data[:4] != LZ4_MAGIC or data[4] != _FLAGS or data[5] not in _BLOCK_SIZES:
        return False
    limit = _BLOCK_SIZES[data[5]]
    position = _HEADER_SIZE
    while position + 4 <= len(data):
        (size,) = UINT32.unpack_from(data, position)
        position += 4
        if size == 0:
            # The checksum, and the end.
            return position + 4 == len(data)
        size &= ~_STORED
        if size > limit:
            return False
        position += size
    return False
