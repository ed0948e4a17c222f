"""What a run may write, replace and remove: the one rule of ownership, which everything that writes files uses.

A file that exists is replaced with ``overwrite``. A folder only if a record in it accounts for every file in it: its
``metadata.yaml``, or `pc2scan.files.records.RECORD` of an export. What was edited since and would not be written again
stays, and is named in an error. ``metadata.yaml`` has no sizes, so a file that it names counts as unchanged.

The manifest of a batch has names, sizes and times of modification (in a store, versions) of each result's files. A
result that is as it was recorded is replaced without ``overwrite``, too; one that was edited since stays, and its
recording has failed (`pc2scan.datasets.plan`).

An input of the run is never replaced, removed or hidden, by any of its names (`refuse_overlap`). A symbolic link is
replaced, never followed.
"""

from __future__ import annotations

import itertools
import os
import shlex
import stat
import unicodedata
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import DestinationError, OutputError, name_list

from .places import working_names
from .records import files_below, is_unchanged
from .urls import UrlPath

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from .records import FolderRecord

#: Endings of the files that SQLite reads beside a database.
_LOGS = ("-wal", "-journal", "-shm")


# --- What may be replaced ---


class Permission(NamedTuple):
    """What of a destination a run may replace.

    Attributes
    ----------
    overwrite
        Whether the user allows to replace it.
    owned
        The files of it that earlier runs have recorded, if it may be replaced without ``overwrite``, too.
    record_in
        Reads the record of what is in a folder. Without it no folder is replaced.
    """

    overwrite: bool
    owned: Collection[str] | None = None
    record_in: FolderRecord | None = None

    @property
    def replaces(self) -> bool:
        """Whether anything may be replaced."""
        return self.overwrite or self.owned is not None


def check_existing(dst: Path, may: Permission) -> None:
    """Raise if there is something at a destination that this run may not replace, as far as that is known beforehand.

    Raises
    ------
    DestinationError
        If it exists and may not be replaced, or is a folder with anything that no record names.
    """
    if isinstance(dst, UrlPath):
        # What a record names is judged file by file, when the new files are known.
        if may.owned is None and dst.exists():
            if dst.is_dir():
                raise DestinationError(
                    "is a folder; folders in a store are never replaced",
                    path=dst,
                    hint="choose another name, or remove it with the store's own tools",
                )
            if not may.overwrite:
                raise existing_error(dst)
        return
    if not os.path.lexists(dst):
        return
    if not may.replaces:
        raise existing_error(dst)
    # A link itself is replaced, not its target; but a link to a device means the device.
    if dst.exists() and not dst.is_file() and not dst.is_dir():
        raise DestinationError("is neither a file nor a directory, and cannot be overwritten", path=dst)
    if not dst.is_symlink() and dst.is_dir():
        refuse_others(dst, may.record_in)


def refuse_others(folder: Path, record_in: FolderRecord | None, written: Collection[str] | None = None) -> None:
    """Raise if a folder that is replaced as a whole has anything that this run may not replace or remove.

    Parameters
    ----------
    folder, record_in
        The folder, and what reads its record; see `Permission`.
    written
        The paths in it that the run writes; None while they are unknown. Then only the names are checked.

    Raises
    ------
    DestinationError
        If there is anything that no record names, or that was changed and is not written by this run.
    """
    present = sorted(files_below(folder))
    if not present:
        return
    record = "its content is not checked" if record_in is None else record_in(folder)
    away = "choose another name, or move it away"
    if isinstance(record, str):
        hint = f"choose another name, or remove it yourself: rm -r {shlex.quote(str(folder))}"
        raise _unaccounted_error(folder, f"{record}, so it does not account for {name_list(present, 3)}", hint)
    if unnamed := [name for name in present if name not in record.files]:
        raise _unaccounted_error(folder, f"its {record.name} does not name {name_list(unnamed, 3)}", away)
    if written is not None:
        kept = [name for name in present if name not in written and not is_unchanged(folder / name, record.files[name])]
        if kept:
            raise _unaccounted_error(folder, f"{name_list(kept, 3)} was changed after it was written", away)


def _unaccounted_error(folder: Path, reason: str, hint: str) -> DestinationError:
    return DestinationError(
        f"is a directory with something that pc2scan has not written, and is not overwritten: {reason}",
        path=folder,
        hint=hint,
    )


def existing_error(dst: Path) -> DestinationError:
    """Return the error of a destination that may not be replaced."""
    return DestinationError("exists already", path=dst, hint="`overwrite=True` replaces it")


