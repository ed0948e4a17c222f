"""What contradicts itself in a ROS 1 bag, by the format 2.0: nothing of pc2scan is used.

The index records after chunks are not looked at: they only repeat what the messages have.
"""

from __future__ import annotations

import struct
from collections import Counter

from fuzz.mutants.rosbag1 import FIRST_LINE, Raw, raw_records, time_at, unpack

__all__ = ["contradictions"]

MESSAGE, BAG_HEADER, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 5, 6, 7


class _Bag:
    """What was met so far."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.found: list[str] = []
        self.connections: dict[int, bytes] = {}
        #: By chunk: its messages as connection and time.
        self.chunks: dict[int, list[tuple[int, int]]] = {}

    def number(self, raw: Raw, name: bytes, data: bytes | None = None) -> int:
        start, stop = raw.values.get(name, (0, 0))
        if stop - start not in (4, 8):
            raise ValueError(f"field {name!r} of the record at {raw.start}")
        return int.from_bytes((self.data if data is None else data)[start:stop], "little")

    def declare(self, raw: Raw, data: bytes) -> None:
        """Note a connection; all its copies must be the same (the order of fields is of no consequence)."""
        number = self.number(raw, b"conn", data)
        topic = data[slice(*raw.values[b"topic"])]
        content = topic + b"\0" + data[slice(*raw.body)]
        if self.connections.setdefault(number, content) != content:
            self.found.append(f"two descriptions of connection {number}")


def contradictions(data: bytes) -> list[str]:
    """List them; empty for a file that could be sound."""
    bag = _Bag(data)
    try:
        _read(bag)
    except (ValueError, OSError, EOFError, RuntimeError, KeyError, struct.error) as err:
        bag.found.append(f"{type(err).__name__}: {err}")
    return bag.found


def _read(bag: _Bag) -> None:
    data = bag.data
    if not data.startswith(FIRST_LINE):
        raise ValueError("first line")
    rows = raw_records(data, len(FIRST_LINE), len(data))
    kinds = [raw.op for raw in rows]
    head = rows[0]
    if kinds[:1] != [BAG_HEADER] or kinds.count(BAG_HEADER) != 1:
        raise ValueError("no bag header, or several")
    index = next((raw.start for raw in rows if raw.op in (CONNECTION, CHUNK_INFO)), len(data))
    expected = (index, kinds.count(CONNECTION), kinds.count(CHUNK_INFO))
    if expected != tuple(bag.number(head, name) for name in (b"index_pos", b"conn_count", b"chunk_count")):
        bag.found.append("the bag header")
    if kinds.count(CHUNK) != kinds.count(CHUNK_INFO):
        bag.found.append("as many chunk infos as chunks")
    if MESSAGE in kinds or any(kind not in range(2, 8) for kind in kinds):
        bag.found.append("a record of a kind that does not belong there")
    for raw in rows:
        if raw.op == CHUNK:
            _chunk(bag, raw)
        elif raw.op == CONNECTION:
            bag.declare(raw, data)
        elif raw.op == CHUNK_INFO:
            _chunk_info(bag, raw)
    if len(bag.connections) != kinds.count(CONNECTION):
        bag.found.append("chunks describe other connections than the index")
    used = {conn for messages in bag.chunks.values() for conn, _ in messages}
    bag.found += [f"connection {conn} is described nowhere" for conn in used - bag.connections.keys()]


def _chunk(bag: _Bag, raw: Raw) -> None:
    compression = bag.data[slice(*raw.values[b"compression"])].decode()
    if compression not in ("none", "lz4", "bz2"):
        raise ValueError(f"compression {compression}")
    unpacked = unpack(bag.data[slice(*raw.body)], compression)
    if len(unpacked) != bag.number(raw, b"size"):
        bag.found.append(f"the size of the chunk at {raw.start}")
    messages = []
    for inner in raw_records(unpacked, 0, len(unpacked)):
        if inner.op == CONNECTION:
            bag.declare(inner, unpacked)
        elif inner.op == MESSAGE:
            conn = bag.number(inner, b"conn", unpacked)
            bag.number(inner, b"time", unpacked)
            messages.append((conn, time_at(unpacked, inner.values[b"time"][0])))
        else:
            bag.found.append(f"a record of kind {inner.op} in the chunk at {raw.start}")
    bag.chunks[raw.start] = messages


def _chunk_info(bag: _Bag, raw: Raw) -> None:
    place = bag.number(raw, b"chunk_pos")
    messages = bag.chunks.get(place)
    if messages is None:
        bag.found.append(f"a chunk info of byte {place}, where no chunk is")
        return
    start, stop = raw.body
    counts = dict(struct.iter_unpack("<II", bag.data[start:stop]))
    times = [time_ns for _, time_ns in messages]
    span = tuple(time_at(bag.data, raw.values[name][0]) for name in (b"start_time", b"end_time"))
    if counts != Counter(conn for conn, _ in messages) or bag.number(raw, b"count") * 8 != stop - start:
        bag.found.append(f"the counts of the chunk at {place}")
    # A span that is wider hides no message, and some writers do not compute it exactly.
    if messages and (min(times) < span[0] or max(times) > span[1]):
        bag.found.append(f"the times of the chunk at {place}")
