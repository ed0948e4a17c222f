"""Scans of several messages in the stream of a conversion."""

from __future__ import annotations

import time
from contextlib import nullcontext
from threading import Thread, current_thread
from typing import TYPE_CHECKING, Any
from weakref import ref

import pytest

from pc2scan.conversion.combine.combiner import Arrival, add_groups
from pc2scan.conversion.combine.conversion import Contribution
from pc2scan.conversion.items import Item
from pc2scan.conversion.plan import Output
from pc2scan.threads import Threads

if TYPE_CHECKING:
    from collections.abc import Generator


class Group:
    """The points of a scan."""

    members = ()


class EachItsOwn:
    """Makes a scan of each message."""

    def __init__(self, *, quick: bool) -> None:
        self.quick = quick
        self.threads: set[Thread] = set()
        self.groups: list[ref[Group]] = []

    def add(self, arrival: Arrival, log_time_ns: int) -> list[Group]:  # noqa: ARG002  # as `Combiner` has them
        group = Group()
        self.groups.append(ref(group))
        return [group]

    def finish(self) -> list[Group]:
        return []

    def is_quick(self, group: Group) -> bool:
        assert isinstance(group, Group)
        return self.quick

    def make(self, group: Group, log_time_ns: int) -> str:
        assert isinstance(group, Group)
        self.threads.add(current_thread())
        return f"scan {log_time_ns}"

    def hold_nothing(self) -> bool:
        """Whether all points are freed: at once, or as soon as the other thread has made the scan."""
        end = time.monotonic() + 30
        while (held := any(each() is not None for each in self.groups)) and time.monotonic() < end:
            time.sleep(0.001)
        return not held


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("jobs", [1, 2])
def test_points_are_freed_before_the_next_message_is_read(jobs: int, *, quick: bool) -> None:
    combiner: Any = EachItsOwn(quick=quick)
    freed = []

    unseen: Any = None
    waiting = Contribution(*[unseen] * 13)
    output = Output(None, "/scan", combiner=combiner)

    def items() -> Generator[Any]:
        for number in range(3):
            yield Item(unseen, number, number, number, 0, [(output, waiting)])
            # This message's scan was made: the next one is read into the same buffer.
            freed.append(combiner.hold_nothing())

    with Threads(jobs) if jobs > 1 else nullcontext() as threads:
        written: list[Any] = list(add_groups(items(), [combiner], threads))
    assert [each if isinstance(each, str) else each.log_time_ns for each in written] == [
        *(0, "scan 0", 1, "scan 1", 2, "scan 2")
    ]
    assert freed == [True] * 3
    if quick:
        # Handing the work to another thread takes longer.
        assert combiner.threads == {current_thread()}
