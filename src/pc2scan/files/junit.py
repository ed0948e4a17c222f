"""Writes JUnit XML, which CI systems show with the results of other tests."""

from __future__ import annotations

import xml.etree.ElementTree as ET  # only written, never parsed
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from pc2scan.errors import visible

from .ownership import InputPath, OutputPath, refuse_overlap
from .text_output import text_output

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

#: The first bytes of such a file; a file with these may be replaced.
_BEGINNING = b'<?xml version="1.0" encoding="utf-8"?>\n<testsuites>\n  <testsuite name="pc2scan '

Outcome: TypeAlias = Literal["passed", "failure", "error"]


class JUnitCase(NamedTuple):
    """A test case: its name, its outcome, its message, and how many seconds it took."""

    name: str
    outcome: Outcome = "passed"
    lines: Sequence[str] = ()
    seconds: float = 0.0


@contextmanager
def junit_file(
    path: Path | None, command: str, inputs: Iterable[Path], *, overwrite: bool, option: str = ""
) -> Iterator[Callable[[Iterable[JUnitCase]], None]]:
    """Check that the file can be written before anything is tested, and yield the function that writes it.

    Parameters
    ----------
    path
        The file; None: no file is written.
    command
        The command that has made the results.
    inputs
        The files that it reads. They are never overwritten.
    overwrite
        Whether a file that is not JUnit XML of pc2scan may be replaced.
    option
        The option that names the file, for errors.

    Raises
    ------
    DestinationError, OutputError
        If it may not or cannot be written. The function raises these, too.
    """
    if path is None:
        yield lambda _: None
        return
    refuse_overlap(map(InputPath, inputs), [OutputPath(path, option)])
    with text_output(path, beginning=_BEGINNING, overwrite=overwrite) as write:
        yield lambda cases: write(junit_xml(command, list(cases)))


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
