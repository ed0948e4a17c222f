"""A ROS 1 bag's fields, by the format 2.0 (http://wiki.ros.org/Bags/Format/2.0)."""

from __future__ import annotations

import bz2
import struct
from typing import TYPE_CHECKING

import lz4.frame

from fuzz.mutants.layout import Field, Layout, Nested, Record

if TYPE_CHECKING:
    from fuzz.mutants.layout import Role

__all__ = ["FIRST_LINE", "KINDS", "Raw", "layout", "pack", "raw_records", "unpack"]

FIRST_LINE = b"#ROSBAG V2.0\n"
KINDS = {2: "message", 3: "bag_header", 4: "index_data", 5: "chunk", 6: "chunk_info", 7: "connection"}

_ROLES: dict[bytes, Role] = {
    b"op": "opcode",
    b"conn": "id",
    b"time": "time",
    b"start_time": "time",
    b"end_time": "time",
    b"chunk_pos": "place",
    b"index_pos": "place",
    b"conn_count": "count",
    b"chunk_count": "count",
    b"count": "count",
    b"ver": "number",
    b"size": "size",
    b"compression": "name",
    b"topic": "name",
    b"type": "name",
    b"callerid": "name",
}


class Raw:
    """A record: the values of its header by name with their places, and where its header and body are."""

    def __init__(self, data: bytes, start: int, end: int) -> None:
        self.start = start
        self.header = (start + 4, start + 4 + _uint32(data, start, end))
        self.values = values(data, *self.header)
        body = self.header[1] + 4
        self.body = (body, body + _uint32(data, body - 4, end))
        self.stop = self.body[1]
        if self.stop > end:
            raise ValueError(f"the record at {start} ends at {self.stop}, behind {end}")
        place = self.values.get(b"op")
        if place is None or place[1] - place[0] != 1:
            raise ValueError(f"the record at {start} has no kind")
        self.op = data[place[0]]


def _uint32(data: bytes, position: int, end: int) -> int:
    if position + 4 > end:
        raise ValueError(f"no length at {position}")
    return int.from_bytes(data[position : position + 4], "little")


def values(data: bytes, position: int, end: int) -> dict[bytes, tuple[int, int]]:
    """Where the values of a header are."""
    found = {}
    if end > len(data):
        raise ValueError("a header reaches beyond the end")
    while position < end:
        stop = position + 4 + _uint32(data, position, end)
        name, equals, _ = data[position + 4 : stop].partition(b"=")
        if stop > end or not equals:
            raise ValueError(f"a field at {position} does not fit")
        found[name] = (position + 5 + len(name), stop)
        position = stop
    return found


def raw_records(data: bytes, position: int, end: int) -> list[Raw]:
    """All records in a row; raises ValueError where they do not fit."""
    found = []
    while position < end:
        found.append(Raw(data, position, end))
        position = found[-1].stop
    return found


def layout(data: bytes) -> Layout:
    """Lay out a sound bag."""
    made = _laid_out(data, raw_records(data, len(FIRST_LINE), len(data)))
    made.fields.append(Field("first_line", "text", 0, len(FIRST_LINE)))
    return made


def _laid_out(data: bytes, found: list[Raw]) -> Layout:
    made = Layout(data)
    for raw in found:
        kind = KINDS[raw.op]
        made.records.append(Record(kind, raw.start, raw.stop))
        made.fields.append(Field(f"{kind}.header_length", "length", raw.start, raw.start + 4, covers=raw.header))
        made.fields.append(Field(f"{kind}.body_length", "length", raw.body[0] - 4, raw.body[0], covers=raw.body))
        made.fields += _header_fields(data, kind, *raw.header)
        if raw.op == 2:
            made.fields.append(Field("message.data", "payload", *raw.body))
        elif raw.op == 4:
            for start in range(*raw.body, 12):
                made.fields.append(Field("index_data.time", "time", start, start + 8))
                made.fields.append(Field("index_data.offset", "number", start + 8, start + 12))
        elif raw.op == 6:
            for start in range(*raw.body, 8):
                made.fields.append(Field("chunk_info.conn", "id", start, start + 4))
                made.fields.append(Field("chunk_info.conn_count", "count", start + 4, start + 8))
        elif raw.op == 7:
            made.fields += _header_fields(data, "connection.published", *raw.body)
        elif raw.op == 5:
            made.fields.append(Field("chunk.data", "payload", *raw.body))
            made.nested.append(_chunk(data, raw))
    return made


def _header_fields(data: bytes, kind: str, start: int, stop: int) -> list[Field]:
    found = []
    for name, (begin, end) in values(data, start, stop).items():
        field_start = begin - 5 - len(name)
        label = f"{kind}.{name.decode()}"
        found.append(
            Field(f"{kind}.field_length", "length", field_start, field_start + 4, covers=(field_start + 4, end))
        )
        found.append(Field(f"{kind}.field_name", "text", field_start + 4, begin))
        found.append(Field(label, _ROLES.get(name, "text"), begin, end))
    return found


def _chunk(data: bytes, raw: Raw) -> Nested:
    compression = data[slice(*raw.values[b"compression"])].decode()

    def inner(unpacked: bytes) -> Layout:
        return _laid_out(unpacked, raw_records(unpacked, 0, len(unpacked)))

    return Nested(
        "chunk",
        *raw.body,
        lambda packed: unpack(packed, compression),
        lambda unpacked: pack(unpacked, compression),
        inner,
        Field("chunk.size", "size", *raw.values[b"size"]),
    )


def unpack(data: bytes, compression: str) -> bytes:
    """A chunk's records; raises ValueError or OSError."""
    if compression == "lz4":
        return bytes(lz4.frame.decompress(data))
    return bz2.decompress(data) if compression == "bz2" else data


def pack(data: bytes, compression: str) -> bytes:
    """A chunk's records as they are stored."""
    if compression == "lz4":
        return bytes(lz4.frame.compress(data))
    return bz2.compress(data) if compression == "bz2" else data


def time_at(data: bytes, start: int) -> int:
    """A time, ns."""
    seconds, nanoseconds = struct.unpack_from("<II", data, start)
    return int(seconds * 1_000_000_000 + nanoseconds)
