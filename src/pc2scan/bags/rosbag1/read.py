"""Reads ROS 1 bags, one chunk at a time.

Messages are found by walking through a chunk. The INDEX DATA records after it are only used to correct the times of
chunks and to count: they have no further information, and some recorders write wrong lengths.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.bags.chunks import ChunkedReader
from pc2scan.bags.damage import DamageLog
from pc2scan.bags.reader import MAX_CHUNK_MESSAGES, check_number
from pc2scan.errors import stamp_text
from pc2scan.model import RawMessage, StoredChunk, Summary
from pc2scan.text import counted

from .records import (
    CONNECTION,
    LAYOUTS,
    MESSAGE,
    SECOND_NS,
    USUAL_LAYOUT,
    BagFile,
    FormatError,
    indexed_entries,
    number_field,
    parse_connection,
    part_of,
    read_chunk,
    read_index,
    read_record,
    time_field,
)
from .recover import payload_prefix, record_at, recover_index, times_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from pc2scan.bags.chunks import Numbers, Segment, Segments, Selection
    from pc2scan.errors import DamageError
    from pc2scan.model import Buffer


class Rosbag1Reader(ChunkedReader):
    """Reads an open ROS 1 bag.

    Opening reads the index and the headers of the chunks. Chunks are read and decompressed one at a time,
    when their first message is due, and their messages are views into them.

    Parameters
    ----------
    path
        A bag of format 2.0.
    strict
        Whether damage is an error; otherwise it is in `damage`, and the rest is recovered. Without a usable index,
        opening a bag reads the chunks whose own index records are not usable either.

    Raises
    ------
    RecordingError
        If it cannot be opened, is of format 1.x or encrypted.
    DamageError
        With ``strict``, if it has no index or contradicts itself; while messages are read, if a chunk does.
    """

    _file: BagFile
    _container = "rosbag1"
    _record_at = staticmethod(record_at)

    def __init__(self, path: Path, *, strict: bool = False) -> None:
        self.path = path
        self._log = DamageLog(strict=strict)
        self._file = BagFile(path)
        #: The latest description of each connection in a chunk, and whether the index has the same: some recorders
        #: repeat connections in every chunk.
        self._described: dict[int, tuple[bytes | None, bytes, bool]] = {}
        try:
            try:
                self._known, self._segments = read_index(self._file, self._log)
            except FormatError as err:
                problem = self._file.damage_error(f"its index cannot be read: {err}")
                self._known, self._segments = recover_index(self._file, problem, self._log)
            self._mend_times(lambda segment: [time for own in times_in(self._file, segment).values() for time in own])
        except BaseException:
            self.close()
            raise
        #: In the order of the index; those that only chunks describe come last.
        self.connections = tuple(self._known.values())
        rows = self._segments.rows[self._segments.rows["end_ns"] > 0]
        counts = [connection.message_count for connection in self.connections]
        self.summary = Summary(
            container="rosbag1",
            storage="",
            compression=tuple(sorted({compression for compression, _ in self._segments.kinds})),
            size_bytes=self._file.size,
            message_count=None if None in counts else sum(filter(None, counts)),
            start_ns=int(rows["start_ns"].min()) if len(rows) else None,
            end_ns=int(rows["end_ns"].max()) if len(rows) else None,
        )

    def _needed(self, segments: Segments, due: Numbers, start_ns: int | None) -> dict[int, frozenset[int]]:
        return first_uses(segments, due, start_ns)

    def _read(self, selection: Selection, segment: Segment, *, whole: bool) -> StoredChunk | list[RawMessage]:
        """Return the wanted messages of a chunk, or the chunk as a whole, decompressed to be checked."""
        try:
            if not (whole and selection.rule):
                return self._scan(selection, segment, read_chunk(self._file, segment)[1], {})
            stored, records = read_chunk(self._file, segment)
            described: dict[int, bool] = {}
            places: list[int] = []
            messages = self._scan(selection, segment, records, described, places)
        except FormatError as err:
            problem = f"the chunk with data at byte {segment.offset} cannot be read: {err}"
            raise self._file.damage_error(problem) from err
        index: dict[int, list[tuple[int, int]]] = {}
        for message, place in zip(messages, places, strict=False):
            index.setdefault(message.connection.id, []).append((message.log_time_ns, place))
        rule, needed = selection.rule, selection.needed.get(segment.offset, frozenset())
        is_described = all(described.values()) and needed <= described.keys()
        is_allowed = described.keys() | index.keys() <= rule.connection_ids
        if not messages or len(messages) < len(places) or not is_described or not is_allowed:
            return messages
        # LZ4 frames that ROS 1's own reader refuses are compressed again.
        if segment.compression not in rule.compressions or (
            segment.compression == "lz4" and not is_readable_lz4(stored)
        ):
            return StoredChunk("", records, len(records), 0, index)
        return StoredChunk(segment.compression, stored, len(records), 0, index)

    def _scan(
        self,
        selection: Selection,
        segment: Segment,
        records: memoryview,
        described: dict[int, bool],
        places: list[int] | None = None,
    ) -> list[RawMessage]:
        """Find the wanted messages of a chunk; ``described`` and ``places`` are filled for chunks to be copied."""
        describe = partial(self._compare_connection, segment, described)
        span = (segment.start_ns, segment.end_ns)
        messages, others, count = scan_messages(records, selection, span, describe, places)
        if unknown := others - self._known.keys():
            raise FormatError(f"it has a message of connection {min(unknown)}, which is not in the index")
        declared = segment.message_count
        if declared is not None and count < declared:
            raise FormatError(f"it has {counted(count, 'message')}, the index counts {declared}")
        if declared is not None and count > declared:
            chunk = f"the chunk with data at byte {segment.offset}"
            what = f"{chunk} has {counted(count, 'message')}, its index counts {declared}"
            self._log.note_index(self._file, segment.offset, what)
        return messages

    def _compare_connection(
        self, segment: Segment, described: dict[int, bool], fields: Mapping[bytes, bytes], body: Buffer
    ) -> None:
        """Compare a chunk's description of a connection with the index, and note a difference.

        Parameters
        ----------
        described
            Gets whether the two are the same in everything, by the connection's id.

        Raises
        ------
        FormatError
            If the record does not describe a connection.
        """
        identity = number_field(fields, "conn")
        topic, header = fields.get(b"topic"), bytes(body)
        compared = self._described.get(identity)
        if compared is not None and compared[:2] == (topic, header):
            described[identity] = compared[2]
            return
        copy, known = parse_connection(fields, body), self._known.get(identity)
        described[identity] = known is not None and known == replace(copy, message_count=known.message_count)
        if known is None:
            return
        self._described[identity] = topic, header, described[identity]
        if not described[identity]:
            what = f"connection {identity} is {known.topic!r:.80} ({known.msgtype:.80}), and otherwise in a chunk"
            self._log.note_index(self._file, segment.offset, what)

    def _prefix(self, segment: Segment, problem: DamageError) -> tuple[Segment, memoryview, DamageError]:
        return segment, payload_prefix(self._file, segment), problem

    def _entries(self, segment: Segment) -> Iterator[tuple[int, list[tuple[int, int]]]]:
        return indexed_entries(self._file, segment)


def first_uses(segments: Segments, due: Numbers, start_ns: int | None) -> dict[int, frozenset[int]]:
    """Find the connections that a chunk has to describe, because no earlier chunk does, by the chunk's offset.

    ROS 1's ``rosbag reindex`` needs a connection's description in the chunk of its first message.

    Parameters
    ----------
    segments
        All segments to read.
    due
        When each of them is; see `whole_chunks`.
    start_ns
        The start of the cut: a chunk across it may be written without its first messages.
    """
    uses = {}
    seen: frozenset[int] = frozenset()
    for place in np.argsort(due, kind="stable").data:
        segment = segments[place]
        if first := (segment.connection_ids or frozenset()) - seen:
            uses[segment.offset] = first
            if start_ns is None or start_ns <= segment.start_ns:
                seen |= first
    return uses


def scan_messages(
    data: memoryview,
    selection: Selection,
    span: tuple[int, int],
    describe: Callable[[Mapping[bytes, bytes], Buffer], object],
    places: list[int] | None = None,
) -> tuple[list[RawMessage], set[int], int]:
    """Find the wanted messages among the records of a chunk; their data are views of these.

    Parameters
    ----------
    data
        The decompressed records.
    selection
        What is wanted.
    span
        The first and the last log time in the index.
    describe
        Called with the fields and the body of each connection that the chunk describes.
    places
        Gets the offset of every message, if given.

    Returns
    -------
    messages
        The wanted ones, in the order of the chunk.
    others
        The connections of others.
    count
        How many messages it has, of all connections and times.

    Raises
    ------
    FormatError
        If a record does not fit, or is not a message or connection, or if a wanted message is outside of ``span``.
    """
    wanted, (first, last) = selection.wanted, span
    # One comparison for cut and span; only if it fails, the two are distinguished.
    low, high = max(selection.start_ns, first), min(selection.stop_ns, last + 1)
    messages: list[RawMessage] = []
    others: set[int] = set()
    # The class's constructor takes twice as long, which matters for small messages.
    new: Callable[[type[RawMessage], tuple[object, ...]], RawMessage] = tuple.__new__
    append = messages.append
    layout, front, middle, last_part, middle_at, conn_at, time_at = current = USUAL_LAYOUT
    prefix, end = layout.size, len(data)
    position = count = 0
    while position < end:
        pause = min(end, position + MAX_CHUNK_MESSAGES * prefix)
        while position < pause:
            origin = position
            values = layout.unpack_from(data, position) if position + prefix <= end else None
            if values and values[0] == front and values[middle_at] == middle and values[5] == last_part:
                identity = values[conn_at]
                stamp = values[time_at] * SECOND_NS + values[time_at + 1]
                start = position + prefix
                position = start + values[6]
                if position > end:
                    raise FormatError(f"a message reaches to byte {position} of a chunk of {end} bytes")
            else:
                kind, fields, start, following = read_record(partial(part_of, data), position, end)
                # Writers use one order of fields: use it from now on, and read this record again.
                other = LAYOUTS.get(tuple(fields), current)
                if other is not current and kind == MESSAGE:
                    layout, front, middle, last_part, middle_at, conn_at, time_at = current = other
                    continue
                position = following
                if position > end:
                    raise FormatError(f"a record reaches to byte {position} of a chunk of {end} bytes")
                if kind == CONNECTION:
                    describe(fields, data[start:position])
                    continue
                if kind != MESSAGE:
                    raise FormatError(f"a record with op {kind} is in it, not a message or connection")
                identity = number_field(fields, "conn")
                stamp = time_field(fields, "time")
            count += 1
            if places is not None:
                places.append(origin)
            connection = wanted.get(identity)
            if connection is None:
                others.add(identity)
            elif low <= stamp < high:
                append(new(RawMessage, (connection, stamp, data[start:position], stamp, 0)))
            elif not first <= stamp <= last:
                raise FormatError(
                    f"it has a message of log time {stamp_text(stamp)}, "
                    f"and declares {stamp_text(first)} to {stamp_text(last)}"
                )
        check_number(messages)
    return messages, others, count


def is_readable_lz4(data: Buffer) -> bool:
    """Whether ROS 1's own reader accepts this LZ4 frame: with independent blocks, a checksum, and no content size.

    Source: ``roslz4/src/lz4s.c`` in ros_comm, and https://github.com/lz4/lz4/blob/dev/doc/lz4_Frame_format.md.
    """
    # The largest block has 64 KiB, 256 KiB, 1 MiB or 4 MiB.
    return len(data) > 5 and data[4] == 0b0110_0100 and data[5] in (0x40, 0x50, 0x60, 0x70)
