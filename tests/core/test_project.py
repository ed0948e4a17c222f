from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from core.reference import reference_moved, reference_scan
from pc2scan import PointCounts, ProjectionParams, project
from pc2scan.core import plain, rule
from pc2scan.core.project import Part, ProjectedScan, Projector
from support import GOLDEN, RECORDINGS, needs_shared

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("loops")

Columns = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]

OPEN = ProjectionParams(min_height=-100.0, max_height=100.0)
INF = math.inf
MAX32 = float(np.finfo(np.float32).max)


def assert_same(scan: ProjectedScan, ranges: NDArray[np.float32], counts: PointCounts) -> None:
    assert scan.ranges.dtype == np.float32
    np.testing.assert_array_equal(scan.ranges, ranges)
    assert scan.counts == counts


def assert_as_reference(points: NDArray[Any], params: ProjectionParams) -> None:
    assert_same(project(points, params), *reference_scan(points.reshape(-1, 3).tolist(), params))


def room(points: int, seed: int = 0) -> NDArray[np.float32]:
    """A cloud with walls, floor, and points of every kind, column-major: 16 rings to a column."""
    rng = np.random.default_rng(seed)
    azimuth = np.repeat(np.linspace(-math.pi, math.pi, math.ceil(points / 16)), 16)[:points]
    elevation = np.deg2rad(np.tile(np.linspace(-25, 15, 16), math.ceil(points / 16))[:points])
    wall = np.minimum(9 / np.abs(np.cos(azimuth)), 6 / np.abs(np.sin(azimuth) + 1e-9)) + rng.normal(0, 0.01, points)
    cloud = np.stack([wall * np.cos(azimuth), wall * np.sin(azimuth), wall * np.tan(elevation)], axis=-1)
    cloud[rng.random(points) < 0.03] = 0
    cloud[rng.random(points) < 0.02] = np.nan
    cloud[rng.random(points) < 0.01, 0] = np.nan
    cloud[rng.random(points) < 0.01, 1] = np.inf
    cloud[rng.random(points) < 0.01, 2] = -np.inf
    return cloud.astype(np.float32)


# Single points, each with what upstream's source makes of it.


@pytest.mark.parametrize(
    ("point", "what"),
    [
        ((1, 0, 1), "used"),
        ((0, 0, 1), "used"),
        ((math.nan, 0, 1), "nan"),
        ((0, math.nan, 1), "nan"),
        ((1, 0, math.nan), "nan"),
        ((math.inf, math.nan, 1), "nan"),
        ((math.nan, 0, -1), "nan"),
        ((1, 0, 0), "height"),
        ((1, 0, -0.0), "height"),
        ((math.inf, 0, -1), "height"),
        ((1, 0, 1e-45), "used"),
        ((1, 0, MAX32), "used"),
        ((1, 0, math.inf), "height"),
        ((math.inf, 0, 1), "range"),
        ((-math.inf, math.inf, 1), "range"),
        ((MAX32, 0, 1), "used"),
        ((MAX32, MAX32, 1), "range"),
        ((-1, 0.0, 1), "past_end"),
        ((-1, -0.0, 1), "used"),
        ((-1, 1e-45, 1), "past_end"),
        ((-0.0, 0.0, 1), "past_end"),
    ],
)
def test_what_upstreams_defaults_make_of_a_point(point: tuple[float, float, float], what: str) -> None:
    scan = project([point])
    assert scan.counts == PointCounts(**{"total": 1, what: 1})
    assert (np.isfinite(scan.ranges).sum() == 1) == (what == "used")


def test_a_beam_keeps_the_closest_point() -> None:
    scan = project([[3, 0.01, 1], [2, 0.01, 1], [4, 0.01, 1]])
    assert np.flatnonzero(np.isfinite(scan.ranges)).tolist() == [180]
    assert scan.ranges[180] == np.float32(math.hypot(2, np.float32(0.01)))
    assert scan.counts == PointCounts(total=3, used=3)


def test_counts_follow_the_order_of_upstreams_checks() -> None:
    params = replace(OPEN, range_min=1.0, range_max=10.0, angle_min=-1.0, angle_max=1.0, angle_increment=0.5)
    points: list[list[float]] = [
        [math.nan, 99, 999],
        [-99, 0, 999],
        [-99, 0, 0],
        [-9, 0, 0],
        [-0.5, 0, 0],
        [9, 0, 0],
    ]
    assert project(points, params).counts == PointCounts(total=6, used=1, nan=1, height=1, range=2, angle=1)


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
    assert_as_reference(points, replace(OPEN, range_min=range_min))
    assert_as_reference(points, replace(OPEN, range_min=-INF, range_max=range_min))
    assert_as_reference(points, replace(OPEN, range_min=-INF, range_max=INF))


