"""Clouds to scans, against a reference of one point at a time: every way of a cloud, reduction and geometry."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.reference import Expected, reference_moved, reference_scan
from pc2scan import PointCounts, ProjectionParams, project
from pc2scan.core import plain
from pc2scan.core.params import CHOICES
from pc2scan.core.project import PointsPart, ProjectedScan, Projector
from pc2scan.core.rigid import Rigid
from support.loops import BOTH_LOOPS
from support.tables import rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

TABLES = Path(__file__).with_name("project.txt")

OPEN = ProjectionParams(min_height=-100.0, max_height=100.0)
INF, PI = math.inf, math.pi
MAX32 = float(np.finfo(np.float32).max)
MOUNT = Rigid.from_rpy(0.1, -0.2, 0.4, (0.3, 0.0, 0.5)).as_float32()


def assert_same(scan: ProjectedScan, expected: Expected) -> None:
    """Equal to the bit, but for the kind of a NaN; a scan without intensities fits points with them."""
    assert scan.ranges.dtype == np.float32
    np.testing.assert_array_equal(scan.ranges, expected.ranges)
    assert scan.counts == expected.counts
    if scan.intensities.size:
        np.testing.assert_array_equal(scan.intensities, expected.intensities)


def assert_as_reference(points: NDArray[Any], params: ProjectionParams) -> None:
    expected = reference_scan(points.reshape(-1, 3).tolist(), params)
    for loops in BOTH_LOOPS:
        with loops():
            assert_same(project(points, params), expected)


# Single points, and limits.


@pytest.mark.parametrize(("point", "what"), rows(TABLES, "single points"))
def test_what_upstreams_defaults_make_of_a_point(point: tuple[float, float, float], what: str) -> None:
    for loops in BOTH_LOOPS:
        with loops():
            scan = project([point])
        assert scan.counts == PointCounts(**{"total": 1, what: 1})
        assert (np.isfinite(scan.ranges).sum() == 1) == (what == "used")


@pytest.mark.parametrize("range_min", [0.45, 1.0, 0.1, 1e-30, 1e30, -1.0, 0.0, 5e-46, MAX32, 1e39])
def test_ranges_are_compared_as_float64(range_min: float) -> None:
    near = np.float32(min(max(range_min, 0.0), MAX32))
    lengths = near.view(np.int32) + np.arange(-4, 5, dtype=np.int32)
    x = np.abs(lengths).astype(np.int32).view(np.float32)
    zero, one = np.zeros_like(x), np.ones_like(x)
    with np.errstate(invalid="ignore"):
        slanted = x * np.float32(0.8), x * np.float32(0.6)
    points = np.concatenate(
        [np.stack(columns, axis=-1) for columns in ((x, zero, one), (zero, -x, one), (*slanted, one))]
    )
    for low, high in ((range_min, OPEN.range_max), (-INF, range_min), (-INF, INF)):
        assert_as_reference(points, replace(OPEN, range_min=low, range_max=high))


@pytest.mark.parametrize("limit", [0.1, 0.5, -0.1, 1e-46, -1e-46, 0.0, 1e300, -1e300, MAX32, INF, -INF])
def test_heights_are_compared_as_float64(limit: float) -> None:
    nearest = np.float32(max(min(limit, MAX32), -MAX32))
    around = [nearest, *(np.nextafter(nearest, np.float32(side)) for side in (1, -1)), 0.0, INF, -INF]
    points = np.array([[1, 1, z] for z in around], np.float32)
    for low, high in ((limit, INF), (-INF, limit)):
        assert_as_reference(points, replace(OPEN, min_height=low, max_height=high))


# Any points, any parameters.

SPECIAL = [0.0, -0.0, 1.0, -1.0, 2.0, 0.1, 1e-45, -1e-45, 1e-38, 1e19, -1e19, 3e38, MAX32, -MAX32, INF, -INF, math.nan]
#: Of the first, points share beams and ranges.
COORDINATES = st.one_of(
    st.sampled_from([0.0, 0.5, 1.0, 1.02, -1.0, 2.0, 3.0]), st.sampled_from(SPECIAL), st.floats(-50, 50, width=32),
    st.floats(width=32),
)  # fmt: skip
SECTORS = st.one_of(
    st.sampled_from([(-PI, PI), (0.0, 2 * PI), (-10.0, 10.0), (-PI / 4, PI / 4)]),
    st.tuples(st.floats(-4, 0), st.floats(0.001, 4)),
)
INCREMENTS = st.one_of(
    st.sampled_from([PI / 180, PI / 4, 0.1, 7.0, 1e3]), st.floats(0.002, 2), st.floats(2**-10, 7, width=32)
)
LIMITS = st.sampled_from([(0.0, 1.7976931348623157e308), (0.45, 4.0), (1.0, 1.0), (-1.0, INF), (0.1, 1e30)])
HEIGHTS = st.sampled_from([(2.2250738585072014e-308, 1.7976931348623157e308), (-1.0, 1.0), (0.1, 0.5), (-INF, INF)])


@st.composite
def parameters(draw: st.DrawFn, reductions: tuple[str, ...]) -> ProjectionParams:
    (low, high), (near, far), (bottom, top) = draw(SECTORS), draw(LIMITS), draw(HEIGHTS)
    geometry, increment = draw(st.sampled_from(CHOICES["geometry"])), draw(INCREMENTS)
    if geometry != "upstream":
        span = draw(st.sampled_from([2 * PI, PI, 1.6]))
        low = -span / 2 if geometry == "symmetric" else draw(st.sampled_from([-PI, 0.0, -1.0]))
        high, increment = low + span, draw(st.sampled_from([PI / 180, PI / 4, 0.1, 0.7]))
    reduce = draw(st.sampled_from(reductions))
    return ProjectionParams(
        geometry=geometry,
        angle_min=low,
        angle_max=high,
        angle_increment=increment,
        range_min=near,
        range_max=far,
        min_height=bottom,
        max_height=top,
        use_inf=draw(st.booleans()),
        inf_epsilon=draw(st.sampled_from([1.0, 0.0, -2.0, -0.5, 1e-9, 1e300, -1e300, INF, -INF])),
        no_return=draw(
            st.sampled_from(["", "inf", "nan", "zero", *(["range-max-plus", "range-max-minus"] if far < 1e30 else [])])
        ),
        reduce=reduce,
        min_points=draw(st.sampled_from([1, 1, 2, 3])),
    )


@st.composite
def edge_point(draw: st.DrawFn, params: ProjectionParams) -> tuple[float, float, float]:
    """A point within some float32 of the edge of a beam, or of a limit of the sector."""
    low, high = np.float32(params.angle_min), np.float32(params.angle_max)
    edge = float(low) + draw(st.integers(0, params.length)) * float(np.float32(params.angle_increment))
    angle = draw(st.sampled_from([edge, float(high)]))
    radius = draw(st.sampled_from([1.0, 0.45, 4.0, 3.7, 1e-3, 1e5]))
    point = np.array([radius * math.cos(angle), radius * math.sin(angle)], np.float32)
    point.view(np.int32)[...] += np.array([draw(st.integers(-2, 2)), draw(st.integers(-2, 2))], np.int32)
    return float(point[0]), float(point[1]), draw(st.sampled_from([0.0, 0.1, 0.5, 1.0]))


@st.composite
def clouds(draw: st.DrawFn, reductions: tuple[str, ...]) -> tuple[NDArray[np.float32], ProjectionParams]:
    params = draw(parameters(reductions))
    point: st.SearchStrategy[Any] = st.tuples(COORDINATES, COORDINATES, COORDINATES)
    if params.geometry == "upstream":
        point = st.one_of(point, edge_point(params))
    return np.array(draw(st.lists(point, max_size=60)), np.float32).reshape(-1, 3), params


def parts_of(
    cloud: NDArray[np.float32], cut: int, moved: tuple[bool, bool], lit: tuple[bool, bool]
) -> tuple[list[PointsPart], NDArray[np.float32], list[float]]:
    """Two messages; all points as they are placed, and the value of each."""
    parts, placed = [], []
    values = np.arange(1, len(cloud) + 1, dtype=np.uint16)
    for k, points in enumerate((cloud[:cut], cloud[cut:])):
        own = values[:cut] if k == 0 else values[cut:]
        if not lit[k]:
            own[:] = 0
        placed.append(reference_moved(points.tolist(), MOUNT[:3], MOUNT[3]) if moved[k] else points)
        x, y, z = points.T
        parts.append(PointsPart(x, y, z, MOUNT if moved[k] else None, own if lit[k] else None))
    return parts, np.concatenate(placed), [float(value) for value in values]


@pytest.mark.parametrize(
    "reductions", [("min", "max", "kth=1", "kth=2", "kth=3"), ("mean", "median", "surface")], ids="/".join
)
@given(
    st.data(),
    st.integers(0, 60),
    st.tuples(st.booleans(), st.booleans()),
    st.tuples(st.booleans(), st.booleans()),
    st.sampled_from([1, 7, 16384]),
)
def test_any_cloud_is_projected_as_by_the_reference(
    reductions: tuple[str, ...],
    data: st.DataObject,
    cut: int,
    moved: tuple[bool, bool],
    lit: tuple[bool, bool],
    block: int,
) -> None:
    points, params = data.draw(clouds(reductions))
    parts, placed, values = parts_of(points, cut, moved, lit)
    expected = reference_scan(placed.tolist(), params, values=values)
    x, y, z = placed.T
    intensities = np.array(values, np.float32)
    least = max(params.min_points, params.kth)
    returning = int((expected.returns > 0).sum())
    sparse = int(((expected.returns > 0) & (expected.returns < least)).sum())
    removed = {"returns": returning, "sparse": sparse} if least > 1 else None
    for loops in BOTH_LOOPS:
        with loops(), pytest.MonkeyPatch.context() as patch:
            patch.setattr(plain, "BLOCK", block)
            project = Projector(params)
            together = project.together(parts)
            scans = [together, project(x, y, z, None, intensities), project(x, y, z)]
            scans.append(project.together([part._replace(intensities=None) for part in parts]))
            if params.reduce == "min":
                scans.append(Projector(replace(params, reduce="kth=1"))(x, y, z, None, intensities))
            for scan in scans:
                assert_same(scan, expected)
                assert scan.removed == removed
            assert [each.intensities.size for each in scans[:4]] == [
                params.length if any(lit) else 0, params.length, 0, 0,
            ]  # fmt: skip
            # What the beams read gives the same scan, and no beam without a range reads anything.
            numbers, beams = project.read(x, y, z)
            assert (np.diff(numbers) > 0).all()
            again = project(x[numbers], y[numbers], z[numbers], None, intensities[numbers])
            assert again.ranges.tobytes() == scans[1].ranges.tobytes()
            assert again.intensities.tobytes() == scans[1].intensities.tobytes()
            assert set(beams.tolist()) == set(np.flatnonzero(expected.returns >= least).tolist())


# What a beam reads.


@pytest.mark.parametrize(("params", "expected"), rows(TABLES, "which points the beams read"))
def test_which_points_the_beams_read(params: dict[str, Any], expected: Any) -> None:
    # Four returns of beam 2, one of beam 3, one too high, one NaN.
    cloud = np.array([(2, 1, 0), (1, 1, 0), (1, 1, 0), (9, 9, 9), (3, 1, 0), (-1, 1, 0), (math.nan, 0, 0)], np.float32)
    project = Projector(ProjectionParams(min_height=-1.0, max_height=5.0, angle_increment=PI / 2, **params))
    numbers, beams = project.read(*cloud.T)
    assert (numbers.tolist(), beams.tolist()) == expected


# Layouts and types.


@pytest.mark.parametrize("dtype", [">f8", "<f8", "f2", "i1", "u1", ">i2", "u2", "i4", ">u4", "i8", "?"])
def test_layouts_and_types_make_no_difference(dtype: str) -> None:
    points = np.random.default_rng(2).normal(scale=60, size=(300, 3))
    params = replace(OPEN, range_min=2.0, range_max=90.0)
    with np.errstate(invalid="ignore"):
        typed = points.astype(dtype)
    expected = reference_scan(typed.tolist(), params)
    rows = np.zeros((20, 19, 4), dtype)
    rows[:, :-4, 1:] = typed.reshape(20, 15, 3)
    for view in (typed, typed[::-1], np.asfortranarray(typed), rows[:, :-4, 1:], rows[::-1, :-4, 1:].swapaxes(0, 1)):
        for loops in BOTH_LOOPS:
            with loops():
                assert_same(Projector(params)(view[..., 0], view[..., 1], view[..., 2]), expected)
