"""The folder that a batch writes into: its locks, the folders in it, and the note of outputs that are being written."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError
from pc2scan.files.places import check_place
from pc2scan.files.run_lock import only_run

from .manifest import MANIFEST, forget_begun, write_begun

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

__all__ = ["begun_noted", "check_folder", "folders_made", "locked"]

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
    out: Path, outputs: Iterable[str], earlier: frozenset[str], is_there: Callable[[str], bool]
) -> Iterator[Callable[[str, bool], None]]:
    """Keep a note of the outputs that are being written and are not in the manifest yet.

    Parameters
    ----------
    out
        The folder.
    outputs, earlier
        The outputs of this run, and those in the notes of killed runs.
    is_there
        Whether an output exists.

    Yields
    ------
    Callable
        To be called with an output when it begins (True) and when it has ended (False).
    """
    write_begun(out, {*outputs, *earlier})
    running: set[str] = set()
    ended: set[str] = set()

    def begin(output: str, begins: bool) -> None:
        (running.add if begins else ended.add)(output)

    try:
        yield begin
    finally:
        # Only outputs that exist stay in the note.
        left = {output for output in (earlier | running) - ended if is_there(output)}
        with suppress(OutputError):
            if left:
                write_begun(out, left)
            else:
                forget_begun(out)


@contextmanager
def folders_made(out: Path, outputs: Iterable[str], earlier: frozenset[str]) -> Iterator[None]:
    """Make the folders of the outputs; those that stay empty are removed at the end, also of killed runs' outputs."""
    made: list[Path] = []
    interrupted = {Path(output).parent for output in earlier}
    try:
        for parent in sorted({Path(output).parent for output in outputs}):
            for folder in reversed((parent, *parent.parents)):
                path = out / folder
                if path.is_dir():
                    if folder in interrupted:
                        made.append(path)
                    continue
                # If it cannot be made, the conversions that write into it report why.
                with suppress(OSError):
                    path.mkdir()
                    made.append(path)
        yield
    finally:
        for path in sorted(set(made) - {out}, key=lambda path: len(path.parts), reverse=True):
            with suppress(OSError):
                path.rmdir()
