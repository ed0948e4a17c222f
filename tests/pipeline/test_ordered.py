from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from pc2scan.pipeline.ordered import map_in_order


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_results_come_in_the_order_of_the_input(jobs: int) -> None:
    def work(item: int) -> int:
        time.sleep(0.002 * (item % 3))
        return item * item

    results = map_in_order(work, range(60), is_heavy=lambda i: i % 4 != 0, jobs=jobs, window=4)
    assert list(results) == [i * i for i in range(60)]


@pytest.mark.parametrize("window", [1, 3])
def test_no_more_than_the_window_is_in_flight(window: int) -> None:
    lock = threading.Lock()
    read = done = worst = 0

    def items() -> Iterator[int]:
        nonlocal read
        for item in range(40):
            with lock:
                read += 1
            yield item

    def work(item: int) -> int:
        nonlocal done, worst
        time.sleep(0.001)
        with lock:
            worst = max(worst, read - done)
            done += 1
        return item

    assert len(list(map_in_order(work, items(), is_heavy=lambda _: True, jobs=4, window=window))) == 40
    # The item that waits for its place has been read too.
    assert worst <= window + 1


@pytest.mark.parametrize("jobs", [1, 3])
def test_an_error_is_raised_in_its_turn(jobs: int) -> None:
    def work(item: int) -> int:
        if item == 5:
            raise ValueError("five")
        return item

    seen = []
    with pytest.raises(ValueError, match="five"):
        for result in map_in_order(work, range(10), is_heavy=lambda _: True, jobs=jobs, window=8):
            seen.append(result)  # noqa: PERF402 - what was seen before the error matters
    assert seen == [0, 1, 2, 3, 4]


def test_leaving_early_leaves_no_threads() -> None:
    results = map_in_order(lambda i: i, range(100), is_heavy=lambda _: True, jobs=2, window=4)
    assert next(results) == 0
    results.close()  # type: ignore[attr-defined]
    assert not [t for t in threading.enumerate() if t.name.startswith("pc2scan")]
