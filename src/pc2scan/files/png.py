"""Pictures as PNG files.

Source of the format: the W3C recommendation "Portable Network Graphics (PNG) Specification".
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.model import Buffer


def png_of(rows: Sequence[Buffer], colours: bytes) -> bytes:
    """Return a picture as a PNG file.

    Parameters
    ----------
    rows
        Its rows from the top, each a byte a pixel: the number of its colour.
    colours
        Red, green and blue of each colour.
    """
    # Each row begins with the number of its filter: 0, none.
    pixels = b"".join(b"\0" + bytes(row) for row in rows)
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", len(rows[0]), len(rows), 8, 3, 0, 0, 0)),
        (b"PLTE", colours),
        (b"IDAT", zlib.compress(pixels, 9)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
