"""The folder that a batch writes into: its locks, the folders in it, the note of unfinished outputs, and their names.

A result of several files has the name of its first file: ``drive_scan_0.bag`` stands for all parts of
``drive_scan.bag``. A result that is one file is named ``drive_scan.bag``, so that the two kinds cannot be confused.
"""

from __future__ import annotations

import json
import os
import re
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.formats import file_suffixes
from pc2scan.errors import DestinationError, OutputError
from pc2scan.files.ownership import first_link
from pc2scan.files.places import check_place, part_name
from pc2scan.files.staging import only_run
from pc2scan.files.text_output import text_output
from pc2scan.version import __version__

from .manifest import MANIFEST, refuse_outside

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

#: The name of the workers' lock is derived from this.
_WORKERS = "manifest.jsonl.workers"

#: Seconds that a run waits for the workers of a killed run to end.
_WAIT_SECONDS = 15.0

#: The name of the note of unfinished outputs, and its beginning.
UNFINISHED = ".pc2scan-begun.json"
_NOTE_BEGINNING = b'{"pc2scan begun": '


class UnfinishedOutputs(NamedTuple):
    """What a run is going to write, relative to its folder.

    Attributes
    ----------
    outputs
        The results.
    folders
        The folders that it makes for them.
    """

    outputs: frozenset[str] = frozenset()
    folders: frozenset[str] = frozenset()


def note_unfinished(folder: Path, unfinished: UnfinishedOutputs) -> None:
    """Note what a run is going to write. After a run was killed, this shows which files belong to the batch.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    outputs, folders = (json.dumps(sorted(names)) for names in unfinished)
    text = f'{_NOTE_BEGINNING.decode()}"{__version__}", "outputs": {outputs}, "folders": {folders}}}\n'
    with text_output(folder / UNFINISHED, beginning=_NOTE_BEGINNING, overwrite=False) as write:
        write(text)


def read_unfinished(folder: Path) -> UnfinishedOutputs:
    """Return what a killed run was going to write; empty if no run was killed."""
    try:
        noted = json.loads((folder / UNFINISHED).read_bytes())
        # Older versions did not note folders.
        unfinished = UnfinishedOutputs(
            frozenset(map(str, noted["outputs"])), frozenset(map(str, noted.get("folders", ())))
        )
        for path in (*unfinished.outputs, *unfinished.folders):
            refuse_outside(path)
    except FileNotFoundError:
        return UnfinishedOutputs()
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as err:
        raise DestinationError(
            "was not written by pc2scan batch, which uses this name",
            path=folder / UNFINISHED,
            hint="move it away",
        ) from err
    return unfinished


def forget_unfinished(folder: Path) -> None:
    """Remove the note: each output in it is in the manifest by now, or was not begun."""
    (folder / UNFINISHED).unlink(missing_ok=True)


def check_folder(out: Path) -> None:
    """Raise the errors that `output_folder` would raise, without making the folder."""
    if out.is_dir():
        return
    if os.path.lexists(out):
        raise DestinationError("is not a folder", path=out, hint="choose another name")
    check_place(out)


@contextmanager
def lock_folder(out: Path) -> Iterator[int]:
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
def track_outputs(
    out: Path,
    outputs: Iterable[str],
    earlier: UnfinishedOutputs,
    existing: Callable[[Iterable[str]], set[str]],
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
    existing
        Returns which of some outputs exist. One that exists at the end, but not now, was made by this run, even if an
        interruption came before the news that it has begun.

    Yields
    ------
    Callable
        To be called with an output when it begins (True) and when it has ended (False).
    """
    outputs = frozenset(outputs)
    folders = earlier.folders | {folder for folder in _folders_of(outputs) if not (out / folder).is_dir()}
    if outputs:
        note_unfinished(out, UnfinishedOutputs(outputs | earlier.outputs, folders))
    absent = outputs - existing(outputs) if outputs else outputs
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
        left = frozenset(existing((earlier.outputs | running | absent) - ended))
        with suppress(OutputError):
            if left:
                note_unfinished(out, UnfinishedOutputs(left))
            else:
                forget_unfinished(out)


def _folders_of(outputs: Iterable[str]) -> set[str]:
    """Return the folders that outputs are in, with those above them."""
    found = {folder.as_posix() for output in outputs for folder in PurePosixPath(output).parents}
    return found - {"."}


def first_part(output: str) -> str:
    """Return the name of the first part of a result.

    >>> first_part("robot1/drive_scan.bag")
    'robot1/drive_scan_0.bag'
    """
    folder, slash, name = output.rpartition("/")
    return f"{folder}{slash}{part_name(name, 0)}"


def is_numbered(output: str) -> bool:
    """Return whether this is the first file of a result with numbered files."""
    return _numbered(output) is not None


def _numbered(output: str) -> re.Match[str] | None:
    """Return the name without the number, and the suffix, of the first file of a result with numbered files."""
    suffixes = "|".join(map(re.escape, file_suffixes()))
    return re.fullmatch(rf"(.*_scan)_0({suffixes})", output, re.DOTALL)


def unnumbered_name(output: str) -> str:
    """Return the name of a result without the number; a name without a number is returned as it is.

    >>> unnumbered_name("drive_scan_0.bag"), unnumbered_name("drive_scan.bag")
    ('drive_scan.bag', 'drive_scan.bag')
    """
    found = _numbered(output)
    return output if found is None else f"{found[1]}{found[2]}"
