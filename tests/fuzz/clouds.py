"""Any header over any points, through the compiled loops and through NumPy's: the same scan from both."""

from __future__ import annotations

import struct
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan import ProjectionParams
from pc2scan.core import kernel, plain
from pc2scan.core.presets import PRESETS
from pc2scan.core.project import Projector
from pc2scan.messages.pointcloud2 import PointCloud2, PointField

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["project_cloud", "written"]

#: What is asked for (parameters, reduction, smallest number of returns, flags); height, width, point_step, row_step.
_HEAD = struct.Struct("<4B4I")
#: Offset, datatype and count of x, y, z and the intensity.
_FIELD = struct.Struct("<IBI")
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
_REDUCTIONS = ("min", "max", "mean", "median", "kth")
_TRANSFORM = (np.array([[0.0, -0.8, 0.6], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]), np.array([0.1, -3e38, 2.0]))


@cache
def _projector(asked: int, reduction: int, few: int) -> Projector:
    reduce = _REDUCTIONS[reduction % len(_REDUCTIONS)]
    kth = {"kth": 1 + few % 3} if reduce == "kth" else {}
    changes: dict[str, Any] = {"min_height": -9.0, "min_points": 1 + few % 3, "reduce": reduce, **kth}
    asked %= len(_GRIDS) + len(PRESETS)
    if asked < len(_GRIDS):
        return Projector(ProjectionParams(**{**_GRIDS[asked], **changes}))
    return Projector(ProjectionParams.preset(sorted(PRESETS)[asked - len(_GRIDS)], **changes))


def written(
    fields: tuple[tuple[int, int], ...], data: bytes, *, step: int, height: int = 1, row_step: int = 0, flags: int = 0
) -> bytes:
    """Write an input: offsets and datatypes of x, y, z and the intensity, and the points."""
    width = len(data) // (row_step or step) if height == 1 else (row_step or len(data) // height) // step
    head = _HEAD.pack(0, 0, 0, flags, height, width, step, row_step)
    return head + b"".join(_FIELD.pack(*field, 1) for field in fields) + data


def project_cloud(data: bytes) -> None:
    """Project with both loops and compare."""
    start = _HEAD.size + len(_NAMES) * _FIELD.size
    data = data.ljust(start, b"\0")
    asked, reduction, few, flags, height, width, step, row_step = _HEAD.unpack_from(data)
    fields = tuple(
        PointField(name, *_FIELD.unpack_from(data, _HEAD.size + place * _FIELD.size))
        for place, name in enumerate(_NAMES)
    )
    cloud = PointCloud2(
        0, 0, "", height, width, fields, bool(flags & _BIG_ENDIAN), step, row_step, memoryview(data)[start:], True
    )
    xyz, lit = cloud.xyz(), cloud.field("intensity") if flags & _LIT else None
    project, moved = _projector(asked, reduction, few), _TRANSFORM if flags & _MOVED else None
    compiled = project(*xyz, moved, lit)
    with _plain():
        expected = project(*xyz, moved, lit)
    assert compiled.counts == expected.counts
    np.testing.assert_array_equal(compiled.ranges, expected.ranges)
    np.testing.assert_array_equal(compiled.intensities, expected.intensities)


@contextmanager
def _plain() -> Iterator[None]:
    compiled = kernel.project, kernel.gather
    kernel.project, kernel.gather = plain.project, plain.gather
    try:
        yield
    finally:
        kernel.project, kernel.gather = compiled
