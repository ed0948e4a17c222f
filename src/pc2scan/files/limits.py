"""What is believed of a recording's declarations: beyond it, a file asks for memory and not for what is in it."""

from __future__ import annotations

__all__ = ["MAX_CONNECTIONS", "MAX_FILE_RATIO", "MAX_UNPACKED", "allowed_bytes"]

#: Any chunk or message may unpack to this many bytes, however few it is stored in.
MAX_UNPACKED = 32 << 20

#: A file that is compressed as a whole may unpack to so many times its size; zeros shrink to a thirty-thousandth.
MAX_FILE_RATIO = 1000

#: Connections of a recording. MCAP has numbers for 65,535.
MAX_CONNECTIONS = 100_000


def allowed_bytes(stored: int) -> int:
    """How many bytes may come out of something compressed, given how many the file (or the message) is stored in."""
    return MAX_UNPACKED + 2 * stored
