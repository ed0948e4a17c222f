"""``pc2scan batch``.

No ``from __future__ import annotations`` here: see `pc2scan.cli.groups.Group`.
"""

import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from inspect import Parameter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from pc2scan.shown import counted

from .groups import Group
from .options.conversion import ConversionGroup, typed_words
from .options.output import OutputGroup, ScratchGroup
from .render import say, show_parts, size, warn
from .spelling import as_typed

if TYPE_CHECKING:
    from typing_extensions import Self

    from pc2scan.batch.manifest import Record
    from pc2scan.batch.plan import Plan
    from pc2scan.batch.summary import BatchReport
    from pc2scan.batch.watch import BatchProgress

__all__ = ["batch"]

_BATCH = "Batch"
_EXPORT = "Export"


class BatchGroup(Group):
    """Options of the batch itself."""

    dataset: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A YAML file with options for the recordings that match a pattern. Options typed here override it.",
            rich_help_panel=_BATCH,
        ),
    ] = None
    workers: Annotated[
        int,
        typer.Option(
            "--jobs",
            "-j",
            min=0,
            metavar="N",
            help="Number of recordings at a time, up to 1,024, each in its own process; the output does not depend on "
            "it.  [default: number of cores, as memory allows]",
            show_default=False,
            rich_help_panel=_BATCH,
        ),
    ] = 0
    retries: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="How often a recording is tried again if its process was killed, for instance for lack of memory; up "
            "to 100 times.",
            rich_help_panel=_BATCH,
        ),
    ] = 1
    dask: Annotated[
        str,
        typer.Option(
            metavar="[ADDRESS]",
            help="Convert on the Dask cluster of this scheduler, such as tcp://scheduler:8786. Without an address, a "
            "cluster is started on this machine. Needs pc2scan[dask].",
            show_default=False,
            rich_help_panel=_BATCH,
        ),
    ] = ""
    force: Annotated[
        bool, typer.Option("--force", help="Convert again what earlier runs have converted.", rich_help_panel=_BATCH)
    ] = False
    checksum: Annotated[
        bool,
        typer.Option(
            "--checksum",
            help="Recognise unchanged recordings by SHA-256 instead of their modification time. Reads every byte.",
            rich_help_panel=_BATCH,
        ),
    ] = False
    fail_fast: Annotated[
        bool, typer.Option("--fail-fast", help="Stop at the first recording that fails.", rich_help_panel=_BATCH)
    ] = False
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the summary of all recordings: *.json, *.csv or *.md.",
            rich_help_panel=_BATCH,
        ),
    ] = None
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show warnings and errors only.", rich_help_panel=_BATCH)
    ] = False
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose",
            "-v",
            help="Show the tables of each conversion, and every recording in the summary.",
            rich_help_panel=_BATCH,
        ),
    ] = False


class ExportGroup(Group):
    """Options of results that are not recordings."""

    export: Annotated[
        Literal["npz", "csv", "tum", "carmen", "flaser", "pcd", "kitti"] | None,
        typer.Option(
            help="Write the files of pc2scan export instead of recordings, in a folder for each recording.",
            rich_help_panel=_EXPORT,
        ),
    ] = None
    pose_frame: Annotated[
        str,
        typer.Option(
            metavar="FRAME",
            help="With --export: the robot's pose in this frame at each stamp.",
            show_default=False,
            rich_help_panel=_EXPORT,
        ),
    ] = ""
    base_frame: Annotated[
        str,
        typer.Option(
            metavar="FRAME",
            help="With --export: the robot's frame, whose pose is written.",
            show_default=False,
            rich_help_panel=_EXPORT,
        ),
    ] = ""
    odom_topic: Annotated[
        str,
        typer.Option(
            metavar="TOPIC",
            help="With --export: take the poses from this nav_msgs/Odometry topic.",
            show_default=False,
            rich_help_panel=_EXPORT,
        ),
    ] = ""


class _Without(Group):
    """A group without some of its options, which keep their defaults."""

    whole: type[Group]
    left_out: Mapping[str, Any]

    @classmethod
    def parameters(cls) -> Iterable[Parameter]:
        """Return the remaining options."""
        return [each for each in cls.whole.parameters() if each.name not in cls.left_out]

    @classmethod
    def gathered(cls, values: Mapping[str, Any]) -> "Self":
        """Make the whole group."""
        return cls.whole.gathered({**values, **cls.left_out})  # type: ignore[return-value]


class _Conversion(_Without):
    """The options of a conversion, except the number of its threads."""

    whole = ConversionGroup
    left_out = {"jobs": 0}  # noqa: RUF012


class _Output(_Without):
    """The options of the destination, except ``--each``: batch converts each recording on its own anyway."""

    whole = OutputGroup
    left_out = {"each": False}  # noqa: RUF012


