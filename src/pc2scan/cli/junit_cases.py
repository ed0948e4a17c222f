"""Converts the results of golden, check and diff to test cases of JUnit XML."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import UsageError
from pc2scan.files.junit import JUnitCase, junit_file

from .spelling import as_typed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from contextlib import AbstractContextManager
    from pathlib import Path

    from pc2scan.compare.result import Difference
    from pc2scan.files.junit import Outcome
    from pc2scan.golden.result import GoldenReport
    from pc2scan.inspect.check import Check
    from pc2scan.options.call import Options

#: Outcomes of golden cases, and those of JUnit XML; updated cases pass.
_OUTCOMES: dict[str, Outcome] = {"passed": "passed", "updated": "passed", "failed": "failure", "error": "error"}


def junit_output(
    options: Options, command: str, inputs: Iterable[Path] = ()
) -> AbstractContextManager[Callable[[Iterable[JUnitCase]], None]]:
    """Check that the file of ``--junit`` can be written; the context is the function that writes it."""
    if options.overwrite and options.junit is None:
        raise UsageError("--overwrite has no effect without --junit")
    return junit_file(options.junit, command, inputs, overwrite=options.overwrite, option="--junit")


def of_golden(report: GoldenReport) -> Iterator[JUnitCase]:
    """Yield a test case for each golden case."""
    for case in report.cases:
        yield JUnitCase(case.name, _OUTCOMES[case.outcome.value], _typed(case.lines), case.seconds)


def of_diff(difference: Difference) -> Iterator[JUnitCase]:
    """Yield a test case for each topic that was compared."""
    from pc2scan.compare.summary import summary

    for topic in difference.topics:
        yield JUnitCase(topic.name, "passed" if topic.same else "failure", _typed(summary([topic], 0)))


def of_check(check: Check) -> Iterator[JUnitCase]:
    """Yield a test case for each topic and consumer that counts, and one for the defects of each topic."""
    for topic in check.topics:
        found = {consumer.consumer: consumer for consumer in topic.consumers}
        for name in check.counting:
            taken = check.takes(topic, name)
            said = found[name].lines(topic.scans) if name in found else ["there are no scans"]
            lines = _typed(" ".join(line.split()) for line in said)
            yield JUnitCase(f"{topic.topic} for {name}", "passed" if taken else "failure", () if taken else lines)
        defects = [finding for finding in topic.findings if check.counts(finding)]
        lines = _typed(line for finding in defects for line in (finding.text, finding.hint) if line)
        yield JUnitCase(f"{topic.topic}: defects", "failure" if defects else "passed", lines)
    if check.damage:
        places = [str(place) for place in check.damage]
        yield JUnitCase("the recording is sound", "passed" if check.asked else "failure", places)


def _typed(lines: Iterable[str]) -> tuple[str, ...]:
    """Return the library's lines with options as they are typed."""
    return tuple(as_typed(line) for line in lines)
