"""What a run may write, replace and remove: the one rule of ownership, which everything that writes files uses.

A file that exists is replaced with ``overwrite``. A folder only if a record in it accounts for every file in it: its
``metadata.yaml``, or `pc2scan.files.records.RECORD` of an export. What was edited since and would not be written again
stays, and is named in an error. ``metadata.yaml`` has no sizes, so a file that it names counts as unchanged.

The manifest of a batch has names, sizes and times of modification of each result's files. A result that is as it was
recorded is replaced without ``overwrite``, too; one that was edited since stays, and its recording has failed
(`pc2scan.datasets.plan`).

An input of the run is never replaced, removed or hidden, by any of its names (`refuse_overlap`). A symbolic link is
replaced, never followed.
"""

from __future__ import annotations

import os
import shlex
import stat
import unicodedata
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import DestinationError, name_list

from .places import working_names
from .records import files_below, is_unchanged
from .urls import UrlPath, exists

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from .records import FolderRecord

#: Endings of the files that SQLite reads beside a database.
_LOGS = ("-wal", "-journal", "-shm")


# --- What may be replaced ---


def check_existing(
    dst: Path,
    *,
    overwrite: bool,
    record_in: FolderRecord | None = None,
    written: Collection[str] | None = None,
) -> None:
    """Raise if there is something at a destination that this run may not replace.

    Parameters
    ----------
    dst
        The destination.
    overwrite
        Whether it may be replaced.
    record_in
        Reads the record of what is in a folder. Without it no folder is replaced.
    written
        The paths in the folder that the run writes; None while they are unknown. Then only the names are checked.

    Raises
    ------
    DestinationError
        If it exists and may not be replaced: it is neither a file nor a folder, or a folder with anything that no
        record names, or that was changed and is not written by this run.
    """
    if not exists(dst):
        return
    if not overwrite:
        raise DestinationError("exists already", path=dst, hint="`overwrite=True` replaces it")
    if isinstance(dst, UrlPath):
        if dst.is_dir():
            hint = "choose another name, or remove it with the store's own tools"
            raise DestinationError("is a folder; folders in a store are never replaced", path=dst, hint=hint)
    elif dst.is_dir() and not dst.is_symlink():
        _refuse_others(dst, record_in, written)
    elif dst.exists() and not dst.is_file():
        # A link itself is replaced, not its target; but a link to a device means the device.
        raise DestinationError("is neither a file nor a directory, and cannot be overwritten", path=dst)


def _refuse_others(folder: Path, record_in: FolderRecord | None, written: Collection[str] | None) -> None:
    present = sorted(files_below(folder))
    if not present:
        return
    hint = "choose another name, or move it away"
    record = "its content is not checked" if record_in is None else record_in(folder)
    if isinstance(record, str):
        reason = f"{record}, so it does not account for {name_list(present, 3)}"
        hint = f"choose another name, or remove it yourself: rm -r {shlex.quote(str(folder))}"
    elif unnamed := [name for name in present if name not in record.files]:
        reason = f"its {record.name} does not name {name_list(unnamed, 3)}"
    elif changed := [
        name
        for name in present
        if written is not None and name not in written and not is_unchanged(folder / name, record.files[name])
    ]:
        reason = f"{name_list(changed, 3)} was changed after it was written"
    else:
        return
    message = f"is a directory with something that pc2scan has not written, and is not overwritten: {reason}"
    raise DestinationError(message, path=folder, hint=hint)


def first_link(folder: Path, below: str) -> Path | None:
    """Return the first folder on the way to a path below a folder that is a symbolic link; None if there is none."""
    for part in PurePosixPath(below).parts[:-1]:
        folder = folder / part
        if folder.is_symlink():
            return folder
    return None


# --- Inputs ---


class InputPath(NamedTuple):
    """A file or folder that a run reads, and its role: ``source``, or the option that names it."""

    path: Path
    role: str = "source"


class OutputPath(NamedTuple):
    """A file or folder that a run writes, and the option that names it; empty for the recording itself."""

    path: Path
    option: str = ""


def inputs_of(
    sources: Iterable[Path], tf_from: Iterable[Path] = (), files: Mapping[str, Path] | None = None
) -> list[InputPath]:
    """Return the inputs of a run: its sources, recordings of transforms, and the files of options, by option."""
    named = [*(("`tf_from`", path) for path in tf_from), *(files or {}).items()]
    return [*map(InputPath, sources), *(InputPath(path, f"file of {option}") for option, path in named)]


def refuse_overlap(inputs: Iterable[InputPath], outputs: Sequence[OutputPath]) -> None:
    """Raise if an output of a run is one of its inputs, or another output.

    Files and folders are compared by device and inode, through hard links, symbolic links, links to folders, and names
    that a file system does not distinguish. An output includes the names that it has while it is written; a folder
    includes its entries; a file includes the logs that SQLite reads beside a database.

    Parameters
    ----------
    inputs
        The inputs; they need not exist.
    outputs
        The outputs.

    Raises
    ------
    DestinationError
        If an output is an input, is inside one, or contains one, or if this is true of two outputs.
    """
    read = Inputs(inputs)
    for number, output in enumerate(outputs):
        read.refuse(output)
        for earlier in outputs[:number]:
            _refuse_output(output, earlier)


