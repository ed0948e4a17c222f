"""Any header over any points, through the compiled loops and through NumPy's: the same scan from both.

At rest, and while the sensor moves: then the fourth field has the times of the points.

With sanitizers, by hand: build with ``CFLAGS="-fsanitize=address,undefined" pip install -e .``, then run pytest on
``tests/fuzz`` and ``tests/core`` with ``LD_PRELOAD=$(gcc -print-file-name=libasan.so)`` and
``ASAN_OPTIONS=detect_leaks=0``.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan import ProjectionParams
from pc2scan.core import kernel, plain
from pc2scan.core.presets import PRESETS
from pc2scan.core.project import Projector
from pc2scan.core.rigid import MovingTransform
from pc2scan.messages.pointcloud2 import PointCloud2, PointField
from support.loops import loops_in_numpy

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.core.project import ProjectedScan

#: What is asked for (parameters, reduction, smallest number of returns, flags); height, width, point_step, row_step.
_HEAD = struct.Struct("<4B4I")
#: Offset, datatype and count of x, y, z and the intensity.
_FIELD = struct.Struct("<IBI")
#: Nodes between the first and the last, and the offset and unit of the times.
_MOTION = struct.Struct("<Bff")
_NAMES = ("x", "y", "z", "intensity")
_BIG_ENDIAN, _MOVED, _LIT = 1, 2, 4

_GRIDS: tuple[dict[str, Any], ...] = (
    {},
    {"angle_increment": 1e-5},
    {"angle_increment": 0.01, "angle_rounding": "glibc-2.40"},
    {"angle_min": -10.0, "angle_max": 10.0, "angle_increment": 0.01},
    {"angle_min": 0.1, "angle_max": 0.1001, "angle_increment": 1.0},
    {"angle_min": 3.0, "angle_max": 3.3, "angle_increment": 0.001, "range_min": 1.0, "range_max": 2.0},
)
_REDUCTIONS = ("min", "max", "mean", "median", "kth=2")
_TRANSFORM = np.array([[0.0, -0.8, 0.6], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [0.1, -3e38, 2.0]], np.float32)


@cache
def _projector(asked: int, reduction: int, few: int) -> Projector:
    reduce = _REDUCTIONS[reduction % len(_REDUCTIONS)]
    changes: dict[str, Any] = {"min_height": -9.0, "min_points": 1 + few % 3, "reduce": reduce}
    asked %= len(_GRIDS) + len(PRESETS)
    if asked < len(_GRIDS):
        return Projector(ProjectionParams(**{**_GRIDS[asked], **changes}))
    return Projector(ProjectionParams.preset(sorted(PRESETS)[asked - len(_GRIDS)], **changes))


def project_cloud(data: bytes) -> None:
    """Project with both loops and compare."""
    project, flags, cloud = _read(data)
    xyz, lit = cloud.xyz(), cloud.field("intensity") if flags & _LIT else None
    moved = _TRANSFORM if flags & _MOVED else None
    with loops_in_numpy():
        expected = project(*xyz, moved, lit)
    for _ in _widths():
        _compare(project(*xyz, moved, lit), expected)


def project_moving(data: bytes) -> None:
    """Move and project with both loops and compare."""
    count, offset, unit = _MOTION.unpack_from(data.ljust(_MOTION.size, b"\0"))
    steps = np.frombuffer(data[_MOTION.size :].ljust(count, b"\0")[:count], np.uint8)
    nodes = np.concatenate([[0.0], np.cumsum((steps.astype(np.float64) + 1) / 100), [100.0]])
    start, size = _MOTION.size + count, (2 * len(nodes) - 1) * 12
    with np.errstate(invalid="ignore"):
        rows = np.frombuffer(data[start:].ljust(4 * size, b"\0")[: 4 * size], "<f4").astype(np.float64).reshape(-1, 12)
    project, flags, cloud = _read(data[start + 4 * size :])
    xyz, times = cloud.xyz(), cloud.field("intensity")
    motion = MovingTransform(times, offset, unit, nodes, rows)
    lit = times if flags & _LIT else None
    outs = np.zeros((2, xyz[0].size, 3), np.float32)
    with np.errstate(all="ignore"):
        with loops_in_numpy():
            expected = project(*xyz, motion, lit)
        lost, span = plain.deskew(*xyz, motion, outs[1]), plain.span(xyz[0], times)
        for _ in _widths():
            _compare(project(*xyz, motion, lit), expected)
            assert kernel.deskew(*xyz, motion, outs[0]) == lost
            np.testing.assert_array_equal(*outs)
            np.testing.assert_array_equal(kernel.span(xyz[0], times), span)
            if lost == (0, 0):
                _compare(project(*xyz, motion._replace(timed=True), lit), expected)


def _read(data: bytes) -> tuple[Projector, int, PointCloud2]:
    start = _HEAD.size + len(_NAMES) * _FIELD.size
    data = data.ljust(start, b"\0")
    asked, reduction, few, flags, height, width, step, row_step = _HEAD.unpack_from(data)
    fields = tuple(
        PointField(name, *_FIELD.unpack_from(data, _HEAD.size + place * _FIELD.size))
        for place, name in enumerate(_NAMES)
    )
    points = memoryview(data)[start:]
    big = bool(flags & _BIG_ENDIAN)
    cloud = PointCloud2(0, 0, "", height, width, fields, big, step, row_step, points, True)
    return _projector(asked, reduction, few), flags, cloud


def _compare(compiled: ProjectedScan, expected: ProjectedScan) -> None:
    assert compiled.counts == expected.counts
    np.testing.assert_array_equal(compiled.ranges, expected.ranges)
    np.testing.assert_array_equal(compiled.intensities, expected.intensities)


def _widths() -> Iterator[int]:
    """Set how many points the compiled loops process at a time, and yield each number that the processor supports."""
    if not kernel.COMPILED:
        yield 1
        return
    from pc2scan.core import _kernel  # not everywhere

    for width in (1, 8, 16):
        if _kernel.lanes(width) == width:
            yield width
