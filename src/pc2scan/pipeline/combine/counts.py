"""Counts of the messages of a topic that become scans together with others, and the jumps of its stamps."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

__all__ = ["Jump", "SourceCounts"]

#: How many jumps of a topic are listed; all of them are counted.
_MAX_LISTED = 3


class Jump(NamedTuple):
    """A stamp that does not continue those before it.

    Attributes
    ----------
    stamp_ns
        The stamp after the jump.
    by_ns
        How much further the stamps went than the log times; negative: back.
    """

    stamp_ns: int
    by_ns: int


@dataclass(slots=True)
class SourceCounts:
    """Counts of the messages of one topic.

    Attributes
    ----------
    messages, used, unmatched
        All messages, those in a scan, and those in no scan.
    scans_without
        Scans without a message of this topic.
    silence
        The longest run of such scans: the stamps of its first and its last scan, and their number.
    jumps, jumped
        The first jumps of its stamps, and the number of all.
    """

    messages: int = 0
    used: int = 0
    unmatched: int = 0
    scans_without: int = 0
    silence: tuple[int, int, int] = (0, 0, 0)
    jumps: list[Jump] = field(default_factory=list)
    jumped: int = 0
    _run: tuple[int, int, int] = field(default=(0, 0, 0), repr=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the counts as JSON types."""
        names = ("messages", "used", "unmatched", "scans_without", "jumped")
        first, last, scans = self.silence
        longest = {"first_stamp_ns": first, "last_stamp_ns": last, "scans": scans} if scans else None
        return {
            **{name: getattr(self, name) for name in names},
            "jumps": [jump._asdict() for jump in self.jumps],
            "longest_silence": longest,
        }

    def scan(self, stamp_ns: int, *, has_it: bool) -> None:
        """Count a scan."""
        if has_it:
            self._run = (0, 0, 0)
            return
        self.scans_without += 1
        first, _, count = self._run
        self._run = (first if count else stamp_ns, stamp_ns, count + 1)
        if self._run[2] > self.silence[2]:
            self.silence = self._run

    def jump(self, stamp_ns: int, by_ns: int) -> None:
        """Count a jump of the stamps."""
        self.jumped += 1
        if self.jumped <= _MAX_LISTED:
            self.jumps.append(Jump(stamp_ns, by_ns))
