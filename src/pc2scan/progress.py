"""The progress of a run: how many bytes of its recordings are read."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

#: Called regularly with the bytes that are read, the bytes in all, and the messages read so far, which are 0 while
#: transforms are read ahead.
Progress: TypeAlias = Callable[[int, int, int], None]


class Meter:
    """Counts the bytes that a run reads, and reports them: when it begins, after each thousandth, and when it ends.

    Parameters
    ----------
    report
        The function to report to; None if nobody asks.

    Attributes
    ----------
    following
        How many bytes are read after what is read ahead.
    messages
        How many messages were read, without those that were read ahead.
    """

    def __init__(self, report: Progress | None) -> None:
        self._report = report
        self._done = self._total = self._next = 0
        self.following = self.messages = 0

    def expect(self, size: int) -> None:
        """Expect this many bytes from now on, whatever was expected before."""
        self._total = self._done + size
        self._tell(self._done)

    def add(self, size: int) -> None:
        """Add bytes that are read."""
        self._done += size
        if self._done >= self._next:
            self._tell(min(self._done, self._total))

    def finish(self) -> None:
        """Report that all is read."""
        self._tell(self._total)

    def _tell(self, done: int) -> None:
        if self._report is not None:
            self._report(done, self._total, self.messages)
        self._next = self._done + self._total // 1000
