from __future__ import annotations

import time
from contextlib import closing
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
    with closing(Threads(4)) as pool:
        ahead.use(pool)
        for item in range(40):
            if item % 4:
                ahead.put(partial(slow, item), written.append, 10)
            else:
                ahead.put_ready(partial(written.append, item), 10)
        ahead.finish()
    assert written == list(range(40))


def test_an_error_is_raised_when_its_turn_comes() -> None:
    def fail() -> None:
        raise ValueError("packed badly")

    written: list[int] = []
    ahead = WriteAhead()
    with closing(Threads(2)) as pool:
        ahead.use(pool)
        ahead.put(lambda: 1, written.append, 1)
        ahead.put(fail, lambda _: written.append(2), 1)
        with pytest.raises(ValueError, match="packed badly"):
            ahead.finish()
    assert written == [1]
