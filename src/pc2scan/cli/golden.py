"""``pc2scan golden``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import UsageError
from pc2scan.shown import counted

from . import completion
from .options.junit import JUnitGroup
from .options.single import Json
from .render import print_json, say, warn
from .spelling import as_typed

if TYPE_CHECKING:
    from pc2scan.golden.result import CaseResult, GoldenReport

__all__ = ["golden"]

_INIT = "A new case"


def golden(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of cases, or one case.")],
    pattern: Annotated[
        str,
        typer.Option(
            "-k",
            metavar="PATTERN",
            help="Run only cases whose name contains this or matches this glob.",
            show_default=False,
        ),
    ] = "",
    *,
    update: Annotated[
        bool,
        typer.Option(
            "--update", help="Write the expected output of cases that differ or have none; review the changes."
        ),
    ] = False,
    init: Annotated[
        Path | None,
        typer.Option("--init", metavar="SRC", help="Make a new case of this recording, in DIR.", rich_help_panel=_INIT),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="With --init: where the input begins, as in convert.", rich_help_panel=_INIT),
    ] = None,
    end: Annotated[
        str | None, typer.Option(metavar="TIME", help="With --init: where it ends.", rich_help_panel=_INIT)
    ] = None,
    topics: Annotated[
        list[str],
        typer.Option(
            "--topic",
            "-t",
            metavar="TOPIC",
            help="With --init: a topic of clouds or scans to keep, or a glob. Repeatable. Default: all.",
            autocompletion=completion.topics("/PointCloud2", "/LaserScan"),
            rich_help_panel=_INIT,
        ),
    ] = [],  # noqa: B006 - typer reads the default and never hands it out
    params_file: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="With --init: the case's parameter file.", rich_help_panel=_INIT),
    ] = None,
    junit: JUnitGroup,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Do not show cases that passed.")] = False,
) -> None:
    """Check conversions against their expected output.

    A case is a folder with input.bag (or input.mcap, input.db3, input/), params.yaml, and the expected output of the
    conversion, expected.txt (or expected.bag, expected.mcap, expected/). A case.yaml may name other inputs, further
    arguments of convert, and tolerances.

    Exit status: 0 all as expected, 1 some differ, 2 some could not be checked.
    """
    if init is not None:
        if update or pattern or junit.junit is not None or as_json:
            raise UsageError("--init makes one case, and cannot be combined with -k, --update, --junit or --json")
        _init(folder, init, start, end, topics, params_file, quiet=quiet)
        return
    if start or end or topics or params_file is not None:
        raise UsageError("--start, --end, --topic and --params-file need --init", hint="a case has its own")
    from pc2scan.golden.case import case_folders
    from pc2scan.golden.check import check_case, refuse_output_over_cases
    from pc2scan.golden.result import GoldenReport

    from .in_process import run_command
    from .junit_cases import of_golden

    report = GoldenReport(str(folder))
    cases = case_folders(folder, pattern)
    if junit.junit is not None:
        refuse_output_over_cases(junit.junit, "--junit", [case for _, case in cases])
    with junit.writing("golden") as write_junit:
        for name, case in cases:
            result = check_case(name, case, run_command, update=update)
            report.cases.append(result)
            if not as_json:
                _show(result, quiet=quiet)
        _conclude(report, as_json=as_json)
        write_junit(of_golden(report))
    raise typer.Exit(report.exit_status)


def _init(
    folder: Path,
    source: Path,
    start: str | None,
    end: str | None,
    topics: list[str],
    params: Path | None,
    *,
    quiet: bool,
) -> None:
    """Make a case, and list its files."""
    from pc2scan.golden.init import make_case

    from .in_process import run_command
    from .progress import progress_bar

    with progress_bar(enabled=not quiet) as progress:
        made = make_case(
            folder, source, run_command, start=start, end=end, topics=topics, params=params, progress=progress
        )
    for warning in made.warnings:
        warn(warning)
    if quiet:
        return
    for name, size in made.files:
        say(f"{made.folder / name}  {counted(size, 'byte')}")
    say(as_typed(f"next: look at {made.folder}/expected.txt, commit the folder, and: pc2scan golden {folder}"))


def _conclude(report: GoldenReport, *, as_json: bool) -> None:
    if as_json:
        print_json(report.as_dict())
        return
    counted = [f"{number} {outcome.value}" for outcome, number in report.counts.items() if number]
    say(f"{', '.join(counted)} in {report.seconds:.1f} s")
    if report.exit_status == 1:
        say("hint: if this is intended, --update makes it the expected output")


def _show(result: CaseResult, *, quiet: bool) -> None:
    if result.outcome == "passed" and quiet:
        return
    say(f"{result.outcome.value:<8}{result.name}")
    for line in result.lines:
        say(as_typed(f"    {line}"))
