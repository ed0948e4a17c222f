"""Converts one recording of a batch, in any process: a job becomes a line of the manifest, errors included."""

from __future__ import annotations

import hashlib
import json
import time
import traceback
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, fields, is_dataclass, replace
from datetime import datetime, timezone
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.bags.opening import open_recordings
from pc2scan.conversion.run import OutputOptions, run
from pc2scan.core.params import ProjectionParams
from pc2scan.errors import DestinationError, NothingToConvertError, OutputError, Pc2ScanError, UsageError
from pc2scan.exports.export import ExportOptions, ExportReport
from pc2scan.exports.export import run as export
from pc2scan.exports.writers import FORMATS
from pc2scan.files.paths import absolute
from pc2scan.files.system import copying_to, is_full
from pc2scan.options.call import Options
from pc2scan.options.table import conversion_options, options_of
from pc2scan.parsing import conversion_of
from pc2scan.result import json_value

from .manifest import NO_CLOUDS, Identity, ManifestRecord, identity_of

if TYPE_CHECKING:
    from pc2scan.bags.damage import Damage
    from pc2scan.conversion.report import Report
    from pc2scan.request.spec import Request

    from .find import Recording

#: Outcomes by the exit status of `pc2scan convert`; that of all others is ``failed``.
_OUTCOMES = {0: "converted", 3: "incomplete", 4: "empty"}

#: Attributes that do not affect the output: where options come from.
_PLACES = frozenset({"origins", "place", "files", "notes"})


@dataclass(frozen=True, slots=True)
class JobRequest:
    """A conversion as it was requested, checked. The recording and its destination are not part of it.

    Attributes
    ----------
    options, output
        As `pc2scan.conversion.run.run` takes them.
    export
        How scans or clouds are exported; None if they are written to a recording instead.
    digest
        See `digest_of`.
    """

    options: Request
    output: OutputOptions
    export: ExportOptions | None = None
    digest: str = ""


def request_of(keywords: Mapping[str, Any], origins: Mapping[str, str] | None = None) -> JobRequest:
    """Read the options of a conversion.

    Parameters
    ----------
    keywords
        Options by name: those of `pc2scan.options.table.conversion_options`.
    origins
        Where options come from, for errors and reports.

    Raises
    ------
    UsageError
        If an option has a wrong value, or contradicts another one.
    """
    options = Options("batch", keywords, origins)
    _check_export(options)
    output = OutputOptions(**options.among(OutputOptions._fields), like_source=True)
    conversion = conversion_of(options)
    export = None if options.format is None else ExportOptions.of(options, conversion)
    # Absolute: another process may have another current folder.
    frames = replace(conversion.frames, tf_from=tuple(map(absolute, conversion.frames.tf_from)))
    files = {name: absolute(path) for name, path in conversion.files.items()}
    request = JobRequest(replace(conversion, frames=frames, files=files), output, export)
    return replace(request, digest=digest_of(request))


def digest_of(request: JobRequest) -> str:
    """Return a digest of everything that affects the output.

    Recordings that transforms are taken from count with their sizes and times of modification.
    """
    names = ("storage", "compression", "profile")
    output = {name: getattr(request.output, name) for name in names}
    if request.export is not None:
        output["export"] = _canonical(request.export)
    options = replace(request.options, jobs=0)
    others = [identity_of([path]).as_json() for path in options.frames.tf_from]
    whole = json_value({"options": _canonical(options), "output": output, "tf_from": others})
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:32]


def _check_export(options: Options) -> None:
    """Raise if an option of recordings is given besides ``format``."""
    name, given = options.format, options.given
    if name is None:
        return
    exported, known = options_of("export"), conversion_options()
    if idle := [
        f"`{word}`" for word in options_of("convert") if word in given and word in known and word not in exported
    ]:
        raise UsageError(f"{', '.join(idle)} would have no effect: `format` writes no recordings")
    if FORMATS[name].needs_poses and not given.keys() & {"pose_frame", "odom_topic"}:
        raise UsageError(f"`format={name}` needs poses", hint="give `pose_frame=odom`, or `odom_topic=/odom`")


def _canonical(value: Any) -> Any:
    """Return options as JSON's types. Equal options give equal results in every process."""
    if isinstance(value, ProjectionParams):
        # The queue's size bounds what is held in memory. It does not affect the output.
        value = replace(value, queue_size=0)
    if is_dataclass(value) and not isinstance(value, type):
        shown = [attribute.name for attribute in fields(value) if attribute.repr and attribute.name not in _PLACES]
        return {"": type(value).__name__, **{name: _canonical(getattr(value, name)) for name in shown}}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(key): _canonical(part) for key, part in value.items()}
    if isinstance(value, tuple | list | set | frozenset):
        return [_canonical(part) for part in value]
    if hasattr(value, "tolist"):
        return value.tolist()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value) if isinstance(value, Path) else repr(value)


