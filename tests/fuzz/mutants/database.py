"""Fields of an SQLite database, of its write-ahead log and of its rollback journal (https://sqlite.org/fileformat2.html)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fuzz.mutants.layout import Field, Layout, Record
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from fuzz.mutants.layout import Role

__all__ = [
    "JOURNAL_MAGIC",
    "database_layout",
    "journal_checksum",
    "journal_layout",
    "journal_segments",
    "wal_checksums",
    "wal_layout",
]

JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")

#: Place, size, name and role of the values in headers.
_TABLES = Path(__file__).with_suffix(".txt")
_VALUES = {kind: rows(_TABLES, kind) for kind in ("header", "wal", "frame", "journal")}
_TABLE_LEAF, _TABLE_INNER, _INDEX_LEAF, _INDEX_INNER = 13, 5, 10, 2


def _field(kind: str, role: Role, start: int, size: int) -> Field:
    # Page numbers do not move when bytes do.
    return Field(kind, "number" if role == "place" else role, start, start + size, "big")


def _header(kind: str, start: int) -> list[Field]:
    return [_field(f"{kind}.{name}", role, start + place, size) for place, size, name, role in _VALUES[kind]]


def database_layout(data: bytes) -> Layout:
    """Lay out a sound database: its header, the headers and cells of its trees' pages, and the records in them."""
    made = Layout(data)
    made.fields += _header("header", 0)
    page_size = int.from_bytes(data[16:18], "big")
    page_size = 65_536 if page_size == 1 else page_size
    for start in range(0, len(data) - page_size + 1, page_size):
        made.records.append(Record("page", start, start + page_size))
        header = start + 100 * (start == 0)
        kind = data[header]
        if kind in (_TABLE_LEAF, _TABLE_INNER, _INDEX_LEAF, _INDEX_INNER) and int.from_bytes(
            data[header + 3 : header + 5], "big"
        ):
            made.fields += _page(data, start, header, page_size)
        else:
            made.fields.append(_field("overflow.next", "place", start, 4))
            made.fields.append(_field("overflow.content", "payload", start + 4, page_size - 4))
    return made


def _page(data: bytes, start: int, header: int, page_size: int) -> Iterator[Field]:
    kind = data[header]
    name = {_TABLE_LEAF: "leaf", _TABLE_INNER: "inner", _INDEX_LEAF: "index", _INDEX_INNER: "index_inner"}[kind]
    yield _field(f"{name}.kind", "opcode", header, 1)
    yield _field(f"{name}.freeblock", "number", header + 1, 2)
    yield _field(f"{name}.cells", "count", header + 3, 2)
    yield _field(f"{name}.content_start", "number", header + 5, 2)
    yield _field(f"{name}.fragments", "count", header + 7, 1)
    pointers = header + 8
    if kind in (_TABLE_INNER, _INDEX_INNER):
        yield _field(f"{name}.right", "place", header + 8, 4)
        pointers += 4
    for number in range(int.from_bytes(data[header + 3 : header + 5], "big")):
        pointer = pointers + 2 * number
        yield _field(f"{name}.cell_place", "number", pointer, 2)
        yield from _cell(data, start + int.from_bytes(data[pointer : pointer + 2], "big"), kind, name, page_size)


def _cell(data: bytes, position: int, kind: int, name: str, page_size: int) -> Iterator[Field]:
    if kind in (_TABLE_INNER, _INDEX_INNER):
        yield _field(f"{name}.child", "place", position, 4)
        position += 4
    size = 0
    if kind != _TABLE_INNER:
        size, stop = varint(data, position)
        yield _field(f"{name}.payload_size", "length", position, stop - position)
        position = stop
    if kind in (_TABLE_LEAF, _TABLE_INNER):
        _, stop = varint(data, position)
        yield _field(f"{name}.rowid", "id", position, stop - position)
        position = stop
    if kind == _TABLE_INNER:
        return
    largest = page_size - 35 if kind == _TABLE_LEAF else (page_size - 12) * 64 // 255 - 23
    smallest = (page_size - 12) * 32 // 255 - 23
    local = size
    if size > largest:
        local = smallest + (size - smallest) % (page_size - 4)
        local = local if local <= largest else smallest
        yield _field(f"{name}.overflow", "place", position + local, 4)
    yield from _record(data, position, position + local, name)