class Inputs:
    """All paths of the inputs, by name and by device and inode, and the folders above them.

    Parameters
    ----------
    inputs
        The inputs; they need not exist.
    """

    def __init__(self, inputs: Iterable[InputPath]) -> None:
        self._files: dict[FileId, InputPath] = {}
        self._folders: dict[FileId, InputPath] = {}
        for given in inputs:
            entries: list[Path] = []
            with suppress(OSError):
                entries = [] if isinstance(given.path, UrlPath) else list(given.path.iterdir())
            for place in (place for path in (given.path, *entries) for place in path_identities(path)):
                # SQLite reads logs beside a database, if they are files; also one that does not exist yet.
                logs = (Path(f"{place}{suffix}") for suffix in _LOGS)
                for name in (place, *(log for log in logs if not os.path.isdir(log))):  # noqa: PTH112  # faster
                    self._files |= dict.fromkeys(file_ids(name) - self._files.keys(), given)
                for folder in place.parents:
                    if folder in self._folders:
                        break
                    self._folders |= dict.fromkeys(file_ids(folder) - self._folders.keys(), given)

    def refuse(self, output: OutputPath) -> None:
        """Raise if an output, or a name that it has while it is written, is an input, is inside one or contains one.

        Raises
        ------
        DestinationError
            If it does; the message says how the two are related.
        """
        for path in (output.path, *working_names(output.path)):
            places = list(path_identities(path))
            above = [folder for place in places for folder in place.parents]
            relations = [
                ("is", self._files, places),
                ("contains", self._folders, places),
                ("is inside", self._files, above),
            ]
            for relation, known, paths in relations:
                source = next((known[key] for each in paths for key in file_ids(each) if key in known), None)
                if source is not None and path != output.path:
                    # What a killed run left may be a source.
                    message = f"needs the name {path.name} while it is written, which is a {source.role}"
                    hint = f"choose another name for it, or rename the {source.role} first"
                    raise DestinationError(message, path=output.path, hint=hint)
                if source is not None:
                    what = f"a {source.role}" if relation == "is" else f"the {source.role} {source.path}"
                    hint = "sources are never changed; choose another name"
                    raise DestinationError(f"{_subject(output)}{relation} {what}", path=path, hint=hint)


def _refuse_output(output: OutputPath, earlier: OutputPath) -> None:
    """Raise if two outputs are one file, or one is inside the other, on file systems that ignore case, too."""
    mine, others = (
        [PurePosixPath(name_key(next(path_identities(path)).as_posix())) for path in (each, *working_names(each))]
        for each in (output.path, earlier.path)
    )
    relations = [("is", mine, others), ("is inside", others, [mine[0]]), ("contains", mine, [others[0]])]
    for relation, places, within in relations:
        pairs = ((place, each) for place in places for each in within)
        if any(place == each if relation == "is" else place in each.parents for place, each in pairs):
            other = f"the file of {earlier.option}" if earlier.option else "the destination"
            message = f"{_subject(output)}{relation} {other}"
            raise DestinationError(message, path=output.path, hint="choose another name")


def _subject(output: OutputPath) -> str:
    return f"the file of {output.option} " if output.option else ""


#: Device and inode; or a path: a URL, or one of this name.
FileId = tuple[int, int] | Path

#: Links that lead to links: the system follows at most this many.
_MAX_LINKS = 40


def path_identities(path: Path) -> Iterator[Path]:
    """Return a path without links in its folders, and if it is a symbolic link each path that it leads to."""
    if isinstance(path, UrlPath):
        yield path.identity
        return
    for _ in range(_MAX_LINKS):
        has_name = path.name not in {"", ".."}
        path = Path(os.path.realpath(path.parent), path.name) if has_name else Path(os.path.realpath(path))
        yield path
        try:
            path = path.parent / path.readlink()
        except OSError:
            return


def file_ids(path: Path) -> set[FileId]:
    """Return a path, and device and inode if it exists; of a symbolic link its own and its target's."""
    if isinstance(path, UrlPath):
        return {path.identity}
    ids: set[FileId] = {path}
    with suppress(OSError):
        status = path.lstat()
        ids.add((status.st_dev, status.st_ino))
        if stat.S_ISLNK(status.st_mode):
            status = path.stat()
            ids.add((status.st_dev, status.st_ino))
    return ids


def name_key(name: str) -> str:
    """Return a key that is equal for names that may be one on a file system that ignores case or Unicode's forms."""
    return unicodedata.normalize("NFC", name).casefold()
