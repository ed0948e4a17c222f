from __future__ import annotations

import threading
import time
from functools import partial

import pytest

from pc2scan.files.new_file import WriteAhead
from pc2scan.threads import Threads


def test_all_is_written_in_the_order_in_which_it_was_put_in() -> None:
    written: list[int] = []

    def slow(item: int) -> int:
        time.sleep(0.003 * (item % 3))
        return item

    ahead = WriteAhead()
    with Threads(4) as pool:
        ahead.use(pool)
        for item in range(40):
            if item % 4:
                ahead.put(partial(slow, item), written.append, 10)
            else:
                ahead.put_ready(partial(written.append, item), 10)
        ahead.finish()
    assert written == list(range(40))


def test_without_threads_nothing_waits() -> None:
    written: list[int] = []
    ahead = WriteAhead()
    ahead.put(lambda: 1, written.append, 1 << 40)
    assert written == [1]
    ahead.put_ready(lambda: written.append(2), 1 << 40)
    assert written == [1, 2]


@pytest.mark.parametrize(("size", "most"), [(1, 8), ((2 << 23) // 3, 3)])
def test_what_waits_is_bounded(size: int, most: int) -> None:
    lock = threading.Lock()
    put = written = worst = 0

    def work() -> None:
        nonlocal worst
        with lock:
            worst = max(worst, put - written)
        time.sleep(0.001)

    def write(_: None) -> None:
        nonlocal written
        written += 1

    ahead = WriteAhead()
    with Threads(2) as pool:
        ahead.use(pool)
        for _ in range(50):
            with lock:
                put += 1
            ahead.put(work, write, size)
        ahead.finish()
    assert written == 50
    # The one that is about to be put in counts too.
    assert 2 <= worst <= most + 1


def test_an_error_is_raised_when_its_turn_comes() -> None:
    def fail() -> None:
        raise ValueError("packed badly")

    written: list[int] = []
    ahead = WriteAhead()
    with Threads(2) as pool:
        ahead.use(pool)
        ahead.put(lambda: 1, written.append, 1)
        ahead.put(fail, lambda _: written.append(2), 1)
        with pytest.raises(ValueError, match="packed badly"):
            ahead.finish()
    assert written == [1]


def test_what_is_given_up_is_not_written() -> None:
    written: list[int] = []
    begun = threading.Event()
    release = threading.Event()

    def hold() -> int:
        begun.set()
        assert release.wait(30)
        return 0

    ahead = WriteAhead()
    with Threads(2) as pool:
        ahead.use(pool)
        ahead.put(hold, written.append, 1)
        ahead.put(lambda: 1, written.append, 1)
        assert begun.wait(30)
        ahead.cancel()
        release.set()
        ahead.finish()
    assert written == []
