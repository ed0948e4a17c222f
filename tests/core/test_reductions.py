"""The projection beyond upstream's, against one point at a time in plain Python."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.reference import float32, reference_scan
from pc2scan import PointCounts, ProjectionParams, project
from pc2scan.core import plain
from pc2scan.core.layout import TURN
from pc2scan.core.project import Projector
from pc2scan.core.rule import rule_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

pytestmark = pytest.mark.usefixtures("loops")

PI = math.pi
CENTERED = ProjectionParams(geometry="centered", min_height=-1.0, max_height=1.0, range_max=30.0)


def beam_of(angle: float, params: ProjectionParams) -> int | str:
    """The beam of an angle, or where else its point goes."""
    layout = params.layout
    if params.geometry == "upstream":
        if not layout.angle_min <= angle <= layout.angle_max:
            return "angle"
        beam = int((angle - layout.angle_min) / layout.angle_increment)
        return beam if beam < layout.count else "past_end"
    offsets = [
        (abs(math.remainder(angle - layout.angle_min - beam * layout.angle_increment, TURN)), beam)
        for beam in range(layout.count)
    ]
    offset, beam = min(offsets)
    return beam if layout.full_circle or offset <= layout.angle_increment / 2 else "angle"


def reference(
    points: Iterable[Sequence[float]], params: ProjectionParams
) -> tuple[list[float], list[float], PointCounts]:
    """Ranges, intensities and counts of points with a fourth value, given as Python floats."""
    rejected = dict.fromkeys(("nan", "height", "range", "angle", "past_end"), 0)
    beams: list[list[tuple[float, int, float]]] = [[] for _ in range(params.length)]
    total = 0
    for number, (x, y, z, value) in enumerate(points):
        total += 1
        reach = float32(math.sqrt(x * x + y * y))
        if math.isnan(x) or math.isnan(y) or math.isnan(z):
            beam: int | str = "nan"
        elif not params.min_height <= z <= params.max_height:
            beam = "height"
        elif not params.range_min <= reach <= params.range_max:
            beam = "range"
        else:
            beam = beam_of(float32(math.atan2(y, x)), params)
        if isinstance(beam, str):
            rejected[beam] += 1
        else:
            beams[beam].append((reach, number, value))
    ranges, lit = [], []
    for returns in beams:
        length, intensity = reduced(returns, params)
        ranges.append(float32(length))
        lit.append(float32(intensity))
    return ranges, lit, PointCounts(total, total - sum(rejected.values()), **rejected)


def reduced(beam: list[tuple[float, int, float]], params: ProjectionParams) -> tuple[float, float]:
    ordered = sorted(beam)
    if len(ordered) < max(params.min_points, params.kth):
        return params.empty_range, 0.0
    match params.reduce:
        case "mean":
            length = value = 0.0
            for reach, _, own in beam:
                length, value = length + reach, value + own
            return length / len(beam), value / len(beam)
        case "surface":
            closest, window = ordered[0][0], params.surface_slope * params.layout.angle_increment
            near = [e for e in ordered if e[0] <= closest + (params.surface_depth + window * closest)]
            place = (len(near) - 1) // 2
        case "max":
            longest = ordered[-1][0]
            place = next(place for place, entry in enumerate(ordered) if entry[0] == longest)
        case "median":
            place = (len(ordered) - 1) // 2
        case "kth":
            place = params.kth - 1
        case _:
            place = 0
    return ordered[place][0], ordered[place][2]


COORDINATES = st.one_of(st.sampled_from([0.0, -0.0, 1.0, -1.0, 2.0, math.nan, math.inf]), st.floats(-40, 40, width=32))
POINTS = st.lists(
    st.tuples(COORDINATES, COORDINATES, st.sampled_from([0.0, 0.5, 2.0, math.nan]), st.floats(-9, 9, width=32)),
    max_size=60,
)


@st.composite
def parameters(draw: st.DrawFn) -> ProjectionParams:
    reduce = draw(st.sampled_from(["min", "max", "mean", "median", "kth", "surface"]))
    geometry = draw(st.sampled_from(["upstream", "centered", "half-open", "symmetric"]))
    span = draw(st.sampled_from([2 * PI, PI, 1.6]))
    low = -span / 2 if geometry == "symmetric" else draw(st.sampled_from([-PI, 0.0, -1.0]))
    return ProjectionParams(
        geometry=geometry,
        angle_min=low,
        angle_max=low + span,
        angle_increment=draw(st.sampled_from([PI / 180, PI / 4, 0.1, 0.7])),
        min_height=-1.0,
        max_height=1.0,
        range_min=draw(st.sampled_from([0.0, 0.5])),
        range_max=draw(st.sampled_from([30.0, 100.0])),
        no_return=draw(st.sampled_from(["inf", "range-max-plus", "range-max-minus", "nan", "zero"])),
        reduce=reduce,
        kth=draw(st.integers(1, 3)) if reduce == "kth" else 0,
        surface_depth=draw(st.sampled_from([0.0, 0.05, 5.0])) if reduce == "surface" else 0.05,
        surface_slope=draw(st.sampled_from([0.0, 3.0])) if reduce == "surface" else 3.0,
        min_points=draw(st.integers(1, 3)),
    )


@given(POINTS, parameters(), st.sampled_from([1, 7, 16384]))
def test_any_cloud_is_projected_as_by_the_reference(
    points: list[tuple[float, ...]], params: ProjectionParams, block: int
) -> None:
    array = np.array(points, np.float32).reshape(-1, 4)
    ranges, lit, counts = reference(array.tolist(), params)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plain, "BLOCK", block)
        projector = Projector(params)
        scan = projector(array[:, 0], array[:, 1], array[:, 2], None, array[:, 3])
        unlit = projector(array[:, 0], array[:, 1], array[:, 2])
    np.testing.assert_array_equal(scan.ranges, np.array(ranges, np.float32))
    np.testing.assert_array_equal(scan.intensities, np.array(lit, np.float32))
    assert scan.counts == unlit.counts == counts
    np.testing.assert_array_equal(unlit.ranges, scan.ranges)
    assert unlit.intensities.size == 0


def room(points: int = 40_000) -> NDArray[np.float32]:
    random = np.random.default_rng(7)
    cloud = random.uniform(-9, 9, (points, 3)) * [1, 1, 0.2]
    cloud[::97] = np.nan
    cloud[::89] = 0
    return cloud.astype(np.float32)


def test_the_closest_of_gathered_returns_is_what_the_short_way_finds() -> None:
    cloud = room()
    params = ProjectionParams(min_height=-1.0, max_height=1.0, range_max=8.0, angle_min=-2.0, angle_increment=0.013)
    columns = cloud[:, 0], cloud[:, 1], cloud[:, 2]
    turned = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]]), np.array([0.5, 0.0, -0.2])
    for geometry in ("upstream", "centered"):
        for transform in (None, turned):
            projector = Projector(replace(params, geometry=geometry))
            short, gathered = projector(*columns, transform), projector(*columns, transform, columns[0])
            assert gathered.ranges.tobytes() == short.ranges.tobytes()
            assert gathered.counts == short.counts


def test_blocks_and_shapes_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    cloud = room()
    params = replace(CENTERED, reduce="median")
    values = np.arange(len(cloud), dtype=np.uint16)
    whole = project(cloud, params, intensities=values)
    monkeypatch.setattr(plain, "BLOCK", 997)
    parts = project(cloud.reshape(200, 200, 3), params, intensities=values.reshape(200, 200))
    assert parts.ranges.tobytes() == whole.ranges.tobytes()
    assert parts.intensities.tobytes() == whole.intensities.tobytes()
    assert parts.counts == whole.counts


def test_any_type_of_column_is_read() -> None:
    cloud = np.round(room(4000) * 1000)
    cloud = np.nan_to_num(cloud)
    params = replace(CENTERED, range_max=1e5, min_height=-1e4, max_height=1e4)
    expected = project(cloud, params)
    record = np.dtype(
        {"names": ["x", "y", "z"], "formats": ["<f4", ">i2", ">f8"], "offsets": [1, 7, 11], "itemsize": 22}
    )
    mixed = np.zeros(len(cloud), record)
    mixed["x"], mixed["y"], mixed["z"] = cloud.T
    scan = Projector(params)(mixed["x"], mixed["y"], mixed["z"])
    assert scan.ranges.tobytes() == expected.ranges.tobytes()
    assert scan.counts == expected.counts


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", ">u2", "i4", "u4", "f4", ">f8"])
def test_intensities_of_any_type_become_float32(dtype: str) -> None:
    values = np.array([100, 7, 3]).astype(dtype)
    points = np.array([[3, 0, 0], [2, 0, 0], [0, 2, 0]])
    scan = project(points, replace(CENTERED, beams=4), intensities=values)
    assert scan.ranges.tolist() == [math.inf, math.inf, 2, 2]
    assert scan.intensities.tolist() == [0, 0, 7, 3]
    assert scan.intensities.dtype == np.float32
    mean = project(points, replace(CENTERED, beams=4, reduce="mean"), intensities=values)
    assert (mean.ranges[2], mean.intensities[2]) == (2.5, 53.5)


@pytest.mark.parametrize(
    ("changes", "ranges"),
    [
        ({}, [1, 5, math.inf]),
        ({"reduce": "max"}, [4, 5, math.inf]),
        ({"reduce": "mean"}, [2.5, 5, math.inf]),
        ({"reduce": "median"}, [2, 5, math.inf]),
        ({"reduce": "kth", "kth": 3}, [3, math.inf, math.inf]),
        # The three closest of 1, 2, 3 and 4 m; the width of a beam is 0.5 rad.
        ({"reduce": "surface", "surface_depth": 0.5, "surface_slope": 3.0}, [2, 5, math.inf]),
        ({"reduce": "surface", "surface_slope": 0.0}, [1, 5, math.inf]),
        ({"min_points": 2}, [1, math.inf, math.inf]),
        ({"reduce": "max", "no_return": "zero"}, [4, 5, 0]),
        ({"reduce": "max", "no_return": "range-max-plus"}, [4, 5, 31]),
        ({"no_return": "range-max-plus", "inf_epsilon": 0.5, "min_points": 2}, [1, 30.5, 30.5]),
    ],
)
def test_what_a_beam_reads(changes: dict[str, Any], ranges: list[float]) -> None:
    params = replace(CENTERED, angle_min=0.0, angle_max=1.0, beams=3, **changes)
    along = [[reach * math.cos(a), reach * math.sin(a), 0] for reach, a in [(3, 0), (1, 0), (4, 0), (2, 0), (5, 0.5)]]
    assert project(np.array(along), params).ranges.tolist() == pytest.approx(ranges)


def test_nothing_is_half_a_beam_off() -> None:
    # Upstream reports the lower edge of a beam; a centered one is off by as much to the left as to the right.
    angles = np.linspace(-3, 3, 50_000).astype(np.float32)
    for geometry, bias in (("centered", 0.0), ("upstream", 0.5)):
        params = replace(CENTERED, geometry=geometry)
        layout = params.layout
        bins = plain.bins_of(angles, rule_of(params), layout.count)
        off = (angles.astype(np.float64) - layout.angle_min - bins * layout.angle_increment) / layout.angle_increment
        assert off.mean() == pytest.approx(bias, abs=1e-2)


def wall(reduce: str, far: float = 0.0) -> NDArray[np.float32]:
    """Distances to a wall 4 m ahead, as 16 rings with 1 cm of noise see it; its right half is ``far`` metres away."""
    random = np.random.default_rng(11)
    angles = np.tile(np.arange(-0.6, 0.6, math.radians(0.2)), 16)
    ahead = np.where((angles < 0.006) & (far > 0), far, 4.0) + random.normal(0, 0.01, angles.size)
    points = np.stack([ahead, ahead * np.tan(angles), np.zeros(angles.size)], axis=1)
    ranges = project(points, replace(CENTERED, angle_min=-0.5, angle_max=0.5, reduce=reduce)).ranges
    cosines = np.cos(-0.5 + np.arange(ranges.size) * CENTERED.layout.angle_increment).astype(np.float32)
    ahead_of_beams: NDArray[np.float32] = ranges * cosines
    return ahead_of_beams


def test_the_surface_of_a_wall_is_where_it_is_and_the_closest_return_in_front_of_it() -> None:
    assert np.median(wall("min")) == pytest.approx(4 - 0.03, abs=0.015)
    assert np.median(wall("surface")) == pytest.approx(4, abs=0.002)
    assert np.abs(wall("surface") - 4).max() < 0.02


def test_a_mean_is_between_near_and_far_and_a_surface_never() -> None:
    def between(reduce: str) -> int:
        seen = wall(reduce, far=8.0)
        return int(np.count_nonzero((seen > 4.2) & (seen < 7.8)))

    assert between("mean") == 1
    assert between("surface") == between("min") == 0


def test_an_empty_cloud() -> None:
    scan = project(np.empty((0, 3)), CENTERED)
    assert scan.counts == PointCounts()
    assert np.isinf(scan.ranges).all()


def test_shapes_that_do_not_fit() -> None:
    one, two = np.zeros(3), np.zeros(4)
    with pytest.raises(ValueError, match="x, y and z have the shapes"):
        Projector(CENTERED)(one, one, two)
    with pytest.raises(ValueError, match=r"intensities have the shape \(4,\), expected that of x, \(3,\)"):
        Projector(CENTERED)(one, one, one, None, two)


def test_the_reference_is_upstreams_where_both_apply() -> None:
    cloud = room(500)
    params = replace(CENTERED, geometry="upstream", no_return="inf")
    ranges, _, counts = reference([(*point, 0.0) for point in cloud.tolist()], params)
    expected, where = reference_scan(cloud.tolist(), params)
    assert ranges == expected.tolist()
    assert counts == where
