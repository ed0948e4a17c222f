"""Runs a batch: finds recordings, plans, lets an executor convert them, and writes the manifest and the report."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import DestinationError, DiskFullError, OutputError, UsageError
from pc2scan.files.outputs import check_file_output, file_output
from pc2scan.files.ownership import InputPath, first_link, inputs_of
from pc2scan.files.staging import clean_up
from pc2scan.files.system import copying_to, is_full
from pc2scan.files.transfers import refuse_without_room
from pc2scan.files.urls import UrlPath, absolute
from pc2scan.result import BEGINNING
from pc2scan.text import counted
from pc2scan.threads import cores

from .cluster import check_dask, run_jobs_on_dask
from .dataset_file import Choices, DatasetFile, load_dataset_file
from .find import find, natural_key
from .folder import open_folder
from .manifest import MANIFEST
from .plan import have_same_outcome, make_plan
from .processes import run_jobs
from .summary import BatchReport, Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from os import PathLike

    from pc2scan.options.call import Options

    from .folder import BatchFolder
    from .jobs import Executor, Job
    from .manifest import ManifestRecord
    from .plan import BatchPlan


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchOptions:
    """How a batch runs. None of these options affects the outputs.

    Attributes
    ----------
    dataset
        The dataset file; None for none.
    jobs
        How many recordings are converted at a time; 0: one for each core.
    again
        Whether recordings are converted again whose results are up to date.
    dry_run
        Whether nothing is written; the report then says what would be.
    dask
        The address of a Dask scheduler whose workers convert; True: a Dask cluster is started on this machine.
    report
        A file for the report, as JSON; None for none.
    scratch
        The folder for local copies of what is at URLs; None: the system's folder for temporary files.
    """

    dataset: Path | None = None
    jobs: int = 0
    again: bool = False
    dry_run: bool = False
    dask: bool | str = False
    report: Path | None = None
    scratch: Path | None = None

    @classmethod
    def of(cls, options: Options) -> BatchOptions:
        """Return how a batch runs, by the options of a call."""
        return cls(**options.among(cls.__dataclass_fields__))

    def __post_init__(self) -> None:
        if isinstance(self.dask, str) and "://" not in self.dask:
            raise UsageError(f"`dask={self.dask}`: the address of a scheduler is tcp://HOST:PORT")
        if isinstance(self.dask, str) and self.jobs:
            raise UsageError(f"`jobs={self.jobs}` has no effect with `dask={self.dask}`", hint="give only one of them")


class BatchProgress(NamedTuple):
    """The progress of a batch: bytes and recordings, done and in total."""

    bytes_done: int
    bytes_total: int
    recordings_done: int
    recordings_total: int


def _ignore(_argument: object) -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True)
class BatchCallbacks:
    """Callbacks for what happens in a batch. All are called in the thread that runs the batch.

    Attributes
    ----------
    planned
        Called with the plan.
    progress
        Called from time to time with the progress.
    done
        Called with the outcome of each recording.
    shown
        Called with the report of each conversion as text; None: no such text is made.
    """

    planned: Callable[[BatchPlan], None] = _ignore
    progress: Callable[[BatchProgress], None] = _ignore
    done: Callable[[Outcome], None] = _ignore
    shown: Callable[[str], None] | None = None


def run_batch(
    sources: Sequence[str],
    out: Path,
    keywords: Mapping[str, Any],
    options: BatchOptions,
    *,
    origins: Mapping[str, str] | None = None,
    executor: Executor | None = None,
    watch: BatchCallbacks | None = None,
) -> BatchReport:
    """Convert every recording of a dataset; see `pc2scan.batch`.

    Parameters
    ----------
    sources
        See `pc2scan.datasets.find.find`.
    out
        The folder that is written into.
    keywords
        Options of the conversions, as `pc2scan.datasets.jobs.request_of` reads them.
    options
        How the batch runs; they do not affect the outputs.
    origins
        Where the keywords come from.
    executor
        Runs the jobs; None: the one that ``options`` names, or processes on this machine.
    watch
        Callbacks for what happens.
    """
    began = time.monotonic()
    if not sources:
        raise UsageError("no source given")
    dataset = DatasetFile() if options.dataset is None else load_dataset_file(options.dataset)
    choices = Choices(dataset, keywords, origins or {})
    if options.dask and not options.dry_run:
        check_dask()
        executor = executor or partial(run_jobs_on_dask, address="" if options.dask is True else options.dask)
    with ExitStack() as stack:
        folder = stack.enter_context(open_folder(out, dry_run=options.dry_run))
        write_report = _open_report(options, folder, stack)
        plan = _plan(sources, folder, choices, options)
        batch = _Batch(plan, folder, options, watch or BatchCallbacks(), executor or run_jobs)
        batch.watch.planned(plan)
        if options.dry_run:
            batch.try_out()
        else:
            batch.convert()
        outcomes = [*batch.outcomes.values(), *(Outcome.skipped_by_file(each.key) for each in plan.skipped)]
        report = BatchReport(
            out,
            outcomes=sorted(outcomes, key=lambda each: natural_key(each.key)),
            dry_run=options.dry_run,
            seconds=round(time.monotonic() - began, 3),
            workers=0 if isinstance(options.dask, str) else batch.workers,
            warnings=[*choices.warnings(each.key for each in outcomes), *plan.warnings],
        )
        if write_report is not None:
            write_report(report.as_json())
    return report


def _open_report(options: BatchOptions, folder: BatchFolder, stack: ExitStack) -> Callable[[str], None] | None:
    """Make sure that the report can be written, before anything is converted; return the function that writes it."""
    path = options.report
    if path is None:
        return None
    real = Path(os.path.realpath(path))
    if real.is_relative_to(folder.path) and (real.relative_to(folder.path).as_posix() in {MANIFEST, *folder.outputs}):
        raise DestinationError("the report cannot be written there: the batch writes this file itself", path=path)
    try:
        if options.dry_run:
            check_file_output(path, beginning=BEGINNING, overwrite=False)
            return None
        return stack.enter_context(file_output(path, beginning=BEGINNING, overwrite=False))
    except (DestinationError, OutputError) as err:
        err.message = f"the report cannot be written there: {err.message}"
        raise


# --- Planning ---


def _plan(sources: Sequence[str], folder: BatchFolder, choices: Choices, options: BatchOptions) -> BatchPlan:
    """Find the recordings, and decide what is done with each."""
    outputs = [folder.path / output for output in folder.outputs]
    recordings = find(sources, folder.path, known=folder.container_of, outputs=outputs)
    if not recordings:
        raise UsageError(f"no recording found in {', '.join(sources)}")
    requests = choices.of(each.key for each in recordings)
    inputs = [InputPath(path) for each in recordings for path in each.paths]
    if options.dataset is not None:
        inputs.append(InputPath(options.dataset, "file of `dataset`"))
    for request in {id(request): request for request in requests.values() if request is not None}.values():
        inputs += inputs_of((), request.options.frames.tf_from, request.options.files)
    paths = (path for each in recordings for path in each.paths)
    if options.scratch is not None and not any(isinstance(path, UrlPath) for path in paths):
        raise UsageError("`scratch` has no effect: no source is a URL")
    return make_plan(recordings, requests, folder, inputs, again=options.again)


# --- Converting ---


class _Batch:
    """A batch that carries out its plan.

    Parameters
    ----------
    plan, folder, options, watch, executor
        What is done, where, and how.

    Attributes
    ----------
    outcomes
        The outcomes so far, by key.
    workers
        How many recordings are converted at a time.
    """

    def __init__(
        self, plan: BatchPlan, folder: BatchFolder, options: BatchOptions, watch: BatchCallbacks, executor: Executor
    ) -> None:
        self.watch = watch
        self._folder = folder
        self._options = options
        self._executor = executor
        self._by_key = {job.key: job for job in plan.jobs}
        self._refused = plan.of("refuse")
        scratch = None if options.scratch is None else absolute(options.scratch)
        how: dict[str, Any] = {"dry_run": options.dry_run, "shown": watch.shown is not None, "scratch": scratch}
        # The largest first, so that at the end no worker is busy with a long recording while the others are idle.
        self._jobs = sorted((replace(job, **how) for job in plan.of("convert")), key=lambda job: -job.size_bytes)
        self.workers = max(1, min(options.jobs or cores(), len(self._jobs)))
        self.outcomes = {job.key: Outcome.of(job, folder.records[job.key]) for job in plan.of("keep")}

    def try_out(self) -> None:
        """Say what would be done, and write nothing."""
        for job in self._refused:
            self._show(self._refusal(job))
        with TemporaryDirectory(prefix="pc2scan-") as folder:
            # Nothing is written there either. It is needed because the folders of the outputs may not exist yet.
            self._run([replace(job, destination=Path(folder, job.destination.name)) for job in self._jobs])

    def convert(self) -> None:
        """Convert the recordings, and write the manifest.

        Raises
        ------
        DiskFullError
            If there is no room for a result or for the manifest. All other recordings would fail, too.
        """
        self._clean_up()
        try:
            with self._folder.writing({job.output for job in self._jobs}):
                for record in map(self._refusal, self._refused):
                    earlier = self._folder.records.get(record.key)
                    if earlier is None or not have_same_outcome(earlier, record):
                        self._folder.append(record)
                    self._show(record)
                if self._jobs:
                    self._run(self._jobs)
        except OutputError as err:
            if is_full(err):
                raise self._disk_is_full(err.message, err.path) from err
            raise

    def _clean_up(self) -> None:
        """Remove the temporary files that killed runs have left beside the outputs in this folder."""
        out = self._folder.path
        for output in {*self._folder.outputs, *(job.output for job in self._by_key.values() if job.action != "refuse")}:
            if first_link(out, output) is None:
                clean_up(out / output)

    def _refusal(self, job: Job) -> ManifestRecord:
        """Return the line of a recording that is refused; it keeps the place of an earlier result."""
        assert job.error is not None
        earlier = self._folder.records.get(job.key)
        return job.failure(job.error, output=earlier.output if earlier else "")

    def _run(self, jobs: Sequence[Job]) -> None:
        """Run jobs, and record and show each as it ends."""
        # The largest come first.
        remote = [job for job in jobs if any(isinstance(path, UrlPath) for path in job.recording.paths)][: self.workers]
        if remote and not self._options.dask:
            with copying_to(self._options.scratch):
                place = remote[0].recording.paths[0]
                refuse_without_room(sum(job.size_bytes for job in remote), place, "lower `jobs`, or give `scratch`")
        done, total = 0, sum(job.size_bytes for job in jobs)
        self.watch.progress(BatchProgress(0, total, 0, len(jobs)))
        records = self._executor(jobs, workers=self.workers, lock=self._folder.lock)
        try:
            for number, record in enumerate(records, start=1):
                if record.disk_is_full:
                    assert record.error is not None  # that of the disk
                    raise self._disk_is_full(record.error["message"], record.error["path"])
                if not self._options.dry_run:
                    self._folder.append(record)
                self._show(record)
                done += self._by_key[record.key].size_bytes
                self.watch.progress(BatchProgress(done, total, number, len(jobs)))
        finally:
            # Also if the manifest cannot be written: the workers must end.
            records.close()

    def _disk_is_full(self, message: str, path: str | PathLike[str] | None) -> DiskFullError:
        """Return the error that ends the batch, given that of a result or of the manifest."""
        left = sum(job.key not in self.outcomes for job in self._jobs)
        return DiskFullError(
            message,
            path=path,
            hint="make room on that disk, and run the same command again: "
            f"of {counted(len(self._jobs), 'recording')}, {left:,} {'are' if left > 1 else 'is'} left to convert",
        )

    def _show(self, record: ManifestRecord) -> None:
        outcome = self.outcomes[record.key] = Outcome.of(self._by_key[record.key], record)
        self.watch.done(outcome)
        if record.text and self.watch.shown is not None:
            self.watch.shown(record.text)
