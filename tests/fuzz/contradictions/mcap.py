"""What contradicts itself in an MCAP file, by its specification: nothing of pc2scan is used.

Of message indexes only the number of entries counts, and indexes of attachments and metadata do not: they only repeat
what the records have.
"""

from __future__ import annotations

import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import zstandard

from fuzz.mutants.mcap import MAGIC, RECORD, records, unpack

__all__ = ["Facts", "facts_of"]

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)


class _Cursor:
    """The values of one record, one after the other."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.position = 0

    def take(self, size: int) -> bytes:
        found = self.data[self.position : self.position + size]
        if len(found) < size:
            raise ValueError("a record is too short for its values")
        self.position += size
        return found

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def numbers(self, *sizes: int) -> tuple[int, ...]:
        return tuple(self.number(size) for size in sizes)

    def block(self, size: int = 4) -> bytes:
        return self.take(self.number(size))

    def text(self) -> str:
        return self.block().decode()

    def entries(self, *sizes: int) -> list[tuple[int, ...]]:
        inner = _Cursor(self.block())
        found = []
        while inner.position < len(inner.data):
            found.append(inner.numbers(*sizes))
        return found


@dataclass(slots=True)
class Facts:
    """What a storage file says: of its messages, for metadata.yaml to be compared with, and what contradicts."""

    topics: dict[str, set[tuple[str, str]]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    times: list[int] = field(default_factory=list)
    contradictions: list[str] = field(default_factory=list)


@dataclass(slots=True)
class _File:
    """What was met so far."""

    data: bytes
    facts: Facts = field(default_factory=Facts)
    schemas: dict[int, bytes] = field(default_factory=dict)
    channels: dict[int, bytes] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    kinds: Counter[int] = field(default_factory=Counter)
    chunks: dict[int, tuple[Any, ...]] = field(default_factory=dict)
    indexed: Counter[int] = field(default_factory=Counter)
    #: Whether every chunk with messages has an index of each channel.
    all_indexed: bool = True

    def declare(self, opcode: int, content: bytes) -> None:
        number = int.from_bytes(content[:2], "little")
        known = self.schemas if opcode == SCHEMA else self.channels
        if known.setdefault(number, content) != content:
            self.facts.contradictions.append(
                f"two definitions of {'schema' if opcode == SCHEMA else 'channel'} {number}"
            )

    def message(self, content: bytes) -> tuple[int, int]:
        channel, _, log_time, _ = _Cursor(content).numbers(2, 4, 8, 8)
        if channel not in self.channels:
            self.facts.contradictions.append(f"a message of channel {channel}, which is not declared")
        self.counts[channel] += 1
        self.facts.times.append(log_time)
        return channel, log_time


def facts_of(data: bytes) -> Facts:
    """Read a file; its contradictions are listed."""
    file = _File(data)
    try:
        _read(file)
    except (ValueError, RuntimeError, KeyError, zstandard.ZstdError) as err:
        file.facts.contradictions.append(f"{type(err).__name__}: {err}")
    _name(file)
    return file.facts


def _name(file: _File) -> None:
    for number, content in file.channels.items():
        try:
            cursor = _Cursor(content)
            _, schema_id = cursor.numbers(2, 2)
            topic, encoding = cursor.text(), cursor.text()
            schema = _Cursor(file.schemas.get(schema_id, bytes(6)))
            schema.number(2)
            msgtype = schema.text()
        except ValueError:
            file.facts.contradictions.append(f"channel {number} or its schema does not fit its lengths")
            continue
        if schema_id and schema_id not in file.schemas:
            file.facts.contradictions.append(f"channel {number} has schema {schema_id}, which is not declared")
        file.facts.topics.setdefault(topic, set()).add((msgtype, encoding))
        file.facts.counts[topic] += file.counts[number]


def _read(file: _File) -> None:
    data, told = file.data, file.facts.contradictions
    if not data.startswith(MAGIC) or not data.endswith(MAGIC):
        told.append("magic")
    rows = records(data, len(MAGIC), len(data) - len(MAGIC))
    opcodes = [opcode for opcode, _, _ in rows]
    if opcodes[:1] != [HEADER] or opcodes[-1:] != [FOOTER] or opcodes.count(DATA_END) != 1 or opcodes.count(HEADER) > 1:
        told.append("the order of records")
    split = opcodes.index(DATA_END)
    found: set[int] | None = None
    last: tuple[int, set[int]] | None = None
    for opcode, start, stop in rows[: split + 1]:
        content = data[start + RECORD.size : stop]
        if opcode != MESSAGE_INDEX and last is not None:
            _close(file, *last, found or set())
            last = found = None
        file.kinds[opcode] += 1
        cursor = _Cursor(content)
        if opcode in (SCHEMA, CHANNEL):
            file.declare(opcode, content)
        elif opcode == MESSAGE:
            file.message(content)
        elif opcode == CHUNK:
            last = start, _chunk(file, start, stop, cursor)
            found = set()
        elif opcode == MESSAGE_INDEX:
            if found is None:
                raise ValueError("a message index without a chunk")
            channel = cursor.number(2)
            entries = cursor.entries(8, 8)
            file.indexed[channel] += len(entries)
            if entries:
                found.add(channel)
        elif opcode == ATTACHMENT:
            _attachment(file, cursor)
        elif opcode == 0:
            told.append("opcode 0")
        elif opcode == DATA_END:
            crc = cursor.number(4)
            if crc and crc != zlib.crc32(data[:start]):
                told.append("the data section's CRC")
    _summary(file, rows, split)


def _chunk(file: _File, start: int, stop: int, cursor: _Cursor) -> set[int]:
    """Check a chunk; returns the channels of its messages."""
    told = file.facts.contradictions
    start_time, end_time, size, crc = cursor.numbers(8, 8, 8, 4)
    compression, stored = cursor.text(), cursor.block(8)
    if compression not in ("", "lz4", "zstd"):
        told.append(f"compression {compression}")
    unpacked = unpack(stored, compression)
    if len(unpacked) != size:
        told.append(f"the chunk at {start} has {len(unpacked)} bytes, {size} declared")
    if crc and zlib.crc32(unpacked) != crc:
        told.append(f"the CRC of the chunk at {start}")
    channels = set()
    times = []
    for opcode, begin, end in records(unpacked, 0, len(unpacked)):
        content = unpacked[begin + RECORD.size : end]
        if opcode in (SCHEMA, CHANNEL):
            file.declare(opcode, content)
        elif opcode == MESSAGE:
            channel, log_time = file.message(content)
            channels.add(channel)
            times.append(log_time)
        elif opcode < 0x80:
            told.append(f"a record of kind {opcode} in the chunk at {start}")
    # A span that is wider hides no message, and some writers do not compute it exactly.
    if min(times, default=0) < start_time or max(times, default=0) > end_time or not (times or end_time == 0):
        told.append(f"the times of the chunk at {start}")
    file.chunks[start] = (start_time, end_time, stop - start, compression, len(stored), size)
    return channels


def _close(file: _File, chunk: int, channels: set[int], indexed: set[int]) -> None:
    """Note whether all channels of a chunk were indexed, or none."""
    missing = channels - indexed
    if missing and indexed:
        file.facts.contradictions.append(f"channels {missing} of the chunk at {chunk} have no message index")
    file.all_indexed = file.all_indexed and not missing
    file.chunks[chunk] += (indexed,)


def _attachment(file: _File, cursor: _Cursor) -> None:
    cursor.numbers(8, 8)
    name, _, _ = cursor.text(), cursor.text(), cursor.block(8)
    covered = cursor.data[: cursor.position]
    crc = cursor.number(4)
    if crc and crc != zlib.crc32(covered):
        file.facts.contradictions.append(f"the CRC of attachment {name}")


def _summary(file: _File, rows: list[tuple[int, int, int]], split: int) -> None:
    data, told = file.data, file.facts.contradictions
    summary = rows[split + 1 : -1]
    footer = rows[-1]
    cursor = _Cursor(data[footer[1] + RECORD.size : footer[2]])
    begin, offsets_begin, crc = cursor.numbers(8, 8, 4)
    expected = summary[0][1] if summary else 0
    if begin != expected and not (begin == footer[1] and not summary):
        told.append(f"the footer places the summary at {begin}, it is at {expected}")
    if crc and begin and crc != zlib.crc32(data[begin : footer[2] - 4]):
        told.append("the summary's CRC")
    chunks, listed = {}, Counter(opcode for opcode, _, _ in summary)
    groups: dict[int, list[int]] = {}
    for opcode, start, stop in summary:
        cursor = _Cursor(data[start + RECORD.size : stop])
        groups.setdefault(opcode, [start, stop])[1] = stop
        if opcode in (SCHEMA, CHANNEL):
            file.declare(opcode, cursor.data)
        elif opcode == STATISTICS:
            _statistics(file, cursor)
        elif opcode == CHUNK_INDEX:
            first, last, place, length = cursor.numbers(8, 8, 8, 8)
            ids = {channel for channel, _ in cursor.entries(2, 8)}
            cursor.number(8)
            compression, *sizes = cursor.text(), *cursor.numbers(8, 8)
            chunks[place] = (first, last, length, compression, *sizes, ids)
        elif opcode == SUMMARY_OFFSET:
            group, *extent = cursor.numbers(1, 8, 8)
            found = groups.get(group)
            # A group without records may be placed anywhere.
            if extent != ([found[0], found[1] - found[0]] if found else [extent[0], 0]):
                told.append(f"the summary offset of group {group}")
    if listed[CHUNK_INDEX] and chunks != file.chunks:
        told.append("the chunk indexes")
    if listed[CHUNK_INDEX] != len(chunks):
        told.append("a chunk has two indexes")
    if not listed[STATISTICS] and file.chunks and file.all_indexed and +file.indexed != file.counts:
        told.append("the message indexes' counts")
    if offsets_begin and (SUMMARY_OFFSET not in groups or groups[SUMMARY_OFFSET][0] != offsets_begin):
        told.append("the footer's place of the summary offsets")


def _statistics(file: _File, cursor: _Cursor) -> None:
    # Schemas and channels: writers differ in whether those without messages count.
    messages, _, _, attachments, metadata, chunks, first, last = cursor.numbers(8, 2, 4, 4, 4, 4, 8, 8)
    counts = {channel: count for channel, count in cursor.entries(2, 8) if count}
    times = file.facts.times
    kinds = (file.kinds[ATTACHMENT], file.kinds[METADATA], file.kinds[CHUNK])
    if messages != file.counts.total() or (attachments, metadata, chunks) != kinds:
        file.facts.contradictions.append("the statistics' counts")
    if (first, last) != (min(times, default=0), max(times, default=0)):
        file.facts.contradictions.append("the statistics' times")
    if counts and counts != +file.counts:
        file.facts.contradictions.append("the statistics' counts by channel")
