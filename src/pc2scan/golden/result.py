"""The results of golden cases, from which text, JSON, JUnit XML, pytest's results and the exit status are made."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pc2scan.text import Shown, Table, TextEnum

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.compare.result import Difference


class CaseOutcome(TextEnum):
    """The outcome of a case."""

    passed = "passed"
    failed = "failed"
    updated = "updated"
    #: The case could not be checked.
    error = "error"


@dataclass(frozen=True, slots=True)
class CaseResult:
    """The result of a case.

    Attributes
    ----------
    lines
        The differences (for an updated case: the old ones), or the error. Empty if it passed.
    difference
        None if nothing was compared.
    """

    name: str
    outcome: CaseOutcome
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


@dataclass(slots=True, repr=False)
class GoldenReport(Shown):
    """The results of a folder of cases."""

    folder: str
    cases: list[CaseResult] = field(default_factory=list)

    @property
    def counts(self) -> dict[CaseOutcome, int]:
        """Number of cases by outcome."""
        counted = Counter(case.outcome for case in self.cases)
        return {outcome: counted[outcome] for outcome in CaseOutcome}

    @property
    def seconds(self) -> float:
        """The duration of all cases together."""
        return sum(case.seconds for case in self.cases)

    @property
    def exit_status(self) -> int:
        """0: all passed or were updated; 1: some differ; 2: some could not be checked."""
        return 2 if self.counts[CaseOutcome.error] else 1 if self.counts[CaseOutcome.failed] else 0

    def __repr__(self) -> str:
        return f"<GoldenReport of {self.folder!r}: {self._counted()}, exit status {self.exit_status}>"

    def _counted(self) -> str:
        return ", ".join(f"{number} {outcome.value}" for outcome, number in self.counts.items() if number) or "no cases"

    def _shown(self) -> Iterator[str | Table]:
        for case in self.cases:
            yield f"{case.outcome.value:<8}{case.name}"
            yield from (f"    {line}" for line in case.lines)
        yield self._counted()

    def as_dict(self) -> dict[str, Any]:
        """Return JSON's types."""
        return {
            "folder": self.folder,
            "exit_status": self.exit_status,
            **{outcome.value: number for outcome, number in self.counts.items()},
            "cases": [case.as_dict() for case in self.cases],
        }
