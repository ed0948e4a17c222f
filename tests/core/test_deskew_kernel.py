"""Points transformed at their own times: the compiled loop and the one in NumPy agree to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pc2scan.core import kernel, plain

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


def rows(rng: np.random.Generator, count: int) -> Any:
    found = rng.normal(size=(count, 12))
    found[rng.random(count) < 0.2] = np.nan
    return found


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
            one = COMPILED(x, y, z, times, node_times, transforms, outs[0])
            other = plain.deskew(x, y, z, times, node_times, transforms, outs[1])
            assert one == other
            nan = np.isnan(outs)
            np.testing.assert_array_equal(nan[0], nan[1])
            np.testing.assert_array_equal(outs[0][~nan[0]].view(np.int32), outs[1][~nan[1]].view(np.int32))


@pytest.mark.usefixtures("loops")
def test_a_transform_is_interpolated_between_its_neighbours() -> None:
    identity = [1.0, 0, 0, 0, 1, 0, 0, 0, 1]
    transforms = np.array([[*identity, 0, 0, 0], [*identity, 1, 0, 0], [*identity, 1, 4, 0], [np.nan] * 12])
    node_times = np.array([0.0, 1.0, 3.0, 4.0])
    times = np.array([0.0, 0.25, 1.0, 2.0, 3.0, 3.5, 4.0, -0.1, 4.1, np.nan, 0.5])
    x = np.array([5.0] * 10 + [np.nan], np.float32)
    out = np.empty((x.size, 3), np.float32)
    missing = kernel.deskew(x, np.zeros_like(x), np.ones_like(x), times, node_times, transforms, out)
    assert missing == 5
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
    assert kernel.deskew(zeros, zeros, zeros, np.array([0.9, 1.0, 1.5, 2.0, 2.1]), node_times, transforms, out) == 2
    np.testing.assert_array_equal(out[:, 0], np.array([np.nan, 7, 7, 7, np.nan], np.float32))


@pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")
def test_arrays_of_other_sizes_are_refused() -> None:
    x = np.zeros(3, np.float32)
    times, nodes, transforms, out = np.zeros(3), np.arange(2.0), np.zeros((2, 12)), np.zeros((3, 3), np.float32)
    assert COMPILED(x, x, x, times, nodes, transforms, out) == 0
    wrong: list[Any] = [
        (times[:2], nodes, transforms, out),
        (times, nodes[:1], transforms[:1], out),
        (times, nodes, transforms[:1], out),
        (times, nodes, transforms, out[:2]),
        (times.astype(np.float32), nodes, transforms, out),
    ]
    for others in wrong:
        with pytest.raises(ValueError, match=r"length or item size|fewer than two"):
            COMPILED(x, x, x, *others)
