"""The results of golden cases, from which text, JSON, pytest's results and the exit status are made."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from pc2scan.result import Part, Result
from pc2scan.text import TextEnum, duration

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

    json_names: ClassVar[tuple[str, ...]] = ("name", "outcome", "text", "difference", "seconds")

    name: str
    outcome: CaseOutcome
    lines: tuple[str, ...] = ()
    difference: Difference | None = None
    seconds: float = 0.0

    @property
    def text(self) -> str:
        """The lines as one text."""
        return "\n".join(self.lines)

    def body(self) -> Iterator[str]:
        """Yield the outcome, and the differences or the error."""
        yield f"{self.outcome.value:<8}{self.name}"
        yield from (f"    {line}" for line in self.lines)


@dataclass(slots=True, repr=False)
class GoldenReport(Result):
    """The results of a folder of cases."""

    kind: ClassVar[str] = "golden"
    json_names: ClassVar[tuple[str, ...]] = ("folder", "counts", "cases", "seconds")

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
        words = {CaseOutcome.error: "could not be checked"}
        counts = ((number, words.get(outcome, outcome.value)) for outcome, number in self.counts.items() if number)
        return ", ".join(f"{number:,} {word}" for number, word in counts) or "no cases"

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the cases, and how many have which outcome."""
        for case in self.cases:
            yield from case.body()
        yield from self.conclusion()

    def conclusion(self) -> Iterator[str]:
        """Yield how many cases have which outcome."""
        yield f"{self._counted()} in {duration(self.seconds)}"
        if self.exit_status == 1:
            yield "hint: if this is intended, `update=True` makes it the expected output"
