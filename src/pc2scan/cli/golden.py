"""``pc2scan golden``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.errors import UsageError
from pc2scan.options.call import Options
from pc2scan.text import counted

from .render import say, show, show_parts, warn
from .spelling import as_typed


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
    options: Options,
) -> None:
    """Check conversions against their expected output.

    A case is a folder with input.bag (or input.mcap, input.db3, input/), params.yaml, and the expected output of the
    conversion, expected.txt (or expected.bag, expected.mcap, expected/). A case.yaml may name other inputs, further
    arguments of convert, and tolerances.

    Exit status: 0 all as expected, 1 some differ, 2 some could not be checked.
    """
    if options.init is not None:
        if pattern or options.given.keys() & {"update", "junit", "as_json"}:
            raise UsageError("--init makes one case, and cannot be combined with -k, --update, --junit or --json")
        _init(folder, options)
        return
    if options.given.keys() & {"start", "end", "topics", "params_file"}:
        raise UsageError("--start, --end, --topic and --params-file need --init", hint="a case has its own")
    from pc2scan.golden.case import case_folders
    from pc2scan.golden.check import check_case, refuse_output_over_cases
    from pc2scan.golden.result import GoldenReport

    from .in_process import run_command
    from .junit_cases import junit_output, of_golden

    report = GoldenReport(str(folder))
    cases = case_folders(folder, pattern)
    if options.junit is not None:
        refuse_output_over_cases(options.junit, "--junit", [case for _, case in cases])
    with junit_output(options, "golden") as write_junit:
        for name, case in cases:
            result = check_case(name, case, run_command, update=options.update)
            report.cases.append(result)
            if not options.as_json and not (options.quiet and result.outcome == "passed"):
                show_parts(result.body())
        if options.as_json:
            show(report, as_json=True)
        else:
            show_parts(report.conclusion())
        write_junit(of_golden(report))
    raise typer.Exit(report.exit_status)


def _init(folder: Path, options: Options) -> None:
    """Make a case, and list its files."""
    from pc2scan.golden.init import make_case

    from .in_process import run_command
    from .progress import progress_bar

    part = {"start": options.start, "end": options.end, "topics": options.topics, "params": options.params_file}
    with progress_bar(enabled=not options.quiet) as progress:
        made = make_case(folder, options.init, run_command, progress=progress, **part)
    for warning in made.warnings:
        warn(warning)
    if options.quiet:
        return
    for name, size in made.files:
        say(f"{made.folder / name}  {counted(size, 'byte')}")
    say(as_typed(f"next: look at {made.folder}/expected.txt, commit the folder, and: pc2scan golden {folder}"))
