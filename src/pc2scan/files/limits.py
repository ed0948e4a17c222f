"""Limits of sizes and counts that untrusted recordings declare. They bound the memory that a recording can take."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pc2scan.model import Connection

#: Size to which any chunk or message may be decompressed, even if it is stored in few bytes.
MAX_UNPACKED = 32 << 20

#: Limit of the ratio for a file that is compressed as a whole. zstd compresses zeros 30,000 times.
MAX_FILE_RATIO = 1000

#: Cells of a map: 410 m by 410 m at 5 cm. Two bytes each while scans are drawn.
MAX_MAP_CELLS = 64 << 20

#: Connections of a recording: as many as MCAP has numbers for. One takes up to 3 kB of memory in a conversion.
MAX_CONNECTIONS = 65_536


def allowed_bytes(stored: int) -> int:
    """Return the allowed size of decompressed data, given the size of the file (or message) that holds them."""
    return MAX_UNPACKED + 2 * stored


class ConnectionLimit:
    """Counts the connections of a recording and their descriptions as they are found, and refuses too many.

    Everything that collects connections asks it: readers with or without an index, and readers of several files or
    parts.

    Parameters
    ----------
    path
        The recording.
    size
        Its bytes.
    """

    def __init__(self, path: Path, size: int = 0) -> None:
        self._path = path
        self._size = size
        self._count = self._bytes = 0
        self._topics: set[str] = set()

    def add(self, described: int = 0, *, count: int = 1, most: int | None = None) -> None:
        """Count connections that take so many bytes to describe, with their definitions.

        Raises
        ------
        RecordingError
            If there are more than ``most`` (`MAX_CONNECTIONS`), or their descriptions are larger than `allowed_bytes`.
        """
        self._count += count
        self._bytes += described
        most = MAX_CONNECTIONS if most is None else most
        if self._count > most:
            raise self._too_many(most)
        if self._bytes > (allowed := allowed_bytes(self._size)):
            raise RecordingError(
                f"describes its connections in more than {allowed:,} bytes, the largest size for a recording of "
                f"{self._size:,} bytes",
                path=self._path,
            )

    def add_file(self, connections: Sequence[Connection], size: int) -> None:
        """Count the connections of a file or a part of ``size`` bytes.

        Those that several files share count in each, because each reader keeps its own; so files of any size may repeat
        them, a kilobyte for each. Definitions that connections share count once. Topics that differ between files
        count as in one file, before all files are open.

        Raises
        ------
        RecordingError
            If there are more, or their descriptions are larger than `allowed_bytes`.
        """
        self._size += size
        definitions = {id(own.definition.data): own.definition.data for own in connections}
        described = sum(map(len, definitions.values())) + sum(len(own.qos) for own in connections)
        self.add(described, count=len(connections), most=MAX_CONNECTIONS + self._size // 1000)
        self._topics.update(own.topic for own in connections)
        if len(self._topics) > MAX_CONNECTIONS:
            raise self._too_many(MAX_CONNECTIONS)

    def _too_many(self, most: int) -> RecordingError:
        return RecordingError(
            f"has more than {most:,} connections (one for each publisher of a topic), the largest number that is read",
            path=self._path,
        )
