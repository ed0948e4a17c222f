"""Runs a batch from beginning to end: finds recordings, plans, converts, and writes the manifest and the report."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from pc2scan.errors import DestinationError, OutputError, UsageError
from pc2scan.files.ownership import InputPath, Inputs, OutputPath, first_link, inputs_of
from pc2scan.files.places import check_place, output_folder, parts_beside
from pc2scan.files.records import Record as FileRecord
from pc2scan.files.recovery import completed_parts
from pc2scan.files.staging import clean_up, note_written
from pc2scan.files.text_output import check_text_output, text_output
from pc2scan.files.urls import UrlPath, absolute
from pc2scan.threads import cores as all_cores

from .dataset_file import DatasetFile, load_dataset_file
from .executors import available_bytes, dask_executor, estimate_seconds, local_executor, workers_for
from .find import find
from .folder import check_folder, is_numbered, lock_folder, read_unfinished, track_outputs, unnumbered_name
from .identity import checksum_of, identity_of
from .jobs import Job
from .manifest import MANIFEST, Manifest, ManifestRecord, read_records
from .options import BatchCallbacks, ProgressSum
from .plan import History, have_same_outcome, make_plan, refusal_record, result_record
from .processes import Information, JobEnd, JobProgress, JobStart, ProcessDeath
from .request import Choices
from .stores import StoreFolder
from .summary import BEGINNINGS, BatchReport, Outcome, report_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from .find import Known, Recording
    from .identity import Identity
    from .options import BatchOptions
    from .plan import BatchPlan, Step
    from .processes import Executor
    from .request import Choice


def run_batch(
    sources: Sequence[str],
    out: Path,
    keywords: Mapping[str, Any],
    options: BatchOptions,
    *,
    origins: Mapping[str, str] | None = None,
    executor: Callable[..., Executor] | None = None,
    watch: BatchCallbacks | None = None,
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
    watch = watch or BatchCallbacks()
    if not sources:
        raise UsageError("no source given")
    dataset = DatasetFile() if options.dataset is None else load_dataset_file(options.dataset)
    choices = Choices(dataset, keywords, origins or {})
    choices.check()
    if options.dask and not options.dry_run:
        executor = executor or dask_executor("" if options.dask is True else str(options.dask))
    with ExitStack() as stack:
        lock, store, notes = None, None, out
        if isinstance(out, UrlPath):
            check_place(out)
            notes = Path(stack.enter_context(TemporaryDirectory(prefix="pc2scan-")))
            store = StoreFolder(out, notes)
        elif options.dry_run:
            check_folder(out)
        else:
            stack.enter_context(output_folder(out))
            lock = stack.enter_context(lock_folder(out))
        if store is None:
            notes = folder = Path(os.path.realpath(out))
        else:
            folder = out
        batch = _Batch(sources, folder, notes, options, choices, watch, store)
        batch.report.destination = out
        deliver = batch.open_report(stack)
        batch.plan()
        watch.planned(batch.made)
        if not options.dry_run:
            batch.clean_up()
        batch.convert(lock, executor or local_executor)
        batch.conclude(began)
        if deliver is not None and options.report is not None:
            deliver(report_text(batch.report, options.report.suffix.lower()))
    return batch.report


class _Batch:
    """The state of a running batch."""

    def __init__(
        self,
        sources: Sequence[str],
        out: Path,
        notes: Path,
        options: BatchOptions,
        choices: Choices,
        watch: BatchCallbacks,
        store: StoreFolder | None,
    ) -> None:
        self._sources = sources
        self._out = out
        self._options = options
        self._choices = choices
        self._watch = watch
        #: The local folder of the manifest and the note of unfinished outputs.
        self._notes = notes
        #: The folder in the store if the destination is a URL.
        self._store = store
        unfinished = read_unfinished(notes)
        self._history = History.read(read_records(notes / MANIFEST), unfinished.outputs)
        #: What killed runs have noted, without what is in the manifest.
        self._unfinished = unfinished._replace(outputs=self._history.unfinished)
        self._records: dict[str, ManifestRecord] = {}
        self.made: BatchPlan
        self.report = BatchReport(out, dry_run=options.dry_run)

    def open_report(self, stack: ExitStack) -> Callable[[str], None] | None:
        """Make sure that the report can be written, before anything is converted."""
        path = self._options.report
        if path is None:
            return None
        real = Path(os.path.realpath(path))
        is_inside = real.is_relative_to(self._out)
        if real == self._out / MANIFEST or (
            is_inside and real.relative_to(self._out).as_posix() in self._history.owned
        ):
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

    def plan(self) -> None:
        """Find the recordings, and decide what is done with each."""
        found = find(
            self._sources,
            self._out,
            known=_known_recordings(self._history),
            outputs=[path for output in {*self._history.owned, *self._history.left} for path in self._files_of(output)],
        )
        if not found:
            raise UsageError(f"no recording found in {', '.join(self._sources)}")
        keys = [each.key for each in found]
        choices = self._choices.of(keys)
        self.made = make_plan(
            found,
            choices,
            self._history,
            out=self._out,
            forbidden=self._forbidden([*self._inputs(found, choices.values())]),
            present=self._present,
            checksum=_source_checksum if self._options.checksum else None,
            force=self._options.force,
        )
        self._refuse_useless_options(found)
        self.report.warnings += [*self._choices.warnings(keys), *self.made.warnings]

    def _refuse_useless_options(self, found: Sequence[Recording]) -> None:
        """Raise for options that have no effect with URLs, or without URLs."""
        if self._store is not None or any(isinstance(path, UrlPath) for each in found for path in each.paths):
            if self._options.checksum:
                raise UsageError(
                    "`checksum` works only with local recordings", hint="a store reports itself whether objects changed"
                )
        elif self._options.scratch is not None:
            raise UsageError("`scratch` has no effect: no source and no destination is a URL")

    def _present(self, output: str) -> Identity:
        if self._store is not None:
            return self._store.present(output, self._history.left.get(output))
        return identity_of(self._files_of(output))

    def _files_of(self, output: str) -> list[Path]:
        """Return the paths of an output's files: of numbered ones those that are recorded, or else all that exist."""
        path = self._out / output
        if not is_numbered(output):
            return [path]
        left = self._history.left.get(output)
        return (
            parts_beside(self._out / unnumbered_name(output))
            if left is None
            else [path.with_name(f[0]) for f in left.files]
        )

    def _inputs(self, found: Sequence[Recording], choices: Iterable[Choice]) -> Iterator[InputPath]:
        """Yield everything that the batch reads."""
        yield from (InputPath(path) for each in found for path in each.paths)
        if self._options.dataset is not None:
            yield InputPath(self._options.dataset, "file of `dataset`")
        for request in {id(each.request): each.request for each in choices if each.request is not None}.values():
            yield from inputs_of((), request.options.frames.tf_from, request.files)

    def _forbidden(self, inputs: Sequence[InputPath]) -> Callable[[str], DestinationError | None]:
        """Return a function that returns why an output may not be written; None if it may."""
        read = cache(lambda: Inputs(inputs))

        def forbidden(output: str) -> DestinationError | None:
            path = self._out / unnumbered_name(output)
            try:
                read().refuse(OutputPath(path, numbered=is_numbered(output)))
            except DestinationError as err:
                return err
            link = first_link(self._out, output)
            return None if link is None else _behind_link(path, link)

        return forbidden

    def clean_up(self) -> None:
        """Remove the temporary files that killed runs have left beside the outputs in this folder."""
        if self._store is not None:
            # Nothing is beside them: see `pc2scan.files.transfers`.
            return
        planned = [step.output for action in ("convert", "keep") for step in self.made.of(action)]
        for output in {*self._history.owned, *planned}:
            if first_link(self._out, output) is None:
                path = self._out / unnumbered_name(output)
                done, noted = completed_parts(path), self._history.record(output)
                recorded = done is None or (noted is not None and noted.files == done.files)
                clean_up(path, recorded=recorded)

    def convert(self, lock: int | None, make: Callable[..., Executor]) -> None:
        """Carry out the plan, and write the manifest."""
        # The largest first, so that at the end no worker is busy with a long recording while the others are idle.
        steps = sorted(self.made.of("convert"), key=lambda step: (-step.found.identity.size_bytes, step.found.key))
        by_key = {step.found.key: step for step in self.made.steps}
        jobs = [self._job(step, self._out) for step in steps]
        count = len(jobs)
        wanted = min(self._options.jobs or workers_for(count, all_cores(), available_bytes()), max(1, count))
        self.report.workers = wanted
        executor = make(workers=wanted, retries=self._options.retries, lock=lock)
        if self._options.dry_run:
            for step in self.made.of("refuse"):
                self._note(refusal_record(step))
            with TemporaryDirectory(prefix="pc2scan-") as folder:
                # Nothing is written there either. It is needed because the folders of the outputs may not exist yet.
                self._run(executor, [self._job(step, Path(folder), flat=True) for step in steps], by_key, self._note)
            self.report.estimate_seconds = estimate_seconds(jobs, list(self._history.records.values()), wanted)
            return
        with ExitStack() as stack:
            stack.callback(self._push, at_once=True)
            manifest: Manifest | None = None

            def note(record: ManifestRecord) -> None:
                nonlocal manifest
                if manifest is None:
                    manifest = stack.enter_context(Manifest(self._notes / MANIFEST))
                manifest.append(record)
                self._push()
                self._note(record)

            for step in self.made.of("refuse"):
                record = refusal_record(step)
                if step.record is None or not have_same_outcome(step.record, record):
                    note(record)
                else:
                    self._note(record)
            if self._options.fail_fast and self.made.of("refuse"):
                jobs = []
            outputs = {step.output for step in steps} if jobs else set()
            with track_outputs(self._notes, outputs, self._unfinished, self._existing) as begin:
                if jobs:
                    self._push(at_once=True)
                    self._run(executor, jobs, by_key, note, begin)

    def _push(self, *, at_once: bool = False) -> None:
        """Upload the manifest, if the folder is at a URL."""
        if self._store is not None:
            self._store.push(at_once=at_once)

    def _existing(self, outputs: Iterable[str]) -> set[str]:
        """Return those outputs that exist now."""
        if self._store is not None:
            return self._store.existing(outputs)
        return {each for each in outputs if os.path.lexists(self._out / each)}

    def _note(self, record: ManifestRecord) -> None:
        self._records[record.key] = record
        self._watch.done(record)

    def _run(
        self,
        executor: Executor,
        jobs: Sequence[Job],
        steps: Mapping[str, Step],
        note: Callable[[ManifestRecord], None],
        begin: Callable[[str, bool], None] = lambda _output, _begins: None,
    ) -> None:
        """Run jobs, and handle their events in the order in which they come."""
        progress = ProgressSum({job.key: job.size_bytes for job in jobs}, self._watch)
        events = executor(jobs)
        try:
            for event in events:
                match event:
                    case JobStart(key):
                        begin(steps[key].output, True)
                        progress.at(key, 0.0)
                    case JobProgress(key, done, total):
                        progress.at(key, done / total if total else 0.0)
                    case ProcessDeath(key, why):
                        progress.at(key, 0.0)
                        self._watch.warn(f"{key}: {why}; it is tried again")
                    case Information(text):
                        self._watch.inform(text)
                    case JobEnd(result):
                        record = result_record(steps[result.key], result)
                        if record.is_written and self._store is None:
                            note_written(self._out / record.output)
                        note(record)
                        if is_numbered(record.output) and self._store is None and not self._options.dry_run:
                            clean_up(self._out / unnumbered_name(record.output), recorded=True)
                        if result.text and self._watch.shown is not None:
                            self._watch.shown(result.text)
                        begin(steps[result.key].output, False)
                        progress.end(result.key)
                        if self._options.fail_fast and record.exit_status in (1, 2):
                            return
        finally:
            # Also if the manifest cannot be written: the workers must end.
            events.close()

    def _job(self, step: Step, folder: Path, *, flat: bool = False) -> Job:
        assert step.choice.request is not None
        destination = folder / unnumbered_name(Path(step.output).name if flat else step.output)
        at_url = any(isinstance(path, UrlPath) for path in (*step.found.paths, destination))
        scratch = self._options.scratch if at_url else None
        return Job(
            key=step.found.key,
            sources=tuple(os.fspath(absolute(path)) for path in step.found.paths),
            destination=os.fspath(absolute(destination)),
            request=step.choice.request,
            size_bytes=step.found.identity.size_bytes,
            owned=step.owned or FileRecord({}),
            checksum=self._options.checksum and not self._options.dry_run,
            dry_run=self._options.dry_run,
            shown=self._watch.shown is not None,
            scratch=None if scratch is None else str(absolute(scratch)),
        )

    def conclude(self, began: float) -> None:
        """Complete the report."""
        for step in self.made.steps:
            record = step.record if step.action == "keep" else self._records.get(step.found.key)
            self.report.outcomes.append(Outcome.of(step, record))
        self.report.seconds = round(time.monotonic() - began, 3)


def _behind_link(path: Path, link: Path) -> DestinationError:
    return DestinationError(
        f"would be written through the link {link}, and a batch writes only into its own folder",
        path=path,
        hint="remove the link; or convert what belongs there in a batch of its own, "
        f"`destination={os.path.realpath(link)}`",
    )


def _known_recordings(history: History) -> Known:
    """Return a function that looks up recordings that earlier runs have found, by path and identity."""
    containers: dict[tuple[str, Any], str] = {}
    for record in history.records.values():
        if not record.container:
            continue
        containers[record.sources[0], record.identity.files] = record.container
        if len(record.sources) == len(record.identity.files) > 1:
            for path, file in zip(record.sources, record.identity.files, strict=True):
                containers[path, (file,)] = record.container
    return lambda path, identity: containers.get((str(path), identity.files), "")


def _source_checksum(found: Recording) -> str:
    try:
        return checksum_of(found.paths)
    except OSError:
        # The conversion will report the error.
        return ""
