from __future__ import annotations

import ctypes
import math
import mmap
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as any_of

from core.reference import reference_scan
from pc2scan import ProjectionParams
from pc2scan.core import kernel, plain
from pc2scan.core.moving import MovingTransform
from pc2scan.core.project import Projector
from pc2scan.core.rigid import Rigid

if TYPE_CHECKING:
    from numpy.typing import NDArray

pytestmark = pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")

GRIDS = {
    "defaults": (-math.pi, math.pi, math.pi / 180),
    "0.01 degrees": (-math.pi, math.pi, math.pi / 18000),
    "odd increment": (-math.pi, math.pi, 0.0061359),
    "very fine": (-math.pi, math.pi, 3e-6),
    "one beam": (-math.pi, math.pi, 7.0),
    "front": (-0.5, 0.5, 0.01),
    "cut last beam": (-0.3, 2.0, 0.0061),
    "0 to 2 pi": (0.0, 2 * math.pi, 0.004),
    "beyond pi": (-10.0, 10.0, 0.01),
    "behind": (3.0, 3.3, 0.001),
    "nowhere": (4.0, 5.0, 0.1),
    "far away": (-1000.0, 1000.0, 0.05),
    "sliver": (0.1, 0.1001, 1e-6),
    "one sliver": (0.1, 0.1001, 1.0),
}


