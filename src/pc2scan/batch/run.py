"""Runs a batch from beginning to end: finds recordings, plans, converts, and writes the manifest and the report."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import DestinationError, OutputError, UsageError
from pc2scan.files.places import check_place, made_folder
from pc2scan.files.run_lock import only_run
from pc2scan.files.staging import clean_up, note_written
from pc2scan.files.text_output import check_text_output, text_output
from pc2scan.pipeline.scheduler import cores as all_cores
from pc2scan.remote.names import ShownUrl
from pc2scan.remote.urls import is_url, shown_path, url_of

from .choices import Choices
from .dataset_file import DatasetFile, load_dataset_file
from .estimate import estimated_seconds
from .find import find
from .identity import checksum_of, identity_of
from .manifest import MANIFEST, Manifest, Record, forget_begun, read_begun, read_manifest, write_begun
from .plan import History, make_plan
from .resources import available_bytes, workers_for
from .results import files_of, whole
from .staged import jobs_here
from .stores import Stores
from .summary import BEGINNINGS, BatchReport, Outcome, report_text
from .work import Job
from .workers import Began, Died, Ended, Information, Progressed, execute

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Mapping, Sequence

    from .find import Found, Known
    from .identity import Identity
    from .plan import Choice, Plan, Step
    from .stores import Output
    from .workers import Event, Executor

__all__ = ["BatchOptions", "BatchProgress", "Watch", "run_batch"]

#: The name of the workers' lock is derived from this.
_WORKERS = "manifest.jsonl.workers"

#: Seconds that a run waits for the workers of a killed run to end.
_WAIT_SECONDS = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchOptions:
    """How a batch runs. None of these options affects the outputs.

    Attributes
    ----------
    dataset
        The dataset file; None for none.
    jobs
        How many recordings are converted at a time; 0: one for each core, as far as the memory is enough.
    retries
        How often a recording is tried again if its process died.
    checksum
        Whether sources are compared by SHA-256 instead of their times of modification.
    force
        Whether recordings are converted again whose results are up to date.
    fail_fast
        Whether the run ends when the first recording fails.
    dry_run
        Whether nothing is written; the report then says what would be.
    dask
        The address of a Dask scheduler whose workers convert; True: a Dask cluster is started on this machine.
    report
        A file for the report: ``.json``, ``.csv`` or ``.md``; None for none.
    scratch, scratch_size
        The folder for local copies of recordings at URLs, and how many bytes they may take; None: the system's
        temporary folder, and its free space.
    """

    dataset: Path | None = None
    jobs: int = 0
    retries: int = 1
    checksum: bool = False
    force: bool = False
    fail_fast: bool = False
    dry_run: bool = False
    dask: bool | str = False
    report: Path | None = None
    scratch: Path | None = None
    scratch_size: int | None = None

    def __post_init__(self) -> None:
        for name in ("jobs", "retries"):
            if getattr(self, name) < 0:
                raise UsageError(f"`{name}` is {getattr(self, name)}, it must not be negative")
        if isinstance(self.dask, str) and "://" not in self.dask:
            raise UsageError(f"`dask={self.dask}`: the address of a scheduler is tcp://HOST:PORT")
        if isinstance(self.dask, str) and self.jobs:
            raise UsageError(f"`jobs={self.jobs}` has no effect with `dask={self.dask}`", hint="give only one of them")
        if is_url(self.report):
            raise UsageError("`report` must be a local file", hint="such as `report=report.csv`")
        if is_url(self.dataset):
            raise UsageError("`dataset` must be a local file", hint="the recordings that it matches may be at URLs")
        if self.report is not None and self.report.suffix.lower() not in BEGINNINGS:
            raise UsageError(
                f"`report={self.report}`: a report of a batch is one of {', '.join('NAME' + end for end in BEGINNINGS)}"
            )


class BatchProgress(NamedTuple):
    """The progress of a batch: bytes of sources and number of recordings, done and in total."""

    bytes_done: int
    bytes_total: int
    recordings_done: int
    recordings_total: int


def _ignore(_argument: object) -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True)
class Watch:
    """Callbacks for what happens in a batch. All are called in the thread that runs the batch.

    Attributes
    ----------
    planned
        Called with the plan.
    progress
        Called from time to time with the progress.
    done
        Called when a recording is done, with its line of the manifest.
    shown
        Called with the report of each conversion as text; None: no such text is made.
    warn
        Called with warnings that the user should see at once.
    inform
        Called with information for the user, such as the address of a dashboard.
    """

    planned: Callable[[Plan], None] = _ignore
    progress: Callable[[BatchProgress], None] = _ignore
    done: Callable[[Record], None] = _ignore
    shown: Callable[[str], None] | None = None
    warn: Callable[[str], None] = _ignore
    inform: Callable[[str], None] = _ignore


def run_batch(
    sources: Sequence[str],
    out: Path,
    keywords: Mapping[str, Any],
    options: BatchOptions,
    *,
    origins: Mapping[str, str] | None = None,
    executor: Callable[..., Executor] | None = None,
    watch: Watch | None = None,
) -> BatchReport:
    """Convert every recording of a dataset; see `pc2scan.batch`.

    Parameters
    ----------
    sources
        See `pc2scan.batch.find.find`.
    out
        The folder that is written into.
    keywords
        Options of the conversions, as `pc2scan.batch.request.request_of` reads them.
    options
        How the batch runs; they do not affect the outputs.
    origins
        Where the keywords come from.
    executor
        Makes the executor of the jobs, from ``workers``, ``retries`` and ``lock``; None: processes on this machine.
    watch
        Callbacks for what happens.
    """
    began = time.monotonic()
    watch = watch or Watch()
    if not sources:
        raise UsageError("no source given")
    dataset = DatasetFile() if options.dataset is None else load_dataset_file(options.dataset)
    choices = Choices(dataset, keywords, origins or {})
    choices.check()
    if options.dask and not options.dry_run:
        executor = executor or _on_dask("" if options.dask is True else str(options.dask))
    with ExitStack() as stack:
        stores = Stores(options.scratch)
        stack.callback(stores.close)
        stack.enter_context(stores.naming())
        lock, store = None, None
        if is_url(out):
            store = stores.output(url_of(out))
            if not options.dry_run:
                stack.enter_context(store.locked())
            store.pull()
        elif options.dry_run:
            _check_folder(out)
        else:
            stack.enter_context(made_folder(out))
            lock = stack.enter_context(_lock(out))
        folder = Path(os.path.realpath(out)) if store is None else store.folder
        batch = _Batch(sources, folder, options, choices, watch, stores, store)
        batch.report.destination = out if store is None else ShownUrl(shown_path(out))
        deliver = batch.open_report(stack)
        batch.plan()
        watch.planned(batch.made)
        if not options.dry_run:
            batch.clean_up()
        batch.convert(lock, executor or _local)
        batch.conclude(began)
        if deliver is not None and options.report is not None:
            deliver(report_text(batch.report, options.report.suffix.lower()))
    return batch.report


def _count_of(jobs: Sequence[Job]) -> int:
    """Return how many processes could work on these jobs at the same time."""
    if not any(job.request.output.cut for job in jobs):
        return len(jobs)
    from .cutting import count_of  # noqa: PLC0415  # most outputs are one file

    return count_of(jobs)


def _cutting(executor: Executor) -> Executor:
    """Return an executor that converts long recordings in pieces, where their output is split."""

    def execute(jobs: Sequence[Job]) -> Generator[Event]:
        if not any(job.request.output.cut for job in jobs):
            return executor(jobs)
        from .cutting import in_pieces  # noqa: PLC0415  # most outputs are one file

        return in_pieces(executor)(jobs)

    return execute


def _local(*, workers: int, retries: int, lock: int | None) -> Executor:
    def executor(jobs: Sequence[Job]) -> Generator[Event]:
        with jobs_here(jobs, workers) as queue:
            yield from execute(queue, workers=workers, cores=all_cores(), retries=retries, lock=lock)

    return _cutting(executor)


def _on_dask(address: str) -> Callable[..., Executor]:
    from .cluster import check_dask, execute_on_dask  # noqa: PLC0415  # most batches have no cluster

    check_dask()

    def make(*, workers: int, retries: int, lock: int | None) -> Executor:
        del lock  # It is for processes on this machine.

        def executor(jobs: Sequence[Job]) -> Generator[Event]:
            if not address and isinstance(jobs, list):
                # The workers are on this machine and share its disk, so each gets a part of the space for copies.
                jobs = [
                    job if job.scratch_size is None else replace(job, scratch_size=job.scratch_size // workers)
                    for job in jobs
                ]
            return execute_on_dask(jobs, address, workers=workers, cores=all_cores(), retries=retries)

        return _cutting(executor)

    return make


def _check_folder(out: Path) -> None:
    """Raise the errors that `made_folder` would raise, without making the folder."""
    if out.is_dir():
        return
    if os.path.lexists(out):
        raise DestinationError("is not a folder", path=out, hint="choose another name")
    check_place(out)


@contextmanager
def _lock(out: Path) -> Iterator[int]:
    """Hold two locks of the folder: one for this process, and one that its workers inherit, which is yielded.

    The second one shows that workers of a killed run are still alive. They may take some seconds to end.
    """
    deadline = time.monotonic() + _WAIT_SECONDS
    with ExitStack() as stack:
        try:
            stack.enter_context(only_run(out / MANIFEST))
            while True:
                try:
                    lock = stack.enter_context(only_run(out / _WORKERS))
                    break
                except DestinationError as err:
                    if "another run" not in err.message or time.monotonic() > deadline:
                        raise
                    time.sleep(0.05)
        except DestinationError as err:
            if "another run" in err.message:
                err.message, err.path = "another batch is writing into this folder", out
            raise
        yield lock


@dataclass(slots=True)
class _Progress:
    """Adds up the progress of all conversions."""

    sizes: Mapping[str, int]
    watch: Watch
    done: dict[str, int] = field(default_factory=dict)
    ended: set[str] = field(default_factory=set)

    def at(self, key: str, share: float) -> None:
        self.done[key] = round(self.sizes[key] * min(1.0, share))
        total = sum(self.sizes.values())
        self.watch.progress(BatchProgress(sum(self.done.values()), total, len(self.ended), len(self.sizes)))

    def end(self, key: str) -> None:
        self.ended.add(key)
        self.at(key, 1.0)


class _Batch:
    """The state of a running batch."""

    def __init__(
        self,
        sources: Sequence[str],
        out: Path,
        options: BatchOptions,
        choices: Choices,
        watch: Watch,
        stores: Stores,
        store: Output | None,
    ) -> None:
        self._sources = sources
        self._out = out
        self._options = options
        self._choices = choices
        self._watch = watch
        self._stores = stores
        #: The folder in the store if the destination is a URL; then `_out` has the files of it that are uploaded.
        self._store = store
        records = read_manifest(out / MANIFEST)
        # An output in the manifest was completed, even if the note still lists it.
        begun = read_begun(out) - {record.output for record in records.values()}
        self._history = History(records, begun)
        self._records: dict[str, Record] = {}
        self.made: Plan
        self.report = BatchReport(out, dry_run=options.dry_run)

    def open_report(self, stack: ExitStack) -> Callable[[str], None] | None:
        """Make sure that the report can be written, before anything is converted."""
        path = self._options.report
        if path is None:
            return None
        real = Path(os.path.realpath(path))
        if real == self._out / MANIFEST or (real.is_relative_to(self._out) and self._is_output(real)):
            raise DestinationError("the report cannot be written there: the batch writes this file itself", path=path)
        beginning = BEGINNINGS[path.suffix.lower()]
        try:
            if self._options.dry_run:
                check_text_output(path, beginning=beginning, overwrite=False)
                return None
            return stack.enter_context(text_output(path, beginning=beginning, overwrite=False))
        except (DestinationError, OutputError) as err:
            err.message = f"the report cannot be written there: {err.message}"
            raise

    def _is_output(self, path: Path) -> bool:
        return path.relative_to(self._out).as_posix() in self._history.owned

    def plan(self) -> None:
        """Find the recordings, and decide what is done with each."""
        found = find(
            self._sources,
            self._out,
            known=_known_recordings(self._history, self._stores),
            outputs=[path for output in self._history.owned for path in files_of(self._out, output)],
            stores=self._stores,
        )
        if not found:
            raise UsageError(f"no recording found in {', '.join(self._sources)}")
        keys = [each.key for each in found]
        self.made = make_plan(
            found,
            self._choices.of(keys),
            self._history,
            out=self._out,
            inputs={Path(os.path.realpath(path)) for each in found for path in each.paths},
            present=self._present,
            checksum=_source_checksum if self._options.checksum else None,
            force=self._options.force,
        )
        for step in self.made.steps:
            if step.error is not None:
                self._stores.names.error(step.error)
        self._stores.forget()
        self._refuse_idle()
        self.report.warnings += [*self._choices.warnings(keys), *self.made.warnings]

    def _refuse_idle(self) -> None:
        """Raise for options that have no effect with URLs, or without URLs."""
        if self._stores.are_used:
            if self._options.checksum:
                raise UsageError(
                    "`checksum` works only with local recordings", hint="a store reports itself whether objects changed"
                )
        elif self._options.scratch is not None or self._options.scratch_size is not None:
            raise UsageError("`scratch` and `scratch_size` have no effect: no source and no destination is a URL")

    def _present(self, output: str) -> Identity:
        if self._store is not None:
            return self._store.present(output)
        return identity_of(files_of(self._out, output))

    def clean_up(self) -> None:
        """Remove the temporary files that killed runs have left beside the outputs in this folder."""
        planned = [step.output for action in ("convert", "keep") for step in self.made.of(action)]
        for output in {*self._history.owned, *planned}:
            clean_up(self._out / whole(output))

    def convert(self, lock: int | None, make: Callable[..., Executor]) -> None:
        """Carry out the plan, and write the manifest."""
        # The largest first, so that at the end no worker is busy with a long recording while the others are idle.
        steps = sorted(self.made.of("convert"), key=lambda step: (-step.found.identity.size_bytes, step.found.key))
        by_key = {step.found.key: step for step in self.made.steps}
        jobs = [self._job(step, self._out) for step in steps]
        count = _count_of(jobs)
        wanted = min(self._options.jobs or workers_for(count, all_cores(), available_bytes()), max(1, count))
        self.report.workers = wanted
        executor = make(workers=wanted, retries=self._options.retries, lock=lock)
        if self._options.dry_run:
            for step in self.made.of("refuse"):
                self._note(self._refused(step))
            with TemporaryDirectory(prefix="pc2scan-") as folder:
                # Nothing is written there either. It is needed because the folders of the outputs may not exist yet.
                self._run(executor, [self._job(step, Path(folder), flat=True) for step in steps], by_key, self._note)
            self.report.estimate_seconds = estimated_seconds(jobs, list(self._history.records.values()), wanted)
            return
        with ExitStack() as stack:
            stack.callback(self._push, at_once=True)
            manifest: Manifest | None = None

            def note(record: Record) -> None:
                nonlocal manifest
                if manifest is None:
                    manifest = stack.enter_context(Manifest(self._out / MANIFEST))
                manifest.append(record)
                self._push()
                self._note(record)

            for step in self.made.of("refuse"):
                record = self._refused(step)
                if step.record is None or not _says_the_same(step.record, record):
                    note(record)
                else:
                    self._note(record)
            if jobs and not (self._options.fail_fast and self.made.of("refuse")):
                with self._begun(steps) as begin, self._folders(steps):
                    self._run(executor, jobs, by_key, note, begin)

    def _push(self, *, at_once: bool = False) -> None:
        """Upload the manifest, if the folder is at a URL."""
        if self._store is not None:
            self._store.push(at_once=at_once)

    def _is_there(self, output: str) -> bool:
        return os.path.lexists(self._out / output) if self._store is None else self._store.exists(output)

    def _note(self, record: Record) -> None:
        self._records[record.key] = record
        self._watch.done(record)

    def _run(
        self,
        executor: Executor,
        jobs: Sequence[Job],
        steps: Mapping[str, Step],
        note: Callable[[Record], None],
        begin: Callable[[str, bool], None] = lambda _output, _begins: None,
    ) -> None:
        """Run jobs, and handle their events in the order in which they come."""
        progress = _Progress({job.key: job.size_bytes for job in jobs}, self._watch)
        events = executor(jobs)
        try:
            for event in events:
                match event:
                    case Began(key):
                        begin(steps[key].output, True)
                        progress.at(key, 0.0)
                    case Progressed(key, done, total):
                        progress.at(key, done / total if total else 0.0)
                    case Died(key, why):
                        progress.at(key, 0.0)
                        self._watch.warn(f"{key}: {why}; it is tried again")
                    case Information(text):
                        self._watch.inform(text)
                    case Ended(result):
                        record = self._recorded(steps[result.key], result)
                        if record.is_written and self._store is None:
                            note_written(self._out / record.output)
                        note(record)
                        if result.text and self._watch.shown is not None:
                            self._watch.shown(result.text)
                        begin(steps[result.key].output, False)
                        progress.end(result.key)
                        if self._options.fail_fast and record.exit_status in (1, 2):
                            return
        finally:
            # Also if the manifest cannot be written: the workers must end.
            events.close()

    @contextmanager
    def _begun(self, steps: Sequence[Step]) -> Iterator[Callable[[str, bool], None]]:
        """Keep a note of the outputs that are being written and are not in the manifest yet."""
        outputs = {step.output for step in steps}
        earlier = self._history.begun
        write_begun(self._out, outputs | earlier)
        self._push(at_once=True)
        running: set[str] = set()
        ended: set[str] = set()

        def begin(output: str, begins: bool) -> None:
            (running.add if begins else ended.add)(output)

        try:
            yield begin
        finally:
            # Only outputs that exist stay in the note.
            left = {output for output in (earlier | running) - ended if self._is_there(output)}
            with suppress(OutputError):
                if left:
                    write_begun(self._out, left)
                else:
                    forget_begun(self._out)

    @contextmanager
    def _folders(self, steps: Sequence[Step]) -> Iterator[None]:
        """Make the folders of the outputs; those that stay empty are removed at the end."""
        made: list[Path] = []
        interrupted = {Path(output).parent for output in self._history.begun}
        try:
            for parent in sorted({Path(step.output).parent for step in steps}):
                for folder in reversed((parent, *parent.parents)):
                    path = self._out / folder
                    if path.is_dir():
                        if folder in interrupted:
                            made.append(path)
                        continue
                    # If it cannot be made, the conversions that write into it report why.
                    with suppress(OSError):
                        path.mkdir()
                        made.append(path)
            yield
        finally:
            for path in sorted(set(made) - {self._out}, key=lambda path: len(path.parts), reverse=True):
                with suppress(OSError):
                    path.rmdir()

    def _job(self, step: Step, folder: Path, *, flat: bool = False) -> Job:
        assert step.choice.request is not None
        return Job(
            key=step.found.key,
            sources=tuple(self._stores.url_of(path) for path in step.found.paths),
            destination=self._stores.url_of(folder / whole(Path(step.output).name if flat else step.output)),
            request=step.choice.request,
            size_bytes=step.found.identity.size_bytes,
            replaces=step.replaces,
            checksum=self._options.checksum and not self._options.dry_run,
            dry_run=self._options.dry_run,
            shown=self._watch.shown is not None,
            scratch=None if self._options.scratch is None else os.path.abspath(self._options.scratch),  # noqa: PTH100
            scratch_size=self._options.scratch_size,
        )

    def _record(self, step: Step, **known: Any) -> Record:
        choice: Choice = step.choice
        paths = tuple(map(self._stores.shown, step.found.paths))
        return Record(key=step.found.key, sources=paths, container=step.found.container, options=choice.digest, **known)

    def _refused(self, step: Step) -> Record:
        """Return the manifest's line for a recording that is refused."""
        assert step.error is not None
        earlier = step.record.output if step.record is not None else ""
        status = step.error.exit_status
        return self._record(
            step,
            identity=step.found.identity,
            outcome="failed",
            exit_status=status,
            error=step.error.as_dict(),
            output=earlier,
        )

    def _recorded(self, step: Step, result: Any) -> Record:
        """Return the manifest's line for a recording whose conversion has ended."""
        names = (
            "identity",
            "sha256",
            "outcome",
            "exit_status",
            "error",
            "output_identity",
            "started",
            "seconds",
            "attempts",
        )
        return self._record(
            step, **{name: getattr(result, name) for name in names}, output=step.output, report=result.report
        )

    def conclude(self, began: float) -> None:
        """Complete the report."""
        for step in self.made.steps:
            record = step.record if step.action == "keep" else self._records.get(step.found.key)
            self.report.outcomes.append(Outcome.of(step, record))
        self.report.seconds = time.monotonic() - began


def _known_recordings(history: History, stores: Stores) -> Known:
    """Return a function that looks up recordings that earlier runs have found, by path and identity."""
    containers: dict[tuple[str, Any], str] = {}
    for record in history.records.values():
        if not record.container:
            continue
        containers[record.sources[0], record.identity.files] = record.container
        if len(record.sources) == len(record.identity.files) > 1:
            for path, file in zip(record.sources, record.identity.files, strict=True):
                containers[path, (file,)] = record.container
    return lambda path, identity: containers.get((stores.shown(path), identity.files), "")


def _source_checksum(found: Found) -> str:
    try:
        return checksum_of(found.paths)
    except OSError:
        # The conversion will report the error.
        return ""


def _says_the_same(record: Record, other: Record) -> bool:
    names = ("outcome", "error", "identity", "options", "version", "output", "sources")
    return all(getattr(record, name) == getattr(other, name) for name in names)
