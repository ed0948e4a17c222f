"""Draws lines and numbers into arrays of pixels, and writes PNG files, without a graphics library."""

from __future__ import annotations

import struct
import zlib
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

#: Numbers and a few letters as lines, in a box of 4 by 6 from its lower left corner: x and y of each point.
_GLYPHS: dict[str, tuple[float, Sequence[Sequence[tuple[float, float]]]]] = {
    "0": (4, [[(2, 6), (0.6, 5.2), (0, 3), (0.6, 0.8), (2, 0), (3.4, 0.8), (4, 3), (3.4, 5.2), (2, 6)]]),
    "1": (3, [[(0.4, 4.8), (2, 6), (2, 0)]]),
    "2": (4, [[(0.1, 4.6), (0.7, 5.7), (2, 6), (3.4, 5.5), (3.8, 4.3), (3.2, 3), (0, 0), (4, 0)]]),
    "3": (
        4,
        [
            [(0.2, 5.3), (1.2, 6), (2.8, 6), (3.7, 5.2), (3.6, 4), (2.7, 3.3), (1.5, 3.2)],
            [(2.7, 3.2), (3.8, 2.4), (4, 1.4), (3.2, 0.3), (1.8, 0), (0.6, 0.3), (0, 1.1)],
        ],
    ),
    "4": (4, [[(3, 0), (3, 6), (0, 1.8), (4.2, 1.8)]]),
    "5": (4, [[(3.6, 6), (0.6, 6), (0.3, 3.2), (1.6, 3.8), (3, 3.6), (4, 2.2), (3.5, 0.6), (1.8, 0), (0, 0.8)]]),
    "6": (
        4,
        [
            [(3.2, 6), (1.4, 5), (0.3, 3.2), (0, 1.8), (0.7, 0.4), (2, 0), (3.4, 0.5), (4, 1.9), (3.3, 3.3), (2, 3.7)],
            [(2, 3.7), (0.8, 3.3), (0.1, 2.2)],
        ],
    ),
    "7": (4, [[(0, 6), (4, 6), (1.4, 0)]]),
    "8": (
        4,
        [
            [(2, 3.3), (0.6, 3.9), (0.4, 5), (1.1, 5.8), (2, 6), (2.9, 5.8), (3.6, 5), (3.4, 3.9), (2, 3.3)],
            [(2, 3.3), (0.4, 2.5), (0, 1.4), (0.8, 0.3), (2, 0), (3.2, 0.3), (4, 1.4), (3.6, 2.5), (2, 3.3)],
        ],
    ),
    "9": (
        4,
        [
            [(0.8, 0), (2.6, 1), (3.7, 2.8), (4, 4.2), (3.3, 5.6), (2, 6), (0.6, 5.5), (0, 4.1), (0.7, 2.7), (2, 2.3)],
            [(2, 2.3), (3.2, 2.7), (3.9, 3.8)],
        ],
    ),
    ".": (1, [[(0.5, 0), (0.5, 0.2)]]),
    " ": (1.5, []),
    "k": (3.4, [[(0, 0), (0, 6)], [(0, 1.6), (3, 4)], [(1.2, 2.5), (3.3, 0)]]),
    "m": (
        6,
        [
            [(0, 0), (0, 4)],
            [(0, 3), (0.9, 3.9), (2, 3.9), (2.9, 3), (2.9, 0)],
            [(2.9, 3), (3.8, 3.9), (4.9, 3.9), (5.8, 3), (5.8, 0)],
        ],
    ),
    "x": (3.4, [[(0, 0), (3.4, 4)], [(0, 4), (3.4, 0)]]),
    "y": (3.6, [[(0, 4), (1.9, 0.4)], [(3.6, 4), (1.2, -1.6), (0.3, -1.8)]]),
}
_GAP = 1.6


def text_width(text: str, size: float) -> float:
    """Return the width of a text in pixels; ``size`` is the height of its numbers."""
    return (sum(_GLYPHS[letter][0] for letter in text) + _GAP * (len(text) - 1)) * size / 6


def strokes(text: str, x: float, y: float, size: float) -> list[NDArray[np.float64]]:
    """Return the lines of a text, each (N, 2), pixels: from ``x`` to the right, on the line ``y`` (downwards).

    The text may have numbers, spaces, a point, and the letters k, m, x and y.
    """
    lines = []
    for letter in text:
        width, parts = _GLYPHS[letter]
        lines += [np.array(part) * (size / 6, -size / 6) + (x, y) for part in parts]
        x += (width + _GAP) * size / 6
    return lines


def coverage(shape: tuple[int, int], lines: Iterable[NDArray[np.float64]], width: float) -> NDArray[np.float32]:
    """Return how much of each pixel lines cover, (H, W), 0 to 1.

    Parameters
    ----------
    shape
        H and W.
    lines
        Each (N, 2): x (to the right) and y (downwards), pixels; pixel 0 is from 0 to 1. One point is a dot.
    width
        The width of the lines in pixels; their ends are round.
    """
    covered = np.zeros(shape, np.float32)
    for line in lines:
        points = line if len(line) > 1 else np.repeat(line, 2, axis=0)
        for begin, end in pairwise(points):
            _add_segment(covered, begin, end, width / 2)
    return covered


def _add_segment(
    covered: NDArray[np.float32], begin: NDArray[np.float64], end: NDArray[np.float64], radius: float
) -> None:
    height, width = covered.shape
    reach = radius + 1
    low = np.clip(np.floor(np.minimum(begin, end) - reach), 0, (width, height)).astype(int)
    high = np.clip(np.ceil(np.maximum(begin, end) + reach), 0, (width, height)).astype(int)
    if (low >= high).any():
        return
    x = np.arange(low[0], high[0])[np.newaxis, :] + 0.5 - begin[0]
    y = np.arange(low[1], high[1])[:, np.newaxis] + 0.5 - begin[1]
    along = end - begin
    square = float(along @ along)
    nearest = np.clip((x * along[0] + y * along[1]) / square, 0, 1) if square else np.zeros_like(x + y)
    distance = np.hypot(x - nearest * along[0], y - nearest * along[1])
    window = covered[low[1] : high[1], low[0] : high[0]]
    np.maximum(window, np.clip(radius + 0.5 - distance, 0, 1), out=window)


def disc(shape: tuple[int, int], x: float, y: float, radius: float) -> NDArray[np.float32]:
    """Return how much of each pixel a disc covers."""
    return coverage(shape, [np.array([[x, y]])], 2 * radius)


def blend(picture: NDArray[np.uint8], covered: NDArray[np.float32], colour: str, opacity: float = 1.0) -> None:
    """Paint a colour, ``#rrggbb``, over a picture (H, W, 3), in proportion to how much of each pixel is covered."""
    rows, columns = np.nonzero(covered)
    share = (covered[rows, columns] * opacity)[:, np.newaxis]
    below = picture[rows, columns].astype(np.float64)
    above: NDArray[Any] = np.frombuffer(bytes.fromhex(colour.removeprefix("#")), np.uint8)
    picture[rows, columns] = np.rint(below + share * (above - below))


def png(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture (H, W, 3) as a PNG file."""
    height, width, _ = picture.shape
    # Each row begins with the number of its filter; 0 means none.
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    rows[:, 1:] = picture.reshape(height, 3 * width)
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows.tobytes(), 9)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
