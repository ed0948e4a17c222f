"""``pc2scan golden``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.compare.golden import check_cases, make_case
from pc2scan.errors import UsageError
from pc2scan.options.call import Options
from pc2scan.options.effects import refuse_idle
from pc2scan.text import counted

from .in_process import run_command
from .render import as_typed, progress_bar, say, show, show_parts

if TYPE_CHECKING:
    from pc2scan.compare.golden import CaseResult


def golden(folder: Path, pattern: str | None, *, options: Options) -> int:
    """Check conversions against their expected output."""
    if options.init is not None:
        if pattern or options.given.keys() & {"update", "as_json"}:
            raise UsageError("--init makes one case, and cannot be combined with -k, --update or --json")
        return _init(folder, options)
    refuse_idle(options.given, "golden")

    def show_case(case: CaseResult) -> None:
        if not options.as_json and not (options.quiet and case.outcome == "passed"):
            show_parts(case.body())

    report = check_cases(folder, pattern or "", run_command, update=options.update, show=show_case)
    if options.as_json:
        return show(report, options)
    show_parts(report.conclusion())
    return report.exit_status


def _init(folder: Path, options: Options) -> int:
    """Make a case, and list its files."""
    with progress_bar(options) as progress:
        report = make_case(folder, run_command, options, progress=progress)
    for remark in report.remarks():
        say(as_typed(remark), err=True)
    if not options.quiet:
        show_parts(f"{file}  {counted(file.stat().st_size, 'byte')}" for file in sorted(folder.iterdir()))
        say(f"next: look at {folder}/expected.txt, commit the folder, and: pc2scan golden {folder}")
    return 0
