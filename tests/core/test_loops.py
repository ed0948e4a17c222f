"""The compiled loops do what those in NumPy do, to the bit, whatever the layout, the types and the processor."""

from __future__ import annotations

import ctypes
import math
import mmap
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pc2scan import ProjectionParams
from pc2scan.core import kernel, plain
from pc2scan.core.project import ProjectedScan, Projector
from pc2scan.core.rigid import MovingTransform, Rigid
from pc2scan.core.rule import rule_of
from support.loops import BOTH_LOOPS, loops_in_numpy, needs_compiled, points_at_a_time

if TYPE_CHECKING:
    from numpy.typing import NDArray

PI = math.pi
#: How many points the compiled loops process at a time, if the processor has such vectors.
WIDTHS = [16, 8, 1]
TYPES = ["<f4", "<f8", "i1", "u1", "<i2", "<u2", "<i4", "<u4", ">f4", ">f8", ">i2", ">u2", ">i4", ">u4"]
#: Whole vectors, and some points more or less; rows.
SHAPES = [(0,), (1,), (9,), (15,), (16,), (17,), (33,), (41,), (700,), (1, 30), (7, 5), (3, 257), (2, 1024)]
seeds = st.integers(0, 2**32 - 1)
shapes = st.sampled_from(SHAPES)
usual = st.just(("<f4",) * 3)
types = st.one_of(
    usual, usual, st.sampled_from(TYPES).map(lambda kind: (kind,) * 3), st.tuples(*[st.sampled_from(TYPES)] * 3)
)
#: Bytes behind each point, and points behind each row.
gaps = st.tuples(st.sampled_from([0, 1, 4, 10, 20]), st.sampled_from([0, 3]))


def fields(
    rng: np.random.Generator, shape: tuple[int, ...], kinds: tuple[str, ...], gaps: tuple[int, int], scale: float = 8.0
) -> list[NDArray[Any]]:
    """Coordinates in records, among bytes of any value; of the further types, fields to fill."""
    record = np.dtype([(f"f{k}", kind) for k, kind in enumerate(kinds)] + ([("", f"V{gaps[0]}")] if gaps[0] else []))
    wide = (*shape[:-1], shape[-1] + gaps[1])
    cloud = np.frombuffer(rng.bytes(math.prod(wide) * record.itemsize), record).reshape(wide).copy()[..., : shape[-1]]
    for axis in range(3):
        values = rng.normal(scale=(scale, scale, 1.0)[axis], size=shape)
        kind = np.dtype(kinds[axis]).kind
        if kind == "f":
            values[rng.random(shape) < 0.08] = rng.choice([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, 3e38])
        cloud[f"f{axis}"] = np.abs(values) if kind == "u" else values
    return [cloud[f"f{k}"] for k in range(len(kinds))]


def assert_equal(one: ProjectedScan, other: ProjectedScan) -> None:
    assert one.ranges.tobytes() == other.ranges.tobytes()
    assert one.counts == other.counts


# Angles.

GRIDS = {
    "defaults": (-PI, PI, PI / 180), "0.01 degrees": (-PI, PI, PI / 18000), "odd increment": (-PI, PI, 0.0061359),
    "very fine": (-PI, PI, 3e-6), "one beam": (-PI, PI, 7.0), "front": (-0.5, 0.5, 0.01),
    "cut last beam": (-0.3, 2.0, 0.0061), "0 to 2 pi": (0.0, 2 * PI, 0.004), "beyond pi": (-10.0, 10.0, 0.01),
    "behind": (3.0, 3.3, 0.001), "nowhere": (4.0, 5.0, 0.1), "far away": (-1000.0, 1000.0, 0.05),
    "sliver": (0.1, 0.1001, 1e-6), "one sliver": (0.1, 0.1001, 1.0),
}  # fmt: skip


def edge_points(grid: tuple[float, float, float], rng: np.random.Generator, count: int) -> NDArray[np.float32]:
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


