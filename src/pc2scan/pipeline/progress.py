"""The progress of a run: how much of its work is done."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

#: Called regularly with the work that is done, the work in all (see `pc2scan.bags.units.Unit.work`), and the messages
#: read so far.
Progress: TypeAlias = Callable[[int, int, int], None]


class Meter:
    """Counts the work of a run, and reports it.

    Parameters
    ----------
    report
        The function to report to.
    """

    def __init__(self, report: Progress) -> None:
        self._report = report
        self._done = self._total = 0
        #: How many messages were read.
        self.messages = 0

    def expect(self, work: int) -> None:
        """Expect this much work from now on, whatever was expected before."""
        self._total = self._done + work
        self.report()

    def add(self, work: int) -> None:
        """Add work that is done."""
        self._done += work

    def add_now(self, work: int) -> None:
        """Add work that is done, and report it."""
        self.add(work)
        self.report()

    def report(self) -> None:
        """Report how much is done; what was not expected counts as if it had been."""
        self._report(min(self._done, self._total), self._total, self.messages)

    def finish(self) -> None:
        """Report that all is done."""
        self._report(self._total, self._total, self.messages)
