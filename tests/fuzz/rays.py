"""Any rays into a grid, by the compiled loop and by NumPy's: the same cells from both."""

from __future__ import annotations

import struct

import numpy as np

from pc2scan.core import kernel, plain

__all__ = ["draw_rays", "written"]

#: Width, height, and the number of scans that the rays are shared among.
_HEAD = struct.Struct("<3B")
#: Both ends of a ray, as they are: outside of the grid too; and whether it hit something.
_RAY = np.dtype([("ends", "<i4", 4), ("hit", "u1")])


def written(width: int, height: int, scans: int, rays: list[tuple[tuple[int, int, int, int], int]]) -> bytes:
    """Write an input."""
    return _HEAD.pack(width, height, scans) + np.array(rays, _RAY).tobytes()


def draw_rays(data: bytes) -> None:
    """Draw with both loops and compare: the cells, or that the rays are refused."""
    width, height, scans = _HEAD.unpack(data[: _HEAD.size].ljust(_HEAD.size, b"\0"))
    body = data[_HEAD.size :]
    rays = np.frombuffer(body[: len(body) // _RAY.itemsize * _RAY.itemsize], _RAY)
    parts = np.array_split(rays, scans % 8 + 1)
    found = []
    for trace in (kernel.trace, plain.trace):
        cells = np.full((height + 1, width + 1), plain.UNKNOWN * 256, np.int16)
        refused = 0
        for mark, part in enumerate(parts):
            ends, hits = np.array(part["ends"], np.int32, order="C"), part["hit"] % 2 == 1
            try:
                trace(cells, width + 1, mark, ends, hits)
            except ValueError:
                refused += 1
        found.append((refused, cells))
    assert found[0][0] == found[1][0]
    np.testing.assert_array_equal(found[0][1], found[1][1])
