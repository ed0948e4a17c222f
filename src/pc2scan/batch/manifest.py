"""The manifest of a batch: a file with one line of JSON for each recording that was converted or has failed.

A line is synced to the disk before its recording counts as done. If a recording has several lines, the last one counts.
A last line without a line end was written by a run that was killed at that moment; it is ignored.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

from pc2scan.errors import DestinationError, OutputError, UsageError
from pc2scan.files.system import sync_directory
from pc2scan.version import __version__

from .identity import Identity

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from typing_extensions import Self

#: The name of the manifest in the folder of a batch.
MANIFEST = "manifest.jsonl"

#: Each line of a manifest begins with this. A file of the same name without it is refused.
_BEGINNING = '{"pc2scan": "'


@dataclass(frozen=True, slots=True, kw_only=True)
class ManifestRecord:
    """The result of one recording: a line of the manifest.

    Attributes
    ----------
    key
        Its name in the dataset.
    sources
        Its paths, absolute.
    identity, sha256
        The identity and the checksum of the source when it was read; no checksum unless it was requested.
    container
        The name of the source's format; empty if it is not a recording.
    options
        The digest of the request: see `pc2scan.batch.request.Request.digest`.
    version
        The version of pc2scan that converted it.
    outcome
        ``converted``, ``incomplete`` (messages skipped, or a damaged source), ``empty`` (no scan has a return),
        ``failed``, or ``died`` (the process that converted it ended unexpectedly).
    exit_status
        The exit status that `pc2scan convert` would have had.
    error
        Why it failed: ``class``, ``message``, ``place``, ``hint``, ``exit_status``; None if it did not.
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
    """

    key: str
    sources: tuple[str, ...]
    identity: Identity
    sha256: str | None = None
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

    @property
    def is_written(self) -> bool:
        """Whether there is a result."""
        return bool(self.output_identity.files)

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
                "sha256": self.sha256,
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
        refuse_outside(str(output.get("path", "")))
        return cls(
            key=str(line["key"]),
            sources=tuple(map(str, source["paths"])),
            identity=Identity.from_json(source["files"]),
            sha256=source["sha256"],
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


def read_records(path: Path) -> Iterator[ManifestRecord]:
    """Yield the lines of a manifest; none if there is no manifest.

    Raises
    ------
    DestinationError
        If the file is not a manifest, or is a link: a batch writes only into its own folder.
    UsageError
        If a line other than the last cannot be read; the message names it.
    """
    if path.is_symlink():
        raise DestinationError("is a link, and nothing is written through links", path=path, hint="remove the link")
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return
    except OSError as err:
        raise OutputError(f"the manifest cannot be read: {err.strerror}", path=path) from err
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


class Manifest:
    """A manifest that is open for appending.

    Parameters
    ----------
    path
        The file; it is created if it does not exist.

    Raises
    ------
    OutputError
        If it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            is_new = not path.exists()
            self._file = path.open("ab")
            if is_new:
                sync_directory(path.parent)
            self._drop_torn_line()
        except OSError as err:
            raise OutputError(f"the manifest cannot be written: {err.strerror}", path=path) from err

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def append(self, record: ManifestRecord) -> None:
        """Append a line, and wait until it is on the disk.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        line = json.dumps(record.as_dict(), ensure_ascii=True) + "\n"
        try:
            self._file.write(line.encode("ascii"))
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as err:
            raise OutputError(f"the manifest cannot be written: {err.strerror}", path=self._path) from err

    def _drop_torn_line(self) -> None:
        size = self._path.stat().st_size
        data = self._path.read_bytes()
        end = data.rfind(b"\n") + 1
        if end != size:
            self._file.truncate(end)


def refuse_outside(output: str) -> None:
    """Raise if a path leads out of the folder of the batch: a run may replace or remove the outputs that are noted."""
    place = PurePosixPath(output)
    if place.is_absolute() or ".." in place.parts:
        raise ValueError(f"{output} is not below the folder of the batch")
