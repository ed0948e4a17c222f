"""Compares the inputs of a run with its outputs: no output may replace, remove or hide an input."""

from __future__ import annotations

import os
import shlex
import unicodedata
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import DestinationError

from .places import working_names

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

__all__ = ["InputPath", "OutputPath", "refuse_overlap"]

#: Endings of the files that SQLite reads beside a database.
_LOGS = ("-wal", "-journal", "-shm")

#: Links that lead to links: the system follows at most this many.
_MAX_LINKS = 40

#: Device and inode.
_Id = tuple[int, int]


class InputPath(NamedTuple):
    """A file or folder that a run reads, and its role: ``source``, or the option that names it."""

    path: Path
    role: str = "source"


class OutputPath(NamedTuple):
    """A file or folder that a run writes, and the option that names it; empty for the recording itself."""

    path: Path
    option: str = ""


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
    read = _Inputs(inputs)
    for output in outputs:
        _refuse_input(output, read)
    for number, output in enumerate(outputs):
        for earlier in outputs[:number]:
            _refuse_output(output, earlier)


class _Inputs:
    """All paths of the inputs, by name and by device and inode, and the folders above them."""

    def __init__(self, inputs: Iterable[InputPath]) -> None:
        self._paths: dict[Path, InputPath] = {}
        self._ids: dict[_Id, InputPath] = {}
        self._folders: dict[_Id, InputPath] = {}
        self._seen: set[Path] = set()
        for given in inputs:
            for path in (given.path, *_entries(given.path)):
                for place in _places(path):
                    for read in (place, *_logs(place)):
                        self._add(given, read)

    def _add(self, given: InputPath, path: Path) -> None:
        for place in _places(path):
            self._paths.setdefault(place, given)
            for identity in _ids(place):
                self._ids.setdefault(identity, given)
            for folder in place.parents:
                if folder in self._seen:
                    break
                self._seen.add(folder)
                for identity in _ids(folder):
                    self._folders.setdefault(identity, given)

    def related(self, path: Path) -> tuple[str, InputPath] | None:
        """Return how a path is related to an input, and to which; None if to none."""
        places = list(_places(path))
        # A file that does not exist has no inode, but a log that appears beside a database would be read with it.
        if found := self._paths.get(places[0]) or _first(self._ids, _ids(*places)):
            return "is", found
        if found := _first(self._folders, _ids(*places)):
            return "contains", found
        if found := _first(self._ids, _ids(*(folder for place in places for folder in place.parents))):
            return "is inside", found
        return None


def _refuse_input(output: OutputPath, read: _Inputs) -> None:
    for path in (output.path, *working_names(output.path)):
        if (related := read.related(path)) is None:
            continue
        relation, found = related
        if path != output.path:
            raise _leftover(output, path, found)
        what = _a(found.role) if relation == "is" else f"the {found.role} {found.path}"
        raise DestinationError(
            f"{_subject(output)}{relation} {what}",
            path=output.path,
            hint="sources are never changed; choose another name",
        )


def _leftover(output: OutputPath, path: Path, found: InputPath) -> DestinationError:
    """Return the error for an input with a name that staging needs, and a command that renames it."""
    better = output.path.with_name(f"interrupted_{output.path.name}")
    rename = f" (mv {shlex.quote(str(path))} {shlex.quote(str(better))})" if not os.path.lexists(better) else ""
    return DestinationError(
        f"needs the name {path.name} while it is written, which is {_a(found.role)}",
        path=output.path,
        hint=f"choose another name for it, or rename the {found.role} first{rename}",
    )


def _refuse_output(output: OutputPath, earlier: OutputPath) -> None:
    other = f"the file of {earlier.option}" if earlier.option else "the destination"
    own, others = ({_path_key(path) for path in (each.path, *working_names(each.path))} for each in (output, earlier))
    relation = None
    if own & others:
        relation = "is"
    elif others & _folder_keys(output.path):
        relation = "is inside"
    elif own & _folder_keys(earlier.path):
        relation = "contains"
    if relation:
        raise DestinationError(f"{_subject(output)}{relation} {other}", path=output.path, hint="choose another name")


def _subject(output: OutputPath) -> str:
    return f"the file of {output.option} " if output.option else ""


def _entries(path: Path) -> list[Path]:
    """Return the entries of a folder; none for a file, or if the folder cannot be read."""
    try:
        return list(path.iterdir())
    except OSError:
        return []


def _logs(path: Path) -> Iterator[Path]:
    """Return the paths that SQLite would read beside a database, if they are files or do not exist."""
    for log in (path.with_name(path.name + suffix) for suffix in _LOGS if path.name):
        # A name may be too long, which `Path.is_dir` raises.
        if not os.path.isdir(log):  # noqa: PTH112
            yield log


def _places(path: Path) -> Iterator[Path]:
    """Return a path without links in its folders, and if it is a symbolic link each path that it leads to."""
    for _ in range(_MAX_LINKS):
        path = Path(os.path.realpath(path.parent), path.name) if path.name not in {"", ".."} else path.resolve()
        yield path
        try:
            path = path.parent / path.readlink()
        except OSError:
            return


def _ids(*paths: Path) -> list[_Id]:
    """Return device and inode of those paths that exist; for a symbolic link its own and its target's."""
    found = []
    for path in paths:
        for look in (os.lstat, os.stat):
            with suppress(OSError):
                status = look(path)
                found.append((status.st_dev, status.st_ino))
    return found


def _path_key(path: Path) -> object:
    """Return a key that is equal for paths that may be one file: file systems may ignore case or Unicode's forms."""
    place = next(_places(path))
    return tuple(_ids(place.parent)[-1:]) or place.parent, unicodedata.normalize("NFC", place.name).casefold()


def _folder_keys(path: Path) -> set[object]:
    return {_path_key(folder) for folder in next(_places(path)).parents}


def _first(known: dict[_Id, InputPath], ids: Iterable[_Id]) -> InputPath | None:
    return next((known[identity] for identity in ids if identity in known), None)


def _a(role: str) -> str:
    return f"an {role}" if role[0] in "aeiou" else f"a {role}"
