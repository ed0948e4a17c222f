"""``pc2scan batch``."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from pc2scan.datasets.run import BatchCallbacks, BatchOptions, run_batch
from pc2scan.files.urls import path_or_url
from pc2scan.options.call import Options
from pc2scan.text import counted, size

from .render import as_typed, limit_width, progress_bar, say, show

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pc2scan.datasets.plan import BatchPlan
    from pc2scan.datasets.run import BatchProgress
    from pc2scan.datasets.summary import Outcome


def batch(sources: list[str], destination: str, *, options: Options) -> int:
    """Convert every recording of a dataset."""
    quiet, verbose = options.quiet, options.verbose
    limit_width()
    hints: set[str] = set()
    with _progress_bar(enabled=not quiet) as progress:
        watch = BatchCallbacks(
            planned=lambda plan: _show_plan(plan, quiet=quiet),
            progress=progress,
            done=lambda outcome: _show_outcome(outcome, hints, quiet=quiet, dry_run=options.dry_run),
            shown=_show_text if verbose and not quiet else None,
        )
        try:
            out, how = path_or_url(destination), BatchOptions.of(options)
            report = run_batch(sources, out, options.of_conversions, how, origins=options.origins, watch=watch)
        except KeyboardInterrupt:
            raise KeyboardInterrupt("run the same command again to continue it") from None
    show(report, quiet=quiet, verbose=verbose)
    return report.exit_status


def _show_plan(plan: BatchPlan, *, quiet: bool) -> None:
    """Show what will be done, in one line."""
    if quiet:
        return
    convert, keep, skip = plan.of("convert"), plan.of("keep"), plan.skipped
    reasons: dict[str, int] = {}
    for job in convert:
        why = job.why.partition(":")[0]
        reasons[why] = reasons.get(why, 0) + 1
    told = ", ".join(f"{number:,} {why}" for why, number in reasons.items())
    parts = [
        counted(len(plan.jobs) + len(skip), "recording"),
        f"{len(convert):,} to convert ({size(sum(job.size_bytes for job in convert))}"
        + (f"; {told})" if told else ")"),
        *([f"{len(keep):,} unchanged"] if keep else []),
        *([f"{len(skip):,} skipped by the dataset file"] if skip else []),
    ]
    say(": ".join((parts[0], ", ".join(parts[1:]))), err=True)


def _show_outcome(done: Outcome, hints: set[str], *, quiet: bool, dry_run: bool) -> None:
    """Show a line for a recording that is finished; a hint only once."""
    if done.error:
        # A recording without clouds is no failure; what it has instead may be a reason to look.
        if quiet and not done.exit_status:
            return
        hint = f" (hint: {done.hint})" if done.hint and done.hint not in hints else ""
        hints.add(done.hint)
        say(as_typed(f"{done.outcome}: {done.key}: {done.error}{hint}"), err=True)
        return
    if quiet:
        return
    told = [
        # A recording without an index does not say how many messages it has, so a dry run cannot count its scans.
        counted(done.scans, "scan") if done.scans or not dry_run else "scans not counted",
        *([f"{done.empty_scans:,} empty"] if done.empty_scans else []),
        *([f"{done.skipped:,} skipped"] if done.skipped else []),
        *([f"damaged: {done.damage[0]}"] if done.damage else []),
        *([counted(len(done.warnings), "warning")] if done.warnings else []),
        f"{done.seconds:.1f} s",
    ]
    would = "would be " if dry_run else ""
    say(as_typed(f"{would}{done.outcome}: {done.key} -> {done.output} ({', '.join(told)})"), err=True)


def _show_text(text: str) -> None:
    """Print the tables of a conversion."""
    for line in text.split("\n"):
        say(as_typed(line), err=True)


@contextmanager
def _progress_bar(*, enabled: bool) -> Iterator[Callable[[BatchProgress], None]]:
    """Show the share and the recordings done, and the time left; yields the function to report to."""
    text = "{task.fields[done]:,} of {task.fields[all]:,} recordings"
    with progress_bar(text, "done", "all", enabled=enabled) as show_bar:

        def update(now: BatchProgress) -> None:
            if show_bar is not None:
                show_bar(now.bytes_done, now.bytes_total, now.recordings_done, now.recordings_total)

        yield update
