from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from core.reference import reference_moved, reference_scan
from pc2scan import PointCounts, ProjectionParams, project
from pc2scan.core import plain
from pc2scan.core.project import Part, ProjectedScan, Projector
from pc2scan.core.rigid import Rigid
from support import sampled

if TYPE_CHECKING:
    from collections.abc import Callable

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


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"use_inf": True}, [2, INF]),
        ({"use_inf": False}, [2, 11]),
        # Upstream's beam begins with 1 m, and 2 m are not below that.
        ({"use_inf": False, "inf_epsilon": -9.0}, [1, 1]),
        ({"use_inf": False, "inf_epsilon": -INF}, [-INF, -INF]),
        ({"use_inf": False, "inf_epsilon": -INF, "range_max": OPEN.range_max}, [math.nan, math.nan]),
    ],
)
@pytest.mark.parametrize("copies", [1, 5], ids=["more beams", "more points"])
def test_what_empty_beams_read(changes: dict[str, Any], expected: list[float], copies: int) -> None:
    sector = replace(OPEN, range_max=10.0, angle_min=0.0, angle_max=1.0, angle_increment=0.5)
    np.testing.assert_array_equal(project([[2, 0, 0]] * copies, replace(sector, **changes)).ranges, expected)


@pytest.mark.parametrize("no_return", sampled(["", "inf", "range-max-plus", "range-max-minus", "nan", "zero"], 2))
@pytest.mark.parametrize("reduce", ["min", "max", "mean", "median", "surface"])
def test_every_reduction_has_the_same_limits(reduce: str, no_return: str) -> None:
    # 2 m and 3.5 m in one beam, with a limit of 3 m if the sum decides; and 3.5 m in another one.
    params = replace(
        OPEN, range_max=4.0, inf_epsilon=-1.0, use_inf=False, no_return=no_return, reduce=reduce, angle_increment=0.1
    )
    endless = replace(params, range_max=INF, no_return="nan" if "range-max" in no_return else no_return)
    x, y, z = np.array([[2, 0.01, 0], [3.5, 0.01, 0], [0.01, 3.5, 0]], np.float32).T
    near = Projector(params)(x[:1], y[:1], z[:1])
    for lit in (None, np.ones(3)):
        scan = Projector(params)(x, y, z, intensities=lit)
        assert scan.counts == PointCounts(3, 3)
        if no_return in {"", "range-max-plus"}:
            np.testing.assert_array_equal(scan.ranges, near.ranges)
        else:
            assert np.count_nonzero(scan.ranges == np.float32(math.hypot(0.01, 3.5))) >= 1
        far = Projector(endless)(x * np.float32(INF), y, z, intensities=lit).ranges
        np.testing.assert_array_equal(far, np.full(endless.length, endless.empty_range, np.float32))


# Any points, any parameters.

SPECIAL = [0.0, -0.0, 1.0, -1.0, 2.0, 0.1, 1e-45, -1e-45, 1e-38, 1e19, -1e19, 3e38, MAX32, -MAX32, INF, -INF, math.nan]
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


@given(clouds(), st.sampled_from([1, 3, 16384]))
def test_any_cloud_is_projected_as_by_the_reference(
    cloud: tuple[NDArray[np.float64], ProjectionParams], block: int
) -> None:
    points, params = cloud
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plain, "BLOCK", block)
        assert_as_reference(points, params)


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


# Layouts, types and blocks.


