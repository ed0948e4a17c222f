"""Counts of the messages of a topic that become scans together with others, and the jumps of its stamps."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

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


class Run(NamedTuple):
    """Scans or messages in a row, of one clock: the stamps of the first and the last, and their number."""

    first_stamp_ns: int
    last_stamp_ns: int
    number: int

    def and_one(self, stamp_ns: int) -> Run:
        """Return the run with one more."""
        return Run(self.first_stamp_ns if self.number else stamp_ns, stamp_ns, self.number + 1)


NO_RUN = Run(0, 0, 0)


@dataclass(slots=True)
class SourceCounts:
    """Counts of the messages of one topic.

    Attributes
    ----------
    messages, used, unmatched
        All messages, those in a scan, and those in no scan.
    scans_without
        Scans without a message of this topic.
    silence, left
        The longest run of such scans, and that of messages in no scan.
    jumps, jumped
        The first jumps of its stamps, and the number of all.
    """

    json_names: ClassVar[tuple[str, ...]] = (
        *("messages", "used", "unmatched", "scans_without", "jumped", "jumps", "longest_silence", "longest_unmatched"),
    )

    messages: int = 0
    used: int = 0
    unmatched: int = 0
    scans_without: int = 0
    silence: Run = NO_RUN
    left: Run = NO_RUN
    jumps: list[Jump] = field(default_factory=list)
    jumped: int = 0

    @property
    def longest_silence(self) -> Run | None:
        """The longest run of scans without a message of this topic; None if each scan has one."""
        return self.silence if self.silence.number else None

    @property
    def longest_unmatched(self) -> Run | None:
        """The longest run of messages in no scan; None if all are used."""
        return self.left if self.left.number else None

    def lack(self, stamp_ns: int, before: Run) -> Run:
        """Count a scan without a message of this topic; return the run of them that goes on."""
        self.scans_without += 1
        run = before.and_one(stamp_ns)
        if run.number > self.silence.number:
            self.silence = run
        return run

    def leave(self, stamp_ns: int, before: Run) -> Run:
        """Count a message that is in no scan; return the run of them that goes on."""
        self.unmatched += 1
        run = before.and_one(stamp_ns)
        if run.number > self.left.number:
            self.left = run
        return run

    def jump(self, stamp_ns: int, by_ns: int) -> None:
        """Count a jump of the stamps."""
        self.jumped += 1
        if self.jumped <= _MAX_LISTED:
            self.jumps.append(Jump(stamp_ns, by_ns))