@pytest.mark.parametrize("limit", [0.1, 0.5, -0.1, 1e-46, -1e-46, 0.0, 1e300, -1e300, MAX32, INF, -INF])
def test_heights_are_compared_as_float64(limit: float) -> None:
    nearest = np.float32(max(min(limit, MAX32), -MAX32))
    around = [
        nearest,
        np.nextafter(nearest, np.float32(1)),
        np.nextafter(nearest, np.float32(-1)),
        0.0,
        INF,
        -INF,
    ]
    points = np.array([[1, 1, z] for z in around], np.float32)
    assert_as_reference(points, replace(OPEN, min_height=limit, max_height=INF))
    assert_as_reference(points, replace(OPEN, min_height=-INF, max_height=limit))


@given(st.floats(0, MAX32, width=32))
def test_the_first_square_of_a_limit_is_the_first(limit: float) -> None:
    first = rule._first_square(np.float32(limit))

    def reaches(square: float) -> bool:
        return bool(np.float32(math.sqrt(square)) >= np.float32(limit))

    assert reaches(first)
    assert first == 0 or not reaches(math.nextafter(first, 0))


@pytest.mark.parametrize(
    ("no_return", "expected"),
    [
        ({"use_inf": True}, [2.0, INF]),
        ({"use_inf": False}, [2.0, 11.0]),
        # Upstream's beam begins with 1 m, and 2 m are not below that.
        ({"use_inf": False, "inf_epsilon": -9.0}, [1.0, 1.0]),
        ({"use_inf": False, "inf_epsilon": -INF}, [-INF, -INF]),
    ],
)
@pytest.mark.parametrize("copies", [1, 5], ids=["more beams", "more points"])
def test_empty_beams(no_return: dict[str, Any], expected: list[float], copies: int) -> None:
    params = replace(OPEN, range_max=10.0, angle_min=0.0, angle_max=1.0, angle_increment=0.5, **no_return)
    points = np.array([[2, 0, 0]] * copies, float)
    assert project(points, params).ranges.tolist() == expected
    assert_as_reference(points, params)


@pytest.mark.parametrize("copies", [1, 5], ids=["more beams", "more points"])
def test_a_sum_that_is_not_a_number_stays_in_every_beam(copies: int) -> None:
    params = replace(OPEN, use_inf=False, inf_epsilon=-INF, angle_min=0.0, angle_max=1.0, angle_increment=0.5)
    assert np.isnan(project([[2, 0, 0]] * copies, params).ranges).all()


def test_infinite_ranges_may_be_allowed() -> None:
    params = replace(OPEN, range_max=INF)
    points = [[INF, 1, 0], [-INF, 0.0, 0], [INF, INF, 0], [MAX32, -MAX32, 0]]
    scan = project(points, params)
    assert scan.counts == PointCounts(total=4, used=3, past_end=1)
    assert np.isinf(scan.ranges).all()
    assert_as_reference(np.array(points), params)
    many = np.tile(np.array(points), (100, 1))
    assert_as_reference(many, params)


# Any points, any parameters.

SPECIAL = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    2.0,
    0.1,
    1e-45,
    -1e-45,
    1e-38,
    1e19,
    -1e19,
    3e38,
    MAX32,
    -MAX32,
    INF,
    -INF,
    math.nan,
]
COORDINATES = st.one_of(
    st.sampled_from(SPECIAL), st.integers(-4, 4).map(float), st.floats(-50, 50, width=32), st.floats(width=32)
)
SECTORS = st.one_of(
    st.sampled_from([(-math.pi, math.pi), (0.0, 2 * math.pi), (-10.0, 10.0), (-math.pi / 4, math.pi / 4)]),
    st.tuples(st.floats(-4, 0), st.floats(0.001, 4)),
)
INCREMENTS = st.one_of(
    st.sampled_from([math.pi / 180, math.pi / 4, 0.1, 7.0, 1e3]),
    st.floats(0.002, 2),
    st.floats(2**-10, 7, width=32),
)
LIMITS = st.sampled_from([(0.0, 1.7976931348623157e308), (0.45, 4.0), (1.0, 1.0), (-1.0, INF), (0.1, 1e30)])
HEIGHTS = st.sampled_from([(2.2250738585072014e-308, 1.7976931348623157e308), (-1.0, 1.0), (0.1, 0.5), (-INF, INF)])