def edge_points(grid: tuple[float, float, float], rng: np.random.Generator, count: int = 20_000) -> NDArray[np.float32]:
    """Points on the edges of beams and on both limits, and some float32 beside them: (2, M)."""
    low, high, increment = (float(np.float32(value)) for value in grid)
    edges = low + increment * rng.integers(0, math.ceil((high - low) / increment) + 2, count)
    edges = np.concatenate([edges, np.repeat([low, high, 0.0, np.pi, -np.pi, np.pi / 2], count // 40)])
    edges = edges[np.abs(edges) < 3.2]
    radius = 10.0 ** rng.uniform(-2, 3, edges.size)
    points = np.stack([radius * np.cos(edges), radius * np.sin(edges)]).astype(np.float32)
    points.view(np.int32)[...] += rng.integers(-3, 4, points.shape, dtype=np.int32)
    # One below zero's bit pattern is a NaN.
    return points[:, ~np.isnan(points).any(axis=0)]


def points_of_all_kinds(rng: np.random.Generator) -> NDArray[np.float32]:
    wide = rng.normal(size=(2, 20_000))
    special = np.array([0.0, -0.0, 1e-45, -1e-45, 1.0, -1.0, 3.4e38, -3.4e38, np.inf, -np.inf])
    kinds = [
        wide,
        rng.integers(-9, 10, (2, 20_000)),
        wide * 1e-41,
        wide[:, :2000] * 3e37,
        wide * np.array([[1.0], [1e-6]]),
        wide * np.array([[1e-6], [1.0]]),
        wide * 10.0 ** rng.uniform(-40, 38, wide.shape),
        np.stack(np.meshgrid(special, special)).reshape(2, -1),
    ]
    with np.errstate(over="ignore"):
        return np.concatenate(kinds, axis=1).astype(np.float32)


#: The row of a transform that changes nothing.
_STILL = np.append(np.eye(3).ravel(), np.zeros(3))


def angles(x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    out = np.empty_like(x)
    kernel.angles(x, y, out)
    return out


def test_angles_are_atan2_rounded_to_float32() -> None:
    rng = np.random.default_rng(7)
    points = [points_of_all_kinds(rng), *(edge_points(grid, rng, 2000) for grid in GRIDS.values())]
    x, y = np.concatenate(points, axis=1)
    expected = [math.atan2(up, across) for across, up in zip(x.tolist(), y.tolist(), strict=True)]
    np.testing.assert_array_equal(angles(x, y).view(np.int32), np.array(expected, np.float32).view(np.int32))


def test_angles_between_two_float32_are_rounded_to_the_nearer() -> None:
    # Pairs whose angle is within 1e-12 of the middle of two float32: the short way cannot tell, and knows it.
    rng = np.random.default_rng(8)
    x, y = (rng.uniform(0.5, 2, 3_000_000).astype(np.float32) for _ in "xy")
    exact = np.arctan2(y, x, dtype=np.float64)
    nearest = exact.astype(np.float32).astype(np.float64)
    off = np.abs(exact - nearest) / np.spacing(nearest.astype(np.float32))
    hard = np.flatnonzero(off > 0.4999985)
    assert hard.size > 5
    x, y = x[hard], y[hard]
    expected = [math.atan2(up, across) for across, up in zip(x.tolist(), y.tolist(), strict=True)]
    np.testing.assert_array_equal(angles(x, y), np.array(expected, np.float32))


def test_where_two_roundings_are_not_one() -> None:
    """What the docs say of one point in a billion; should this fail, they are no longer true."""
    x, y = np.array([-8.08657455, 36.3], np.float32), np.array([5.3598547, 0.0], np.float32)
    # The angle is 2.556265473365783883: above the middle of two float32, and rounded to it in float64.
    assert math.atan2(float(y[0]), float(x[0])).hex() == "0x1.4733b50000000p+1"
    assert float(angles(x, y)[0]).hex() == "0x1.4733b40000000p+1"


@pytest.mark.parametrize("size", [0, 1, 511, 512, 513, 1500])
def test_angles_of_any_number_of_points(size: int) -> None:
    x, y = np.random.default_rng(9).normal(size=(2, size)).astype(np.float32)
    np.testing.assert_array_equal(angles(x, y), np.arctan2(y, x, dtype=np.float64).astype(np.float32))


@pytest.mark.parametrize("name", GRIDS)
def test_points_on_edges_fall_into_the_beam_of_their_exact_angle(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(7)
    low, high, increment = GRIDS[name]
    params = ProjectionParams(
        angle_min=low, angle_max=high, angle_increment=increment, min_height=-1.0, max_height=1.0, range_min=0.02
    )
    x, y = np.concatenate([edge_points(GRIDS[name], rng), points_of_all_kinds(rng)], axis=1)
    z = np.zeros_like(x)
    compiled = Projector(params)(x, y, z)
    few = slice(None, None, 37)
    ranges, counts = reference_scan(zip(x[few].tolist(), y[few].tolist(), z[few].tolist(), strict=True), params)
    scan = Projector(params)(x[few], y[few], z[few])
    np.testing.assert_array_equal(scan.ranges, ranges)
    assert scan.counts == counts
    monkeypatch.setattr(kernel, "project", plain.project)
    scan = Projector(params)(x, y, z)
    np.testing.assert_array_equal(scan.ranges, compiled.ranges)
    assert scan.counts == compiled.counts


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("together", [False, True], ids=["apart", "together"])
def test_transformed_points_are_summed_in_one_order(
    dtype: Any, together: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(10)
    cloud = rng.normal(scale=20, size=(3, 50_000)).astype(dtype)
    # Coordinates that follow each other are taken eight at a time where the processor can.
    x, y, z = np.ascontiguousarray(cloud.T).T if together else cloud
    moved = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    projector = Projector(ProjectionParams(min_height=-3.0, max_height=3.0, angle_increment=1e-4))
    compiled = projector(x, y, z, moved)
    monkeypatch.setattr(kernel, "project", plain.project)
    scan = projector(x, y, z, moved)
    np.testing.assert_array_equal(scan.ranges, compiled.ranges)
    assert scan.counts == compiled.counts


usual = st.floats(-30, 30, width=32)
coordinates = st.one_of(usual, st.floats(width=32), st.sampled_from([0.0, -0.0, 1e-45, 3.4e38, math.nan, -math.inf]))
component = st.one_of(st.floats(-1, 1), st.sampled_from([0.0, -0.0, 1.0, -1.0, math.sqrt(0.5)]))


@st.composite
def transforms(draw: st.DrawFn) -> Rigid | None:
    quaternion = [draw(component) for _ in range(4)]
    if not any(quaternion):
        return None
    translation = [draw(st.one_of(st.floats(-20, 20), st.floats(allow_nan=False, allow_infinity=False))) for _ in "xyz"]
    return Rigid(np.array(quaternion), np.array(translation))


@settings(deadline=None, max_examples=300)
@given(
    points=st.integers(0, 40).flatmap(lambda count: any_of.arrays(np.float32, (count, 3), elements=coordinates)),
    dtype=st.sampled_from(["<f4", ">f4", "<f8"]),
    step=st.sampled_from([12, 16, 22, 32]),
    moved=transforms(),
    reduced=st.sampled_from(["min", "max"]),
    rounding=st.sampled_from(["correct", "glibc-2.40"]),
)
def test_compiled_loops_equal_those_in_numpy_whatever_there_is(
    points: NDArray[np.float32], dtype: str, step: int, moved: Rigid | None, reduced: Any, rounding: Any
) -> None:
    size = np.dtype(dtype).itemsize
    layout = {"names": [*"xyz"], "formats": [dtype] * 3, "offsets": [0, size, 2 * size], "itemsize": size // 4 * step}
    record = np.dtype(layout)  # type: ignore[call-overload]
    cloud = np.zeros(len(points), record)
    with np.errstate(invalid="ignore"):  # a NaN may be one that signals
        for name, column in zip("xyz", points.T, strict=True):
            cloud[name] = column
    params = ProjectionParams(
        min_height=-5.0, max_height=5.0, angle_increment=0.1, reduce=reduced, angle_rounding=rounding
    )
    project, transform = Projector(params), None if moved is None else moved.as_float32()
    compiled = project(cloud["x"], cloud["y"], cloud["z"], transform)
    with pytest.MonkeyPatch.context() as patch:
        for loop in ("angles", "gather", "project"):
            patch.setattr(kernel, loop, getattr(plain, loop))
        scan = project(cloud["x"], cloud["y"], cloud["z"], transform)
    assert scan.ranges.tobytes() == compiled.ranges.tobytes()
    assert scan.counts == compiled.counts


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("moves", [False, True])
def test_every_datatype_of_a_field_is_read(order: str, moves: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(11)
    moved = (np.linalg.qr(rng.normal(size=(3, 3)))[0], np.array([0.1, 0.2, 0.3])) if moves else None
    projector = Projector(ProjectionParams(min_height=-1e9, max_height=1e9, angle_increment=1e-3))
    types = ["i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"]
    cloud = np.zeros(3000, np.dtype([(name, order + name) for name in types]))
    for name in types:
        bits = rng.integers(0, 256, cloud[name].nbytes, dtype=np.uint8)
        cloud[name] = bits.view(name) if name[0] != "f" else rng.normal(scale=50, size=cloud.size)
    for first, name in enumerate(types):
        xyz = [cloud[types[(first + step) % len(types)]] for step in range(3)]
        for x, y, z in (xyz, [cloud[name]] * 3):
            compiled = projector(x, y, z, moved)
            with monkeypatch.context() as patch:
                patch.setattr(kernel, "project", plain.project)
                scan = projector(x, y, z, moved)
            np.testing.assert_array_equal(scan.ranges, compiled.ranges)
            assert scan.counts == compiled.counts
            assert scan.counts.used


@pytest.mark.usefixtures("lanes")
@pytest.mark.parametrize("moves", [False, True])
def test_points_one_behind_the_other_are_taken_as_any_others(moves: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is between them and behind the last, in rows or not, and where none or all of them are dropped."""
    rng = np.random.default_rng(12)
    moved = (np.linalg.qr(rng.normal(size=(3, 3)))[0], np.array([0.1, 0.2, 0.3])) if moves else None
    projector = Projector(ProjectionParams(min_height=-1.0, max_height=1.0, range_max=30.0, angle_increment=0.01))
    shapes = [(count,) for count in range(42)] + [(2500,), (1, 30), (7, 5), (3, 1000)]
    for step in (12, 13, 16, 22, 32, 48):
        for shape in shapes:
            size = math.prod(shape) * step
            memory = rng.integers(0, 256, size, dtype=np.uint8)
            x, y, z = (np.ndarray(shape, "<f4", memory, at, (*(shape[-1] * step,) * (len(shape) - 1), step))
                       for at in (0, 4, 8)) if size else (np.empty(shape, "<f4"),) * 3  # fmt: skip
            if size:
                x[...], y[...], z[...] = rng.normal(scale=(8, 8, 1), size=(*shape, 3)).T.reshape(3, *shape)
                for axis in (x, y, z):
                    axis[rng.random(shape) < 0.1] = rng.choice([np.nan, np.inf, -np.inf, 0.0])
            for lift in (0.0, 5.0):
                z += np.float32(lift)
                compiled = projector(x, y, z, moved)
                with monkeypatch.context() as patch:
                    patch.setattr(kernel, "project", plain.project)
                    scan = projector(x, y, z, moved)
                np.testing.assert_array_equal(scan.ranges, compiled.ranges)
                assert scan.counts == compiled.counts
                # With gaps between rows.
                part = projector(x[..., 2:], y[..., 2:], z[..., 2:], moved)
                alone = projector(x[..., 2:].copy(), y[..., 2:].copy(), z[..., 2:].copy(), moved)
                np.testing.assert_array_equal(part.ranges, alone.ranges)
                assert part.counts == alone.counts


@pytest.mark.skipif(sys.platform != "linux", reason="protects memory as Linux does")
@pytest.mark.usefixtures("lanes")
@pytest.mark.parametrize("step", [12, 16, 32])
def test_nothing_behind_the_last_point_is_read(step: int) -> None:
    """A process that reads the page behind the cloud dies."""
    page = mmap.PAGESIZE
    memory = mmap.mmap(-1, 2 * page)
    start = np.frombuffer(memory, np.uint8).ctypes.data
    libc = ctypes.CDLL(None)
    assert libc.mprotect(ctypes.c_void_p(start + page), ctypes.c_size_t(page), 0) == 0
    for count in range(1, page // step):
        first = page - count * step + step - 12
        x, y, z = (np.ndarray((count,), "<f4", memory, first + at, (step,)) for at in (0, 4, 8))
        project = Projector(ProjectionParams(min_height=-1.0, max_height=1.0))
        assert project(x, y, z).counts.total == count
        if step == 12:
            continue
        z[...], z[::3] = 0.0, 50.0
        times = np.ndarray((count,), "<u4", memory, first - 4, (step,))
        assert kernel.span(x, times)[2] == count
        for timed in (False, True):
            motion = MovingTransform(times, 0.0, 1e-9, np.array([0.0, 1.0]), np.tile(_STILL, (3, 1)), timed)
            assert project(x, y, z, motion).counts.height == len(z[::3])


def test_arrays_that_do_not_fit_together_are_refused() -> None:
    rule, move, ranges = np.zeros(13), np.zeros(12, np.float32), np.zeros(4, np.float32)
    one, two, double = np.zeros(1, np.float32), np.zeros(2, np.float32), np.zeros(1)
    cube, small, long = np.zeros((1, 1, 1), np.float32), np.zeros(1, np.float16), np.zeros(1, np.int64)
    fixed = ranges.copy()
    fixed.setflags(write=False)
    bins, numbers = np.zeros(1, np.int32), np.zeros(1, np.int64)
    triples: list[tuple[Any, Any, Any]] = [
        (one, one, two),
        (one, one, one[None]),
        (cube, cube, cube),
        (small, small, small),
        (one, long, one),
    ]
    for xyz in triples:
        with pytest.raises(ValueError, match="coordinates"):
            kernel.project(*xyz, rule, None, ranges, 1.0, 1.0)
        with pytest.raises(ValueError, match="coordinates"):
            kernel.gather(*xyz, rule, None, 1, bins, one, numbers)
    triples = [(rule[:12], None, ranges), (rule, move[:11], ranges), (rule, rule, ranges), (rule, None, rule)]
    for others in triples:
        with pytest.raises(ValueError, match="length or item size"):
            kernel.project(one, one, one, *others, 1.0, 1.0)
    triples = [(bins[:0], one, numbers), (bins, two, numbers), (bins, one, bins)]
    for outputs in triples:
        with pytest.raises(ValueError, match="length or item size"):
            kernel.gather(one, one, one, rule, None, 1, *outputs)
    with pytest.raises(ValueError, match="read-only"):
        kernel.project(one, one, one, rule, None, fixed, 1.0, 1.0)
    with pytest.raises(TypeError):
        kernel.project(one, one, one, rule, [1.0] * 12, ranges, 1.0, 1.0)  # type: ignore[arg-type]
    triples = [(one, two, two), (two, one, two), (two, two, one), (double, double, double)]
    for arrays in triples:
        with pytest.raises(ValueError, match="length or item size"):
            kernel.angles(*arrays)
