"""Writes the results of golden cases as JUnit XML, which CI systems show with the results of other tests."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET  # only written, never parsed
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pc2scan.files.overlap import OutputPath
from pc2scan.files.text_output import text_output

from .check import refuse_output_over_cases
from .result import CaseOutcome

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from .result import GoldenReport

__all__ = ["junit_file", "junit_xml"]

#: The first bytes of such a file; a file with these may be replaced.
_BEGINNING = b'<?xml version="1.0" encoding="utf-8"?>\n<testsuites>\n  <testsuite name="pc2scan golden"'

#: Characters that XML 1.0 cannot hold, even escaped.
_UNPRINTABLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@contextmanager
def junit_file(
    path: Path | None, cases: Sequence[Path], *, overwrite: bool
) -> Iterator[Callable[[GoldenReport], None]]:
    """Check that the file can be written before the first case runs, and yield the function that writes it.

    Parameters
    ----------
    path
        The file; None: no file is written.
    cases
        The folders of the cases: their files are never overwritten.
    overwrite
        Whether a file that is not JUnit XML of pc2scan may be replaced.

    Raises
    ------
    DestinationError, OutputError
        If it may not or cannot be written; by the function too.
    """
    if path is None:
        yield lambda _: None
        return
    refuse_output_over_cases(OutputPath(path, "--junit"), cases)
    with text_output(path, beginning=_BEGINNING, overwrite=overwrite) as write:
        yield lambda report: write(junit_xml(report))


def junit_xml(report: GoldenReport) -> str:
    """Write one test suite, with a test case for each golden case; updated cases pass."""
    suite = ET.Element(
        "testsuite",
        name="pc2scan golden",
        tests=str(len(report.cases)),
        failures=str(report.counts[CaseOutcome.failed]),
        errors=str(report.counts[CaseOutcome.error]),
        skipped="0",
        time=f"{report.seconds:.3f}",
    )
    for case in report.cases:
        element = ET.SubElement(
            suite, "testcase", classname="pc2scan.golden", name=_clean(case.name), time=f"{case.seconds:.3f}"
        )
        text = _clean("\n".join(case.lines))
        if case.outcome in (CaseOutcome.failed, CaseOutcome.error):
            kind = "failure" if case.outcome is CaseOutcome.failed else "error"
            ET.SubElement(element, kind, message=text.partition("\n")[0]).text = text
        elif text:
            ET.SubElement(element, "system-out").text = text
    root = ET.Element("testsuites")
    root.append(suite)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _clean(text: str) -> str:
    return _UNPRINTABLE.sub("?", text)
