"""Limits of sizes and counts that untrusted recordings declare. They bound the memory that a recording can take."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import RecordingError

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["MAX_CONNECTIONS", "MAX_FILE_RATIO", "MAX_MAP_CELLS", "MAX_UNPACKED", "allowed_bytes", "refuse_connections"]

#: Size to which any chunk or message may be decompressed, even if it is stored in few bytes.
MAX_UNPACKED = 32 << 20

#: Limit of the ratio for a file that is compressed as a whole. zstd compresses zeros 30,000 times.
MAX_FILE_RATIO = 1000

#: Cells of a map: 410 m by 410 m at 5 cm. Two bytes each while scans are drawn.
MAX_MAP_CELLS = 64 << 20

#: Connections of a recording, of all its files and parts together. MCAP's ids allow 65,535.
MAX_CONNECTIONS = 100_000


def allowed_bytes(stored: int) -> int:
    """Return the allowed size of decompressed data, given the size of the file (or message) that holds them."""
    return MAX_UNPACKED + 2 * stored


def refuse_connections(count: int, path: Path) -> None:
    """Raise if a recording has more connections than are allowed.

    Whatever collects connections calls it as they come: with or without an index, in a chunk, a database or
    metadata.yaml, and for all files of a recording together.

    Raises
    ------
    RecordingError
        If there are more than `MAX_CONNECTIONS`.
    """
    if count > MAX_CONNECTIONS:
        raise RecordingError(
            f"has more than {MAX_CONNECTIONS:,} connections (a topic has one for each publisher), no more can be read",
            path=path,
        )
