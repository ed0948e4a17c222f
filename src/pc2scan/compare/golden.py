"""Golden cases: folders with a conversion's input, options and expected output; they are read, checked and made."""

from __future__ import annotations

import os
import shutil
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

from pc2scan.bags.opening import open_recordings
from pc2scan.bags.topics import find_topics, types_by_topic
from pc2scan.compare.diff import diff, open_source
from pc2scan.compare.rules import Rules
from pc2scan.compare.scan_text import render_scans
from pc2scan.conversion.run import OutputOptions, run
from pc2scan.errors import DestinationError, OutputError, Pc2ScanError, RecordingError, ResultError, UsageError
from pc2scan.files.outputs import files_output, output_folder, staged_output
from pc2scan.files.source_file import missing_hint, open_text
from pc2scan.files.yaml import MAX_CHARACTERS, load_yaml
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.options.call import Options
from pc2scan.options.values import count, texts
from pc2scan.request.spec import Request
from pc2scan.result import Part, Result
from pc2scan.text import did_you_mean, duration, nearest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.bags.reader import Reader
    from pc2scan.compare.differences import Difference
    from pc2scan.conversion.report import Report
    from pc2scan.progress import Progress


EXPECTED_TEXT = "expected.txt"
_EXPECTED = (EXPECTED_TEXT, "expected.bag", "expected.mcap", "expected")
_INPUTS = ("input.bag", "input.mcap", "input.db3", "input")
SETTINGS = "case.yaml"
_PARAMS = "params.yaml"

#: The keys of ``case.yaml``: those of a case, and options of ``diff``.
_COMPARISON = ("all_topics", "atol", "rtol", "allow_beams", "ignore")
_KEYS = ("input", "params", "arguments", "exit_status", *_COMPARISON)

#: Types that conversions read besides clouds and scans.
_ALSO_READ = {"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage", "sensor_msgs/msg/Imu"}


@dataclass(frozen=True, slots=True)
class GoldenCase:
    """A conversion and its expected output.

    Attributes
    ----------
    folder
        The case's folder.
    inputs
        Recordings; several are merged into one.
    params
        The parameter file; None for upstream's defaults.
    expected
        ``expected.txt`` (see `pc2scan.compare.scan_text`) or a recording; None if there is none yet.
    arguments
        Further options of ``pc2scan convert``, not yet checked; ``{case}`` in them is replaced by the folder.
    exit_status
        The expected exit status of the conversion.
    comparison
        The options of the comparison; with ``all_topics``, not only converted topics are compared.
    """

    folder: Path
    inputs: tuple[Path, ...]
    params: Path | None
    expected: Path | None
    arguments: tuple[str, ...]
    exit_status: int
    comparison: Options


def is_case(folder: Path) -> bool:
    """Whether a folder is a case, complete or not."""
    return any((folder / name).exists() for name in (SETTINGS, _PARAMS, *_INPUTS, *_EXPECTED))


def case_folders(folder: Path, pattern: str = "") -> list[tuple[str, Path]]:
    """Find the cases in a folder, at any depth; the folder itself may be one.

    Parameters
    ----------
    pattern
        A part of the name, or a glob for the whole name; empty for every case.

    Returns
    -------
    list of (name, folder)
        Sorted; a name is the path relative to the folder.

    Raises
    ------
    UsageError
        If there is no such folder, or no case with such a name in it.
    """
    if not os.path.lexists(folder):
        raise UsageError("does not exist", path=folder, hint=missing_hint(folder))
    if not folder.is_dir():
        raise UsageError("is not a folder", path=folder, hint="give the folder with the cases")
    cases = [(case.relative_to(folder).as_posix(), case) for case in _cases_in(folder)]
    cases = [(folder.resolve().name if case == folder else name, case) for name, case in cases]
    if not cases:
        raise UsageError(
            "has no cases", path=folder, hint="a case is a folder with input.bag (or .mcap, ...) and params.yaml"
        )
    chosen = [(name, case) for name, case in cases if pattern in name or fnmatchcase(name, pattern)]
    if not chosen:
        near = did_you_mean(pattern, [name for name, _ in cases])
        raise UsageError(f"none of its {len(cases)} cases has {pattern!r} in its name", path=folder, hint=near or None)
    return chosen


def _cases_in(folder: Path) -> Iterator[Path]:
    if is_case(folder):
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink() and not path.name.startswith("."):
            yield from _cases_in(path)


def load_case(folder: Path) -> GoldenCase:
    """Read a case from its folder.

    Raises
    ------
    UsageError
        If a file is missing or exists twice, or ``case.yaml`` has a wrong value.
    """
    path = folder / SETTINGS
    _refuse_misnamed(folder)
    settings = _settings(path)
    try:
        comparison = Options("diff", {key: value for key, value in settings.items() if key in _COMPARISON})
        Rules.of(comparison)
        named = {key: [folder / name for name in texts().read(key, settings.get(key))] for key in ("input", "params")}
        status = count().read("exit_status", settings.get("exit_status", 0))
        if not isinstance(arguments := settings.get("arguments", []), list):
            raise TypeError(f"arguments is {arguments!r}, it must be a list, such as [--topic, /points:=/scan]")
        # A missing file is always an error, even if the case expects a failure.
        for missing in (file for files in named.values() for file in files if not file.exists()):
            raise UsageError(f"names {missing.relative_to(folder)}, which does not exist")
    except (AttributeError, TypeError, UsageError) as err:
        raise UsageError(str(err), path=path, hint=getattr(err, "hint", None)) from err
    inputs = named["input"] or _only(folder, _INPUTS)
    if not inputs:
        raise UsageError("has no input", path=folder, hint=f"{', '.join(_INPUTS)}, or 'input:' in {SETTINGS}")
    params = named["params"] or _only(folder, (_PARAMS,))
    expected = _only(folder, _EXPECTED)
    if expected and any(file.samefile(expected[0]) for file in (*inputs, *params)):
        raise UsageError("is a file of a case", path=expected[0])
    return GoldenCase(
        folder=folder,
        inputs=tuple(inputs),
        params=params[0] if params else None,
        expected=expected[0] if expected else None,
        arguments=tuple(str(part).replace("{case}", str(folder)) for part in arguments),
        exit_status=status,
        comparison=comparison,
    )


