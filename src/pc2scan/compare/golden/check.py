"""Runs a case's conversion, and compares its output with the expected one."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple, Protocol

from pc2scan.compare.diff import diff, open_source
from pc2scan.compare.scan_text import render_scans
from pc2scan.errors import OutputError, Pc2ScanError, RecordingError, UsageError
from pc2scan.files.outputs import file_output
from pc2scan.messages.laserscan import LASERSCAN

from .case import EXPECTED_TEXT, SETTINGS, case_folders, load_case
from .result import CaseOutcome, CaseResult, GoldenReport

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pc2scan.compare.result import Difference

    from .case import Case

#: The names of the two sides.
NAMES = ("expected", "actual")


class CommandResult(NamedTuple):
    """A command's exit status and messages."""

    status: int
    messages: str


class Command(Protocol):
    """Runs pc2scan like the command line."""

    def __call__(self, arguments: Sequence[str], chosen: Sequence[str] = ()) -> CommandResult:
        """Run a command.

        Parameters
        ----------
        arguments
            The command and its arguments.
        chosen
            Further options from an untrusted case: only those that decide what is converted are allowed.

        Raises
        ------
        UsageError
            If ``chosen`` has any other or an unknown option.
        """


def check_cases(
    folder: Path,
    pattern: str,
    command: Command,
    *,
    update: bool = False,
    each: Callable[[CaseResult], object] | None = None,
) -> GoldenReport:
    """Check conversions against expected outputs; see `pc2scan.golden`.

    ``each`` is called with the result of each case.
    """
    report = GoldenReport(str(folder))
    for name, case in case_folders(folder, pattern):
        result = check_case(name, case, command, update=update)
        report.cases.append(result)
        if each is not None:
            each(result)
    return report


def check_case(name: str, folder: Path, command: Command, *, update: bool = False) -> CaseResult:
    """Check a case.

    Parameters
    ----------
    name
        The name in the report.
    command
        Runs ``pc2scan``.
    update
        Whether to write the expected output if it differs or does not exist. It stays unchanged if it differs only
        within the case's tolerances.
    """
    began = time.monotonic()
    try:
        outcome, lines, difference = _run_case(load_case(folder), command, update=update)
    except Pc2ScanError as err:
        outcome, difference = CaseOutcome.error, None
        lines = (str(err), *([f"hint: {err.hint}"] if err.hint else []))
    return CaseResult(name, outcome, tuple(lines), difference, time.monotonic() - began)


def _run_case(case: Case, command: Command, *, update: bool) -> tuple[CaseOutcome, Sequence[str], Difference | None]:
    with TemporaryDirectory(prefix="pc2scan-golden-") as folder:
        actual = Path(folder) / "actual.mcap"
        result = _run_conversion(case, command, actual, "--compression", "none")
        if result.status != case.exit_status:
            text = f"the conversion ended with exit status {result.status}, expected was {case.exit_status}"
            return CaseOutcome.failed, [text, *result.messages.splitlines()], None
        if not actual.exists():
            # The conversion failed as expected.
            return CaseOutcome.passed, [], None
        difference, lines = _compare(case, actual, update=update)
        if not lines:
            return CaseOutcome.passed, lines, difference
        if not update:
            return CaseOutcome.failed, lines, difference
        _write_expected(case, actual, command)
        return CaseOutcome.updated, lines, difference


def _compare(case: Case, actual: Path, *, update: bool) -> tuple[Difference | None, list[str]]:
    """Compare with the expected output; returns no lines if there is no difference."""
    if case.expected is None:
        return None, ["new" if update else "there is no expected output: `update=True` writes it"]
    try:
        difference = diff(case.expected, actual, all_topics=case.all_topics, rules=case.rules)
    except RecordingError as err:
        if not update:
            raise
        return None, [str(err)]
    return difference, [] if difference.same else difference.text(NAMES).split("\n")


def _run_conversion(case: Case, command: Command, destination: Path, *further: str) -> CommandResult:
    """Run the case's conversion."""
    arguments = ["convert", *map(str, case.inputs), "-o", str(destination), *further]
    if case.params is not None:
        arguments += ["--params-file", str(case.params)]
    if not case.all_topics:
        arguments.append("--only-scans")
    try:
        return command(arguments, case.arguments)
    except UsageError as err:
        raise UsageError(f"arguments: {err.message}", path=case.folder / SETTINGS, hint=err.hint) from err


def _write_expected(case: Case, actual: Path, command: Command) -> None:
    """Write the actual output as the expected one, in its form; scans without one yet, as text."""
    with closing(open_source(actual)) as source:
        scans = all(connection.ros_type == LASERSCAN for connection in source.connections)
        path = case.expected or case.folder / (EXPECTED_TEXT if scans else "expected.mcap")
        text = render_scans(source.messages()) if path.name == EXPECTED_TEXT else ""
    if text:
        # Any existing file may be replaced: in a case, a file of this name is always its expected output.
        with file_output(path, beginning=b"", overwrite=True) as write:
            write(text)
        return
    result = _run_conversion(case, command, path, "--overwrite")
    if result.status != case.exit_status:
        raise OutputError(f"cannot be written: {result.messages.strip()}", path=path)