def _record(data: bytes, start: int, stop: int, name: str) -> Iterator[Field]:
    """Fields of a row: the kinds of its values, and these."""
    header, position = varint(data, start)
    yield _field(f"{name}.row_header", "length", start, position - start)
    content = start + header
    while position < start + header:
        kind, following = varint(data, position)
        yield _field(f"{name}.value_kind", "number", position, following - position)
        size = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0, 0, 0)[kind] if kind < 12 else (kind - 12) // 2
        if 0 < size <= stop - content:
            role: Role = ("time" if size == 8 else "id") if kind < 12 else "name" if kind % 2 else "payload"
            yield _field(f"{name}.{role}", role, content, size)
        content, position = content + size, following


def varint(data: bytes, position: int) -> tuple[int, int]:
    """SQLite's number of one to nine bytes, and where it ends."""
    value = 0
    for _ in range(8):
        byte = data[position]
        position += 1
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, position
    return value << 8 | data[position], position + 1


def wal_layout(data: bytes) -> Layout:
    """Lay out a write-ahead log."""
    made = Layout(data)
    made.fields += _header("wal", 0)
    page_size = int.from_bytes(data[8:12], "big")
    for start in range(32, len(data) - page_size - 23, 24 + page_size):
        made.records.append(Record("frame", start, start + 24 + page_size))
        made.fields += _header("frame", start)
        made.fields.append(_field("frame.content", "payload", start + 24, page_size))

    def seal(changed: bytearray, _: Callable[[int], int]) -> None:
        changed[:] = wal_checksums(bytes(changed), page_size)

    made.seal = seal
    return made


def wal_checksums(data: bytes, page_size: int) -> bytes:
    """The log with the checksums of its header and of all whole frames as they must be."""
    changed = bytearray(data)
    order = ">" if changed[3] & 1 else "<"
    sums = _wal_sum(order, data[:24], (0, 0))
    struct.pack_into(">II", changed, 24, *sums)
    for start in range(32, len(data) - page_size - 23, 24 + page_size):
        sums = _wal_sum(order, data[start : start + 8] + data[start + 24 : start + 24 + page_size], sums)
        struct.pack_into(">II", changed, start + 16, *sums)
    return bytes(changed)


def _wal_sum(order: str, data: bytes, sums: tuple[int, int]) -> tuple[int, int]:
    first, second = sums
    for a, b in struct.iter_unpack(f"{order}II", data):
        first = (first + a + second) & 0xFFFF_FFFF
        second = (second + b + first) & 0xFFFF_FFFF
    return first, second


def journal_layout(data: bytes) -> Layout:
    """Lay out a rollback journal: segments of a header, which fills a sector, and pages."""
    made = Layout(data)
    found = journal_segments(data)
    for segment in found:
        made.fields.append(Field("journal.magic", "text", segment.start, segment.start + 8))
        made.fields += _header("journal", segment.start)
        size = segment.page_size
        for start in segment.pages:
            made.records.append(Record("journal_page", start, start + size + 8))
            made.fields.append(_field("journal_page.number", "number", start, 4))
            made.fields.append(_field("journal_page.content", "payload", start + 4, size))
            made.fields.append(_field("journal_page.checksum", "checksum", start + 4 + size, 4))

    def seal(changed: bytearray, moved: Callable[[int], int]) -> None:
        for segment in found:
            (nonce,) = struct.unpack_from(">I", changed, moved(segment.start) + 12)
            for start in map(moved, segment.pages):
                end = start + 4 + segment.page_size
                if end + 4 <= len(changed):
                    struct.pack_into(">I", changed, end, journal_checksum(bytes(changed[start + 4 : end]), nonce))

    made.seal = seal
    return made


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of a journal: where its header and the pages that this declares begin."""

    start: int
    nonce: int
    page_size: int
    pages: tuple[int, ...]
    stop: int


def journal_segments(data: bytes) -> list[Segment]:
    """Find the segments; those whose headers make no sense end the list."""
    found: list[Segment] = []
    start, first = 0, (0, 0)
    while data[start : start + 8] == JOURNAL_MAGIC and start + 28 <= len(data):
        pages, nonce, _, sector, page_size = struct.unpack_from(">IIIII", data, start + 8)
        if found:
            # The first one counts.
            sector, page_size = first
        if sector not in [1 << n for n in range(5, 17)] or page_size not in [1 << n for n in range(9, 17)]:
            break
        first = sector, page_size
        step = page_size + 8
        begin = start + sector
        count = min(pages, max(0, len(data) - begin) // step)
        stop = begin + count * step
        found.append(Segment(start, nonce, page_size, tuple(range(begin, stop, step)), stop))
        start = -(-stop // sector) * sector
    return found


def journal_checksum(content: bytes, nonce: int) -> int:
    """Of one page: every 200th byte from the end, and the nonce."""
    return (nonce + sum(content[len(content) - 200 :: -200])) & 0xFFFF_FFFF
