"""Wraps an executor: a long recording whose output is split by time becomes several jobs, whose results are joined.

The jobs of a recording are steps: find where to cut it, read its transforms (one job a stretch), convert its pieces.
They write into one directory, which is renamed to the destination when it is complete; see `pc2scan.pipeline.pieces`.
"""

from __future__ import annotations

import time
from collections import deque
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.destinations import recorded_in
from pc2scan.errors import OutputError, Pc2ScanError
from pc2scan.files.source import changed_while_read
from pc2scan.files.staging import staged_output
from pc2scan.pipeline.pieces import join, join_reports, may_be_cut, read_stretch, stretches_of
from pc2scan.pipeline.run import run_piece
from pc2scan.pipeline.split import Piece

from .identity import Identity, identity_of
from .jobs import Job, JobResult, outcome_of, utc_now
from .processes import JobEnd, JobProgress, JobStart, ProcessDeath
from .staging import is_remote

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence

    from pc2scan.bags.damage import Damage
    from pc2scan.pipeline.pieces import Stretch, Stretches
    from pc2scan.pipeline.split import PieceResult

    from .processes import Event, Executor

#: A file beside the pieces of a recording. While it exists, the steps that remain end at once: another one has failed.
_GIVEN_UP = "given-up"

#: Minimum size of a piece. Starting a process and reading the index of the source cost some tenths of a second a piece.
PIECE_BYTES = 2_000_000_000


class _CutSearch(NamedTuple):
    """The part of a job that finds where to cut a recording."""

    piece_bytes: int

    def do(self, job: Job, _progress: object) -> Stretches | None:
        cut = job.request.output.cut
        assert cut is not None
        return stretches_of(_sources(job), job.request.options, cut, piece_bytes=self.piece_bytes)


class _TransformReading(NamedTuple):
    """The part of a job that reads the transforms of a stretch."""

    sources: tuple[Path, ...]
    file: Path
    start_ns: int | None = None
    stop_ns: int | None = None

    def do(self, job: Job, _progress: object) -> list[Damage]:
        _refuse_given_up(job)
        return read_stretch(self.sources, job.request.options, self.file, self.start_ns, self.stop_ns)


class _PieceConversion(NamedTuple):
    """The part of a job that converts a piece."""

    destination: str
    piece: Piece

    def do(self, job: Job, progress: Callable[[int, int, int], None] | None) -> PieceResult:
        _refuse_given_up(job)
        request = job.request
        return run_piece(
            _sources(job),
            Path(self.destination),
            replace(request.options, jobs=job.threads),
            request.output,
            self.piece,
            also_read=request.files,
            progress=progress,
        )


def _refuse_given_up(job: Job) -> None:
    if is_given_up(job):
        raise OutputError("the recording was given up", path=Path(job.destination))


def is_given_up(job: Job) -> bool:
    """Whether another step of the recording has failed."""
    return job.step is not None and (Path(job.destination).parent / _GIVEN_UP).exists()


def _sources(job: Job) -> tuple[Path, ...]:
    return tuple(map(Path, job.sources))


def _cuttable(job: Job) -> bool:
    request = job.request
    # Only directories: pieces are written into the directory that becomes the output, and numbered files have none.
    plain = request.export is None and request.output.to == "rosbag2" and not job.dry_run and not is_remote(job)
    return plain and may_be_cut(request.output.cut) and job.size_bytes >= 2 * PIECE_BYTES