@st.composite
def parameters(draw: st.DrawFn) -> ProjectionParams:
    (low, high), (near, far), (bottom, top) = draw(SECTORS), draw(LIMITS), draw(HEIGHTS)
    return ProjectionParams(
        angle_min=low,
        angle_max=high,
        angle_increment=draw(INCREMENTS),
        range_min=near,
        range_max=far,
        min_height=bottom,
        max_height=top,
        use_inf=draw(st.booleans()),
        inf_epsilon=draw(st.sampled_from([1.0, 0.0, -2.0, -0.5, 1e-9, 1e300, -1e300, INF, -INF])),
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
def clouds(draw: st.DrawFn) -> tuple[NDArray[np.float64], ProjectionParams]:
    params = draw(parameters())
    points = draw(
        st.lists(st.one_of(st.tuples(COORDINATES, COORDINATES, COORDINATES), edge_point(params)), max_size=60)
    )
    return np.array(points, np.float64).reshape(-1, 3), params


@settings(deadline=None, max_examples=300)
@given(clouds(), st.sampled_from([1, 3, 16384]))
def test_any_cloud_is_projected_as_by_the_reference(
    cloud: tuple[NDArray[np.float64], ProjectionParams], block: int
) -> None:
    points, params = cloud
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plain, "BLOCK", block)
        assert_as_reference(points, params)


@settings(deadline=None, max_examples=200)
@given(clouds(), st.integers(0, 60))
def test_all_ways_to_the_closest_return_are_one(cloud: tuple[NDArray[np.float64], ProjectionParams], cut: int) -> None:
    points, params = cloud
    ranges, counts = reference_scan(points.tolist(), params)
    x, y, z = points.astype(np.float32).T
    values = np.arange(x.size, dtype=np.float32)
    project = Projector(params)
    first, second = (Part(x[some], y[some], z[some]) for some in (slice(cut), slice(cut, None)))
    scans = {
        "intensities": project(x, y, z, intensities=values),
        "kth": Projector(replace(params, reduce="kth", kth=1))(x, y, z),
        "kth, intensities": Projector(replace(params, reduce="kth", kth=1))(x, y, z, intensities=values),
        "two messages": project.together([first, second]),
        "two messages, one with intensities": project.together([first, second._replace(intensities=values[cut:])]),
    }
    for scan in scans.values():
        assert_same(scan, ranges, counts)
    # The points that the beams read, and no point of a beam that reads nothing.
    numbers, beams = project.read(x, y, z)
    assert ranges[beams].tolist() == np.hypot(x[numbers], y[numbers], dtype=np.float64).astype(np.float32).tolist()
    unread = np.delete(ranges, beams)
    assert np.array_equal(unread, np.full(unread.size, params.empty_range, np.float32), equal_nan=True)
    assert set(project.bins(Part(x, y, z))[0].tolist()) == set(beams.tolist())


@pytest.mark.parametrize("no_return", ["", "inf", "range-max-plus", "range-max-minus", "nan", "zero"])
@pytest.mark.parametrize("reduce", ["min", "max", "mean", "median", "surface"])
def test_returns_are_the_same_with_every_reduction(reduce: str, no_return: str) -> None:
    # 2 m and 5 m in one beam, with a limit of 3 m if the sum decides; and infinitely far in another one.
    params = replace(
        OPEN, range_max=4.0, inf_epsilon=-1.0, use_inf=False, no_return=no_return, reduce=reduce, angle_increment=0.1
    )
    x, y, z = np.array([[2, 0.01, 0], [3.5, 0.01, 0], [0.01, 3.5, 0]], np.float32).T
    limited = no_return in {"", "range-max-plus"}
    near = Projector(params)(x[:1], y[:1], z[:1])
    for lit in (None, np.ones(3)):
        scan = Projector(params)(x, y, z, intensities=lit)
        assert scan.counts == PointCounts(3, 3)
        if limited:
            np.testing.assert_array_equal(scan.ranges, near.ranges)
        else:
            assert np.count_nonzero(scan.ranges == np.float32(math.hypot(0.01, 3.5))) >= 1
    endless = replace(params, range_max=INF, no_return="nan" if "range-max" in no_return else no_return)
    for lit in (None, np.ones(3)):
        scan = Projector(endless)(x * np.float32(INF), y, z, intensities=lit)
        assert np.array_equal(scan.ranges, np.full(endless.length, endless.empty_range, np.float32), equal_nan=True)