def is_of_kind(path: Path, beginning: bytes | None) -> bool:
    """Return whether a file has this beginning, or is empty."""
    length = len(beginning or b" ")
    if isinstance(path, UrlPath):
        return path.remote.read(length) in (beginning, b"")
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            return False
        with path.open("rb") as file:
            return file.read(length) in (beginning, b"")
    except OSError as err:
        raise OutputError(f"cannot be written: {err.strerror}", path=path) from err


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
    """A file or folder that a run writes.

    Attributes
    ----------
    path
        The path.
    option
        The option that names it; empty for the recording itself.
    """

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
    for output in outputs:
        read.refuse(output)
    for number, output in enumerate(outputs):
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
        #: Names count, too: a log that does not exist yet would be read with its database.
        self._ids: dict[FileId, InputPath] = {}
        self._folders: dict[FileId, InputPath] = {}
        seen: set[Path] = set()
        for given in inputs:
            for path in (given.path, *_entries(given.path)):
                for place in path_identities(path):
                    # SQLite reads logs beside a database, if they are files.
                    logs = (Path(f"{place}{suffix}") for suffix in _LOGS)
                    for name in (place, *itertools.filterfalse(os.path.isdir, logs)):
                        for identity in (name, *file_ids(name)):
                            self._ids.setdefault(identity, given)
                    for folder in itertools.takewhile(lambda folder: folder not in seen, place.parents):
                        seen.add(folder)
                        for identity in file_ids(folder):
                            self._folders.setdefault(identity, given)

    def refuse(self, output: OutputPath) -> None:
        """Raise if an output, or a name that it has while it is written, is an input, is inside one or contains one.

        Raises
        ------
        DestinationError
            If it does; the message says how the two are related.
        """
        for path in (output.path, *working_names(output.path)):
            if (related := self._relation(path)) is None:
                continue
            relation, source = related
            role = f"an {source.role}" if source.role[0] in "aeiou" else f"a {source.role}"
            if path != output.path:
                # What a killed run left may be a source.
                better = output.path.with_name(f"interrupted_{output.path.name}")
                rename = f"mv -n {shlex.quote(str(path))} {shlex.quote(str(better))}"
                raise DestinationError(
                    f"needs the name {path.name} while it is written, which is {role}",
                    path=output.path,
                    hint=f"choose another name for it, or rename the {source.role} first ({rename})",
                )
            what = role if relation == "is" else f"the {source.role} {source.path}"
            hint = "sources are never changed; choose another name"
            raise DestinationError(f"{_subject(output)}{relation} {what}", path=path, hint=hint)

    def _relation(self, path: Path) -> tuple[str, InputPath] | None:
        """Return how a path is related to an input, and to which; None if to none."""
        places = list(path_identities(path))
        above = [folder for place in places for folder in place.parents]
        for relation, known, paths in (
            ("is", self._ids, places),
            ("contains", self._folders, places),
            ("is inside", self._ids, above),
        ):
            for identity in (each for path in paths for each in (path, *file_ids(path))):
                if identity in known:
                    return relation, known[identity]
        return None


def _refuse_output(output: OutputPath, earlier: OutputPath) -> None:
    """Raise if two outputs are one file, or one is inside the other."""
    (own, own_folders), (others, other_folders) = (
        (
            {path_key(path) for path in (each.path, *working_names(each.path))},
            {path_key(folder) for folder in next(path_identities(each.path)).parents},
        )
        for each in (output, earlier)
    )
    relation = "is" if own & others else "is inside" if others & own_folders else "contains"
    if own & others or others & own_folders or own & other_folders:
        other = f"the file of {earlier.option}" if earlier.option else "the destination"
        raise DestinationError(f"{_subject(output)}{relation} {other}", path=output.path, hint="choose another name")


def _subject(output: OutputPath) -> str:
    return f"the file of {output.option} " if output.option else ""


def _entries(path: Path) -> list[Path]:
    """Return the entries of a local folder; none for a file, or if the folder cannot be read."""
    try:
        return [] if isinstance(path, UrlPath) else list(path.iterdir())
    except OSError:
        return []


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


def file_ids(path: Path) -> list[FileId]:
    """Return device and inode of a path that exists; for a symbolic link its own and its target's."""
    if isinstance(path, UrlPath):
        return [path.identity]
    ids: list[FileId] = []
    with suppress(OSError):
        status = path.lstat()
        ids.append((status.st_dev, status.st_ino))
        if stat.S_ISLNK(status.st_mode):
            status = path.stat()
            ids.append((status.st_dev, status.st_ino))
    return ids


def path_key(path: Path) -> object:
    """Return a key that is equal for paths that may be one file: file systems may ignore case or Unicode's forms."""
    place = next(path_identities(path))
    return tuple(file_ids(place.parent)[-1:]) or place.parent, name_key(place.name)


def name_key(name: str) -> str:
    """Return a key that is equal for names that may be one on a file system that ignores case or Unicode's forms."""
    return unicodedata.normalize("NFC", name).casefold()