def batch(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SRC...",
            help="Folders, which are searched for recordings; recordings; globs in quotes; text files with one path "
            "per line; URLs.",
        ),
    ],
    destination: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="Folder for the results, with the subfolders of the sources, and for manifest.jsonl. May be a URL.",
        ),
    ],
    *,
    running: BatchGroup,
    exporting: ExportGroup,
    conversion: _Conversion,
    output: _Output,
    scratch: ScratchGroup,
) -> None:
    """Convert every recording of a dataset, each on its own, in several processes.

    If a recording fails, the others are still converted. A second run converts only what is missing, has changed or
    failed. OUT/manifest.jsonl has the result of each recording. After an interruption, run the same command again.
    """
    from pc2scan.batch.options import BatchOptions
    from pc2scan.batch.run import run_batch
    from pc2scan.batch.watch import Watch
    from pc2scan.pipeline.run import scratch_bytes

    words, origins = typed_words(exporting, conversion, output)
    dry_run = bool(words.pop("dry_run", False))
    options = BatchOptions(
        dataset=running.dataset,
        jobs=running.workers,
        retries=running.retries,
        checksum=running.checksum,
        force=running.force,
        fail_fast=running.fail_fast,
        dry_run=dry_run,
        dask=True if running.dask == "local" else running.dask or False,
        report=running.report,
        scratch=scratch.scratch,
        scratch_size=scratch_bytes(scratch.scratch_size),
    )
    with _progress_bar(enabled=not running.quiet) as progress:
        watch = Watch(
            planned=lambda plan: _show_plan(plan, quiet=running.quiet),
            progress=progress,
            done=lambda record: _show_record(record, quiet=running.quiet, dry_run=dry_run),
            shown=_show_text if running.verbose and not running.quiet else None,
            warn=warn,
            inform=lambda text: None if running.quiet else say(as_typed(text), err=True),
        )
        try:
            report = run_batch(sources, destination, words, options, origins=origins, watch=watch)
        except KeyboardInterrupt:
            say("hint: run the same command again to continue it", err=True)
            raise
    _show_report(report, quiet=running.quiet, verbose=running.verbose)
    raise typer.Exit(report.exit_status)


def _show_plan(plan: "Plan", *, quiet: bool) -> None:
    """Show what will be done, in one line."""
    if quiet:
        return
    convert, keep, skip = plan.of("convert"), plan.of("keep"), plan.of("skip")
    reasons: dict[str, int] = {}
    for step in convert:
        why = step.why.partition(":")[0]
        reasons[why] = reasons.get(why, 0) + 1
    told = ", ".join(f"{number:,} {why}" for why, number in reasons.items())
    parts = [
        counted(len(plan.steps), "recording"),
        f"{len(convert):,} to convert ({size(sum(step.found.identity.size_bytes for step in convert))}"
        + (f"; {told})" if told else ")"),
        *([f"{len(keep):,} unchanged"] if keep else []),
        *([f"{len(skip):,} skipped by the dataset file"] if skip else []),
    ]
    say(": ".join((parts[0], ", ".join(parts[1:]))), err=True)


def _show_record(record: "Record", *, quiet: bool, dry_run: bool) -> None:
    """Show a line for a recording that is finished."""
    if record.error is not None:
        hint = f" (hint: {record.error['hint']})" if record.error.get("hint") else ""
        say(as_typed(f"{record.outcome}: {record.key}: {record.error['message']}{hint}"), err=True)
        return
    if quiet:
        return
    from pc2scan.batch.summary import Facts

    facts = Facts.of(record.report or {})
    told = [
        # A recording without an index does not say how many messages it has, so a dry run cannot count its scans.
        counted(facts.scans, "scan") if facts.scans or not dry_run else "scans not counted",
        *([f"{facts.empty_scans:,} empty"] if facts.empty_scans else []),
        *([f"{facts.skipped:,} skipped"] if facts.skipped else []),
        *([f"damaged: {facts.damage[0]}"] if facts.damage else []),
        *([counted(facts.warnings, "warning")] if facts.warnings else []),
        f"{record.seconds:.1f} s",
    ]
    would = "would be " if dry_run else ""
    say(as_typed(f"{would}{record.outcome}: {record.key} -> {record.output} ({', '.join(told)})"), err=True)


def _show_text(text: str) -> None:
    """Print the tables of a conversion."""
    for line in text.split("\n"):
        say(as_typed(line), err=True)


def _show_report(report: "BatchReport", *, quiet: bool, verbose: bool) -> None:
    for warning in report.warnings:
        warn(warning)
    if not quiet:
        if report.dry_run:
            say("dry run, nothing is written")
        show_parts(report.tables(None) if verbose else report.tables())


@contextmanager
def _progress_bar(*, enabled: bool) -> "Iterator[Any]":
    """Show bytes and recordings done, and the time left; yields the function to report to."""
    if not enabled or not sys.stderr.isatty():
        yield lambda _progress: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    with Progress(
        BarColumn(),
        DownloadColumn(),
        TextColumn("{task.fields[done]:,} of {task.fields[all]:,} recordings"),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        # `Screen` writes lines above the bar, fitted to the terminal; rich would write them as they are.
        redirect_stdout=False,
        redirect_stderr=False,
    ) as bar:
        task = bar.add_task("batch", total=None, done=0, all=0)

        def update(progress: "BatchProgress") -> None:
            bar.update(
                task,
                completed=progress.bytes_done,
                total=progress.bytes_total,
                done=progress.recordings_done,
                all=progress.recordings_total,
            )

        yield update