def _refuse_misnamed(folder: Path) -> None:
    """Raise if a file's name is a misspelling of one that would be read: a ``param.yaml`` would silently be ignored."""
    names = {entry.name for entry in folder.iterdir()}
    kinds = ((SETTINGS,), (_PARAMS,), _INPUTS, _EXPECTED)
    missing = [name for kind in kinds if not names & {*kind} for name in kind]
    for name in sorted(names - {name for kind in kinds for name in kind}):
        if near := nearest(name, missing):
            raise UsageError(f"{name} is not read", path=folder, hint=f"did you mean {near}?")


def _settings(path: Path) -> dict[str, Any]:
    """Return the content of ``case.yaml``."""
    if not path.exists():
        return {}
    try:
        with open_text(path) as file:
            # One more than allowed, so that longer text is refused.
            settings = load_yaml(file.read(MAX_CHARACTERS + 1)) or {}
    except (OSError, ValueError) as err:
        raise UsageError(f"cannot be read: {err}", path=path) from err
    known = f"the keys are {', '.join(_KEYS)}"
    if not isinstance(settings, dict):
        raise UsageError("is not a mapping", path=path, hint=known)
    if unknown := [key for key in settings if key not in _KEYS]:
        raise UsageError(f"unknown key {unknown[0]!r}", path=path, hint=known)
    return settings


def _only(folder: Path, names: tuple[str, ...]) -> list[Path]:
    """Return the only path that exists among several names; empty for none."""
    paths = [folder / name for name in names if (folder / name).exists()]
    if len(paths) > 1:
        raise UsageError(f"has {' and '.join(path.name for path in paths)}", path=folder, hint="remove all but one")
    return paths


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
    show: Callable[[CaseResult], object] | None = None,
) -> GoldenReport:
    """Check conversions against expected outputs; see `pc2scan.golden`.

    ``show`` is called with the result of each case.
    """
    report = GoldenReport(str(folder))
    for name, case in case_folders(folder, pattern):
        result = check_case(name, case, command, update=update)
        report.cases.append(result)
        if show is not None:
            show(result)
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


def _run_case(case: GoldenCase, command: Command, *, update: bool) -> tuple[str, list[str], Difference | None]:
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


def _run_conversion(case: GoldenCase, command: Command, destination: Path, *further: str) -> CommandResult:
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


def _write_expected(case: GoldenCase, actual: Path, command: Command) -> None:
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


def make_case(folder: Path, command: Command, options: Options, *, progress: Progress | None = None) -> Report:
    """Make a case, by ``init``, ``start``, ``end``, ``topics`` and ``params_file`` of a call.

    Clouds, scans, transforms and IMU messages of the recording are kept, byte for byte.

    Parameters
    ----------
    folder
        The case; it must not exist. The folder above it is made, if it does not exist.
    command
        Runs ``pc2scan``.

    Returns
    -------
    Report
        The report of the conversion that cuts the input out.

    Raises
    ------
    Pc2ScanError
        If the recording cannot be read, the case cannot be written, or its conversion does not succeed.
    """
    if os.path.lexists(folder):
        raise DestinationError("exists already", path=folder, hint="give a folder that does not exist yet")
    with ExitStack() as stack:
        if folder.parent != folder and not os.path.lexists(folder.parent):
            stack.enter_context(output_folder(folder.parent))
        partial = stack.enter_context(staged_output(folder, overwrite=False))
        partial.mkdir()
        (reader,) = open_recordings([options.init], stack)
        kept = _needed_topics(reader, options.topics)
        name = "input.bag" if any(connection.ros_version == 1 for connection in reader.connections) else "input.mcap"
        cut = Request(repair=True, start=options.start, end=options.end, keep=tuple(kept))
        report = run([options.init], partial / name, cut, OutputOptions(), progress=progress)
        if (params := options.params_file) is not None:
            try:
                shutil.copyfile(params, partial / "params.yaml")
            except OSError as err:
                raise OutputError(f"cannot be copied: {err.strerror}", path=params) from err
        result = check_case(folder.name, partial, command, update=True)
        if result.outcome != "updated":
            raise ResultError(
                "; ".join(result.lines) or "its conversion writes nothing that can be compared",
                path=folder,
                hint="the conversion must succeed: cut out a part with transforms for each cloud (`start`, `end`)",
            )
    return report


def _needed_topics(reader: Reader, topics: Sequence[str]) -> list[str]:
    """The topics of a recording that a case needs."""
    types = types_by_topic(reader.connections)
    kinds = (*CLOUDS, *SCANS)
    candidates = sorted(topic for topic, names in types.items() if names & {*kinds})
    chosen = {name for topic in topics for name in find_topics(topic, types, candidates, *kinds)} or {*candidates}
    return sorted(chosen | {topic for topic, names in types.items() if names & _ALSO_READ})
