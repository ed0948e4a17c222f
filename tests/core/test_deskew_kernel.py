"""Points transformed at their own times: the compiled loop and the one in NumPy agree to the bit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pc2scan.core import kernel, plain
from pc2scan.core.moving import MovingTransform
from pc2scan.core.params import ProjectionParams
from pc2scan.core.rule import rule_of

#: What runs, even while a fixture replaces it.
COMPILED = kernel.deskew


def cloud(rng: np.random.Generator, dtype: str, shape: tuple[int, ...]) -> list[Any]:
    """Coordinates with gaps between the points, and between the rows if there are several."""
    wide = np.zeros((*shape[:-1], shape[-1] + 3), np.dtype([("x", dtype), ("y", dtype), ("pad", "u1"), ("z", dtype)]))
    points = wide[..., : shape[-1]]
    for name in "xyz":
        values = rng.normal(size=shape) * 20
        if dtype[1] == "f":
            values[rng.random(shape) < 0.05] = np.nan
            values[rng.random(shape) < 0.01] = np.inf
        points[name] = values
    return [points[name] for name in "xyz"]


def rows(rng: np.random.Generator, nodes: int) -> Any:
    """At the nodes and between them."""
    found = rng.normal(size=(2 * nodes - 1, 12))
    found[rng.random(2 * nodes - 1) < 0.1] = np.nan
    return found


def straight(transforms: Any) -> Any:
    """Rows at the nodes, with the means of neighbours between them."""
    found = np.empty((2 * len(transforms) - 1, 12))
    found[::2], found[1::2] = transforms, (transforms[:-1] + transforms[1:]) / 2
    return found


def same_bits(one: Any, other: Any) -> None:
    nan = np.isnan(one)
    np.testing.assert_array_equal(nan, np.isnan(other))
    np.testing.assert_array_equal(one[~nan].view(np.int32), other[~nan].view(np.int32))


@pytest.mark.usefixtures("lanes")
@pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8", "<i2", ">u4"])
@pytest.mark.parametrize("order", ["in time", "by ring", "random"])
def test_the_compiled_loop_does_what_numpy_does(dtype: str, order: str) -> None:
    rng = np.random.default_rng(len(order))
    for shape in ((1,), (700,), (3, 257), (0,)):
        x, y, z = cloud(rng, dtype, shape)
        size = int(np.prod(shape))
        times = rng.uniform(-0.05, 1.05, size)
        times[rng.random(size) < 0.05] = np.nan
        for nodes in (2, 3, 17, 400):
            node_times = np.unique([*rng.uniform(0, 1, nodes - 2).tolist(), 0.0, 1.0])
            transforms = rows(rng, node_times.size)
            on_nodes = rng.random(size) < 0.2
            times[on_nodes] = rng.choice(node_times, int(on_nodes.sum()))
            if order != "random":
                times = (
                    np.sort(times)
                    if order == "in time"
                    else np.concatenate([np.sort(t) for t in np.array_split(times, 3)])
                )
            outs = np.zeros((2, size, 3), np.float32)
            motion = MovingTransform(times.reshape(shape), 0.0, 1.0, node_times, transforms)
            assert COMPILED(x, y, z, motion, outs[0]) == plain.deskew(x, y, z, motion, outs[1])
            same_bits(outs[0], outs[1])


RULES = [
    rule_of(ProjectionParams(min_height=low, max_height=high, range_min=1.0, angle_min=-2.0, angle_max=2.5))
    for low, high in ((-100.0, 100.0), (-0.5, 0.5), (-1.0, math.inf))
]


@pytest.mark.usefixtures("lanes")
@pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8", "<i2"])
@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize("times_type", ["<u4", "<f4", "<f8", ">u4", "<i4", "<u8"])
def test_points_are_projected_where_they_are_at_their_own_times(dtype: str, packed: bool, times_type: str) -> None:
    rng = np.random.default_rng(int(packed))
    project, gather = kernel.project, kernel.gather
    for shape in ((1,), (15,), (16,), (17,), (700,), (3, 257), (2, 1024)):
        record = np.dtype([("x", dtype), ("y", dtype), ("z", dtype), ("t", times_type), ("pad", "V8")])
        cloud = np.zeros(shape, record)
        for name in "xyz":
            cloud[name] = rng.normal(size=shape) * 5
            if dtype[1] == "f":
                cloud[name][rng.random(shape) < 0.05] = np.nan
        cloud["t"] = np.sort(rng.integers(0, 1_100_000, shape))
        if times_type[1] == "f":
            cloud["t"][rng.random(shape) < 0.05] = np.nan
        x, y, z, times = (cloud[name] if packed else cloud[name].copy() for name in "xyzt")
        nodes = np.linspace(0.0, 1.0, 40)
        transforms = straight(rng.normal(size=(40, 12)))
        transforms[9] = np.nan
        motion = MovingTransform(times, 1000.0, 1e-6, nodes, transforms)
        for rule in RULES:
            ranges = np.zeros((2, 90), np.float32)
            one = project(x, y, z, rule, motion, ranges[0], math.inf, 9.0)
            assert one == plain.project(x, y, z, rule, motion, ranges[1], math.inf, 9.0)
            np.testing.assert_array_equal(ranges[0], ranges[1])
            assert len(one) == 7
            outs = [
                (np.zeros(x.size, np.int32), np.zeros(x.size, np.float32), np.zeros(x.size, np.int64)) for _ in "12"
            ]
            assert one == gather(x, y, z, rule, motion, 90, *outs[0])
            assert one == plain.gather(x, y, z, rule, motion, 90, *outs[1])
            for own, other in zip(*outs, strict=True):
                np.testing.assert_array_equal(own, other)
            # And as if they had been moved first.
            moved = np.zeros((x.size, 3), np.float32)
            lost = kernel.deskew(x, y, z, motion, moved)
            alone = np.zeros(90, np.float32)
            counts = project(moved[:, 0], moved[:, 1], moved[:, 2], rule, None, alone, math.inf, 9.0)
            np.testing.assert_array_equal(alone, ranges[0])
            assert (counts[0] - sum(lost), *counts[1:], *lost) == one


@pytest.mark.usefixtures("lanes")
@pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")
@pytest.mark.parametrize("times_type", ["<u4", "<f4", "<f8", "<u8"])
@pytest.mark.parametrize("tilt", [0.0, 1e-3, 0.3])
@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
def test_points_beside_the_heights_are_rejected_without_their_times(times_type: str, tilt: float, share: float) -> None:
    rng = np.random.default_rng(int(100 * share))
    for shape in ((9,), (17,), (33,), (5000,), (3, 2500)):
        record = np.dtype([(name, "<f4") for name in "xyz"] + [("t", times_type), ("pad", "V8")])
        cloud = np.zeros(shape, record)
        for name, width in (("x", 30.0), ("y", 30.0), ("z", 0.5 / share)):
            cloud[name] = rng.normal(size=shape) * width
        cloud["z"] *= 10.0 ** rng.integers(-3, 2, shape)
        for name in "xyz":
            cloud[name][rng.random(shape) < 0.03] = np.nan
            cloud[name][rng.random(shape) < 0.01] = rng.choice([np.inf, -np.inf, 3e38, -3e38, 1e17])
        cloud["t"] = np.linspace(1000, 900_000, cloud.size).reshape(shape)
        nodes = np.linspace(0.0, 1.0, 40)
        angles = rng.normal(size=40) * tilt
        transforms = np.zeros((40, 12))
        transforms[:, 4] = 1.0
        transforms[:, 0] = transforms[:, 8] = np.cos(angles)
        transforms[:, 6], transforms[:, 2] = np.sin(angles), -np.sin(angles)
        transforms[:, 9:] = rng.normal(size=(40, 3)) * [1, 1, tilt]
        motion = MovingTransform(cloud["t"], 0.0, 1e-6, nodes, straight(transforms), timed=True)
        x, y, z = (cloud[name] for name in "xyz")
        for low, high in ((-0.5, 0.5), (-0.01, 0.3), (-math.inf, 0.0), (1e6, math.inf), (-1e9, 1e9)):
            rule = rule_of(ProjectionParams(min_height=low, max_height=high, range_min=0.1))
            ranges = np.zeros((2, 90), np.float32)
            one = kernel.project(x, y, z, rule, motion, ranges[0], math.inf, 9.0)
            assert one == plain.project(x, y, z, rule, motion, ranges[1], math.inf, 9.0)
            np.testing.assert_array_equal(ranges[0], ranges[1])


@pytest.mark.usefixtures("lanes")
@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<i2"])
def test_the_span_of_values(dtype: str) -> None:
    rng = np.random.default_rng(3)
    for shape in ((0,), (1,), (5,), (700,), (3, 257)):
        for kind in ("<u4", "<f4", "<f8", ">i4"):
            x, values = rng.normal(size=shape).astype(dtype), (rng.normal(size=shape) * 1000).astype(kind)
            if dtype[1] == "f":
                x[rng.random(shape) < 0.2] = np.nan
            if kind[1] == "f":
                values[rng.random(shape) < 0.2] = np.nan
                values[rng.random(shape) < 0.1] = np.inf
            assert kernel.span(x, values) == plain.span(x, values)
            points = np.zeros(shape, np.dtype([("x", dtype), ("y", "V8"), ("values", kind), ("pad", "V4")]))
            points["x"], points["values"] = x, values
            assert kernel.span(points["x"], points["values"]) == plain.span(x, values)
            # With gaps between rows.
            part = points[..., 2:]
            assert kernel.span(part["x"], part["values"]) == plain.span(x[..., 2:], values[..., 2:])


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


@pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")
def test_the_compiled_loop_finds_the_nodes_that_numpy_finds() -> None:
    rng = np.random.default_rng(5)
    for samples in (0, 1, 2, 40):
        for frames in (0, 1, 3):
            stamps = tuple(np.unique(rng.integers(-50, 1050, samples)) for _ in range(frames))
            for begin, end in ((0, 1000), (0, 1), (-60, 1060), (400, 450), (1100, 1200), (-200, -100)):
                for step in (1, 7, 333, 5000):
                    found = kernel.nodes(stamps, begin, end, step)
                    assert found == plain.nodes(stamps, begin, end, step)
                    times = np.frombuffer(found[0], np.int64)
                    nodes = times[::2]
                    assert (nodes[0], nodes[-1]) == (begin, end)
                    assert 1 <= np.diff(nodes).min() <= np.diff(nodes).max() <= step
                    for own in stamps:
                        inside = (own >= begin) & (own <= end)
                        assert set(own[inside].tolist()) <= set(nodes.tolist())


@pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")
def test_nodes_that_cannot_be_are_refused() -> None:
    for begin, end, step in (
        (1, 1, 1),
        (2, 1, 1),
        (0, 1, 0),
        (0, 1, -1),
        (0, 1 << 60, 1),
        (-(1 << 62), 1 << 62, 1 << 62),
    ):
        with pytest.raises(ValueError, match="the end is not behind the beginning"):
            kernel.nodes((), begin, end, step)
    with pytest.raises(ValueError, match="length or item size"):
        kernel.nodes((np.zeros(3, np.int32),), 0, 9, 1)


@pytest.mark.usefixtures("loops")
def test_how_far_transforms_are_apart() -> None:
    rows_found = np.zeros((5, 12))
    rows_found[1, 0] = 50.0
    rows_found[2, :2], rows_found[2, 9] = (3.0, 4.0), 2.0
    rows_found[3] = np.nan
    rows_found[4, :2], rows_found[4, 10:] = (3.0, 3.0), (3.0, 4.0)
    assert kernel.apart(rows_found, None) == (25.0, 29.0)
    assert kernel.apart(rows_found, rows_found[4]) == (47.0**2 + 9.0, 29.0)
    assert np.isnan(kernel.apart(rows_found, rows_found[3])).all()
    assert np.isnan(kernel.apart(rows_found[:1], None)).all()
    random = np.random.default_rng(6).normal(size=(99, 12))
    for row in (None, random[7]):
        assert kernel.apart(random, row) == plain.apart(random, row)


@pytest.mark.usefixtures("loops")
def test_a_transform_is_interpolated_between_its_neighbours() -> None:
    identity = [1.0, 0, 0, 0, 1, 0, 0, 0, 1]
    transforms = np.array([[*identity, 0, 0, 0], [*identity, 1, 0, 0], [*identity, 1, 4, 0], [np.nan] * 12])
    node_times = np.array([0.0, 1.0, 3.0, 4.0])
    times = np.array([0.0, 0.25, 1.0, 2.0, 3.0, 3.5, 4.0, -0.1, 4.1, np.nan, 0.5])
    x = np.array([5.0] * 10 + [np.nan], np.float32)
    out = np.empty((x.size, 3), np.float32)
    motion = MovingTransform(times, 0.0, 1.0, node_times, straight(transforms))
    assert kernel.deskew(x, np.zeros_like(x), np.ones_like(x), motion, out) == (1, 4)
    expected = [5, 5.25, 6, 6, 6, *[np.nan] * 6]
    np.testing.assert_array_equal(out[:, 0], np.array(expected, np.float32))
    np.testing.assert_array_equal(out[:5, 1], np.array([0, 0, 0, 2, 4], np.float32))
    np.testing.assert_array_equal(out[:5, 2], np.ones(5, np.float32))


@pytest.mark.usefixtures("loops")
def test_a_part_without_a_transform_does_not_hide_its_ends() -> None:
    transforms = np.full((4, 12), np.nan)
    transforms[1:3] = [1, 0, 0, 0, 1, 0, 0, 0, 1, 7, 0, 0]
    node_times = np.array([0.0, 1.0, 2.0, 3.0])
    out = np.empty((5, 3), np.float32)
    zeros = np.zeros(5, np.float32)
    motion = MovingTransform(np.array([0.9, 1.0, 1.5, 2.0, 2.1]), 0.0, 1.0, node_times, straight(transforms))
    assert kernel.deskew(zeros, zeros, zeros, motion, out) == (0, 2)
    np.testing.assert_array_equal(out[:, 0], np.array([np.nan, 7, 7, 7, np.nan], np.float32))


@pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")
def test_arrays_of_other_sizes_are_refused() -> None:
    x = np.zeros(3, np.float32)
    times, nodes, transforms, out = np.zeros(3), np.arange(2.0), np.zeros((3, 12)), np.zeros((3, 3), np.float32)
    assert COMPILED(x, x, x, MovingTransform(times, 0.0, 1.0, nodes, transforms), out) == (0, 0)
    wrong: list[Any] = [
        (times[:2], nodes, transforms, out),
        (times, nodes[:1], transforms[:1], out),
        (times, nodes, transforms[:2], out),
        (times, nodes, transforms, out[:2]),
        (times, nodes.astype(np.float32), transforms, out),
        (times.astype(np.float16), nodes, transforms, out),
    ]
    for values, *others, into in wrong:
        with pytest.raises(ValueError, match=r"length or item size|fewer than two|coordinates' shape|of a type that"):
            COMPILED(x, x, x, MovingTransform(values, 0.0, 1.0, *others), into)