def piece_count(jobs: Sequence[Job]) -> int:
    """Return about how many processes could work on these jobs at a time."""
    return sum(job.size_bytes // PIECE_BYTES if _cuttable(job) else 1 for job in jobs)


def cutting_executor(executor: Executor) -> Executor:
    """Return an executor that cuts long recordings. ``executor`` must accept a deque to which jobs are appended."""

    def execute(jobs: Sequence[Job]) -> Generator[Event]:
        # Recordings at URLs are copied as a whole, so they are not cut.
        if not any(_cuttable(job) for job in jobs) or any(map(is_remote, jobs)):
            yield from executor(jobs)
            return
        todo: deque[Job] = deque()
        recordings: dict[str, _RecordingInPieces] = {}
        for job in jobs:
            if _cuttable(job):
                step = replace(job, key=_step_key(job, "index"), step=_CutSearch(PIECE_BYTES))
                recordings[step.key] = _RecordingInPieces(job, todo, recordings)
                todo.append(step)
            else:
                todo.append(job)
        events = executor(todo)
        try:
            for event in events:
                key = event.result.key if isinstance(event, JobEnd) else getattr(event, "key", "")
                recording = recordings.get(key)
                if recording is None:
                    yield event
                else:
                    yield from recording.take(key, event)
        finally:
            events.close()
            for recording in set(recordings.values()):
                recording.close()

    return execute


@dataclass(slots=True, eq=False)
class _RecordingInPieces:
    """A recording that is converted in pieces.

    Attributes
    ----------
    job
        The job of the whole recording.
    todo
        The queue of the executor: jobs that it has not begun.
    owners
        All recordings that are cut, by the keys of their steps.
    """

    job: Job
    todo: deque[Job]
    owners: dict[str, _RecordingInPieces]
    began: float = field(default_factory=time.monotonic)
    started: str = ""
    stack: ExitStack = field(default_factory=ExitStack)
    folder: Path = field(default_factory=Path)
    stretches: list[Stretch] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)
    waiting: set[str] = field(default_factory=set)
    transforms: tuple[Path, ...] = ()
    damage: list[Damage] = field(default_factory=list)
    #: Identity of the source when the first step read it, and its checksum below.
    identity: Identity = field(default_factory=Identity)
    sha256: str | None = None
    attempts: int = 1
    numbered: int = 0
    shares: dict[str, float] = field(default_factory=dict)
    next: Callable[[], Iterator[Event]] | None = None
    error: JobResult | None = None
    done: bool = False

    def take(self, key: str, event: Event) -> Generator[Event]:
        """Handle an event of one of its steps, and yield the events of the whole recording."""
        if self.done:
            return
        match event:
            case JobStart():
                if not self.started:
                    self.started = utc_now()
                    self.began = time.monotonic()
                    yield JobStart(self.job.key)
            case JobProgress(_, done, total) if key in self.shares and self.error is None:
                self.shares[key] = min(1.0, max(self.shares[key], done * len(self.pieces) / max(1, total)))
                yield self._report_progress()
            case ProcessDeath(_, why) if self.error is None:
                yield ProcessDeath(self.job.key, why)
            case JobEnd(result):
                self.attempts = max(self.attempts, result.attempts)
                self.waiting.discard(key)
                if result.error is None and self.error is None:
                    if key in self.shares:
                        self.shares[key] = 1.0
                        yield self._report_progress()
                    try:
                        yield from self._after(key, result)
                    except Pc2ScanError as err:
                        status, error = err.exit_status, err.as_dict()
                        self._give_up(replace(result, outcome=outcome_of(status), exit_status=status, error=error))
                elif self.error is None:
                    self._give_up(result)
                if self.error is not None and not self.waiting:
                    yield self._fail(self.error)

    def close(self) -> None:
        """Remove the output if it is not complete."""
        if not self.done:
            self.done = True
            self._abandon()

    def _give_up(self, result: JobResult) -> None:
        """Keep the error of a step, and end the other steps; what they have written is removed after that."""
        self.error = result
        dropped = {job.key for job in self.todo} & self.waiting
        self.waiting -= dropped
        left = [job for job in self.todo if job.key not in dropped]
        self.todo.clear()
        self.todo.extend(left)
        if self.waiting:
            with suppress(OSError):
                (self.folder / _GIVEN_UP).touch()

    def _abandon(self) -> None:
        error = OutputError("interrupted", path=Path(self.job.destination))
        self.stack.__exit__(type(error), error, None)

    def _report_progress(self) -> JobProgress:
        done = sum(self.shares.values()) / max(1, len(self.pieces))
        return JobProgress(self.job.key, round(1000 * done), 1000)

    def _after(self, key: str, result: JobResult) -> Generator[Event]:
        """Continue after a step."""
        if key == _step_key(self.job, "index"):
            self._cut(result)
            return
        if result.identity != self.identity:
            raise changed_while_read(Path(self.job.sources[0]))
        self.values[key] = result.value
        if not self.waiting and self.next is not None:
            yield from self.next()

    def _cut(self, result: JobResult) -> None:
        """Begin the steps that follow the cutting; a recording that is not cut becomes one job again."""
        self.identity, self.sha256 = result.identity, result.sha256
        cut: Stretches | None = result.value
        if cut is None:
            self.done = True
            self.todo.appendleft(self.job)
            return
        self.stretches = list(cut.stretches)
        destination = Path(self.job.destination)
        self.folder = self.stack.enter_context(
            staged_output(
                destination,
                overwrite=self.job.request.output.overwrite,
                owned=self.job.owned,
                record_in=recorded_in,
            )
        )
        try:
            self.folder.mkdir()
        except OSError as err:
            raise OutputError(f"cannot be written: {err.strerror}", path=destination) from err
        if not cut.needs_transforms:
            self._convert()
            return
        sources, others = _sources(self.job), self.job.request.options.frames.tf_from
        steps = [
            _TransformReading(sources, self.folder / f"transforms-{number}", each.start_ns, each.stop_ns)
            for number, each in enumerate(cut.stretches)
        ]
        # Transforms before and after the converted stretch are needed, too.
        steps[0] = steps[0]._replace(start_ns=None)
        steps[-1] = steps[-1]._replace(stop_ns=None)
        steps += [_TransformReading((other,), self.folder / f"others-{n}") for n, other in enumerate(others)]
        self.transforms = tuple(step.file for step in steps)
        for number, step in enumerate(steps):
            self._add(f"transforms {number + 1}", step, step.file)
        self.next = self._transforms_read

    def _add(self, name: str, step: _TransformReading | _PieceConversion, destination: Path) -> str:
        key = _step_key(self.job, name)
        self.owners[key] = self
        self.waiting.add(key)
        self.todo.append(
            replace(self.job, key=key, step=step, destination=str(destination), checksum=False, shown=False)
        )
        return key

    def _transforms_read(self) -> Iterator[Event]:
        self.damage = [damage for found in self.values.values() for damage in found]
        self._convert()
        return iter(())

    def _convert(self) -> None:
        first = 0
        self.pieces = []
        for number, stretch in enumerate(self.stretches):
            folder = self.folder / f"piece-{number}-{self.numbered}"
            piece = Piece(folder, stretch.start_ns, stretch.stop_ns, number == 0, first, self.transforms)
            self.pieces.append(piece)
            first += stretch.files
        self._submit(range(len(self.pieces)))

    def _submit(self, numbers: Sequence[int]) -> None:
        """Add jobs that convert pieces."""
        for number in numbers:
            piece = self.pieces[number]
            self.shares[self._add(piece.folder.name, _PieceConversion(self.job.destination, piece), piece.folder)] = 0.0
        self.next = self._finish_conversions

    def _finish_conversions(self) -> Iterator[Event]:
        """Join the pieces if their files have the numbers that one conversion would give; convert the others again."""
        results: list[PieceResult] = [self.values[_step_key(self.job, piece.folder.name)] for piece in self.pieces]
        self.numbered += 1
        if not results[0].file_count and len(results) > 1:
            # The first piece has no message. The first file of one conversion begins with the first message, so
            # the first two pieces become one.
            first, second, *others = self.stretches
            self.stretches = [first._replace(stop_ns=second.stop_ns), *others]
            piece = self.pieces[0]._replace(folder=self.folder / f"piece-0-{self.numbered}", stop_ns=second.stop_ns)
            self.pieces = [piece, *self.pieces[2:]]
            self._submit([0])
            return
        wrong = []
        number = 0
        for place, (piece, each) in enumerate(zip(self.pieces, results, strict=True)):
            if piece.first_file != number and each.file_count:
                folder = self.folder / f"piece-{place}-{self.numbered}"
                self.pieces[place] = piece._replace(folder=folder, first_file=number)
                wrong.append(place)
            number += each.file_count
        if wrong:
            self._submit(wrong)
            return
        yield self._complete(results)

    def _complete(self, results: list[PieceResult]) -> JobEnd:
        destination = Path(self.job.destination)
        options = self.job.request.options
        report = join_reports(results, self.damage, options)
        join(self.folder, self.pieces, results)
        self.done = True
        self.stack.close()
        files = sorted(destination.iterdir(), key=lambda path: (len(path.name), path.name))
        report.files = [str(path) for path in files if path.name != "metadata.yaml"]
        report.bytes_written = sum(path.stat().st_size for path in files)
        report.seconds = time.monotonic() - self.began
        return self._end_job(
            JobResult(
                key=self.job.key,
                outcome=outcome_of(report.exit_status),
                exit_status=report.exit_status,
                identity=self.identity,
                sha256=self.sha256,
                output_identity=identity_of([destination]),
                report=report.as_dict(),
                text=str(report) if self.job.shown else "",
            )
        )

    def _fail(self, result: JobResult) -> JobEnd:
        """Return the event that the recording failed, with the error of a step."""
        self.done = True
        self._abandon()
        return self._end_job(replace(result, sha256=self.sha256, value=None))

    def _end_job(self, result: JobResult) -> JobEnd:
        seconds = time.monotonic() - self.began
        started = self.started or utc_now()
        return JobEnd(replace(result, key=self.job.key, started=started, seconds=seconds, attempts=self.attempts))


def _step_key(job: Job, step: str) -> str:
    return f"{job.key}: {step}"
