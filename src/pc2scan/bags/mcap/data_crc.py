"""Compares the CRC of an MCAP file's data section, combined from the CRCs of the segments as they are read.

It is compared in files without chunks, which have no other CRC for messages, when all messages were read.
"""

from __future__ import annotations

from operator import attrgetter
from threading import Lock
from typing import TYPE_CHECKING

from pc2scan.files.crc32 import crc32, crc32_combined

from .chunks import ChunkSegment

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.bags.damage import DamageLog
    from pc2scan.model import Buffer

    from .index import McapIndex
    from .records import RecordFile

#: Bytes between messages are read in pieces of this size.
_PIECE = 4 << 20


class DataCrc:
    """Compares the CRC of a data section when all of its messages were read.

    Parameters
    ----------
    file
        The file.
    segments
        All segments with messages.
    stop
        The end of the data section.
    recorded
        Its recorded CRC.
    log
        Gets a difference.
    counted
        Whether statistics tell if messages are missing.
    """

    def __init__(
        self,
        file: RecordFile,
        segments: Sequence[Segment],
        stop: int,
        recorded: int,
        log: DamageLog,
        *,
        counted: bool,
    ) -> None:
        self._file = file
        self._segments = sorted(segments, key=attrgetter("offset"))
        self._stop = stop
        self._recorded = recorded
        self._log = log
        self._counted = counted
        self._found: dict[int, int] = {}
        self._lock = Lock()

    def add(self, segment: Segment, data: Buffer) -> None:
        """Add a segment that was read; may be called on any thread, and again."""
        self._found[segment.offset] = crc32(data)

    def compare(self) -> None:
        """Compare the CRC when all segments were read.

        Raises
        ------
        DamageError
            If it differs, and damage is an error.
        """
        with self._lock:
            if len(self._found) < len(self._segments):
                return
            found, self._found = self._found, {}
        value = position = 0
        for segment in self._segments:
            value = self._between(value, position, segment.offset)
            value = crc32_combined(value, found[segment.offset], segment.length)
            position = segment.offset + segment.length
        value = self._between(value, position, self._stop)
        if value != self._recorded:
            error = f"the data section has CRC {value:08x}, recorded is {self._recorded:08x}"
            self._log.note(self._file.damage(error), key="data", messages_lost=0 if self._counted else None)

    def _between(self, value: int, start: int, stop: int) -> int:
        for position in range(start, stop, _PIECE):
            value = crc32(self._file.read(position, min(_PIECE, stop - position)), value)
        return value


def data_crc(file: RecordFile, index: McapIndex, log: DamageLog) -> DataCrc | None:
    """Return the comparison for a file; None if it has no CRC, or its chunks have their own."""
    if index.data_end is None or not index.segments:
        return None
    stop, recorded = index.data_end
    if not recorded or any(isinstance(segment, ChunkSegment) for segment in index.segments):
        return None
    return DataCrc(file, index.segments, stop, recorded, log, counted=index.statistics is not None)
