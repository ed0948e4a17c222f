"""Limits of sizes and counts that untrusted recordings declare. They bound the memory that a recording can take."""

from __future__ import annotations

__all__ = ["MAX_CONNECTIONS", "MAX_FILE_RATIO", "MAX_MAP_CELLS", "MAX_UNPACKED", "allowed_bytes"]

#: Size to which any chunk or message may be decompressed, even if it is stored in few bytes.
MAX_UNPACKED = 32 << 20

#: Limit of the ratio for a file that is compressed as a whole. zstd compresses zeros 30,000 times.
MAX_FILE_RATIO = 1000

#: Cells of a map: 410 m by 410 m at 5 cm. Two bytes each while scans are drawn.
MAX_MAP_CELLS = 64 << 20

#: Connections of a recording. MCAP's ids allow 65,535.
MAX_CONNECTIONS = 100_000


def allowed_bytes(stored: int) -> int:
    """Return the allowed size of decompressed data, given the size of the file (or message) that holds them."""
    return MAX_UNPACKED + 2 * stored
