"""Problems of the scans of a topic, which `check` reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: ``defect``: violates the definition of the message, or makes scans useless. ``notice``: worth knowing.
Level = Literal["defect", "notice"]

#: Scans without a transform are usual at the beginning and the end: as many as come within this time, nanoseconds, or
#: this share of all scans.
_USUAL_NS = 2_000_000_000
_USUAL_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class Finding:
    """A problem of the scans of a topic, for all consumers.

    Attributes
    ----------
    kind
        A word for programs, such as ``stamps-back``.
    level
        ``defect`` or ``notice``.
    text
        The problem, with the numbers.
    hint
        What the user can do; empty if unknown.
    count
        How many scans have it.
    stamp_ns
        The stamp of the first of these scans; None if it does not concern single scans.
    """

    kind: str
    level: Level
    text: str
    hint: str = ""
    count: int = 0
    stamp_ns: int | None = None


@dataclass(slots=True)
class Tally:
    """A count, and the stamp of the first occurrence."""

    count: int = 0
    stamp_ns: int | None = None

    def add(self, stamp_ns: int) -> None:
        """Count one more."""
        self.count += 1
        if self.stamp_ns is None:
            self.stamp_ns = stamp_ns


def finding(kind: str, level: Level, text: str, hint: str, tally: Tally) -> Finding:
    """Return the finding about a tally."""
    return Finding(kind, level, text, hint, tally.count, tally.stamp_ns)


def few_unplaced(unplaced: int, scans: int, interval_ns: float | None) -> bool:
    """Whether so many scans without a transform are usual in a sound recording.

    Parameters
    ----------
    unplaced
        Scans without a transform; each of them is lost.
    scans
        All scans.
    interval_ns
        The median interval between scans; None if unknown.

    Returns
    -------
    bool
        True if these are less than half of the scans, and at most 5 % of them or as many as come within 2 s: transforms
        often begin a little later than the scans, and end earlier.
    """
    at_the_ends = _USUAL_NS / interval_ns if interval_ns else 0.0
    return 2 * unplaced < scans and unplaced <= max(_USUAL_SHARE * scans, at_the_ends)