# Layouts, types and blocks.

LAYOUTS = ["column-major", "clockwise", "ring-major", "random", "organised"]


def layout(points: NDArray[Any], name: str) -> NDArray[Any]:
    columns = points.reshape(-1, 16, 3)
    if name == "column-major":
        return points
    if name == "clockwise":
        return points[::-1]
    if name == "ring-major":
        return np.ascontiguousarray(columns.swapaxes(0, 1)).reshape(-1, 3)
    if name == "random":
        return np.random.default_rng(5).permutation(points)
    return np.ascontiguousarray(columns.swapaxes(0, 1))


def columns_of(points: NDArray[Any]) -> Columns:
    return points[..., 0], points[..., 1], points[..., 2]


@pytest.fixture(scope="module")
def scene() -> NDArray[np.float32]:
    return room(20_000)


@pytest.fixture(scope="module")
def expected(scene: NDArray[np.float32]) -> dict[ProjectionParams, tuple[NDArray[np.float32], PointCounts]]:
    cases = [
        ProjectionParams(min_height=-1.0, max_height=1.0, range_min=0.3, range_max=8.0),
        replace(OPEN, angle_increment=math.pi / 18000),
        replace(OPEN, angle_min=-0.3, angle_max=2.0, angle_increment=0.0061, use_inf=False, range_max=30.0),
        replace(OPEN, angle_increment=math.pi / 45),
    ]
    return {params: reference_scan(scene.tolist(), params) for params in cases}


