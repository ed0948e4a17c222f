"""``pc2scan golden``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.compare.golden.check import check_cases
from pc2scan.compare.golden.init import make_case
from pc2scan.errors import UsageError
from pc2scan.options.call import Options
from pc2scan.options.effects import refuse_idle

from .in_process import run_command
from .render import progress_bar, say, show, show_parts

if TYPE_CHECKING:
    from pc2scan.compare.golden.check import CaseResult


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

    report = check_cases(folder, pattern or "", run_command, update=options.update, each=show_case)
    if options.as_json:
        return show(report, options)
    show_parts(report.conclusion())
    return report.exit_status


def _init(folder: Path, options: Options) -> int:
    """Make a case, and list its files."""
    with progress_bar(options) as progress:
        case = make_case(folder, run_command, options, progress=progress)
    if not options.quiet:
        show(case, options)
        say(f"next: look at {case.folder}/expected.txt, commit the folder, and: pc2scan golden {folder}")
    return 0
