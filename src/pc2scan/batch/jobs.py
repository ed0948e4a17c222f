"""Converts one recording of a batch in any process: a job becomes a result, which includes errors."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from pc2scan.bags.opening import open_recordings
from pc2scan.errors import Pc2ScanError, RecordingError
from pc2scan.files.records import Record as FileRecord
from pc2scan.files.urls import path_or_url
from pc2scan.pipeline.run import run

from .identity import Identity, checksum_of, identity_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.export.report import ExportReport
    from pc2scan.pipeline.report import Report

    from .request import Request

#: Outcomes by the exit status of `pc2scan convert`.
_OUTCOMES = {0: "converted", 3: "incomplete", 4: "empty"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A recording to be converted, with everything that another process needs for it.

    Attributes
    ----------
    key
        Its name in the dataset.
    sources, destination
        Absolute paths, or URLs.
    request
        The conversion that is requested.
    size_bytes
        The size of all sources together.
    owned
        What earlier runs wrote into the destination's folder: it may be replaced without ``overwrite``, too.
    threads
        The number of threads of the conversion.
    checksum
        Whether the checksum of the sources is computed.
    dry_run
        Whether nothing is written; the result is then a forecast.
    shown
        Whether the result includes the report as text.
    scratch
        The folder for local copies of what is at URLs; None: the system's folder for temporary files.
    """

    key: str
    # Not in the repr: URLs may contain secrets, and a cluster writes jobs into its logs.
    sources: tuple[str, ...] = field(repr=False)
    destination: str = field(repr=False)
    request: Request
    size_bytes: int = 0
    owned: FileRecord | None = None
    threads: int = 1
    checksum: bool = False
    dry_run: bool = False
    shown: bool = False
    scratch: str | None = None

    def retried(self) -> Job:
        """Return the job for another attempt: one that died may have completed the output, which may be replaced."""
        done = FileRecord({PurePosixPath(self.destination).name: None})
        return replace(self, owned=done if self.owned is None else self.owned | done)


@dataclass(frozen=True, slots=True, kw_only=True)
class JobResult:
    """The result of a job: the attributes of a `pc2scan.batch.manifest.ManifestRecord` that only the conversion knows.

    ``text`` is the report as text if the job requests it.
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


def utc_now() -> str:
    """Return the time as the manifest has it: in UTC, with milliseconds."""
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")


def outcome_of(exit_status: int) -> str:
    """Return the outcome of a conversion that ended with this status."""
    return _OUTCOMES.get(exit_status, "failed")


def convert_one(job: Job, progress: Callable[[int, int, int], None] | None = None) -> JobResult:
    """Convert a recording. Errors do not raise; they are part of the result.

    Parameters
    ----------
    progress
        See `pc2scan.convert`.
    """
    began = time.monotonic()
    started = utc_now()
    sources = [path_or_url(path) for path in job.sources]
    destination = path_or_url(job.destination)
    identity = Identity()
    sha256 = None
    report = error = None
    text, status = "", 0
    try:
        identity = identity_of(sources)
        if job.checksum:
            sha256 = _checksum_of_sources(sources)
        done = _run_job(job, sources, destination, progress)
        report, status = done.as_dict(), done.exit_status
        text = str(done) if job.shown else ""
    except Pc2ScanError as err:
        error, status = err.as_dict(), err.exit_status
    except Exception as err:  # noqa: BLE001  # one recording must not end the others; the manifest has the traceback
        error, status = _unexpected_error(err), 1
    return JobResult(
        key=job.key,
        outcome=outcome_of(status),
        exit_status=status,
        identity=identity,
        sha256=sha256,
        output_identity=Identity() if error or job.dry_run else _output_identity(destination, report),
        started=started,
        seconds=round(time.monotonic() - began, 3),
        report=report,
        error=error,
        text=text,
    )


def _run_job(
    job: Job, sources: list[Path], destination: Path, progress: Callable[[int, int, int], None] | None
) -> Report | ExportReport:
    """Convert or export; raises the errors of that."""
    request = job.request
    options = replace(request.options, jobs=job.threads)
    if job.dry_run and request.export is not None and not request.export.converting:
        return _inspect_export(job, sources)
    if request.export is None or job.dry_run:
        # The forecast of an export that converts clouds is the forecast of the conversion.
        scratch = None if job.scratch is None else Path(job.scratch)
        output = request.output._replace(owned=job.owned, dry_run=job.dry_run, scratch=scratch)
        return run(
            sources,
            destination,
            options,
            output,
            also_read=request.files,
            progress=progress,
        )
    from pc2scan.export.run import run as export  # noqa: PLC0415  # most batches write recordings

    form = replace(request.export, overwrite=request.output.overwrite, owned=job.owned)
    return export(sources, destination, options, form, in_folder=True, also_read=request.files, progress=progress)


def _inspect_export(job: Job, sources: list[Path]) -> ExportReport:
    """Open a recording whose scans or clouds would be exported without conversion, and report what would be read."""
    from pc2scan.export.report import ExportReport  # noqa: PLC0415  # most batches write recordings

    options = job.request.options
    with ExitStack() as stack:
        readers = open_recordings(sources, stack, verify=options.verify, strict=options.strict)
        damage = tuple(place for reader in readers for place in reader.damage)
    assert job.request.export is not None
    return ExportReport(list(job.sources), job.destination, str(job.request.export.format), damage=damage)


def _output_identity(destination: Path, report: Mapping[str, Any] | None) -> Identity:
    """Return the identity of the output: a file, a directory, or numbered files."""
    files = (report or {}).get("files") or ()
    return identity_of(map(path_or_url, files) if files and not destination.is_dir() else [destination])


def death_of(job: Job, why: str, *, attempts: int, seconds: float) -> JobResult:
    """Return the result of a job whose process died."""
    error = Pc2ScanError(why).as_dict() | {"kind": "ProcessDied"}
    started = utc_now()
    try:
        identity = identity_of(map(path_or_url, job.sources))
    except Pc2ScanError:
        identity = Identity()
    return JobResult(
        key=job.key,
        outcome="died",
        exit_status=1,
        identity=identity,
        started=started,
        seconds=seconds,
        attempts=attempts,
        error=error,
    )


def _checksum_of_sources(sources: list[Path]) -> str:
    try:
        return checksum_of(sources)
    except OSError as err:
        raise RecordingError(f"cannot be read: {err.strerror}", path=sources[0]) from err


def _unexpected_error(err: Exception) -> dict[str, Any]:
    import traceback  # noqa: PLC0415  # a bug, or memory that is not there

    kind = type(err).__name__
    text = "".join(traceback.format_exception(err))
    return Pc2ScanError(f"{kind}: {err}" if str(err) else kind).as_dict() | {"kind": kind, "traceback": text}
