"""Runs a batch: finds recordings, plans, lets an executor convert them, and writes the manifest and the report."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from pc2scan.errors import DestinationError, DiskFullError, OutputError, UsageError
from pc2scan.files.outputs import InputPath, files_output, inputs_of
from pc2scan.files.paths import absolute, is_url
from pc2scan.files.system import copying_to, is_full, refuse_without_room
from pc2scan.options.effects import refuse_idle
from pc2scan.result import BEGINNING
from pc2scan.threads import cores

from .executors import run_jobs, run_jobs_on_dask
from .find import find, natural_key
from .manifest import BEGUN, MANIFEST, open_folder
from .planning import Choices, have_same_outcome, load_dataset_file, make_plan
from .summary import BatchReport, RecordingOutcome

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from pc2scan.options.call import Options

    from .jobs import Job
    from .manifest import BatchFolder, ManifestRecord
    from .planning import BatchPlan


_NO_ROOM = "make room on that disk, and run the same command again"


def run_batch(
    sources: Sequence[str],
    out: Path,
    options: Options,
    *,
    planned: Callable[[BatchPlan], object] | None = None,
    done: Callable[[RecordingOutcome], object] | None = None,
    progress: Callable[[int, int, int, int], object] | None = None,
) -> BatchReport:
    """Convert every recording of a dataset; see `pc2scan.batch`.

    Parameters
    ----------
    sources
        See `pc2scan.datasets.find.find`.
    out
        The folder that is written into.
    options
        The options of the call: those of the conversions, and how the batch runs.
    planned, done
        Called with the plan, and with the outcome of each recording as it ends.
    progress
        Called with the bytes done, the bytes in all, the recordings done, and the recordings in all.
    """
    began = time.monotonic()
    if not sources:
        raise UsageError("no source given")
    refuse_idle(options.among(("dry_run", "report")))
    if isinstance(dask := options.dask, str) and "://" not in dask:
        raise UsageError(f"`dask={dask}`: the address of a scheduler is tcp://HOST:PORT")
    if isinstance(dask, str) and options.jobs:
        raise UsageError(f"`jobs={options.jobs}` has no effect with `dask={dask}`", hint="give only one of them")
    entries = [] if options.dataset is None else load_dataset_file(options.dataset)
    choices = Choices(entries, options.of_conversions, options.origins)
    with ExitStack() as stack:
        folder = stack.enter_context(open_folder(out, dry_run=options.dry_run))
        write_report = _open_report(options, folder, stack)
        plan = _plan(sources, folder, choices, options)
        if planned is not None:
            planned(plan)
        jobs = {job.key: job for job in plan.jobs}
        outcomes = {job.key: RecordingOutcome.of(job, folder.records[job.key]) for job in plan.of("keep")}
        total, size, count = len(plan.of("convert")), 0, 0
        size_in_all = sum(job.size_bytes for job in plan.of("convert"))
        for record in _records(plan, folder, options):
            job = jobs[record.key]
            outcomes[job.key] = outcome = RecordingOutcome.of(job, record)
            if done is not None:
                done(outcome)
            if job.action == "convert":
                size, count = size + job.size_bytes, count + 1
            if progress is not None:
                progress(size, size_in_all, count, total)
        report = BatchReport(
            out,
            outcomes=sorted(
                [*outcomes.values(), *(RecordingOutcome.skipped_by_file(recording.key) for recording in plan.skipped)],
                key=lambda outcome: natural_key(outcome.key),
            ),
            dry_run=options.dry_run,
            seconds=round(time.monotonic() - began, 3),
            workers=0 if isinstance(options.dask, str) else _workers(plan, options),
            warnings=[*choices.warnings([*jobs, *(recording.key for recording in plan.skipped)]), *plan.warnings],
        )
        if write_report is not None:
            write_report([report.as_json()])
    return report


def _open_report(
    options: Options, folder: BatchFolder, stack: ExitStack
) -> Callable[[Sequence[str | bytes]], None] | None:
    """Make sure that the report can be written, before anything is converted; return the function that writes it."""
    path = options.report
    if path is None:
        return None
    real = Path(os.path.realpath(path))
    if real.is_relative_to(folder.path) and (real.relative_to(folder.path).as_posix() in {MANIFEST, *folder.outputs}):
        raise DestinationError("the report cannot be written there: the batch writes this file itself", path=path)
    try:
        return stack.enter_context(files_output([path], beginning=BEGINNING, overwrite=False))
    except (DestinationError, OutputError) as err:
        err.message = f"the report cannot be written there: {err.message}"
        raise


def _plan(sources: Sequence[str], folder: BatchFolder, choices: Choices, options: Options) -> BatchPlan:
    """Find the recordings, and decide what is done with each."""
    recordings = find(sources, folder.path, outputs=[folder.path / output for output in folder.outputs])
    if not recordings:
        raise UsageError(f"no recording found in {', '.join(sources)}")
    requests = choices.of(recording.key for recording in recordings)
    inputs = [InputPath(path) for recording in recordings for path in recording.paths]
    if options.dataset is not None:
        inputs.append(InputPath(options.dataset, "file of `dataset`"))
    for request in {id(request): request for request in requests.values() if request is not None}.values():
        inputs += inputs_of((), request.options.frames.tf_from, request.options.files)
    if options.scratch is not None and not any(is_url(path.path) for path in inputs):
        raise UsageError("`scratch` has no effect: no source is a URL")
    return make_plan(recordings, requests, folder, inputs, again=options.again)


def _workers(plan: BatchPlan, options: Options) -> int:
    """Return how many recordings are converted at a time."""
    return max(1, min(options.jobs or cores(), len(plan.of("convert"))))


def _records(plan: BatchPlan, folder: BatchFolder, options: Options) -> Iterator[ManifestRecord]:
    """Refuse and convert recordings, write the manifest, and yield their lines; a dry run writes nothing.

    Raises
    ------
    DiskFullError
        If there is no room for a result or for the manifest. All other recordings would fail, too.
    """
    # The largest first, so that at the end no worker is busy with a long recording while the others are idle.
    jobs = sorted(plan.of("convert"), key=lambda job: -job.size_bytes)
    scratch = None if options.scratch is None else absolute(options.scratch)
    jobs = [replace(job, dry_run=options.dry_run, scratch=scratch) for job in jobs]
    remote = [job for job in jobs if any(map(is_url, job.recording.paths))]
    if remote and not options.dask:
        at_once = remote[: _workers(plan, options)]
        with copying_to(options.scratch):
            place = at_once[0].recording.paths[0]
            refuse_without_room(sum(job.size_bytes for job in at_once), place, "lower `jobs`, or give `scratch`")
    run: Callable[..., Any] = partial(run_jobs, lock=folder.lock)
    if options.dask and not options.dry_run:
        run = partial(run_jobs_on_dask, address="" if options.dask is True else options.dask)
    with ExitStack() as stack:
        if options.dry_run:
            # Nothing is written there either. It is needed because the folders of the outputs may not exist yet.
            temporary = Path(stack.enter_context(TemporaryDirectory(prefix="pc2scan-")))
            jobs = [replace(job, destination=temporary / job.destination.name) for job in jobs]
        try:
            if not options.dry_run:
                begun = [job.record(outcome=BEGUN, exit_status=0, output_identity=job.present) for job in jobs]
                stack.enter_context(folder.writing(begun))
            for job in plan.of("refuse"):
                record = _refusal(job, earlier := folder.records.get(job.key))
                if not options.dry_run and (earlier is None or not have_same_outcome(earlier, record)):
                    folder.append(record)
                yield record
            # Closed if the manifest cannot be written, too: the workers must end.
            records = stack.enter_context(closing(run(jobs, workers=_workers(plan, options))))
            for record in records if jobs else ():
                if record.disk_is_full and record.error is not None:
                    raise DiskFullError(record.error["message"], path=record.error["path"], hint=_NO_ROOM)
                if not options.dry_run:
                    folder.append(record)
                yield record
        except OutputError as err:
            if not is_full(err):
                raise
            raise DiskFullError(err.message, path=err.path, hint=_NO_ROOM) from err


def _refusal(job: Job, earlier: ManifestRecord | None) -> ManifestRecord:
    """Return the line of a recording that is refused; it keeps the place of an earlier result."""
    assert job.error is not None
    return job.failure(job.error, output=earlier.output if earlier else "")
