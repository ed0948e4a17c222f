from __future__ import annotations

from contextlib import closing
from threading import Event, Thread, current_thread, main_thread

import pytest

from pc2scan.threads import InOrder, Threads


def test_who_waits_works() -> None:
    with closing(Threads(1)) as pool:
        tasks = [pool.submit(current_thread) for _ in range(5)]
        assert not any(task.done() for task in tasks)
        assert tasks[2].result() is main_thread()
        # What was given before it is done, what was given after is not.
        assert [task.done() for task in tasks] == [True, True, True, False, False]
        assert [task.result() for task in tasks] == [main_thread()] * 5


def test_others_work_meanwhile() -> None:
    begun, release = Event(), Event()

    def hold() -> str:
        begun.set()
        assert release.wait(30)
        return current_thread().name

    def let_go() -> Thread:
        release.set()
        return current_thread()

    with closing(Threads(2)) as pool:
        slow = pool.submit(hold)
        assert begun.wait(30)
        more = [pool.submit(current_thread) for _ in range(2)]
        more.append(pool.submit(let_go))
        # The only other thread is busy until all that is left to do is done by the one that waits.
        assert slow.result() == "pc2scan_0"
        assert [task.result() for task in more] == [main_thread()] * 3


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_is_that_of_the_task(jobs: int) -> None:
    def fail() -> None:
        raise ValueError("packed badly")

    with closing(Threads(jobs)) as pool:
        first, second = pool.submit(fail), pool.submit(lambda: "done")
        assert second.result() == "done"
        with pytest.raises(ValueError, match="packed badly"):
            first.result()


def test_an_interruption_is_raised_at_once() -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    with closing(Threads(1)) as pool:
        first, second = pool.submit(interrupted), pool.submit(lambda: "done")
        with pytest.raises(KeyboardInterrupt):
            second.result()
        with pytest.raises(KeyboardInterrupt):
            first.result()
        assert second.result() == "done"


def test_where_there_may_be_no_more_threads_those_that_are_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(Thread, "start", refuse)
    with closing(Threads(4)) as pool:
        tasks = [pool.submit(current_thread) for _ in range(6)]
        assert [task.result() for task in tasks] == [main_thread()] * 6


def test_what_waits_is_bounded_by_bytes_and_by_number() -> None:
    """Up to 10 bytes a thread and 3 results; of larger ones 2 in any case."""
    with closing(Threads(2)) as pool:
        for size, room in ((5, 3), (10, 2), (20, 2), (1000, 2)):
            queue: InOrder[int] = InOrder(pool, 10, 2, 3)
            while queue.has_room(size):
                queue.put(lambda: 7, size)
            assert len(queue) == room, size
            assert [queue.take() for _ in range(room)] == [7] * room
            assert queue.has_room(size)
        # As many as the threads can do ahead, and one at least.
        for least, most, room in ((100, None, pool.ahead), (100, 10**6, pool.ahead), (0, 0, 1)):
            queue = InOrder(pool, 10**9, least, most)
            while queue.has_room(1):
                queue.put(lambda: 7, 1, at_its_turn=True)
            assert len(queue) == room
