"""What became of golden cases: one structure that text, JSON, JUnit XML, pytest and the exit status all read."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pc2scan.compare.result import Difference

__all__ = ["CaseResult", "GoldenReport", "Outcome"]


class Outcome(StrEnum):
    """What became of a case."""

    passed = "passed"
    failed = "failed"
    updated = "updated"
    #: It could not be checked.
    error = "error"


@dataclass(frozen=True, slots=True)
class CaseResult:
    """What became of a case.

    Attributes
    ----------
    lines
        What to tell: what differs (for an updated case: what differed), or what went wrong. Empty if it passed.
    difference
        None where it did not come to a comparison.
    """

    name: str
    outcome: Outcome
    lines: tuple[str, ...] = ()
    difference: Difference | None = None
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return JSON's types."""
        return {
            "name": self.name,
            "outcome": self.outcome.value,
            "text": "\n".join(self.lines),
            "difference": None if self.difference is None else self.difference.as_dict(),
            "seconds": round(self.seconds, 3),
        }


@dataclass(slots=True)
class GoldenReport:
    """What became of a folder of cases."""

    folder: str
    cases: list[CaseResult] = field(default_factory=list)

    @property
    def counts(self) -> dict[Outcome, int]:
        """Cases by outcome."""
        counted = Counter(case.outcome for case in self.cases)
        return {outcome: counted[outcome] for outcome in Outcome}

    @property
    def seconds(self) -> float:
        """All cases together."""
        return sum(case.seconds for case in self.cases)

    @property
    def exit_status(self) -> int:
        """0 all as expected (or made so), 1 some differ, 2 some could not be checked."""
        return 2 if self.counts[Outcome.error] else 1 if self.counts[Outcome.failed] else 0

    def as_dict(self) -> dict[str, Any]:
        """Return JSON's types."""
        return {
            "folder": self.folder,
            "exit_status": self.exit_status,
            **{outcome.value: number for outcome, number in self.counts.items()},
            "cases": [case.as_dict() for case in self.cases],
        }