def room(points: int) -> NDArray[np.float32]:
    """A cloud with walls, floor, and points of every kind, column-major: 16 rings to a column."""
    rng = np.random.default_rng(points)
    azimuth = np.repeat(np.linspace(-math.pi, math.pi, points // 16), 16)
    elevation = np.deg2rad(np.tile(np.linspace(-25, 15, 16), points // 16))
    wall = np.minimum(9 / np.abs(np.cos(azimuth)), 6 / np.abs(np.sin(azimuth) + 1e-9)) + rng.normal(0, 0.01, points)
    cloud = np.stack([wall * np.cos(azimuth), wall * np.sin(azimuth), wall * np.tan(elevation)], axis=-1)
    for axis, value in ((slice(None), 0), (slice(None), np.nan), (0, np.nan), (1, np.inf), (2, -np.inf)):
        cloud[rng.random(points) < 0.02, axis] = value
    return cloud.astype(np.float32)


def columns_of(points: NDArray[Any]) -> Columns:
    return points[..., 0], points[..., 1], points[..., 2]


def record_of(points: NDArray[Any], order: str, step: int) -> Columns:
    """The coordinates behind each other at the end of records of a size."""
    offsets = [step - 12, step - 8, step - 4]
    cloud = np.zeros(
        len(points), {"names": [*"xyz"], "formats": [f"{order}f4"] * 3, "offsets": offsets, "itemsize": step}
    )
    for name, column in zip("xyz", points.T, strict=True):
        cloud[name] = column
    return cloud["x"], cloud["y"], cloud["z"]


def padded(points: NDArray[Any]) -> NDArray[Any]:
    rows = np.full((20, len(points) // 20 + 11, 5), np.nan, np.float32)
    rows[:, :-11, 1:4] = points.reshape(20, -1, 3)
    return rows[:, :-11, 1:4]


VIEWS: dict[str, Callable[[NDArray[Any]], Columns]] = {
    "column-major": columns_of,
    "backwards": lambda points: columns_of(points[::-1]),
    "ring-major": lambda points: columns_of(points.reshape(-1, 16, 3).swapaxes(0, 1).reshape(-1, 3).copy()),
    "organised": lambda points: columns_of(points.reshape(-1, 16, 3).swapaxes(0, 1).copy()),
    "random": lambda points: columns_of(np.random.default_rng(5).permutation(points)),
    "padded rows": lambda points: columns_of(padded(points)),
    "padded rows, backwards": lambda points: columns_of(padded(points)[::-1, ::-1]),
    "padded rows, transposed": lambda points: columns_of(padded(points).swapaxes(0, 1)),
    "contiguous axes": lambda points: tuple(np.ascontiguousarray(points.T)),
    **{
        f"records of {step} bytes, {order}": partial(record_of, order=order, step=step)
        for step in (12, 15, 16, 22, 32, 48)
        for order in "<>"
    },
}
SCENE = room(4000)


@cache
def expected(params: ProjectionParams) -> tuple[NDArray[np.float32], PointCounts]:
    return reference_scan(SCENE.tolist(), params)


@pytest.mark.parametrize("block", [997, 1 << 20])
@pytest.mark.parametrize("view", VIEWS)
def test_layouts_and_blocks_make_no_difference(view: str, block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plain, "BLOCK", block)
    cloud = VIEWS[view](SCENE)
    before = [axis.tobytes() for axis in cloud]
    for axis in cloud:
        axis.setflags(write=False)
    for params in (
        ProjectionParams(min_height=-1.0, max_height=1.0, range_min=0.3, range_max=8.0),
        replace(OPEN, angle_increment=math.pi / 18000),
        replace(OPEN, angle_min=-0.3, angle_max=2.0, angle_increment=0.0061, use_inf=False, range_max=30.0),
    ):
        assert_same(Projector(params)(*cloud), *expected(params))
    assert [axis.tobytes() for axis in cloud] == before


@pytest.mark.parametrize("dtype", [">f8", "<f8", "f2", "i1", "u1", ">i2", "u2", "i4", ">u4", "i8", "?"])
def test_other_types_are_rounded_to_float32(dtype: str) -> None:
    with np.errstate(invalid="ignore"):
        points = np.random.default_rng(2).normal(scale=60, size=(300, 3)).astype(dtype)
    assert_as_reference(points, replace(OPEN, range_min=2.0, range_max=90.0))


def test_float64_and_large_integers_are_rounded_first() -> None:
    assert project([[-1.0, 1e-60, 1.0], [-1.0, -1e-60, 1.0]]).counts == PointCounts(total=2, used=1, past_end=1)
    assert project(np.array([[2**60 + 1, 1, 1]], np.int64)).ranges.min() == np.float32(2**60)
    assert project([[1e300, 0, 1]]).counts == PointCounts(total=1, range=1)


@pytest.mark.parametrize("shape", [(0, 3), (0, 5, 3), (5, 0, 3)])
def test_empty_clouds_are_empty_scans(shape: tuple[int, ...]) -> None:
    scan = project(np.zeros(shape))
    assert np.isposinf(scan.ranges).all()
    assert scan.counts == PointCounts()


@pytest.mark.parametrize(
    ("call", "error", "told"),
    [
        (lambda: project([1, 2, 3]), ValueError, r"shape \(3,\)"),
        (lambda: project([[1, 2], [3, 4]]), ValueError, r"shape \(2, 2\)"),
        (lambda: project([[1, 2, 3j]]), TypeError, "complex128"),
        (lambda: Projector(OPEN)(np.zeros(1), np.zeros(1), np.zeros(2)), ValueError, "shapes"),
        (lambda: Projector(OPEN)(*[np.zeros((1, 1, 1))] * 3), ValueError, "shapes"),
    ],
)
def test_wrong_arrays_are_refused(call: Callable[[], object], error: type[Exception], told: str) -> None:
    with pytest.raises(error, match=told):
        call()


def test_threads_may_share_a_projector() -> None:
    projector = Projector(OPEN)
    sizes = [96, 4800, 16_000] * 8
    rooms = {size: columns_of(room(size)) for size in set(sizes)}
    alone = {size: projector(*cloud) for size, cloud in rooms.items()}
    with ThreadPoolExecutor(4) as pool:
        for size, scan in zip(sizes, pool.map(lambda size: projector(*rooms[size]), sizes), strict=True):
            assert_same(scan, alone[size].ranges, alone[size].counts)
            # They are the caller's own.
            scan.ranges[:] = -1


@pytest.mark.parametrize("dtype", ["f4", "f8", ">f4"])
def test_a_transform_is_applied_in_float32(dtype: str) -> None:
    cloud = (SCENE.astype(np.float64) * 1.000000001).astype(dtype)
    rotation, translation = Rigid.from_rpy(0.4, 0, 0.4).matrix, np.array([0.3, -2.0, 0.7])
    moved = reference_moved(cloud.tolist(), rotation, translation)
    scan = Projector(OPEN)(*columns_of(cloud), (rotation, translation))
    assert_same(scan, *reference_scan(moved.tolist(), OPEN))
    # One rounding at the end is something else, so that the test can tell them apart.
    with np.errstate(invalid="ignore"):
        once = (cloud.astype(np.float64) @ rotation.T + translation).astype(np.float32)
    assert np.count_nonzero(once != moved) > moved.size // 4