# --- Jobs ---


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """What is done with a recording, with everything that another process needs for it.

    Attributes
    ----------
    recording
        The recording, with absolute paths.
    request
        The conversion that is requested.
    destination
        The absolute path of the result.
    output
        The same, relative to the folder of the batch; empty for none.
    action
        ``convert``; ``keep``: the result is up to date; ``refuse``: it cannot be converted; ``skip``: the dataset file
        excludes it.
    why
        The reason, for people.
    error
        Why it is refused.
    owned
        Whether an earlier run has recorded the output: it is replaced without ``overwrite``, too.
    present
        The output as the plan found it; None: it is not compared.
    threads
        The number of threads of the conversion.
    dry_run
        Whether nothing is written.
    scratch
        The folder for local copies of what is at URLs; None: the system's folder for temporary files.
    """

    recording: Recording
    request: JobRequest
    destination: Path
    output: str
    action: str = "convert"
    why: str = ""
    error: Pc2ScanError | None = None
    owned: bool = False
    present: Identity | None = None
    threads: int = 1
    dry_run: bool = False
    scratch: Path | None = None

    @property
    def key(self) -> str:
        """The recording's name in the dataset."""
        return self.recording.key

    @property
    def size_bytes(self) -> int:
        """The size of all sources together."""
        return self.recording.identity.size_bytes

    def retried(self) -> Job:
        """Return the job for another attempt: one that died may have completed the output, which may be replaced."""
        return replace(self, owned=True, present=None)

    def record(self, **values: Any) -> ManifestRecord:
        """Return the line of the manifest, with what the conversion says."""
        known: dict[str, Any] = {
            "identity": self.recording.identity,
            "container": self.recording.container,
            "options": self.request.digest,
            "output": self.output,
        }
        return ManifestRecord(key=self.key, sources=tuple(map(str, self.recording.paths)), **(known | values))

    def failure(self, error: Pc2ScanError, /, **values: Any) -> ManifestRecord:
        """Return the line of a recording that cannot be converted, with what is known of it."""
        known = {"outcome": "failed", "exit_status": error.exit_status, "error": error.as_dict()}
        return self.record(**(known | values))

    def death(self, why: str) -> ManifestRecord:
        """Return the line of a recording whose process died."""
        error = Pc2ScanError(why)
        return self.failure(error, outcome="died", error=error.as_dict() | {"kind": "ProcessDied"})


def convert_one(job: Job) -> ManifestRecord:
    """Convert a recording, and return its line of the manifest. Errors do not raise; they are part of the line."""
    began = time.monotonic()
    known: dict[str, Any] = {"started": datetime.now(timezone.utc).isoformat(timespec="milliseconds")}
    try:
        known["identity"] = identity_of(job.recording.paths)
        with copying_to(job.scratch):
            report = _run_job(job)
        record = job.record(
            outcome=_OUTCOMES.get(report.exit_status, "failed"),
            exit_status=report.exit_status,
            output_identity=Identity() if job.dry_run else identity_of([job.destination]),
            report=report.as_dict(),
            **known,
        )
    except NothingToConvertError as err:
        # Datasets have recordings of other kinds, too. A damaged one may have lost its clouds.
        if not _damage_of(job):
            known |= {"outcome": NO_CLOUDS, "exit_status": 0}
        record = job.failure(err, **known)
    except Pc2ScanError as err:
        full = isinstance(err, OutputError) and is_full(err)
        record = job.failure(err, disk_is_full=full, **known)
    except Exception as err:  # noqa: BLE001  # one recording must not end the others; the manifest has the traceback
        kind, text = type(err).__name__, "".join(traceback.format_exception(err))
        error = Pc2ScanError(f"{kind}: {err}" if str(err) else kind)
        record = job.failure(error, error=error.as_dict() | {"kind": kind, "traceback": text}, **known)
    return replace(record, seconds=round(time.monotonic() - began, 3))


def _run_job(job: Job) -> Report | ExportReport:
    """Convert or export; raises the errors of that."""
    request, sources, destination = job.request, job.recording.paths, job.destination
    if job.present is not None and not request.output.overwrite:
        now = identity_of([destination])
        if now.files and now != job.present:
            hint = "move it away, or `overwrite=True` replaces it"
            raise DestinationError("was edited since the batch began", path=destination, hint=hint)
    options = replace(request.options, jobs=job.threads)
    overwrite = request.output.overwrite or job.owned
    if job.dry_run and request.export is not None and not request.export.converting:
        # Opened, and not read.
        return ExportReport([*map(str, sources)], str(destination), str(request.export.format), damage=_damage_of(job))
    if request.export is None or job.dry_run:
        # An export that converts clouds would do what the conversion would.
        output = request.output._replace(overwrite=overwrite, dry_run=job.dry_run)
        # The batch says its notes once; here they count if they are errors.
        notes = options.notes if options.fail_on == "warning" else ()
        return run(sources, destination, replace(options, notes=notes), output)
    return export(sources, destination, options, request.export, in_folder=True, overwrite=overwrite)


def _damage_of(job: Job) -> tuple[Damage, ...]:
    """Open a recording, and return the damage that is found by that."""
    with ExitStack() as stack:
        readers = open_recordings(job.recording.paths, stack, strict=job.request.options.strict)
        return tuple(place for reader in readers for place in reader.damage)
