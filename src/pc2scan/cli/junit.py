"""Writes the results of golden, check and diff as JUnit XML, which CI systems show with the results of other tests."""

from __future__ import annotations

import xml.etree.ElementTree as ET  # only written, never parsed
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from pc2scan.errors import UsageError, visible
from pc2scan.files.ownership import InputPath, OutputPath, refuse_overlap
from pc2scan.files.text_output import text_output

from .render import as_typed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from pc2scan.compare.result import Difference
    from pc2scan.golden.result import GoldenReport
    from pc2scan.inspect.check import Check
    from pc2scan.options.call import Options

#: The first bytes of such a file; a file with these may be replaced.
_BEGINNING = b'<?xml version="1.0" encoding="utf-8"?>\n<testsuites>\n  <testsuite name="pc2scan '

Outcome: TypeAlias = Literal["passed", "failure", "error"]


class JUnitCase(NamedTuple):
    """A test case: its name, its outcome, its message, and how many seconds it took."""

    name: str
    outcome: Outcome = "passed"
    lines: Sequence[str] = ()
    seconds: float = 0.0


#: Outcomes of golden cases, and those of JUnit XML; updated cases pass.
_OUTCOMES: dict[str, Outcome] = {"passed": "passed", "updated": "passed", "failed": "failure", "error": "error"}


@contextmanager
def junit_output(
    options: Options, command: str, inputs: Iterable[Path] = ()
) -> Iterator[Callable[[Iterable[JUnitCase]], None]]:
    """Check beforehand that the file of ``--junit`` can be written, and yield the function that writes it.

    Parameters
    ----------
    options
        Without ``junit``, no file is written.
    command
        The command that has made the results.
    inputs
        The files that it reads. They are never overwritten.

    Raises
    ------
    UsageError
        If there is no file to overwrite.
    DestinationError, OutputError
        If it may not or cannot be written. The function raises these, too.
    """
    if options.junit is None:
        if options.overwrite:
            raise UsageError("--overwrite has no effect without --junit")
        yield lambda _: None
        return
    refuse_overlap(map(InputPath, inputs), [OutputPath(options.junit, "--junit")])
    with text_output(options.junit, beginning=_BEGINNING, overwrite=options.overwrite) as write:
        yield lambda cases: write(junit_xml(command, list(cases)))


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


def junit_xml(command: str, cases: Sequence[JUnitCase]) -> str:
    """Return one test suite, of the cases that a command has tested."""
    outcomes = [case.outcome for case in cases]
    suite = ET.Element(
        "testsuite",
        name=f"pc2scan {command}",
        tests=str(len(cases)),
        failures=str(outcomes.count("failure")),
        errors=str(outcomes.count("error")),
        skipped="0",
        time=f"{sum(case.seconds for case in cases):.3f}",
    )
    for case in cases:
        element = ET.SubElement(
            suite, "testcase", classname=f"pc2scan.{command}", name=visible(case.name), time=f"{case.seconds:.3f}"
        )
        text = "\n".join(map(visible, case.lines))
        if case.outcome != "passed":
            ET.SubElement(element, case.outcome, message=text.partition("\n")[0]).text = text
        elif text:
            ET.SubElement(element, "system-out").text = text
    root = ET.Element("testsuites")
    root.append(suite)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
