"""Runs a case's conversion, and compares its output with the expected one."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, ClassVar, NamedTuple, TypeAlias

from pc2scan.compare.diff import diff, open_source
from pc2scan.compare.scan_text import render_scans
from pc2scan.errors import OutputError, Pc2ScanError, RecordingError, UsageError
from pc2scan.files.staging import files_output
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.result import Part, Result
from pc2scan.text import duration

from .case import EXPECTED_TEXT, SETTINGS, case_folders, load_case

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.compare.result import Difference

    from .case import Case


@dataclass(frozen=True, slots=True)
class CaseResult:
    """The result of a case.

    Attributes
    ----------
    outcome
        ``passed``, ``failed``, ``updated``; or ``error``: it could not be checked.
    lines
        The differences (for an updated case: the old ones), or the error. Empty if it passed.
    difference
        None if nothing was compared.
    """

    json_names: ClassVar[tuple[str, ...]] = ("name", "outcome", "text", "difference", "seconds")

    name: str
    outcome: str
    lines: tuple[str, ...] = ()
    difference: Difference | None = None
    seconds: float = 0.0

    @property
    def text(self) -> str:
        """The lines as one text."""
        return "\n".join(self.lines)

    def body(self) -> Iterator[str]:
        """Yield the outcome, and the differences or the error."""
        yield f"{self.outcome:<8}{self.name}"
        yield from (f"    {line}" for line in self.lines)


@dataclass(slots=True, repr=False)
class GoldenReport(Result):
    """The results of a folder of cases."""

    kind: ClassVar[str] = "golden"
    json_names: ClassVar[tuple[str, ...]] = ("folder", "counts", "cases", "seconds")

    folder: str
    cases: list[CaseResult] = field(default_factory=list)

    @property
    def counts(self) -> dict[str, int]:
        """Number of cases by outcome."""
        counted = Counter(case.outcome for case in self.cases)
        return {outcome: counted[outcome] for outcome in ("passed", "failed", "updated", "error")}

    @property
    def seconds(self) -> float:
        """The duration of all cases together."""
        return sum(case.seconds for case in self.cases)

    @property
    def exit_status(self) -> int:
        """0: all passed or were updated; 1: some differ; 2: some could not be checked."""
        return 2 if self.counts["error"] else 1 if self.counts["failed"] else 0

    def __repr__(self) -> str:
        return f"<GoldenReport of {self.folder!r}: {self._counted()}, exit status {self.exit_status}>"

    def _counted(self) -> str:
        words = {"error": "could not be checked"}
        counts = (f"{number:,} {words.get(outcome, outcome)}" for outcome, number in self.counts.items() if number)
        return ", ".join(counts) or "no cases"

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


class CommandResult(NamedTuple):
    """A command's exit status and messages."""

    status: int
    messages: str


#: Runs pc2scan like the command line, given a command with its arguments, and further options from an untrusted case:
#: only those that decide what is converted are allowed, any other is a UsageError.
Command: TypeAlias = Callable[[Sequence[str], Sequence[str]], CommandResult]


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
        outcome, lines, difference = "error", [str(err), *([f"hint: {err.hint}"] if err.hint else [])], None
    return CaseResult(name, outcome, tuple(lines), difference, time.monotonic() - began)


def _run_case(case: Case, command: Command, *, update: bool) -> tuple[str, list[str], Difference | None]:
    """Return the outcome, the lines about it, and the difference."""
    difference = None
    with TemporaryDirectory(prefix="pc2scan-golden-") as folder:
        actual = Path(folder) / "actual.mcap"
        result = _run_conversion(case, command, actual, "--compression", "none")
        if result.status != case.exit_status:
            text = f"the conversion ended with exit status {result.status}, expected was {case.exit_status}"
            return "failed", [text, *result.messages.splitlines()], None
        if not actual.exists():
            # The conversion failed as expected.
            return "passed", [], None
        lines = ["new" if update else "there is no expected output: `update=True` writes it"]
        if case.expected is not None:
            try:
                difference = diff(case.expected, actual, case.comparison)
            except RecordingError as err:
                if not update:
                    raise
                lines = [str(err)]
            else:
                if difference.same:
                    return "passed", [], difference
                lines = difference.text(("expected", "actual")).split("\n")
        if update:
            _write_expected(case, actual, command)
        return "updated" if update else "failed", lines, difference


def _run_conversion(case: Case, command: Command, destination: Path, *further: str) -> CommandResult:
    """Run the case's conversion."""
    arguments = ["convert", *map(str, case.inputs), "-o", str(destination), *further]
    if case.params is not None:
        arguments += ["--params-file", str(case.params)]
    if not case.comparison.all_topics:
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
        with files_output([path], overwrite=True) as write:
            write([text])
        return
    result = _run_conversion(case, command, path, "--overwrite")
    if result.status != case.exit_status:
        raise OutputError(f"cannot be written: {result.messages.strip()}", path=path)
