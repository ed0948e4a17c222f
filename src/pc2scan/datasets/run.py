"""Runs a batch: finds recordings, plans, lets an executor convert them, and writes the manifest and the report."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import DestinationError, DiskFullError, OutputError, UsageError
from pc2scan.files.outputs import check_file_output, file_output
from pc2scan.files.ownership import InputPath, Inputs, OutputPath, first_link, inputs_of
from pc2scan.files.staging import clean_up, note_written
from pc2scan.files.system import copying_to, is_full
from pc2scan.files.transfers import refuse_without_room
from pc2scan.files.urls import UrlPath, absolute, is_url
from pc2scan.result import BEGINNING
from pc2scan.text import counted
from pc2scan.threads import cores

from .cluster import check_dask, run_jobs_on_dask
from .dataset_file import Choices, DatasetFile, load_dataset_file
from .find import find
from .folder import open_folder
from .jobs import Job
from .manifest import MANIFEST
from .plan import have_same_outcome, make_plan
from .processes import available_bytes, run_jobs, workers_for
from .summary import BatchReport, Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from os import PathLike

    from pc2scan.options.call import Options

    from .folder import BatchFolder
    from .jobs import Executor
    from .manifest import ManifestRecord
    from .plan import BatchPlan, Step


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchOptions:
    """How a batch runs. None of these options affects the outputs.

    Attributes
    ----------
    dataset
        The dataset file; None for none.
    jobs
        How many recordings are converted at a time; 0: one for each core, as far as the memory is enough.
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
        keys = [step.found.key for step in plan.steps]
        report = BatchReport(
            out,
            outcomes=[batch.outcomes.get(step.found.key) or Outcome.of(step, None) for step in plan.steps],
            dry_run=options.dry_run,
            seconds=round(time.monotonic() - began, 3),
            workers=0 if isinstance(options.dask, str) else batch.workers,
            warnings=[*choices.warnings(keys), *plan.warnings],
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
    found = find(sources, folder.path, known=folder.container_of, outputs=outputs)
    if not found:
        raise UsageError(f"no recording found in {', '.join(sources)}")
    requests = choices.of(each.key for each in found)
    inputs = [InputPath(path) for each in found for path in each.paths]
    if options.dataset is not None:
        inputs.append(InputPath(options.dataset, "file of `dataset`"))
    for request in {id(request): request for request in requests.values() if request is not None}.values():
        inputs += inputs_of((), request.options.frames.tf_from, request.options.files)
    plan = make_plan(
        found,
        requests,
        folder,
        forbidden=partial(_forbidden, folder.path, cache(partial(Inputs, inputs))),
        again=options.again,
    )
    at_url = isinstance(folder.path, UrlPath) or any(isinstance(path, UrlPath) for each in found for path in each.paths)
    if options.scratch is not None and not at_url:
        raise UsageError("`scratch` has no effect: no source and no destination is a URL")
    return plan


def _forbidden(out: Path, read: Callable[[], Inputs], output: str) -> DestinationError | None:
    """Return why an output may not be written into a folder, whatever is there; None if it may."""
    path = out / output
    try:
        read().refuse(OutputPath(path))
    except DestinationError as err:
        return err
    link = first_link(out, output)
    if link is None:
        return None
    return DestinationError(
        f"would be written through the link {link}, and a batch writes only into its own folder",
        path=path,
        hint="remove the link; or convert what belongs there in a batch of its own, "
        f"`destination={os.path.realpath(link)}`",
    )


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
        self._plan = plan
        self._options = options
        self._executor = executor
        self._steps = {step.found.key: step for step in plan.steps}
        self._jobs = [self._job(step) for step in plan.of("convert")]
        # The largest first, so that at the end no worker is busy with a long recording while the others are idle.
        self._jobs.sort(key=lambda job: (-job.size_bytes, job.key))
        count = len(self._jobs)
        self.workers = min(options.jobs or workers_for(count, cores(), available_bytes()), max(1, count))
        self.outcomes = {step.found.key: Outcome.of(step, step.record) for step in plan.of("keep")}

    def try_out(self) -> None:
        """Say what would be done, and write nothing."""
        for record in self._refusals():
            self._show(record)
        with TemporaryDirectory(prefix="pc2scan-") as folder:
            # Nothing is written there either. It is needed because the folders of the outputs may not exist yet.
            self._run([replace(job, destination=str(Path(folder, Path(job.destination).name))) for job in self._jobs])

    def convert(self) -> None:
        """Convert the recordings, and write the manifest.

        Raises
        ------
        DiskFullError
            If there is no room for a result or for the manifest. All other recordings would fail, too.
        """
        self._clean_up()
        try:
            self._convert()
        except OutputError as err:
            if is_full(err):
                raise self._disk_is_full(err.message, err.path) from err
            raise

    def _convert(self) -> None:
        refusals = self._refusals()
        with self._folder.writing({job.output for job in self._jobs}):
            for record in refusals:
                earlier = self._steps[record.key].record
                if earlier is None or not have_same_outcome(earlier, record):
                    self._folder.append(record)
                self._show(record)
            if self._jobs:
                self._run(self._jobs)

    def _clean_up(self) -> None:
        """Remove the temporary files that killed runs have left beside the outputs in this folder."""
        out = self._folder.path
        if isinstance(out, UrlPath):
            # Nothing is beside them: see `pc2scan.files.transfers`.
            return
        planned = [step.output for action in ("convert", "keep") for step in self._plan.of(action)]
        for output in {*self._folder.outputs, *planned}:
            if first_link(out, output) is None:
                clean_up(out / output)

    def _refusals(self) -> list[ManifestRecord]:
        """Return the lines of the recordings that are refused."""
        return [
            self._job(step).failure(
                step.error, identity=step.found.identity, output=step.record.output if step.record else ""
            )
            for step in self._plan.of("refuse")
            if step.error is not None
        ]

    def _job(self, step: Step) -> Job:
        assert step.request is not None
        destination = self._folder.path / step.output
        at_url = any(isinstance(path, UrlPath) for path in (*step.found.paths, destination))
        scratch = self._options.scratch if at_url else None
        return Job(
            key=step.found.key,
            sources=tuple(os.fspath(absolute(path)) for path in step.found.paths),
            destination=os.fspath(absolute(destination)),
            container=step.found.container,
            output=step.output,
            request=step.request,
            size_bytes=step.found.identity.size_bytes,
            owned=step.owned,
            there=step.there,
            dry_run=self._options.dry_run,
            shown=self.watch.shown is not None,
            scratch=None if scratch is None else str(absolute(scratch)),
        )

    def _run(self, jobs: Sequence[Job]) -> None:
        """Run jobs, and record and show each as it ends."""
        if self._executor is run_jobs:
            # The largest are first. On a cluster, each worker has a folder of its own.
            fetched = sum(job.size_bytes for job in jobs[: self.workers] if any(map(is_url, job.sources)))
            with copying_to(self._options.scratch):
                refuse_without_room(
                    fetched, self._folder.path, "give fewer `jobs`, or another disk's folder as `scratch`"
                )
        sizes = {job.key: job.size_bytes for job in jobs}
        done, total = 0, sum(sizes.values())
        self.watch.progress(BatchProgress(0, total, 0, len(sizes)))
        records = self._executor(jobs, workers=self.workers, lock=self._folder.lock)
        try:
            for number, record in enumerate(records, start=1):
                if record.disk_is_full:
                    assert record.error is not None  # that of the disk
                    raise self._disk_is_full(record.error["message"], record.error["path"])
                self._end(record)
                done += sizes[record.key]
                self.watch.progress(BatchProgress(done, total, number, len(sizes)))
        finally:
            # Also if the manifest cannot be written: the workers must end.
            records.close()

    def _disk_is_full(self, message: str, path: str | PathLike[str] | None) -> DiskFullError:
        """Return the error that ends the batch, given that of a result or of the manifest."""
        planned = self._plan.of("convert")
        left = sum(step.found.key not in self.outcomes for step in planned)
        return DiskFullError(
            message,
            path=path,
            hint="make room on that disk, and run the same command again: "
            f"of {counted(len(planned), 'recording')}, {left:,} {'are' if left > 1 else 'is'} left to convert",
        )

    def _end(self, record: ManifestRecord) -> None:
        """Record and show the result of a recording."""
        path = self._folder.path / record.output
        if record.is_written and not self._options.dry_run and not isinstance(path, UrlPath):
            note_written(path)
        if not self._options.dry_run:
            self._folder.append(record)
        self._show(record)
        if record.text and self.watch.shown is not None:
            self.watch.shown(record.text)

    def _show(self, record: ManifestRecord) -> None:
        outcome = self.outcomes[record.key] = Outcome.of(self._steps[record.key], record)
        self.watch.done(outcome)
