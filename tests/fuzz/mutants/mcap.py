"""An MCAP file's fields, by its specification (https://mcap.dev/spec)."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lz4.frame
import zstandard

from fuzz.mutants.layout import Field, Layout, Nested, Record

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from fuzz.mutants.layout import Role

__all__ = ["RECORD", "layout", "pack", "records", "unpack"]

MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length of the content.
RECORD = struct.Struct("<BQ")

_Spec = tuple[str, "Role", str]


def _specs(text: str) -> Iterator[tuple[int, tuple[str, tuple[_Spec, ...]]]]:
    """Opcodes, and the name of each record and its fields: their names, roles and codes."""
    for line in text.splitlines():
        head, _, fields = line.partition(": ")
        if line.startswith("0x"):
            opcode, kind = head.split()
            specs: Any = tuple(tuple(field.split()) for field in fields.split(", "))
            yield int(opcode, 16), (kind, specs)


_SPECS = dict(_specs(Path(__file__).with_suffix(".txt").read_text()))
_SIZES = {"B": 1, "H": 2, "I": 4, "Q": 8}
#: Arrays: the names, roles and codes of an entry's parts.
_ENTRIES: dict[str, tuple[_Spec, ...]] = {
    "m": (("key", "text", "s"), ("value", "text", "s")),
    "i": (("time", "time", "Q"), ("offset", "place", "Q")),
    "o": (("channel_id", "id", "H"), ("offset", "place", "Q")),
    "c": (("channel_id", "id", "H"), ("count", "count", "Q")),
}


def records(data: bytes, position: int, end: int) -> list[tuple[int, int, int]]:
    """Opcodes, starts and stops of the records in a row; raises ValueError where they do not fit."""
    found = []
    while position < end:
        if position + RECORD.size > end:
            raise ValueError(f"a record begins {end - position} bytes before the end")
        opcode, length = RECORD.unpack_from(data, position)
        stop = position + RECORD.size + length
        if stop > end:
            raise ValueError(f"the record at {position} ends at {stop}, behind {end}")
        found.append((opcode, position, stop))
        position = stop
    return found


class _Parser:
    """The fields of one record."""

    def __init__(self, data: bytes, found: list[Field]) -> None:
        self._data = data
        self._found = found

    def add(self, kind: str, role: Role, start: int, stop: int, covers: tuple[int, int] | None = None) -> int:
        self._found.append(Field(kind, role, start, stop, "little", covers))
        return stop

    def value(self, position: int, kind: str, spec: _Spec, stop: int) -> int:
        """Note one value; returns where it ends."""
        name, role, code = spec
        name = f"{kind}.{name}"
        if code in _SIZES:
            return self.add(name, role, position, position + _SIZES[code])
        if code == "r":
            return self.add(name, role, position, stop)
        size = 8 if code == "b" else 4
        length = int.from_bytes(self._data[position : position + size], "little")
        start = position + size
        self.add(f"{name}.length", "length", position, start, (start, start + length))
        if code not in _ENTRIES:
            return self.add(name, role, start, start + length)
        entry = start
        while entry < start + length:
            for part in _ENTRIES[code]:
                # A message index has offsets within its chunk.
                part = (part[0], "number", part[2]) if code == "i" and part[1] == "place" else part  # noqa: PLW2901
                entry = self.value(entry, name, part, stop)
        return start + length


def layout(data: bytes) -> Layout:
    """Lay out a sound file."""
    found = records(data, len(MAGIC), len(data) - len(MAGIC))
    made = _laid_out(data, found)
    ends = {opcode: start for opcode, start, _ in found}
    made.fields += [
        Field("magic", "number", 0, len(MAGIC)),
        Field("magic", "number", len(data) - len(MAGIC), len(data)),
    ]

    def seal(changed: bytearray, moved: Callable[[int], int]) -> None:
        footer, data_end = moved(ends[0x02]), moved(ends[0x0F])
        begin = int.from_bytes(changed[footer + 9 : footer + 17], "little")
        if begin and begin < footer:
            struct.pack_into("<I", changed, footer + 25, zlib.crc32(changed[begin : footer + 25]))
        if any(data[ends[0x0F] + 9 : ends[0x0F] + 13]):
            struct.pack_into("<I", changed, data_end + 9, zlib.crc32(changed[:data_end]))
        for opcode, start, stop in found:
            if opcode == 0x09:
                start, stop = moved(start), moved(stop)  # noqa: PLW2901
                struct.pack_into("<I", changed, stop - 4, zlib.crc32(changed[start + 9 : stop - 4]))

    made.seal = seal
    made.crc = zlib.crc32
    return made


def _laid_out(data: bytes, found: list[tuple[int, int, int]]) -> Layout:
    made = Layout(data)
    parser = _Parser(data, made.fields)
    for opcode, start, stop in found:
        kind, specs = _SPECS[opcode]
        made.records.append(Record(kind, start, stop))
        parser.add(f"{kind}.opcode", "opcode", start, start + 1)
        parser.add(f"{kind}.length", "length", start + 1, start + RECORD.size, (start + RECORD.size, stop))
        position = start + RECORD.size
        for spec in specs:
            position = parser.value(position, kind, spec, stop)
        if opcode == 0x06:
            made.nested.append(_chunk(data, made.fields, start))
    return made


def _chunk(data: bytes, fields: list[Field], start: int) -> Nested:
    own = {field.kind: field for field in fields if field.start >= start}
    name, stored = own["chunk.compression"], own["chunk.records"]
    compression = data[name.start : name.stop].decode()

    def inner(unpacked: bytes) -> Layout:
        return _laid_out(unpacked, records(unpacked, 0, len(unpacked)))

    return Nested(
        "chunk",
        stored.start,
        stored.stop,
        lambda packed: unpack(packed, compression),
        lambda unpacked: pack(unpacked, compression),
        inner,
        own["chunk.uncompressed_size"],
        own["chunk.crc"],
    )


def unpack(data: bytes, compression: str) -> bytes:
    """A chunk's records."""
    if compression == "lz4":
        return bytes(lz4.frame.decompress(data))
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 26) if compression == "zstd" else data


def pack(data: bytes, compression: str) -> bytes:
    """A chunk's records as they are stored."""
    if compression == "lz4":
        return bytes(lz4.frame.compress(data))
    return zstandard.ZstdCompressor().compress(data) if compression == "zstd" else data
