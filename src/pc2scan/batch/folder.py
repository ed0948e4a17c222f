"""The folder that a batch writes into: its locks, the folders in it, and the note of outputs that are being written."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError
from pc2scan.files.ownership import first_link
from pc2scan.files.places import check_place
from pc2scan.files.run_lock import only_run

from .manifest import MANIFEST, Begun, forget_begun, write_begun

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

#: The name of the workers' lock is derived from this.
_WORKERS = "manifest.jsonl.workers"

#: Seconds that a run waits for the workers of a killed run to end.
_WAIT_SECONDS = 15.0


def check_folder(out: Path) -> None:
    """Raise the errors that `made_folder` would raise, without making the folder."""
    if out.is_dir():
        return
    if os.path.lexists(out):
        raise DestinationError("is not a folder", path=out, hint="choose another name")
    check_place(out)


@contextmanager
def locked(out: Path) -> Iterator[int]:
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


@contextmanager
def begun_noted(
    out: Path, outputs: Iterable[str], earlier: Begun, is_there: Callable[[str], bool], absent: frozenset[str]
) -> Iterator[Callable[[str, bool], None]]:
    """Keep a note of the outputs that are being written and are not in the manifest yet, and make their folders.

    Folders that stay empty are removed at the end, also those that killed runs have made.

    Parameters
    ----------
    out
        The folder.
    outputs
        The outputs of this run; if there are none, the notes of killed runs are only put in order.
    earlier
        What killed runs have noted.
    is_there
        Whether an output exists.
    absent
        Outputs of this run that do not exist yet. One of them that exists at the end was made by this run, even if an
        interruption came before the news that it has begun, as of a cluster.

    Yields
    ------
    Callable
        To be called with an output when it begins (True) and when it has ended (False).
    """
    outputs = frozenset(outputs)
    folders = earlier.folders | {folder for folder in _folders_of(outputs) if not (out / folder).is_dir()}
    if outputs:
        write_begun(out, Begun(outputs | earlier.outputs, folders))
    running: set[str] = set()
    ended: set[str] = set()

    def begin(output: str, begins: bool) -> None:
        (running.add if begins else ended.add)(output)

    try:
        for folder in sorted(folders) if outputs else ():
            # If it cannot be made, the conversions that write into it report why.
            with suppress(OSError):
                (out / folder).mkdir()
        yield begin
    finally:
        for folder in sorted(folders, key=lambda folder: folder.count("/"), reverse=True):
            # Not through a link, which a batch has not made.
            if first_link(out, folder) is None:
                with suppress(OSError):
                    (out / folder).rmdir()
        # Only outputs that exist stay in the note.
        left = frozenset(output for output in (earlier.outputs | running | absent) - ended if is_there(output))
        with suppress(OutputError):
            if left:
                write_begun(out, Begun(left))
            else:
                forget_begun(out)


def _folders_of(outputs: Iterable[str]) -> set[str]:
    """Return the folders that outputs are in, with those above them."""
    found = {folder.as_posix() for output in outputs for folder in PurePosixPath(output).parents}
    return found - {"."}
