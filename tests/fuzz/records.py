"""Where the records of MCAP files and ROS 1 bags are, by their specifications; nothing of pc2scan is used."""

from __future__ import annotations

import bz2
import struct
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import lz4.frame
import zstandard

if TYPE_CHECKING:
    from collections.abc import Iterator

FIRST_LINE = b"#ROSBAG V2.0\n"
_MAGIC = b"\x89MCAP0\r\n"
_MCAP_RECORD = struct.Struct("<BQ")


def mcap_records(data: bytes, position: int, end: int) -> list[tuple[int, int, int]]:
    """Opcodes, starts and stops of the records in a row."""
    rows = []
    while position < end:
        opcode, length = _MCAP_RECORD.unpack_from(data, position)
        rows.append((opcode, position, position + _MCAP_RECORD.size + length))
        position = rows[-1][2]
    return rows


class BagRecord:
    """A record of a bag: its kind, where it is, and where the values of its header and its body are."""

    def __init__(self, data: bytes, start: int) -> None:
        position = start + 4
        stop = position + _uint32(data, start)
        self.values: dict[bytes, tuple[int, int]] = {}
        while position < stop:
            after = position + 4 + _uint32(data, position)
            name = data[position + 4 : after].partition(b"=")[0]
            self.values[name] = (position + 5 + len(name), after)
            position = after
        self.body = (stop + 4, stop + 4 + _uint32(data, stop))
        self.start, self.stop = start, self.body[1]
        self.op = data[self.values[b"op"][0]]


def _uint32(data: bytes, position: int) -> int:
    return int.from_bytes(data[position : position + 4], "little")


def bag_records(data: bytes, position: int, end: int) -> list[BagRecord]:
    """All records in a row."""
    rows = []
    while position < end:
        rows.append(BagRecord(data, position))
        position = rows[-1].stop
    return rows


class Stretch(NamedTuple):
    """A chunk, or a message outside of one, and the data of its messages."""

    start: int
    stop: int
    messages: frozenset[bytes]


@lru_cache(maxsize=64)
def stretches(data: bytes) -> list[Stretch]:
    """Where the messages of a sound bag or MCAP file are."""
    return list(_bag_stretches(data) if data.startswith(FIRST_LINE) else _mcap_stretches(data))


def _mcap_stretches(data: bytes) -> Iterator[Stretch]:
    for opcode, start, stop in mcap_records(data, len(_MAGIC), len(data) - len(_MAGIC)):
        if opcode == 5:
            yield Stretch(start, stop, frozenset([data[start + 31 : stop]]))
        elif opcode == 6:
            place = start + 9 + 28
            name = data[place + 4 : place + 4 + _uint32(data, place)].decode()
            chunk = _unpacked(data[place + 4 + len(name) + 8 : stop], name)
            inner = mcap_records(chunk, 0, len(chunk))
            yield Stretch(start, stop, frozenset(chunk[first + 31 : last] for kind, first, last in inner if kind == 5))


def _bag_stretches(data: bytes) -> Iterator[Stretch]:
    for record in bag_records(data, len(FIRST_LINE), len(data)):
        if record.op == 5:
            chunk = _unpacked(data[slice(*record.body)], data[slice(*record.values[b"compression"])].decode())
            inner = bag_records(chunk, 0, len(chunk))
            yield Stretch(record.start, record.stop, frozenset(chunk[slice(*row.body)] for row in inner if row.op == 2))


def _unpacked(data: bytes, compression: str) -> bytes:
    match compression:
        case "lz4":
            return bytes(lz4.frame.decompress(data))
        case "bz2":
            return bz2.decompress(data)
        case "zstd":
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 26)
    return data


@lru_cache(maxsize=64)
def edges(name: str, data: bytes) -> list[int]:
    """Where records begin, and the last one ends; lines of a text, pages of a database."""
    if name.endswith(".bag"):
        return [len(FIRST_LINE), *(record.stop for record in bag_records(data, len(FIRST_LINE), len(data)))]
    if name.endswith(".mcap"):
        return [len(_MAGIC), *(stop for _, _, stop in mcap_records(data, len(_MAGIC), len(data) - len(_MAGIC)))]
    if name.endswith(".yaml"):
        return [0, *(place + 1 for place, byte in enumerate(data) if byte == 10)]
    return [*range(0, len(data), 4096), len(data)]
