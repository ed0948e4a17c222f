"""Searches a ROS 1 bag for the certain beginning of a record or of another bag."""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.concatenation import NextRecordingError

from .records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    FIRST_LINE,
    INDEX_DATA,
    MESSAGE,
    UINT32,
    FormatError,
    parse_fields,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from .records import BagFile

#: Bytes that are searched at a time.
_WINDOW = 1 << 20

#: Limit of a record's header, except for connections with longer topics.
_MAX_HEADER = 4096

# The field with the kind of a record; the fields before it are few and short.
_OP = re.compile(rb"\x04\0\0\0op=[\x02-\x07]")
_REACH = 72

ANYWHERE = frozenset({MESSAGE, INDEX_DATA, CHUNK, CHUNK_INFO, CONNECTION})
#: Records that cannot be in a chunk.
OUTSIDE_CHUNKS = frozenset({INDEX_DATA, CHUNK, CHUNK_INFO})

#: The required fields of each kind of record, so that other text is not detected as a record.
_NEEDED = {
    MESSAGE: {b"conn", b"time"},
    INDEX_DATA: {b"ver", b"conn", b"count"},
    CHUNK: {b"compression", b"size"},
    CHUNK_INFO: {b"ver", b"chunk_pos", b"start_time", b"end_time", b"count"},
    CONNECTION: {b"conn", b"topic"},
    BAG_HEADER: {b"index_pos"},
}

Fields = dict[bytes, bytes]


class BagRecord(NamedTuple):
    """A record: its fields, and start and stop of its body."""

    fields: Fields
    start: int
    stop: int

    @property
    def kind(self) -> int:
        """The kind of the record."""
        return self.fields[b"op"][0]


def _are_complete(fields: Fields) -> bool:
    kind = fields.get(b"op", b"")
    if len(kind) != 1 or not _NEEDED.get(kind[0], {b""}) <= fields.keys():
        return False
    return all(len(fields[name]) == size for name, size in ((b"conn", 4), (b"time", 8), (b"size", 4)) if name in fields)


def record_at(read: Callable[[int, int], bytes], position: int, size: int) -> BagRecord | None:
    """Return the record that begins here, if one does; its body may reach beyond ``size``."""
    if position + 8 > size:
        return None
    (length,) = UINT32.unpack(read(position, 4))
    if not 8 <= length <= _MAX_HEADER or position + 8 + length > size:
        return None
    try:
        fields = parse_fields(read(position + 4, length))
    except FormatError:
        return None
    if not _are_complete(fields):
        return None
    (body,) = UINT32.unpack(read(position + 4 + length, 4))
    start = position + 8 + length
    return BagRecord(fields, start, start + body)


def _record_in(window: bytes, op_at: int) -> int | None:
    """Return the beginning of the record whose ``op`` field is here."""
    # The usual places first: ``op`` is the header's first field, or after ``conn``, ``compression``...
    for start in range(op_at - 4, max(-1, op_at - _REACH), -1):
        (length,) = struct.unpack_from("<I", window, start)
        if op_at - start + 5 <= length + 4 <= _MAX_HEADER and start + 8 + length <= len(window):
            try:
                fields = parse_fields(window[start + 4 : start + 4 + length])
            except FormatError:
                continue
            if _are_complete(fields):
                return start
    return None


def next_record(
    read: Callable[[int, int], bytes], start: int, size: int, kinds: frozenset[int], limit: int | None = None
) -> int:
    """Search, before ``limit``, for the beginning of a record; ``size`` if there is none."""
    stop = size if limit is None else min(size, limit + _REACH)
    begin = start
    while begin < stop:
        window = read(begin, min(_WINDOW, size - begin))
        for match in _OP.finditer(window):
            if match[0][-1] not in kinds:
                continue
            found = _record_in(window, match.start())
            if found is not None and begin + found >= start:
                position = begin + found
                if limit is not None and position >= limit:
                    return size
                record = record_at(read, position, size)
                # A chunk may be cut off by the end of the file; all other records must be whole.
                if record is not None and (record.stop <= size or record.kind == CHUNK):
                    return position
        if begin + len(window) >= size:
            break
        begin += len(window) - _MAX_HEADER - _REACH
    return size


def another_bag(file: BagFile, start: int, stop: int) -> int | None:
    """Search a part of the file for the beginning of another bag: its first line, and its header."""
    overlap = len(FIRST_LINE) - 1
    for begin in range(start, stop, _WINDOW):
        window = file.read(begin, min(_WINDOW + overlap, file.size - begin))
        at = window.find(FIRST_LINE)
        while at >= 0:
            record = record_at(file.nearby, begin + at + len(FIRST_LINE), file.size)
            if begin + at > 0 and record is not None and record.kind == BAG_HEADER:
                return begin + at
            at = window.find(FIRST_LINE, at + 1)
    return None


def record_behind(file: BagFile, start: int) -> int | None:
    """Search the rest of the file for a record; returns the beginning of the first one."""
    found = next_record(file.nearby, start, file.size, ANYWHERE)
    return found if found < file.size else None


def refuse_another(file: BagFile, start: int, stop: int) -> None:
    """Raise if another bag begins in this part of the file."""
    if (found := another_bag(file, start, stop)) is not None:
        raise NextRecordingError(found)
