from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.threads import Threads
from pc2scan.pipeline.ordered import map_in_order

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(params=[None, 2, 5])
def pool(request: pytest.FixtureRequest) -> Iterator[Threads | None]:
    if request.param is None:
        yield None
    else:
        with Threads(request.param) as threads:
            yield threads


def test_results_come_in_the_order_of_the_input(pool: Threads | None) -> None:
    def work(item: int) -> int:
        time.sleep(0.002 * (item % 3))
        return item * item

    results = map_in_order(work, range(60), is_heavy=lambda i: i % 4 != 0, pool=pool, window=4)
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

    with Threads(4) as pool:
        results = list(map_in_order(work, items(), is_heavy=lambda _: True, pool=pool, window=window))
    assert results == list(range(40))
    # The item that waits for its place has been read too.
    assert worst <= window + 1


def test_an_error_is_raised_in_its_turn(pool: Threads | None) -> None:
    def work(item: int) -> int:
        if item == 5:
            raise ValueError("five")
        return item

    results = map_in_order(work, range(10), is_heavy=lambda _: True, pool=pool, window=8)
    assert [next(results) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(ValueError, match="five"):
        next(results)


def test_leaving_early_gives_up_what_has_not_begun() -> None:
    begun = []

    def work(item: int) -> int:
        begun.append(item)
        time.sleep(0.01)
        return item

    with Threads(1) as pool:
        results = map_in_order(work, range(100), is_heavy=lambda _: True, pool=pool, window=20)
        assert next(results) == 0
        results.close()
    assert len(begun) < 20


def test_what_queues_behind_a_slow_item_is_bounded_in_bytes() -> None:
    release = threading.Event()
    read = 0

    def items() -> Iterator[int]:
        nonlocal read
        for item in range(200):
            read += 1
            yield item

    def work(item: int) -> int:
        if item == 0:
            assert release.wait(30)
        return item

    with Threads(1) as pool:
        results = map_in_order(
            work, items(), is_heavy=lambda item: item == 0, pool=pool, window=4, size=lambda _: 4 << 20
        )
        timer = threading.Timer(0.2, release.set)
        timer.start()
        assert next(results) == 0
        # 8 MiB for one thread, and the one that exceeds them.
        assert read == 3
        assert list(results) == list(range(1, 200))
