"""Converts one recording of a batch, in whatever process: a job becomes a result, and errors are part of it."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from pc2scan.bags.opening import open_recordings
from pc2scan.errors import Pc2ScanError, RecordingError
from pc2scan.pipeline.run import run
from pc2scan.remote.urls import is_url

from .identity import Identity, checksum_of, identity_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.export.report import ExportReport
    from pc2scan.pipeline.report import Report

    from .request import Request

__all__ = ["Job", "Result", "Step", "convert_one", "died", "outcome_of"]

#: Outcomes by the exit status of `pc2scan convert`.
_OUTCOMES = {0: "converted", 3: "incomplete", 4: "empty"}


class Step(Protocol):
    """A part of a conversion that a process of its own does; see `pc2scan.batch.cutting`."""

    def do(self, job: Job, progress: Callable[[int, int, int], None] | None) -> Any:
        """Do it, and return what `Result.made` is."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A recording to be converted: all that another process needs to know.

    Attributes
    ----------
    key
        Its name in the dataset.
    sources, destination
        Absolute paths, or URLs.
    request
        What is asked for.
    size_bytes
        Of the sources.
    replaces
        Whether what is at the destination may be replaced.
    threads
        How many threads convert.
    checksum
        Whether the result has the checksum of the sources.
    dry_run
        Whether nothing is written, and the result is a forecast.
    shown
        Whether the result has the report as text, too.
    scratch, scratch_size
        Where local copies of what is at URLs are, and how many bytes of them there may be.
    room
        The folder of the copies and of a result that is uploaded, and how many bytes may be in it; None for any.
    step
        The part of the conversion that is to be done; None for all of it.
    """

    key: str
    # URLs may have secrets in them, and jobs are shown in the logs of a cluster.
    sources: tuple[str, ...] = field(repr=False)
    destination: str = field(repr=False)
    request: Request
    size_bytes: int = 0
    replaces: bool = False
    threads: int = 1
    checksum: bool = False
    dry_run: bool = False
    shown: bool = False
    scratch: str | None = None
    scratch_size: int | None = None
    room: tuple[str, int] | None = None
    step: Step | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What became of a job: the attributes of a `pc2scan.batch.manifest.Record` that only the conversion knows.

    ``text`` is the report for people, if the job asked for it; ``made`` is what a step returns.
    """

    key: str
    outcome: str
    exit_status: int
    identity: Identity = Identity()
    sha256: str | None = None
    output_identity: Identity = Identity()
    started: str = ""
    seconds: float = 0.0
    attempts: int = 1
    report: dict[str, Any] | None = None
    error: dict[str, Any] | None = None
    text: str = ""
    made: Any = None


def outcome_of(exit_status: int) -> str:
    """Return the outcome of a conversion that ended with this status."""
    return _OUTCOMES.get(exit_status, "failed")


def convert_one(job: Job, progress: Callable[[int, int, int], None] | None = None) -> Result:
    """Convert a recording; whatever goes wrong with it is in the result.

    Parameters
    ----------
    progress
        See `pc2scan.convert`.
    """
    if any(is_url(Path(path)) for path in (*job.sources, job.destination)):
        return _at_urls(job, progress)
    began = time.monotonic()
    started = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
    sources = [Path(path) for path in job.sources]
    destination = Path(job.destination)
    identity = identity_of(sources)
    sha256 = None
    report = error = made = None
    text, status = "", 0
    try:
        if job.checksum:
            sha256 = _checksum(sources)
        limit = None
        if job.room is not None:
            from pc2scan.remote.scratch import Limit  # noqa: PLC0415  # few jobs have URLs

            limit = Limit(Path(job.room[0]), job.room[1])
            progress = limit.watching(progress)
        if job.step is not None:
            made = job.step.do(job, progress)
        else:
            done = _done(job, sources, destination, progress)
            if limit is not None:
                limit.check()
            report, status = done.as_dict(), done.exit_status
            text = str(done) if job.shown else ""
    except Pc2ScanError as err:
        error, status = err.as_dict(), err.exit_status
    except Exception as err:  # noqa: BLE001  # one recording must not end the others; the manifest has the traceback
        error, status = _unexpected(err), 1
    return Result(
        key=job.key,
        outcome=outcome_of(status),
        exit_status=status,
        identity=identity,
        sha256=sha256,
        output_identity=Identity() if error or job.dry_run or job.step is not None else _identity(destination, report),
        started=started,
        seconds=time.monotonic() - began,
        report=report,
        error=error,
        text=text,
        made=made,
    )


