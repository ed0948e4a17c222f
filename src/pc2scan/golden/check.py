"""Run a case's conversion, and compare what it makes with what is expected."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple, Protocol

from pc2scan.compare.diff import diff, open_source
from pc2scan.compare.scan_text import render
from pc2scan.errors import OutputError, Pc2ScanError, RecordingError, UsageError
from pc2scan.files.overlap import Input, Output, refuse_overlap
from pc2scan.files.text_output import text_output

from .case import EXPECTED_TEXT, SETTINGS, load_case
from .result import CaseResult, Outcome

if TYPE_CHECKING:
    from pc2scan.compare.result import Difference

    from .case import Case

__all__ = ["Command", "Ended", "check_case", "refuse_output_over_cases"]

#: What the two sides are called.
NAMES = ("expected", "actual")


class Ended(NamedTuple):
    """How a command ended, and what it had to say."""

    status: int
    messages: str


class Command(Protocol):
    """Runs pc2scan, as the command line does."""

    def __call__(self, arguments: Sequence[str], chosen: Sequence[str] = ()) -> Ended:
        """Run a command.

        Parameters
        ----------
        arguments
            The command and its arguments.
        chosen
            Further options from an untrusted case: they decide what is converted, and nothing else.

        Raises
        ------
        UsageError
            If ``chosen`` has anything else, or what the command does not know.
        """


def refuse_output_over_cases(output: Output, folders: Sequence[Path]) -> None:
    """Raise a `DestinationError` if a file that is to be written is one that a case reads, or its expected output."""
    files = []
    for folder in folders:
        # What is wrong with a case is reported where it is checked.
        with suppress(Pc2ScanError):
            case = load_case(folder)
            files += [*case.read_files(), Input(case.new_expected(), "file of a case")]
    refuse_overlap(files, [output])


def check_case(name: str, folder: Path, command: Command, *, update: bool = False) -> CaseResult:
    """Check a case.

    Parameters
    ----------
    name
        What to call it.
    command
        Runs ``pc2scan``.
    update
        Whether an expected output that differs, or is not there, is written anew. What differs only within the case's
        tolerances is left as it is.
    """
    began = time.monotonic()
    try:
        outcome, lines, difference = _checked(load_case(folder), command, update=update)
    except Pc2ScanError as err:
        outcome, difference = Outcome.error, None
        lines = (str(err), *([f"hint: {err.hint}"] if err.hint else []))
    return CaseResult(name, outcome, tuple(lines), difference, time.monotonic() - began)


_Checked = tuple[Outcome, Sequence[str], "Difference | None"]


def _checked(case: Case, command: Command, *, update: bool) -> _Checked:
    with TemporaryDirectory(prefix="pc2scan-golden-") as folder:
        actual = Path(folder) / "actual.mcap"
        ended = _ended(case, command, actual, "--compression", "none")
        if ended.status != case.exit_status:
            told = f"the conversion ended with {ended.status}, expected is {case.exit_status}"
            return Outcome.failed, [told, *ended.messages.splitlines()], None
        if not actual.exists():
            # It failed, as it should.
            return Outcome.passed, [], None
        difference, lines = _compared(case, actual, update=update)
        if not lines:
            return Outcome.passed, lines, difference
        if not update:
            return Outcome.failed, lines, difference
        _write_expected(case, actual, command)
        return Outcome.updated, lines, difference


def _compared(case: Case, actual: Path, *, update: bool) -> tuple[Difference | None, list[str]]:
    """Compare with what is expected; no lines if there is nothing to tell."""
    if case.expected is None:
        name = case.new_expected().name
        return None, [f"new: {name}" if update else f"there is no expected output: --update makes {name}"]
    try:
        difference = diff(case.expected, actual, all_topics=case.all_topics, rules=case.rules)
    except RecordingError as err:
        if not update:
            raise
        return None, [str(err)]
    return difference, [] if difference.same else difference.text(NAMES).splitlines()


def _ended(case: Case, command: Command, destination: Path, *further: str) -> Ended:
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
    """Make what was made the expected output, in the form that it has."""
    path = case.new_expected()
    if path.name != EXPECTED_TEXT:
        ended = _ended(case, command, path, "--overwrite")
        if ended.status != case.exit_status:
            raise OutputError(f"cannot be written: {ended.messages.strip()}", path=path)
        return
    source = open_source(actual)
    try:
        text = render(source.messages())
    finally:
        source.close()
    refuse_overlap(case.read_files(), [Output(path)])
    # Whatever has this name in a case is its expected output.
    with text_output(path, beginning=b"", overwrite=True) as write:
        write(text)
