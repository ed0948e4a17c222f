"""What a batch remembers: the files of sources and results, and a line of JSON for each recording that was converted.

A line is synced to the disk before its recording counts as done. If a recording has several lines, the last one counts.
A last line without a line end was written by a run that was killed at that moment; it is ignored.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from pc2scan.errors import DestinationError, OutputError, UsageError
from pc2scan.files.outputs import RECORD, check_new_folder, only_run, output_folder
from pc2scan.files.source_file import file_beside
from pc2scan.files.system import sync_directory
from pc2scan.files.urls import UrlPath, files_of
from pc2scan.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

#: The outcome of a recording without a topic of the types to convert. It is no failure.
NO_CLOUDS = "no clouds"

#: The outcomes of a recording whose conversion has begun, which a later line replaces unless the run was killed; and of
#: one that was to be converted by a run that was interrupted.
BEGUN, STOPPED = "begun", "stopped"

#: The name of the manifest in the folder of a batch.
MANIFEST = "manifest.jsonl"

#: Each line of a manifest begins with this. A file of the same name without it is refused.
_BEGINNING = '{"pc2scan": "'

#: Identities list up to this many files of a folder one by one; more are summed up.
_MOST = 100

#: What fsspec calls the version of a file at a URL, the best first. Stores differ in which of these they have.
_VERSION = ("ETag", "etag", "generation", "Last-Modified", "created")

#: Seconds that a run waits for the workers of a killed run.
_WAIT_SECONDS = 5.0


@dataclass(frozen=True, slots=True)
class Identity:
    """The files of a recording: the name, size and time of modification (ns) of each; no files if it does not exist.

    A file in a store has its version there, such as an ETag, instead of a time.
    """

    files: tuple[tuple[str, int, int | str], ...] = ()

    @property
    def size_bytes(self) -> int:
        """Return the total size of the files."""
        return sum(size for _, size, _ in self.files)

    def as_json(self) -> list[list[Any]]:
        """Return it as JSON's types."""
        return [list(file) for file in self.files]

    @classmethod
    def from_json(cls, files: Iterable[Sequence[Any]]) -> Identity:
        """Read what `as_json` returned."""
        return cls(
            tuple((str(name), int(size), time if isinstance(time, str) else int(time)) for name, size, time in files)
        )


def identity_of(paths: Iterable[Path]) -> Identity:
    """Return the identity of a recording: of a file, of the files in a folder, or of several files."""
    files = []
    for path in paths:
        if isinstance(path, UrlPath):
            files += _stored_files(path)
            continue
        try:
            # os.path is faster than Path, which matters for thousands of recordings.
            files += _files_in(path) if os.path.isdir(path) else _file_and_logs(path)  # noqa: PTH112
        except OSError:
            continue
    return Identity(tuple(files))


def _file_and_logs(path: Path) -> list[tuple[str, int, int | str]]:
    """Return the entries of a file and of the logs beside a database: a running recorder may write only to the logs."""
    logs = filter(None, (file_beside(path, suffix) for suffix in ("-wal", "-journal")))
    states = [(path.name, os.stat(path)), *((log.name, log.stat()) for log in logs)]  # noqa: PTH116
    return [(name, state.st_size, state.st_mtime_ns) for name, state in states if state.st_size or name == path.name]


def _stored_files(path: UrlPath) -> list[tuple[str, int, int | str]]:
    """Return the entries of a file at a URL, with the logs beside a database, or of the files in a folder."""
    return sorted((file.name, file.size, _version(file.details)) for file in files_of(path) if file.exists())


def _version(details: Mapping[str, Any]) -> str:
    """Return text that changes if a file at a URL does; empty if the store has none."""
    return next((str(details[name]).strip('"') for name in _VERSION if details.get(name) is not None), "")


