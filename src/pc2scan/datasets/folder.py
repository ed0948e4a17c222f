"""The folder that a batch writes into: its manifest, what earlier runs have recorded there, and a lock for one run."""

from __future__ import annotations

import json
import os
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError
from pc2scan.files.staging import check_new_folder, only_run, output_folder
from pc2scan.files.system import sync_directory
from pc2scan.files.urls import UrlPath

from .manifest import BEGUN, MANIFEST, STOPPED, identity_of, records_in

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from .manifest import Identity, ManifestRecord

#: Seconds that a run waits for the workers of a killed run.
_WAIT_SECONDS = 5.0


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

    def may_replace(self, output: str, there: Identity) -> bool:
        """Whether an output that is there may be replaced: no one else has written or edited it."""
        is_begun = output in self.unfinished and there != self.unfinished[output]
        return is_begun or not there.files or there == self.left.get(output)

    @contextmanager
    def writing(self, begun: Iterable[ManifestRecord]) -> Iterator[None]:
        """Write lines of what is begun, and make its folders; at the end, folders that stay empty are removed.

        After a run was killed, these lines show which files belong to the batch. After one that was interrupted, there
        is a line for each output that is as it was.
        """
        begun = list(begun)
        folders = {folder for line in begun for folder in PurePosixPath(line.output).parents}
        made = [self.path / folder for folder in sorted(folders) if not (self.path / folder).is_dir()]
        self.append(*begun)
        try:
            for folder in made:
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
            for folder in reversed(made):
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