@pytest.mark.parametrize("block", [997, 4096, 16384, 1 << 20])
@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_and_blocks_make_no_difference(
    scene: NDArray[np.float32],
    expected: dict[ProjectionParams, tuple[NDArray[np.float32], PointCounts]],
    name: str,
    block: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(plain, "BLOCK", block)
    for params, (ranges, counts) in expected.items():
        assert_same(project(layout(scene, name), params), ranges, counts)


@pytest.mark.parametrize("step", [12, 15, 16, 22, 32, 48])
def test_views_into_points_of_any_size(
    scene: NDArray[np.float32],
    expected: dict[ProjectionParams, tuple[NDArray[np.float32], PointCounts]],
    step: int,
) -> None:
    names, offsets = ["x", "y", "z"], [step - 12, step - 8, step - 4]
    for order in "<>":
        record = np.dtype({"names": names, "formats": [f"{order}f4"] * 3, "offsets": offsets, "itemsize": step})
        cloud = np.zeros(len(scene), record)
        for name, column in zip(names, scene.T, strict=True):
            cloud[name] = column
        before = cloud.tobytes()
        for params, (ranges, counts) in expected.items():
            assert_same(Projector(params)(cloud["x"], cloud["y"], cloud["z"]), ranges, counts)
        assert cloud.tobytes() == before


def test_padded_rows_and_reversed_axes(
    scene: NDArray[np.float32],
    expected: dict[ProjectionParams, tuple[NDArray[np.float32], PointCounts]],
) -> None:
    padded = np.full((50, 411, 5), np.nan, np.float32)
    padded[:, :400, 1:4] = scene.reshape(50, 400, 3)
    x, y, z = columns_of(padded[:, :400, 1:4])
    for params, (ranges, counts) in expected.items():
        projector = Projector(params)
        assert_same(projector(x, y, z), ranges, counts)
        assert_same(projector(x[::-1, ::-1], y[::-1, ::-1], z[::-1, ::-1]), ranges, counts)
        assert_same(projector(x.T, y.T, z.T), ranges, counts)


def test_read_only_and_contiguous_columns_are_left_alone(scene: NDArray[np.float32]) -> None:
    columns = np.ascontiguousarray(scene.T)
    columns.setflags(write=False)
    x, y, z = columns
    scan = Projector(OPEN)(x, y, z)
    assert_same(scan, *reference_scan(scene.tolist(), OPEN))
    assert not np.shares_memory(scan.ranges, columns)


@pytest.mark.parametrize("dtype", [">f8", "<f8", "f2", "i1", "u1", ">i2", "u2", "i4", ">u4", "i8", "?"])
def test_other_types_are_rounded_to_float32(dtype: str) -> None:
    values = np.random.default_rng(2).normal(scale=60, size=(3000, 3))
    with np.errstate(invalid="ignore"):
        points = values.astype(dtype)
    assert_as_reference(points, replace(OPEN, range_min=2.0, range_max=90.0))


def test_float64_and_large_integers_are_rounded_first() -> None:
    below_pi_by_float64 = [[-1.0, 1e-60, 1.0], [-1.0, -1e-60, 1.0]]
    assert project(below_pi_by_float64).counts == PointCounts(total=2, used=1, past_end=1)
    far = project(np.array([[2**60 + 1, 1, 1]], np.int64))
    assert far.ranges.min() == np.float32(2**60)
    assert project([[1e300, 0, 1]]).counts == PointCounts(total=1, range=1)


@pytest.mark.parametrize("shape", [(0, 3), (0, 5, 3), (5, 0, 3)])
def test_empty_clouds(shape: tuple[int, ...]) -> None:
    scan = project(np.zeros(shape))
    assert np.isposinf(scan.ranges).all()
    assert scan.counts == PointCounts()


def test_wrong_arrays_are_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(3,\)"):
        project([1, 2, 3])
    with pytest.raises(ValueError, match=r"shape \(2, 2\)"):
        project([[1, 2], [3, 4]])
    with pytest.raises(TypeError, match="complex128"):
        project([[1, 2, 3j]])
    one, two = np.zeros(1), np.zeros(2)
    with pytest.raises(ValueError, match="shapes"):
        Projector(OPEN)(one, one, two)
    with pytest.raises(ValueError, match="shapes"):
        Projector(OPEN)(np.zeros((1, 1, 1)), np.zeros((1, 1, 1)), np.zeros((1, 1, 1)))


def test_ranges_are_new_arrays() -> None:
    projector = Projector(OPEN)
    cloud = columns_of(room(4000))
    first = projector(*cloud)
    kept = first.ranges.copy()
    first.ranges[:] = -1
    np.testing.assert_array_equal(projector(*cloud).ranges, kept)
    x, y, z = cloud
    few = projector(x[:100], y[:100], z[:100])
    assert few.ranges.shape == (360,)


def test_counts_add_up() -> None:
    scans = [project(room(3000, seed), replace(OPEN, range_max=7.0, angle_max=1.0)) for seed in range(3)]
    total = sum((scan.counts for scan in scans), PointCounts())
    assert total.total == 9000
    for counts in [total, *(scan.counts for scan in scans)]:
        parts = counts.nan, counts.height, counts.range, counts.angle, counts.past_end, counts.used
        assert min(parts[:4]) > 0
        assert sum(parts) == counts.total


def test_threads_may_share_a_projector() -> None:
    projector = Projector(OPEN)
    sizes = [100, 5000, 20_000, 40_000] * 10
    rooms = {size: columns_of(room(size, size)) for size in set(sizes)}
    alone = {size: projector(*cloud) for size, cloud in rooms.items()}
    with ThreadPoolExecutor(4) as pool:
        for size, scan in zip(sizes, pool.map(lambda size: projector(*rooms[size]), sizes), strict=True):
            assert_same(scan, alone[size].ranges, alone[size].counts)


# Transforms.


def turned(angle: float) -> NDArray[np.float64]:
    cosine, sine = math.cos(angle), math.sin(angle)
    about_z = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])
    about_x = np.array([[1.0, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    both: NDArray[np.float64] = about_z @ about_x
    return both


@pytest.mark.parametrize("dtype", ["f4", "f8", ">f4"])
def test_a_transform_is_applied_in_float32(scene: NDArray[np.float32], dtype: str) -> None:
    cloud = (scene.astype(np.float64) * 1.000000001).astype(dtype)
    rotation, translation = turned(0.4), np.array([0.3, -2.0, 0.7])
    moved = reference_moved(cloud.tolist(), rotation, translation)
    scan = Projector(OPEN)(*columns_of(cloud), (rotation, translation))
    assert_same(scan, *reference_scan(moved.tolist(), OPEN))
    # One rounding at the end is something else, so that the test can tell them apart.
    with np.errstate(invalid="ignore"):
        once = (cloud.astype(np.float64) @ rotation.T + translation).astype(np.float32)
    assert np.count_nonzero(once != moved) > moved.size // 4


def test_a_transform_of_padded_rows() -> None:
    cloud = np.zeros((40, 60, 4), np.float32)
    cloud[:, :50, :3] = room(2000).reshape(40, 50, 3)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    x, y, z = columns_of(cloud[:, :50])
    scan = Projector(OPEN)(x, y, z, (quarter, np.zeros(3)))
    finite = np.isfinite(cloud[:, :50, :3]).all(axis=-1)
    assert_same(
        Projector(OPEN)(x[finite], y[finite], z[finite], (quarter, np.zeros(3))),
        *reference_scan(np.stack([-y[finite] + 0.0, x[finite], z[finite]], axis=-1).tolist(), OPEN),
    )
    assert scan.counts.total == 2000


# What the compiled upstream node returned.

FLOATS = {7: "f4", 8: "f8"}


def xyz(message: Any) -> Columns:
    """A PointCloud2's coordinates, as views of its bytes."""
    fields = {field.name: field for field in message.fields}
    order = ">" if message.is_bigendian else "<"
    record = np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": [order + FLOATS[fields[name].datatype] for name in "xyz"],
            "offsets": [fields[name].offset for name in "xyz"],
            "itemsize": message.point_step,
        }
    )
    cloud: NDArray[Any] = np.ndarray(
        (message.height, message.width), record, message.data, strides=(message.row_step, message.point_step)
    )
    return cloud["x"], cloud["y"], cloud["z"]


def ros1_messages(path: Path, topic: str) -> list[tuple[int, Any]]:
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(path) as reader:
        chosen = [connection for connection in reader.connections if connection.topic == topic]
        return [
            (stamp, store.deserialize_ros1(data, connection.msgtype))
            for connection, stamp, data in reader.messages(chosen)
        ]


def mcap_messages(path: Path, topic: str) -> list[tuple[int, Any]]:
    from mcap.reader import make_reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("rb") as file:
        return [
            (message.log_time, store.deserialize_cdr(message.data, schema.name))
            for schema, _, message in make_reader(file).iter_messages(topics=[topic])
            if schema is not None
        ]


def golden_params(case: str) -> dict[str, Any] | None:
    """Parameters of a golden case of this direction without a transform; None for the others."""
    from ruamel.yaml import YAML

    document = YAML(typ="safe").load((GOLDEN / case / "params.yaml").read_text())
    if "pointcloud_to_laserscan" not in document:
        return None
    params: dict[str, Any] = document["pointcloud_to_laserscan"]["ros__parameters"] or {}
    return None if case in {"tf_static", "tf_dynamic"} else params


CASES = [
    path.name
    for path in (sorted(GOLDEN.iterdir()) if GOLDEN.is_dir() else [])
    if path.is_dir() and golden_params(path.name) is not None
]


def test_golden_cases_are_found() -> None:
    if GOLDEN.is_dir():
        assert len(CASES) == 11


@pytest.mark.parametrize("case", CASES)
def test_golden_cases_to_the_bit(case: str) -> None:
    params = ProjectionParams(**(golden_params(case) or {}))
    clouds = ros1_messages(GOLDEN / case / "input.bag", "/points")
    scans = ros1_messages(GOLDEN / case / "expected.bag", "/scan")
    assert len(clouds) == len(scans) > 0
    projector = Projector(params)
    for (log_time, cloud), (expected_time, scan) in zip(clouds, scans, strict=True):
        assert log_time == expected_time
        assert projector(*xyz(cloud)).ranges.tobytes() == scan.ranges.tobytes()


RECORDED = json.loads((RECORDINGS / "expected_scans.json").read_text()) if RECORDINGS.is_dir() else []


@needs_shared
@pytest.mark.parametrize("case", RECORDED, ids=[case["recording"] for case in RECORDED])
def test_real_recordings_to_the_bit(case: dict[str, Any]) -> None:
    path = RECORDINGS / case["recording"]
    read = mcap_messages if path.suffix == ".mcap" else ros1_messages
    projector = Projector(ProjectionParams(**case["params"]))
    messages = read(path, case["topic"])
    assert len(messages) == len(case["scans"])
    for (log_time, cloud), scan in zip(messages, case["scans"], strict=True):
        assert log_time == int(scan["log_time"])
        upstream = np.array([float(value) for value in scan["ranges"]], np.float32)
        assert projector(*xyz(cloud)).ranges.tobytes() == upstream.tobytes()