def points_of_all_kinds(rng: np.random.Generator, count: int) -> NDArray[np.float32]:
    wide = rng.normal(size=(2, count))
    special = np.array([0.0, -0.0, 1e-45, -1e-45, 1.0, -1.0, 3.4e38, -3.4e38, np.inf, -np.inf])
    kinds = [
        wide,
        rng.integers(-9, 10, (2, count)),
        wide * 1e-41,
        wide[:, : count // 10] * 3e37,
        wide * np.array([[1.0], [1e-6]]),
        wide * np.array([[1e-6], [1.0]]),
        wide * 10.0 ** rng.uniform(-40, 38, wide.shape),
        np.stack(np.meshgrid(special, special)).reshape(2, -1),
    ]
    with np.errstate(over="ignore"):
        return np.concatenate(kinds, axis=1).astype(np.float32)


def angles(x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    out = np.empty_like(x)
    kernel.angles(x, y, out)
    return out


#: x and y of angles that are within 1e-13 of the middle of two float32: the short way cannot tell, and knows it.
BETWEEN = [
    ("0x1.461ab8p+0", "0x1.83f942p+0"), ("0x1.9b8fp+0", "0x1.98c66cp-1"), ("0x1.3743b6p+0", "0x1.38c54ep+0"),
    ("0x1.69ca5ep-1", "0x1.8d9730p-1"), ("0x1.c55d2p+0", "0x1.ba76e2p-1"), ("0x1.fb461cp-1", "0x1.fcab82p-1"),
    ("0x1.2c8896p+0", "0x1.d53b3ap+0"), ("0x1.e20c0ap-1", "0x1.148aeep+0"), ("0x1.6314acp+0", "0x1.7519040p+0"),
]  # fmt: skip


def test_angles_are_atan2_rounded_to_float32() -> None:
    rng = np.random.default_rng(7)
    between = np.array([[float.fromhex(text) for text in pair] for pair in BETWEEN], np.float32).T
    points = [points_of_all_kinds(rng, 5000), *(edge_points(grid, rng, 1000) for grid in GRIDS.values()), between]
    x, y = np.concatenate(points, axis=1)
    expected = [math.atan2(up, across) for across, up in zip(x.tolist(), y.tolist(), strict=True)]
    bits = np.array(expected, np.float32).view(np.int32)
    for loops in BOTH_LOOPS:
        with loops():
            np.testing.assert_array_equal(angles(x, y).view(np.int32), bits)
            for size in (0, 1, 511, 512, 513):
                np.testing.assert_array_equal(angles(x[:size], y[:size]).view(np.int32), bits[:size])


# Points at one time.


# Points at their own times.


def straight(transforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows at the nodes, with the means of neighbours between them."""
    found = np.empty((2 * len(transforms) - 1, 12))
    found[::2], found[1::2] = transforms, (transforms[:-1] + transforms[1:]) / 2
    return found


def tilting(rng: np.random.Generator, nodes: int, tilt: float) -> NDArray[np.float64]:
    """Transforms of a sensor that pitches by some radians as it drives."""
    angles, transforms = rng.normal(size=nodes) * tilt, np.zeros((nodes, 12))
    transforms[:, 4] = 1.0
    transforms[:, 0] = transforms[:, 8] = np.cos(angles)
    transforms[:, 6], transforms[:, 2] = np.sin(angles), -np.sin(angles)
    transforms[:, 9:] = rng.normal(size=(nodes, 3)) * [1, 1, tilt]
    return straight(transforms)


def motion_of(rng: np.random.Generator, times: NDArray[Any], kind: str, nodes: int) -> MovingTransform:
    """Fill in times, in an order, and make a motion of a kind: of one that covers all times, or not."""
    count = times.size
    node_times = np.unique([*rng.uniform(0, 1, nodes - 2).tolist(), 0.0, 1.0])
    if kind in {"level", "tilting"}:
        times[...] = np.linspace(1000, 900_000, count).reshape(times.shape)
        rows = tilting(rng, node_times.size, 1e-3 if kind == "level" else 0.3)
        return MovingTransform(times, 0.0, 1e-6, node_times, rows, timed=True)
    seconds = rng.uniform(-0.05 if times.dtype.kind != "u" else 0, 1.05, count)
    on_nodes = rng.random(count) < 0.2
    seconds[on_nodes] = rng.choice(node_times, int(on_nodes.sum()))
    if kind == "in time":
        seconds = np.sort(seconds)
    elif kind == "zeros":
        # As drivers write for points without a return; some are just before the first time.
        seconds[rng.random(count) < 0.7] = 0.0
        seconds[rng.random(count) < 0.1] = -1e-6 if times.dtype.kind != "u" else 0.0
    elif kind == "by ring":
        seconds = np.concatenate([np.sort(part) for part in np.array_split(seconds, 3)])
    if times.dtype.kind == "f":
        seconds[rng.random(count) < 0.05] = np.nan
    with np.errstate(invalid="ignore"):
        times[...] = (seconds * 1e6).reshape(times.shape)
    rows = rng.normal(size=(2 * node_times.size - 1, 12))
    rows[rng.random(len(rows)) < 0.1] = np.nan
    return MovingTransform(times, 1000.0 if kind == "in time" else 0.0, 1e-6, node_times, rows)


RULES = [
    rule_of(ProjectionParams(min_height=low, max_height=high, range_min=0.1, angle_min=-2.0, angle_max=2.5))
    for low, high in ((-100.0, 100.0), (-0.5, 0.5), (-0.01, 0.3), (-math.inf, 0.0), (1e6, math.inf))
]


def same_bits(one: NDArray[np.float32], other: NDArray[np.float32]) -> None:
    nan = np.isnan(one)
    np.testing.assert_array_equal(nan, np.isnan(other))
    np.testing.assert_array_equal(one[~nan].view(np.int32), other[~nan].view(np.int32))


#: The seed, the shape, the types of x, y and z, and gaps.
clouds = st.tuples(seeds, shapes, types, gaps)


@needs_compiled
@given(
    clouds,
    st.booleans(),
    st.builds(
        ProjectionParams,
        geometry=st.sampled_from(["upstream", "centered"]),
        min_height=st.just(-1.0),
        max_height=st.sampled_from([1.0, 50.0]),
        range_max=st.just(30.0),
        angle_increment=st.sampled_from([0.1, 0.001]),
        reduce=st.sampled_from(["min", "max"]),
        angle_rounding=st.sampled_from(["correct", "glibc-2.40"]),
    ),
)
def test_compiled_loops_equal_those_in_numpy(cloud: Any, apart: bool, params: ProjectionParams) -> None:
    rng = np.random.default_rng(cloud[0])
    x, y, z = (axis.copy() if apart else axis for axis in fields(rng, *cloud[1:]))
    project = Projector(params)
    pose = rng.normal(size=4), rng.normal(size=3) * [1, 1, 0.2]
    for transform in (None, Rigid(*pose).as_float32()):
        with loops_in_numpy():
            expected = project(x, y, z, transform)
        for most in WIDTHS:
            with points_at_a_time(most):
                assert_equal(project(x, y, z, transform), expected)


@needs_compiled
@given(
    clouds,
    st.sampled_from(["<u4", "<f4", "<f8", ">u4", "<i4", "<u8"]),
    st.sampled_from(["in time", "by ring", "random", "zeros", "level", "tilting"]),
    st.sampled_from([2, 3, 17, 400]),
)
@example((7, (2, 2600), ("<f4",) * 3, (4, 3)), "<u4", "tilting", 2)
def test_moving_points_are_where_they_are_at_their_own_times(
    cloud: Any, times_type: str, kind: str, nodes: int
) -> None:
    seed, shape, kinds, gap = cloud
    rng = np.random.default_rng(seed)
    # Of the points, all to few are between the heights, and some of them far away.
    x, y, z, times = fields(rng, shape, (*kinds, times_type), gap, 30.0)
    if z.dtype.kind == "f":
        z *= 10.0 ** rng.integers(-3, 1)
    motion = motion_of(rng, times, kind, nodes)
    moved = np.zeros((2, x.size, 3), np.float32)
    lost = plain.deskew(x, y, z, motion, moved[0])
    for most in WIDTHS:
        with points_at_a_time(most):
            assert kernel.span(x, times) == plain.span(x, times)
            assert kernel.deskew(x, y, z, motion, moved[1]) == lost
        same_bits(*moved)
    for rule in RULES:
        ranges = np.zeros((3, 90), np.float32)
        found = [[np.zeros(x.size, dtype) for dtype in (np.int32, np.float32, np.int64)] for _ in "12"]
        counts = plain.project(x, y, z, rule, motion, ranges[0], math.inf, 9.0)
        assert len(counts) == 7
        assert plain.gather(x, y, z, rule, motion, 90, *found[0]) == counts  # type: ignore[arg-type]
        # As if they had been moved first.
        ahead, left, up = moved[0].T
        first = kernel.project(ahead, left, up, rule, None, ranges[1], math.inf, 9.0)
        np.testing.assert_array_equal(ranges[1], ranges[0])
        assert (first[0] - sum(lost), *first[1:], *lost) == counts
        for most in WIDTHS:
            with points_at_a_time(most):
                assert kernel.project(x, y, z, rule, motion, ranges[2], math.inf, 9.0) == counts
                assert kernel.gather(x, y, z, rule, motion, 90, *found[1]) == counts
            np.testing.assert_array_equal(ranges[2], ranges[0])
            for own, other in zip(*found, strict=True):
                np.testing.assert_array_equal(own, other)


def test_a_transform_is_interpolated_between_its_neighbours() -> None:
    identity = [1.0, 0, 0, 0, 1, 0, 0, 0, 1]
    transforms = np.array([[*identity, 0, 0, 0], [*identity, 1, 0, 0], [*identity, 1, 4, 0], [np.nan] * 12])
    node_times = np.array([0.0, 1.0, 3.0, 4.0])
    times = np.array([0.0, 0.25, 1.0, 2.0, 3.0, 3.5, 4.0, -0.1, 4.1, np.nan, 0.5])
    x = np.array([5.0] * 10 + [np.nan], np.float32)
    for loops in BOTH_LOOPS:
        out = np.empty((x.size, 3), np.float32)
        with loops():
            motion = MovingTransform(times, 0.0, 1.0, node_times, straight(transforms))
            assert kernel.deskew(x, np.zeros_like(x), np.ones_like(x), motion, out) == (1, 4)
        np.testing.assert_array_equal(out[:, 0], np.array([5, 5.25, 6, 6, 6, *[np.nan] * 6], np.float32))
        np.testing.assert_array_equal(out[:5, 1:], np.array([[0, 1], [0, 1], [0, 1], [2, 1], [4, 1]], np.float32))


# Other loops.


def test_a_frame_is_followed_as_numpy_follows_it() -> None:
    rng = np.random.default_rng(4)
    for samples in (0, 1, 2, 9):
        stamps = np.unique(rng.integers(0, 10**9, samples))
        poses = rng.normal(size=(max(1, samples), 7))
        poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1)[:, np.newaxis]
        times = np.concatenate([rng.integers(-(10**8), 11 * 10**8, 300), stamps])
        both = np.repeat(rng.normal(size=(1, times.size, 12)), 2, axis=0)
        kernel.follow(times, stamps, poses, both[0])
        plain.follow(times, stamps, poses, both[1])
        np.testing.assert_allclose(both[0], both[1], rtol=0, atol=1e-13)


@needs_compiled
@given(
    seeds,
    st.lists(st.sampled_from([0, 1, 2, 40]), max_size=3),
    st.sampled_from([(0, 1000), (0, 1), (-60, 1060), (400, 450), (1100, 1200), (-200, -100)]),
    st.sampled_from([1, 7, 333, 5000]),
)
def test_nodes_are_the_samples_and_at_most_a_step_apart(
    seed: int, samples: list[int], ends: tuple[int, int], step: int
) -> None:
    rng = np.random.default_rng(seed)
    stamps = tuple(np.unique(rng.integers(-50, 1050, count)) for count in samples)
    found = kernel.nodes(stamps, *ends, step)
    assert found == plain.nodes(stamps, *ends, step)
    nodes = np.frombuffer(found[0], np.int64)[::2]
    assert (nodes[0], nodes[-1]) == ends
    assert 1 <= np.diff(nodes).min() <= np.diff(nodes).max() <= step
    for own in stamps:
        assert set(own[(own >= ends[0]) & (own <= ends[1])].tolist()) <= set(nodes.tolist())


# Memory, and arrays that do not fit together.


@needs_compiled
@pytest.mark.skipif(sys.platform != "linux", reason="protects memory as Linux does")
@pytest.mark.parametrize("step", [12, 16, 32])
def test_nothing_behind_the_last_point_is_read(step: int) -> None:
    """A process that reads the page behind the cloud dies."""
    page = mmap.PAGESIZE
    memory = mmap.mmap(-1, 2 * page)
    start = np.frombuffer(memory, np.uint8).ctypes.data
    libc = ctypes.CDLL(None)
    assert libc.mprotect(ctypes.c_void_p(start + page), ctypes.c_size_t(page), 0) == 0
    still = np.tile(np.append(np.eye(3).ravel(), np.zeros(3)), (3, 1))
    project = Projector(ProjectionParams(min_height=-1.0, max_height=1.0))
    for most in WIDTHS:
        with points_at_a_time(most):
            for count in (*range(1, 70), 84, page // step - 1):
                first = page - count * step + step - 12
                x, y, z = (np.ndarray((count,), "<f4", memory, first + at, (step,)) for at in (0, 4, 8))
                assert project(x, y, z).counts.total == count
                if step == 12:
                    continue
                z[...], z[::3] = 0.0, 50.0
                times = np.ndarray((count,), "<u4", memory, first - 4, (step,))
                assert kernel.span(x, times)[2] == count
                for timed in (False, True):
                    motion = MovingTransform(times, 0.0, 1e-9, np.array([0.0, 1.0]), still, timed)
                    assert project(x, y, z, motion).counts.height == len(z[::3])
