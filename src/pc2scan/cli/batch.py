"""``pc2scan batch``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.datasets.batch import run_batch
from pc2scan.files.paths import path_or_url
from pc2scan.options.call import Options
from pc2scan.text import counted, size

from .render import as_typed, progress_bar, say, show

if TYPE_CHECKING:
    from pc2scan.datasets.planning import BatchPlan
    from pc2scan.datasets.summary import RecordingOutcome


def batch(sources: list[str], destination: str, *, options: Options) -> int:
    """Convert every recording of a dataset."""
    with progress_bar(options, "recordings") as progress:
        try:
            report = run_batch(
                sources,
                path_or_url(destination),
                options,
                planned=lambda plan: _show_plan(plan, options),
                done=lambda outcome: _show_outcome(outcome, options),
                progress=progress,
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt("run the same command again to continue it") from None
    return show(report, options)


def _show_plan(plan: BatchPlan, options: Options) -> None:
    """Show what will be done, in one line."""
    if options.quiet:
        return
    convert, keep, skip = plan.of("convert"), plan.of("keep"), plan.skipped
    reasons: dict[str, int] = {}
    for job in convert:
        why = job.why.partition(":")[0]
        reasons[why] = reasons.get(why, 0) + 1
    tally = "; " + ", ".join(f"{number:,} {why}" for why, number in reasons.items()) if convert else ""
    text = f"{counted(len(plan.jobs) + len(skip), 'recording')}: {len(convert):,} to convert"
    text += f" ({size(sum(job.size_bytes for job in convert))}{tally})"
    text += f", {len(keep):,} unchanged" if keep else ""
    say(text + (f", {len(skip):,} skipped by the dataset file" if skip else ""), err=True)


def _show_outcome(outcome: RecordingOutcome, options: Options) -> None:
    """Show a line for a recording that is finished."""
    if options.quiet and not (outcome.error and outcome.exit_status):
        return
    text = f"{outcome.outcome}: {outcome.key}"
    if outcome.error:
        text += f": {outcome.error}" + (f" (hint: {outcome.hint})" if outcome.hint else "")
    else:
        facts = filter(None, [counted(outcome.scans, "scan"), outcome.remark, f"{outcome.seconds:.1f} s"])
        text = f"{'would be ' if options.dry_run else ''}{text} -> {outcome.output} ({', '.join(facts)})"
    say(as_typed(text), err=True)
