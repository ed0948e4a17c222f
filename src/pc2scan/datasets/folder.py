"""The folder that a batch writes into: its manifest, the note of unfinished outputs, and a lock for one run."""

from __future__ import annotations

import json
import os
import time
from contextlib import ExitStack, contextmanager, suppress
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from pc2scan.errors import DestinationError, OutputError
from pc2scan.files.outputs import file_output
from pc2scan.files.places import check_new_folder, output_folder
from pc2scan.files.staging import only_run
from pc2scan.files.system import sync_directory
from pc2scan.files.urls import UrlPath
from pc2scan.version import __version__

from .manifest import (
    MANIFEST,
    identity_of,
    records_in,
    refuse_outside,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator
    from typing import BinaryIO

    from .manifest import Identity, ManifestRecord

#: Seconds that a run waits for the workers of a killed run.
_WAIT_SECONDS = 5.0

#: The name of the note of unfinished outputs, and its beginning.
_UNFINISHED = ".pc2scan-begun.json"
_NOTE_BEGINNING = b'{"pc2scan begun": '


class BatchFolder:
    """The folder of a batch: its manifest, and what earlier runs have recorded there. Its files are read once.

    Parameters
    ----------
    path
        The folder, with links resolved.
    lock
        The descriptor of the lock that workers inherit; None if there is none.

    Attributes
    ----------
    records
        The last line of each recording in the manifest, by key.
    left
        How the files of the outputs were left when they were last written, by output. The last line of a recording
        that could not be converted again does not say it.
    unfinished
        Outputs that a killed run was going to write, and did not record; relative to the folder.

    Raises
    ------
    DestinationError
        If the manifest, or the note of unfinished outputs, is something else, or a link.
    OutputError
        If the manifest cannot be read.
    """

    def __init__(self, path: Path, lock: int | None = None) -> None:
        self.path = path
        self.lock = lock
        data = self._read_manifest()
        noted, after = self._read_note()
        self.records: dict[str, ManifestRecord] = {}
        self.left: dict[str, Identity] = {}
        self._count = 0
        for line in records_in(data, path / MANIFEST):
            self.records[line.key] = line
            if line.is_written:
                self.left[line.output] = line.output_identity
            if self._count >= after:
                noted -= {line.output}
            self._count += 1
        self.unfinished = noted
        #: How many bytes of the manifest are whole lines.
        self._whole = data.rfind(b"\n") + 1
        self._file: BinaryIO | None = None
        self._ended: set[str] = set()

    def _read_manifest(self) -> bytes:
        path = self.path / MANIFEST
        if path.is_symlink():
            raise DestinationError("is a link, and nothing is written through links", path=path, hint="remove the link")
        try:
            return self._read(MANIFEST) or b""
        except OSError as err:
            raise OutputError(f"the manifest cannot be read: {err.strerror}", path=path) from err

    def _read_note(self) -> tuple[frozenset[str], int]:
        """Return what a killed run was going to write, and how many lines the manifest had then."""
        try:
            data = self._read(_UNFINISHED)
            if data is None:
                return frozenset(), 0
            noted = json.loads(data)
            outputs = frozenset(map(str, noted["outputs"]))
            for output in outputs:
                refuse_outside(output)
            return outputs, int(noted["after"])
        except (OSError, ValueError, LookupError, TypeError, AttributeError) as err:
            raise DestinationError(
                "was not written by pc2scan batch, which uses this name",
                path=self.path / _UNFINISHED,
                hint="move it away",
            ) from err

    def _read(self, name: str) -> bytes | None:
        """Return the content of a small file in the folder; None if there is none."""
        try:
            return (self.path / name).read_bytes()
        except FileNotFoundError:
            return None

    # --- Outputs ---

    def present(self, output: str) -> Identity:
        """Return the identity that an output has; without files if it does not exist."""
        return identity_of([self.path / output])

    @cached_property
    def outputs(self) -> frozenset[str]:
        """The outputs that were written by earlier runs, or may be."""
        return self._unknown.union(self.left)

    @cached_property
    def _unknown(self) -> frozenset[str]:
        """The outputs of which it is not known what a run left: it was killed, or the process died that wrote it."""
        return self.unfinished | {
            each.output for each in self.records.values() if each.output and each.outcome == "died"
        }

    def may_replace(self, output: str, there: Identity) -> bool:
        """Whether an output that is there may be replaced: no one else has written or edited it."""
        return not there.files or output in self._unknown or there == self.left.get(output)

    @cached_property
    def _containers(self) -> dict[tuple[str, Any], str]:
        """The formats of recordings and their parts, by path and files."""
        containers: dict[tuple[str, Any], str] = {}
        for record in self.records.values():
            if not record.container:
                continue
            containers[record.sources[0], record.identity.files] = record.container
            if len(record.sources) == len(record.identity.files) > 1:
                for path, file in zip(record.sources, record.identity.files, strict=True):
                    containers[path, (file,)] = record.container
        return containers

    def container_of(self, path: Path, identity: Identity) -> str:
        """Return the format of a recording that an earlier run has found, by its first path and files; else empty."""
        return self._containers.get((str(path), identity.files), "")

    def _unrecorded(self, outputs: Iterable[str]) -> dict[str, Identity]:
        """Return what those outputs are that exist now, and not as the manifest had them."""
        now = {each: self.present(each) for each in outputs}
        return {each: found for each, found in now.items() if found.files and found != self.left.get(each)}

    @contextmanager
    def writing(self, outputs: Collection[str]) -> Iterator[None]:
        """Keep a note of outputs while they are written, and make their folders.

        After a run was killed, the note shows which files belong to the batch. At the end, only outputs that exist and
        that the manifest does not have stay in it, and folders that this run has made and that stay empty are removed.
        """
        folders: list[str] = []
        others: dict[str, Identity] = {}
        if outputs:
            folders = sorted(folder for folder in _folders_of(outputs) if not (self.path / folder).is_dir())
            self._write_note(self.unfinished.union(outputs))
            # What is there already and unknown is somebody else's, until this run replaces it.
            others = self._unrecorded(set(outputs) - self.unfinished)
        try:
            for folder in folders:
                # If it cannot be made, the conversions that write into it report why.
                with suppress(OSError):
                    (self.path / folder).mkdir()
            yield
        finally:
            self.close()
            for folder in reversed(folders):
                with suppress(OSError):
                    (self.path / folder).rmdir()
            # A note that cannot be removed names outputs that the manifest has.
            with suppress(OutputError, OSError):
                identities = self._unrecorded(self.unfinished.union(outputs) - self._ended)
                if left := [each for each, now in identities.items() if now != others.get(each)]:
                    self._write_note(left)
                else:
                    (self.path / _UNFINISHED).unlink(missing_ok=True)

    def _write_note(self, outputs: Iterable[str]) -> None:
        """Note what a run is going to write; raises OutputError if that cannot be written."""
        text = json.dumps({"pc2scan begun": __version__, "outputs": sorted(outputs), "after": self._count}) + "\n"
        with file_output(self.path / _UNFINISHED, beginning=_NOTE_BEGINNING, overwrite=False) as write:
            write(text)

    # --- The manifest ---

    def append(self, record: ManifestRecord) -> None:
        """Append a line to the manifest, and wait until it is on the disk.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        try:
            if self._file is None:
                self._file = self._open_manifest()
            self._file.write(f"{json.dumps(record.as_dict(), ensure_ascii=True)}\n".encode("ascii"))
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as err:
            raise OutputError(f"the manifest cannot be written: {err.strerror}", path=self.path / MANIFEST) from err
        self._count += 1
        self._ended.add(record.output)

    def close(self) -> None:
        """Complete the manifest."""
        if self._file is not None:
            # What `append` has written is on the disk; a line that had no room there is an error already.
            with suppress(OSError):
                self._file.close()

    def _open_manifest(self) -> BinaryIO:
        path = self.path / MANIFEST
        is_new = not path.exists()
        file = path.open("ab")
        if is_new:
            sync_directory(self.path)
        else:
            # Without the line that a killed run has begun.
            file.truncate(self._whole)
        return file


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

    Those of a killed run may take some seconds.
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


def _folders_of(outputs: Iterable[str]) -> set[str]:
    """Return the folders that outputs are in, with those above them."""
    folders = {folder.as_posix() for output in outputs for folder in PurePosixPath(output).parents}
    return folders - {"."}
