"""Transforms at many times, which points are interpolated between: each is what `lookup` returns."""

from __future__ import annotations

from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.errors import TransformError
from support import sampled
from support.loops import BOTH_LOOPS
from transforms.small_buffers import at
from transforms.small_buffers import built as built_of
from transforms.small_buffers import row as moved
from transforms.trees import EPOCH, SECOND, built, changing_tree, random_tree

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from pc2scan.transforms.buffer import TransformBuffer
    from transforms.trees import Rows


@pytest.fixture(params=BOTH_LOOPS, ids=lambda loops: loops.__name__, autouse=True)
def loops(request: pytest.FixtureRequest) -> Iterator[None]:
    """What is tested holds for the compiled loops and for those in NumPy."""
    with request.param():
        yield


#: No motion needs more times.
ENOUGH = 1 << 62


def times_of(stamps: NDArray[np.int64]) -> list[int]:
    """The times of all rows: the stamps, and the middle between each and the next one."""
    between = [(one + (other - one) // 2, other) for one, other in pairwise(stamps.tolist())]
    return [int(stamps[0]), *(time for both in between for time in both)]


def assert_rows_are_lookups(buffer: TransformBuffer, target: str, source: str, begin_ns: int, end_ns: int) -> int:
    """Compare rotations and metres to 1e-9; return how many rows have a transform."""
    stamps, rows, _ = buffer.rows(target, source, begin_ns, end_ns, SECOND // 7, lambda *_: ENOUGH)
    assert (stamps[0], stamps[-1]) == (begin_ns, end_ns)
    assert (np.diff(stamps) > 0).all()
    times = times_of(stamps)
    assert rows.shape == (len(times), 12)
    found = 0
    for time, ours in zip(times, rows, strict=True):
        try:
            theirs = buffer.lookup(target, source, time)
        except TransformError:
            assert np.isnan(ours).all(), time
            continue
        np.testing.assert_allclose(ours[:9].reshape(3, 3), theirs.matrix, rtol=0, atol=1e-9)
        np.testing.assert_allclose(ours[9:], theirs.translation, rtol=0, atol=1e-9)
        found += 1
    return found


def whole_stamps(rows: Rows) -> Rows:
    """Transforms whose stamps are not 0, which would ask for the latest transform."""
    return [(entry, static) for entry, static in rows if static or entry[2] > 0]


@pytest.mark.parametrize(("make", "seed"), sampled(product([random_tree, changing_tree], range(6)), 4))
def test_every_row_is_what_a_lookup_returns(
    make: Callable[[np.random.Generator], tuple[Rows, list[str]]], seed: int
) -> None:
    rng = np.random.default_rng(300 + seed)
    rows, frames = make(rng)
    buffer = built(whole_stamps(rows))
    found = 0
    for _ in range(25):
        target, source = rng.choice(frames, 2, replace=False).tolist()
        begin_ns = EPOCH + int(rng.integers(-SECOND, 5 * SECOND))
        try:
            found += assert_rows_are_lookups(buffer, target, source, begin_ns, begin_ns + int(rng.integers(1, SECOND)))
        except TransformError as err:
            if "changes its parent" not in err.message:
                with pytest.raises(type(err)):
                    buffer.lookup(target, source, begin_ns)
    assert found > 20


def test_a_change_of_parents_within_a_cloud_is_an_error() -> None:
    buffer = built_of(
        [moved("odom", "base", 10, x=1), moved("odom", "base", 11, x=2), moved("dock", "base", 12, x=5)],
        [moved("odom", "dock", 0, x=100)],
    )
    # Up to 12 s the sample of 11 s is valid, unchanged.
    stamps, rows, gap_ns = buffer.rows("odom", "base", at(10.5), at(12) - 1, 10 * SECOND, lambda *_: ENOUGH)
    assert stamps.tolist() == [at(10.5), at(11), at(12) - 1]
    assert rows[:, 9].tolist() == pytest.approx([1.5, 1.75, 2, 2, 2], abs=1e-12)
    assert gap_ns == SECOND
    assert_rows_are_lookups(buffer, "odom", "base", at(12), at(12) + 1)
    with pytest.raises(TransformError, match=r"a frame changes its parent before 17000000\d\d"):
        buffer.rows("odom", "base", at(10.5), at(12), 10 * SECOND, lambda *_: ENOUGH)


def test_a_frame_above_both_may_be_placed_later() -> None:
    frames = [moved("base", name, second, x=second) for name in ("lidar", "camera") for second in (0, 9)]
    buffer = built_of([*frames, moved("odom", "base", 3, x=1), moved("map", "base", 4, x=2)])
    assert assert_rows_are_lookups(buffer, "camera", "lidar", at(1), at(6)) > 30