def _at_urls(job: Job, progress: Callable[[int, int, int], None] | None) -> Result:
    """Look into recordings of which only ranges are read: a dry run; all else is copied before it comes here."""
    from pc2scan.remote.ranges import nearby  # noqa: PLC0415  # loads fsspec

    assert job.dry_run
    others = job.request.options.frames.tf_from
    try:
        with nearby([*map(Path, job.sources), *others]) as here:
            paths = here.paths[: len(job.sources)]
            frames = replace(job.request.options.frames, tf_from=tuple(here.paths[len(job.sources) :]))
            request = replace(job.request, options=replace(job.request.options, frames=frames))
            result = convert_one(replace(job, sources=tuple(map(str, paths)), request=request), progress)
            shown: Result = here.names.of(result)
            return shown
    except Pc2ScanError as err:
        return Result(key=job.key, outcome="failed", exit_status=err.exit_status, error=err.as_dict())


def _done(
    job: Job, sources: list[Path], destination: Path, progress: Callable[[int, int, int], None] | None
) -> Report | ExportReport:
    """Convert or export; raises what that raises."""
    request = job.request
    options = replace(request.options, jobs=job.threads)
    if job.dry_run and request.export is not None and not request.export.converting:
        return _looked_into(job, sources)
    if request.export is None or job.dry_run:
        # Scans that would be exported are those that would be converted.
        output = request.output._replace(overwrite=job.replaces, dry_run=job.dry_run)
        return run(
            sources,
            destination,
            options,
            output,
            also_read=request.files,
            progress=progress,
        )
    from pc2scan.export.run import run as export  # noqa: PLC0415  # most batches write recordings

    form = replace(request.export, overwrite=job.replaces)
    return export(sources, destination, options, form, in_folder=True, also_read=request.files, progress=progress)


def _looked_into(job: Job, sources: list[Path]) -> ExportReport:
    """Open a recording of which messages would be exported as they are."""
    from pc2scan.export.report import ExportReport  # noqa: PLC0415  # most batches write recordings

    options = job.request.options
    with ExitStack() as stack:
        readers = open_recordings(sources, stack, verify=options.verify, strict=options.strict)
        damage = tuple(place for reader in readers for place in reader.damage)
    assert job.request.export is not None
    return ExportReport(list(job.sources), job.destination, str(job.request.export.format), damage=damage)


def _identity(destination: Path, report: Mapping[str, Any] | None) -> Identity:
    """Of what was written: a file, a directory, or numbered files."""
    files = (report or {}).get("files") or ()
    return identity_of(map(Path, files) if files and not destination.is_dir() else [destination])


def died(job: Job, why: str, *, attempts: int, seconds: float) -> Result:
    """Return the result of a job whose process died."""
    error = {"class": "ProcessDied", "message": why, "place": None, "hint": None, "exit_status": 1}
    started = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
    identity = identity_of(map(Path, job.sources))
    return Result(
        key=job.key,
        outcome="died",
        exit_status=1,
        identity=identity,
        started=started,
        seconds=seconds,
        attempts=attempts,
        error=error,
    )


def _checksum(sources: list[Path]) -> str:
    try:
        return checksum_of(sources)
    except OSError as err:
        raise RecordingError(f"cannot be read: {err.strerror}", path=sources[0]) from err


def _unexpected(err: Exception) -> dict[str, Any]:
    import traceback  # noqa: PLC0415  # a bug, or memory that is not there

    return {
        "class": type(err).__name__,
        "message": f"{type(err).__name__}: {err}" if str(err) else type(err).__name__,
        "place": None,
        "hint": None,
        "exit_status": 1,
        "traceback": "".join(traceback.format_exception(err)),
    }