def _files_in(folder: Path) -> list[tuple[str, int, int | str]]:
    """Return the files in a folder and its subfolders; very many (one for each cloud) are summed up in one entry."""
    files: list[tuple[str, int, int | str]] = []
    for place, folders, names in os.walk(folder):
        folders.sort()
        below = os.path.relpath(place, folder)
        # Not -shm: programs that only read a database create and change that file.
        # Nor the record of an export, which says nothing that its files do not.
        for name in sorted(name for name in names if not name.endswith("-shm") and name != RECORD):
            # Broken links are ignored.
            with suppress(OSError):
                path = os.path.join(place, name)  # noqa: PTH118
                state = os.stat(path)  # noqa: PTH116
                files.append((os.path.normpath(os.path.join(below, name)), state.st_size, state.st_mtime_ns))  # noqa: PTH118
    return _summed_up(files)


def _summed_up(files: list[tuple[str, int, int | str]]) -> list[tuple[str, int, int | str]]:
    """Return the files of a folder; very many as one entry."""
    if len(files) <= _MOST:
        return files
    digest = hashlib.sha256(repr(files).encode()).hexdigest()
    return [(f"{len(files)} files", sum(size for _, size, _ in files), digest)]


# --- Lines ---


@dataclass(frozen=True, slots=True, kw_only=True)
class ManifestRecord:
    """The result of one recording: a line of the manifest.

    Attributes
    ----------
    key
        Its name in the dataset.
    sources
        Its paths, absolute.
    identity
        The identity of the source when it was read.
    container
        The name of the source's format; empty if it is not a recording.
    options
        The digest of the request: see `pc2scan.datasets.jobs.JobRequest`.
    version
        The version of pc2scan that converted it.
    outcome
        ``converted``, ``incomplete`` (messages skipped, or a damaged source), ``empty`` (no scan has a return),
        ``no clouds`` (nor other topics of the types to convert), ``failed``, ``died`` (the process that converted it
        ended unexpectedly), ``begun`` or ``stopped``.
    exit_status
        The exit status that `pc2scan convert` would have had; 0 for ``no clouds``.
    error
        Why there is no result: ``class``, ``message``, ``place``, ``hint``, ``exit_status``; None if there is one.
    output
        The path of the result, relative to the folder of the batch; if the conversion failed, where an earlier result
        may be. Empty if nothing was ever written.
    output_identity
        The identity of the result; without files if there is none.
    started
        When the conversion began, ISO 8601.
    seconds
        How long it took.
    attempts
        How often the conversion was tried.
    report
        The report of the conversion, as ``convert --report`` writes it; None if it failed.
    disk_is_full
        Whether it failed because the disk of the results has no room; not part of the line.
    """

    key: str
    sources: tuple[str, ...]
    identity: Identity
    container: str = ""
    options: str
    version: str = __version__
    outcome: str
    exit_status: int
    error: Mapping[str, Any] | None = None
    output: str = ""
    output_identity: Identity = field(default_factory=Identity)
    started: str = ""
    seconds: float = 0.0
    attempts: int = 1
    report: Mapping[str, Any] | None = None
    disk_is_full: bool = False

    @property
    def is_written(self) -> bool:
        """Whether there is a result."""
        return bool(self.output_identity.files)

    @property
    def has_nothing(self) -> bool:
        """Whether the recording has nothing to convert."""
        return self.outcome == NO_CLOUDS

    def as_dict(self) -> dict[str, Any]:
        """Return the line as JSON's types."""
        return {
            "pc2scan": self.version,
            "key": self.key,
            "outcome": self.outcome,
            "exit_status": self.exit_status,
            "source": {
                "paths": list(self.sources),
                "container": self.container or None,
                "bytes": self.identity.size_bytes,
                "files": self.identity.as_json(),
            },
            "options": self.options,
            "output": None
            if not self.output
            else {
                "path": self.output,
                "bytes": self.output_identity.size_bytes,
                "files": self.output_identity.as_json(),
            },
            "started": self.started,
            "seconds": round(self.seconds, 3),
            "attempts": self.attempts,
            "error": None if self.error is None else dict(self.error),
            "report": None if self.report is None else dict(self.report),
        }

    @classmethod
    def from_dict(cls, line: Mapping[str, Any]) -> ManifestRecord:
        """Read what `as_dict` returned."""
        source, output = line["source"], line["output"] or {}
        _refuse_outside(str(output.get("path", "")))
        return cls(
            key=str(line["key"]),
            sources=tuple(map(str, source["paths"])),
            identity=Identity.from_json(source["files"]),
            container=source["container"] or "",
            options=str(line["options"]),
            version=str(line["pc2scan"]),
            outcome=str(line["outcome"]),
            exit_status=int(line["exit_status"]),
            error=line["error"],
            output=str(output.get("path", "")),
            output_identity=Identity.from_json(output.get("files", ())),
            started=str(line["started"]),
            seconds=float(line["seconds"]),
            attempts=int(line["attempts"]),
            report=line["report"],
        )


