"""Shows the result of a conversion: tables on standard output, notes on standard error."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from pc2scan.bags.formats import FORMATS
from pc2scan.errors import leading
from pc2scan.options.table import PARAMETERS
from pc2scan.options.values import in_words
from pc2scan.text import Table, duration, size, stamp

from .damage import SHOWN, show_recovery
from .next_command import next_command
from .render import say, show_parts, show_table, warn
from .spelling import as_typed

if TYPE_CHECKING:
    from collections.abc import Container

    from pc2scan.pipeline.report import Report, Skipped
    from pc2scan.pipeline.scan_spec import ScanSpec

#: The text for the frame of scans without a target frame.
_OWN = "each message's own"


def show(report: Report, *, verbose: bool = False) -> None:
    """Print the result, or that of a dry run."""
    if report.dry_run:
        say(f"dry run, nothing is written: {', '.join(report.sources)}")
        say()
    for spec in report.scans:
        names = [name for name in PARAMETERS if verbose or (report.dry_run and _origin(spec, name) != "default")]
        if spec.name and names:
            say(f"{leading(spec.name)}:")
        if names:
            rows = [(name, in_words(getattr(spec.params, name)), _origin(spec, name)) for name in names]
            show_table(Table(("parameter", "value", "from"), rows, left=("parameter", "from")))
            say()
    show_parts(report.tables())
    written, read = size(report.bytes_written), size(report.bytes_read)
    if report.dry_run:
        frames = [repr(spec.params.target_frame) if spec.params.target_frame else _OWN for spec in report.scans]
        named = ", ".join(dict.fromkeys(frames))
        say(f"frame{'s' * (',' in named)}: {named}; points: those of the first messages")
        made = FORMATS[report.container].readable_one
        say(f"{report.written_to}: {made}, about {written} from {read}")
    else:
        say(f"{report.written_to}: {written} from {read} in {duration(report.seconds)}")
    if report.container == "mcap":
        # Shown because the file's name does not say which ROS version it is for.
        converts = any(topic.action == "converted" for topic in report.topics)
        hint = ": --profile ros2 for ros2 tools" if converts and report.ros_version == 1 else ""
        say(f"MCAP, ROS {report.ros_version} profile{hint}")


def _origin(spec: ScanSpec, name: str) -> str:
    return spec.origins.get(name, "default")


def show_next(report: Report) -> None:
    """Print the command that most users run next; the last line of all."""
    say(f"next: {next_command(report)}")


def _show_skipped(report: Report, limit: int) -> None:
    """List skipped messages by reason, with a hint for the first."""
    reasons: dict[tuple[str, str, tuple[str, ...]], list[Skipped]] = {}
    for entry in report.skipped:
        reasons.setdefault((entry.topic, entry.reason, entry.targets), []).append(entry)
    shown = 0
    for (topic, reason, _), entries in list(reasons.items())[:limit]:
        first = entries[0]
        when = "unknown" if first.stamp_ns is None else stamp(first.stamp_ns)
        several = f" and {len(entries) - 1} more" if len(entries) > 1 else ""
        to = f" (for {', '.join(first.targets)})" if report.scans[1:] and first.targets else ""
        say(as_typed(f"skipped: {topic}, stamp {when}{several}{to}: {reason}"), err=True)
        # A message counts once for each output that lacks it, like in the counts of the topics.
        shown += sum(max(1, len(entry.targets)) for entry in entries)
    # Topics that are skipped completely are not counted here: they have their own warning.
    single = sum(topic.skipped for topic in report.topics if topic.action != "skipped")
    if single > shown:
        say(f"skipped: {single - shown:,} more (--verbose or --report lists them)", err=True)
    hints = [entry.hint for entry in report.skipped if entry.hint]
    if hints:
        say(as_typed(f"hint: {hints[0]}"), err=True)


def conclude(report: Report, *, verbose: bool = False, shown: Container[str] = ()) -> typer.Exit:
    """Show warnings and damage; return the exception that ends the command.

    ``shown`` are warnings that were shown while the conversion ran.
    """
    _show_skipped(report, limit=len(report.skipped) if verbose else SHOWN)
    show_recovery(report, limit=len(report.damage) if verbose else SHOWN)
    for warning in report.warnings:
        if warning not in shown:
            warn(warning)
    return typer.Exit(report.exit_status)