def _refuse_outside(output: str) -> None:
    """Raise if a path leads out of the folder of the batch: a run may replace or remove the outputs that are noted."""
    place = PurePosixPath(output)
    if place.is_absolute() or ".." in place.parts:
        raise ValueError(f"{output} is not below the folder of the batch")


def records_in(data: bytes, path: Path) -> Iterator[ManifestRecord]:
    """Yield the lines of a manifest.

    Raises
    ------
    DestinationError
        If it is not a manifest.
    UsageError
        If a line other than the last cannot be read; the message names it.
    """
    if data and not data.startswith(_BEGINNING.encode()[: len(data)]):
        raise DestinationError("is not a manifest of pc2scan batch", path=path, hint="write into another folder")
    # What follows the last line end was being written when a run was killed.
    for number, line in enumerate(data.split(b"\n")[:-1], start=1):
        try:
            yield ManifestRecord.from_dict(json.loads(line))
        except (ValueError, LookupError, TypeError, AttributeError) as err:
            raise UsageError(
                f"line {number} is not a line of a manifest ({type(err).__name__}: {err})",
                path=path,
                hint="remove the line, and the output that it names: that recording is converted again",
            ) from err


class BatchFolder:
    """The folder of a batch: its manifest, and what earlier runs have recorded there.

    Parameters
    ----------
    path
        The folder, with links resolved.
    lock
        The descriptor of the lock that workers inherit; None if there is none.

    Attributes
    ----------
    records
        The last result of each recording in the manifest, by key.
    left
        How the files of the outputs were left when they were last written, by output. The last line of a recording
        that could not be converted again does not say it.
    unfinished
        How outputs were before a run began to write them that was killed, or whose process died.

    Raises
    ------
    DestinationError
        If the manifest is something else, or a link.
    OutputError
        If the manifest cannot be read.
    """

    def __init__(self, path: Path, lock: int | None = None) -> None:
        self.path, self.lock, self._manifest = path, lock, path / MANIFEST
        self.records: dict[str, ManifestRecord] = {}
        self.left: dict[str, Identity] = {}
        self.unfinished: dict[str, Identity] = {}
        if self._manifest.is_symlink():
            hint = "remove the link"
            raise DestinationError("is a link, and nothing is written through links", path=self._manifest, hint=hint)
        try:
            data = self._manifest.read_bytes()
        except FileNotFoundError:
            data = b""
        except OSError as err:
            raise OutputError(f"the manifest cannot be read: {err.strerror}", path=self._manifest) from err
        #: How many bytes of the manifest are whole lines: a killed run may have begun another one.
        self._whole = data.rfind(b"\n") + 1
        for line in records_in(data, self._manifest):
            self._take(line)

    def _take(self, line: ManifestRecord) -> None:
        """Take a line of the manifest into account."""
        if line.outcome == BEGUN:
            self.unfinished[line.output] = line.output_identity
        elif line.outcome != "died":
            self.unfinished.pop(line.output, None)
        if line.outcome in (BEGUN, STOPPED):
            return
        self.records[line.key] = line
        if line.is_written:
            self.left[line.output] = line.output_identity

    def present(self, output: str) -> Identity:
        """Return the identity that an output has; without files if it does not exist."""
        return identity_of([self.path / output])

    @property
    def outputs(self) -> set[str]:
        """The outputs that were written by earlier runs, or may be."""
        return {*self.left, *self.unfinished}

    def may_replace(self, output: str, present: Identity) -> bool:
        """Whether an output that is there may be replaced: no one else has written or edited it."""
        is_begun = output in self.unfinished and present != self.unfinished[output]
        return is_begun or not present.files or present == self.left.get(output)

    @contextmanager
    def writing(self, begun: Iterable[ManifestRecord]) -> Iterator[None]:
        """Write the lines of recordings that are begun, and make their folders; at the end, empty folders are removed.

        After a run was killed, these lines show which files belong to the batch. After one that was interrupted, there
        is a line for each output that is as it was.
        """
        begun = list(begun)
        folders = {folder for line in begun for folder in PurePosixPath(line.output).parents}
        new_folders = [self.path / folder for folder in sorted(folders) if not (self.path / folder).is_dir()]
        self.append(*begun)
        try:
            for folder in new_folders:
                # If it cannot be made, the conversions that write into it report why.
                with suppress(OSError):
                    folder.mkdir()
            yield
        finally:
            died = {line.output for line in self.records.values() if line.outcome == "died"}
            left = [line for line in begun if line.output in self.unfinished.keys() - died]
            as_before = [line for line in left if self.present(line.output) == line.output_identity]
            with suppress(OutputError):
                self.append(*(replace(line, outcome=STOPPED) for line in as_before))
            with suppress(OSError):
                if not (self.records or self.unfinished):
                    self._manifest.unlink()
            for folder in reversed(new_folders):
                with suppress(OSError):
                    folder.rmdir()

    def append(self, *records: ManifestRecord) -> None:
        """Append lines to the manifest, and wait until they are on the disk.

        Raises
        ------
        OutputError
            If they cannot be written.
        """
        if not records:
            return
        lines = "".join(f"{json.dumps(record.as_dict(), ensure_ascii=True)}\n" for record in records).encode("ascii")
        try:
            with self._manifest.open("r+b" if self._manifest.exists() else "xb") as file:
                file.truncate(self._whole)
                file.seek(self._whole)
                file.write(lines)
                file.flush()
                os.fsync(file.fileno())
            if not self._whole:
                sync_directory(self.path)
        except OSError as err:
            raise OutputError(f"the manifest cannot be written: {err.strerror}", path=self._manifest) from err
        self._whole += len(lines)
        for record in records:
            self._take(record)


@contextmanager
def open_folder(out: Path, *, dry_run: bool) -> Iterator[BatchFolder]:
    """Make the folder of a batch, lock it, and yield it; in a dry run nothing is written.

    Raises
    ------
    DestinationError
        If it cannot be made, or another run is writing into it; see also `BatchFolder`.
    OutputError
        If it cannot be written.
    """
    if isinstance(out, UrlPath):
        raise DestinationError("a batch writes into a folder of this machine", path=out, hint="upload it afterwards")
    with ExitStack() as stack:
        if not dry_run:
            stack.enter_context(output_folder(out))
        elif not out.is_dir():
            check_new_folder(out)
        lock = None if dry_run else _hold(out, stack)
        yield BatchFolder(Path(os.path.realpath(out)), lock)


def _hold(out: Path, stack: ExitStack) -> int:
    """Return the lock of a folder, which is held until the stack is closed, and until the workers end that inherit it.

    The workers of a killed run may take some seconds.
    """
    deadline = time.monotonic() + _WAIT_SECONDS
    while True:
        try:
            return stack.enter_context(only_run(out / MANIFEST))
        except DestinationError as err:
            if "another run" not in err.message:
                raise
            if time.monotonic() > deadline:
                raise DestinationError("another batch is writing into this folder", path=out) from err
            time.sleep(0.05)
