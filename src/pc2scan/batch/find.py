"""Finds the recordings of a dataset, by content: in folders, by globs, in lists of paths, or by name."""

from __future__ import annotations

import glob
import os
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.folders import continues, groups_of_parts, is_named_as_recording, natural_order
from pc2scan.bags.opening import open_recording, sniff
from pc2scan.errors import Pc2ScanError, RecordingError, UsageError
from pc2scan.files.source import opened_bytes
from pc2scan.files.staging import working_names
from pc2scan.remote.urls import is_url

from .identity import Identity, identity_of
from .stores import Stores

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from pc2scan.bags.reader import Reader

    #: Returns the container of a recording that is known by its first path and its files; empty if it is not.
    Known = Callable[[Path, Identity], str]

__all__ = ["Found", "find"]

#: What metadata.yaml of a rosbag2 directory has in its first bytes; other programs have files of this name, too.
_METADATA, _METADATA_MARK, _METADATA_HEAD = "metadata.yaml", b"rosbag2_bagfile_information", 4096

#: Names that staging gives to what is not complete.
_UNFINISHED = tuple(path.name.removeprefix("x") for path in working_names(Path("x")))

_GLOB = frozenset("*?[")

#: A list of paths has text, and so few bytes.
_MAX_LIST_BYTES = 64_000_000


@dataclass(frozen=True, slots=True)
class Found:
    """A recording, or what should have been one.

    Attributes
    ----------
    key
        Its name in the dataset: the path below the folder that was searched, with slashes. Unique.
    paths
        One file or folder, or the parts of a split recording in their order.
    container
        The name of its format; empty where it is none.
    identity
        Of its files.
    error
        Why it cannot be converted; None if it seems sound.
    """

    key: str
    paths: tuple[Path, ...]
    container: str
    identity: Identity
    error: Pc2ScanError | None = None


class _Place(NamedTuple):
    """A path, the folder that its key is relative to, and whether it was named (what is not named must look right)."""

    path: Path
    root: Path
    named: bool


@dataclass(slots=True)
class _Search:
    """What one search has seen."""

    out: tuple[int, int] | None
    known: Known
    #: Files that batches have written: they are no sources.
    outputs: frozenset[Path]
    stores: Stores
    #: Folders by device and inode, because links may lead around in circles; files by their paths without links.
    folders: set[tuple[int, int]] = field(default_factory=set)
    files: set[str] = field(default_factory=set)


def find(
    sources: Sequence[str],
    out: Path,
    *,
    known: Known | None = None,
    outputs: Iterable[Path] = (),
    stores: Stores | None = None,
) -> list[Found]:
    """Find recordings.

    Parameters
    ----------
    sources
        Folders, which are searched; recordings; globs (``**`` for any folders); text files with a path a line, relative
        to the file's folder. Or URLs of these.
    out
        Where the batch writes: not searched.
    known
        Returns the container of what an earlier run has found, by path and identity, so that it need not be opened.
    outputs
        What earlier runs have written.
    stores
        What is at URLs: their paths are those of stand-ins.

    Returns
    -------
    list[Found]
        In natural order of their keys. What is found twice is there once.

    Raises
    ------
    MissingError
        If there is nothing of a source's name.
    UsageError
        If a folder to be searched is in ``out``, a glob matches nothing, or two recordings would have one key.
    """
    stores = Stores(None) if stores is None else stores
    search = _Search(_id(out), known or (lambda _path, _identity: ""), frozenset(map(_absolute, outputs)), stores)
    found: list[Found] = []
    for places in _gathered(sources, out, stores):
        named: dict[Path, list[Found]] = {}
        for place in places:
            if place.named:
                named.setdefault(place.path.parent, []).extend(_in_place(place, search))
            else:
                found += _in_place(place, search)
        for files in named.values():
            found += _joined(files, search)
    return sorted(_distinct(found), key=lambda each: _natural(each.key))


def _gathered(sources: Sequence[str], out: Path, stores: Stores) -> Iterator[Iterable[_Place]]:
    """What is named, in places with one root: single files share the folder that all of them are in."""
    files: list[Path] = []
    for source in sources:
        text = stores.located(source)
        path = Path(text)
        if path.is_dir():
            _refuse_inside(path, out)
            yield (
                [_Place(path, path, named=False)] if not _is_rosbag2(path) else [_Place(path, path.parent, named=True)]
            )
        elif path.exists():
            if (listed := _listed(path, stores)) is None:
                files.append(path)
            else:
                yield from _at_all(listed, out, stores, searching=f"{path}: ")
        elif _GLOB & set(text):
            matches = sorted(glob.glob(text, recursive=True))  # noqa: PTH207  # the text may be absolute
            if not matches:
                raise UsageError(f"{source!r} matches nothing")
            yield [
                _Place(Path(match), _literal_part(text), named=not os.path.isdir(match))  # noqa: PTH112
                for match in matches
                if not os.path.isdir(match) or _is_rosbag2(Path(match))  # noqa: PTH112
            ]
        else:
            # Raises, with what may be meant.
            sniff(path)
    yield from _at_all(files, out, stores)


def _at_all(paths: Sequence[Path], out: Path, stores: Stores, searching: str = "") -> Iterator[list[_Place]]:
    """Places for paths that were named one by one, those at URLs by themselves."""
    for remote in (False, True):
        yield from _paths([path for path in paths if stores.is_remote(path) == remote], out, searching)


def _paths(paths: Sequence[Path], out: Path, searching: str = "") -> Iterator[list[_Place]]:
    """Places for paths that were named one by one: their keys are relative to the folder that all are in."""
    if not paths:
        return
    parents = [os.path.abspath(path.parent) for path in paths]  # noqa: PTH100  # links keep their names
    try:
        root = Path(os.path.commonpath(parents))
    except ValueError:
        # On drives of their own.
        yield from ([places] for path in paths for (places,) in _paths([path], out, searching))
        return
    places = []
    for path in paths:
        if path.is_dir() and not _is_rosbag2(path):
            if searching:
                _refuse_inside(path, out)
            places.append(_Place(path, root, named=False))
        else:
            places.append(_Place(path, root, named=True))
    yield places


def _literal_part(pattern: str) -> Path:
    """The folder of a glob that has no wildcard in it: keys are relative to it."""
    parts: list[str] = []
    for part in Path(pattern).parts[:-1]:
        if _GLOB & set(part):
            break
        parts.append(part)
    return Path(*parts)


def _listed(path: Path, stores: Stores) -> list[Path] | None:
    """The paths in a text file; None if it is no list of paths."""
    if is_named_as_recording(path.name):
        return None
    with suppress(Pc2ScanError):
        sniff(path)
        return None
    try:
        with opened_bytes(path) as file:
            text = file.read(_MAX_LIST_BYTES).decode("utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    lines = [line.strip() for line in text.splitlines()]
    named = [line for line in lines if line and not line.startswith("#")]
    if any(is_url(Path(line)) for line in named) or stores.is_remote(path):
        # Nothing else looks like a URL. That of a folder ends with a slash as well as not.
        return [Path(stores.located(stores.beside(path, line))) for line in named]
    paths = [path.parent / line for line in named]
    # A list has at least one path that leads somewhere; anything else is a text given by mistake.
    return paths if any(map(os.path.lexists, paths)) else None


def _in_place(place: _Place, search: _Search) -> Iterator[Found]:
    path = place.path
    if path.is_dir() and not place.named:
        yield from _in_folder(path, place.root, search)
        return
    if _absolute(path) in search.outputs or not _is_new(path, search):
        return
    key = _key(path, place.root)
    yield from _judged(path, key, search, named=True)


def _in_folder(folder: Path, root: Path, search: _Search) -> Iterator[Found]:
    """Everything in a folder and in those below it."""
    identity = _id(folder)
    if identity is None or identity == search.out or identity in search.folders:
        return
    search.folders.add(identity)
    try:
        with os.scandir(folder) as entries:
            listed = sorted((entry for entry in entries if not entry.name.startswith(".")), key=_entry_order)
    except OSError as err:
        error = RecordingError(f"cannot be searched: {err.strerror}", path=folder)
        yield Found(_key(folder, root) or folder.name, (folder,), "", Identity(), error)
        return
    files: list[Found] = []
    for entry in listed:
        path = folder / entry.name
        if entry.name.endswith(_UNFINISHED) or _absolute(path) in search.outputs:
            continue
        if entry.is_dir():
            if _is_rosbag2(path, search):
                if _is_new(path, search):
                    yield from _judged(path, _key(path, root), search, named=True)
            else:
                yield from _in_folder(path, root, search)
        elif entry.is_file():
            if _is_new(path, search):
                files += _judged(path, _key(path, root), search, named=is_named_as_recording(entry.name))
        elif entry.is_symlink() and is_named_as_recording(entry.name):
            # It leads nowhere.
            files += _judged(path, _key(path, root), search, named=True)
    yield from _joined(files, search)


def _judged(path: Path, key: str, search: _Search, *, named: bool) -> Iterator[Found]:
    """A file or a rosbag2 directory, if it is a recording; if it is none, only if it was named as one."""
    identity = identity_of([path])
    if container := search.known(_absolute(path), identity):
        yield Found(key, (path,), container, identity)
        return
    try:
        container = sniff(path).partition("+")[0]
        if container == "sqlite3" and not named:
            # Other programs have databases, too.
            _opened(path, search).close()
    except Pc2ScanError as err:
        if named:
            yield Found(key, (path,), "", identity, err)
    else:
        yield Found(key, (path,), container, identity)


def _joined(found: Sequence[Found], search: _Search) -> Iterator[Found]:
    """Make one recording of the parts of each."""
    by_path = {each.paths[0]: each for each in found if each.container}
    joined: dict[Path, Found] = {}
    parts: set[Path] = set()
    for group in groups_of_parts(by_path):
        for chain in _chains([by_path[path] for path in group], search):
            if len(chain) > 1:
                first = chain[0]
                paths = tuple(each.paths[0] for each in chain)
                joined[paths[0]] = Found(first.key, paths, first.container, identity_of(paths))
                parts.update(paths[1:])
    for each in found:
        if each.paths[0] not in parts:
            yield joined.get(each.paths[0], each)


def _chains(group: Sequence[Found], search: _Search) -> Iterator[list[Found]]:
    """Cut files that are named as parts where one does not continue the other."""
    if chains := _known_chains(group, search):
        yield from chains
        return
    chain: list[Found] = []
    last = None
    try:
        for each in group:
            reader = None
            with suppress(Pc2ScanError):
                reader = _opened(each.paths[0], search)
            if chain and not (last and reader and continues(chain[-1].paths[0], last, each.paths[0], reader)):
                yield chain
                chain = []
            chain.append(each)
            if last is not None:
                last.close()
            last = reader
    finally:
        if last is not None:
            last.close()
    yield chain


def _opened(path: Path, search: _Search) -> Reader:
    search.stores.complete(path)
    return open_recording(path)


def _known_chains(group: Sequence[Found], search: _Search) -> list[list[Found]]:
    """The parts as an earlier run has joined them, if no file has changed since; empty if one has."""
    chains: list[list[Found]] = []
    rest = list(group)
    while rest:
        # The longest first: a single file that is known may have become the first part of several.
        for count in range(len(rest), 0, -1):
            chain = rest[:count]
            if search.known(_absolute(chain[0].paths[0]), identity_of(each.paths[0] for each in chain)):
                chains.append(chain)
                rest = rest[count:]
                break
        else:
            return []
    return chains


def _distinct(found: Sequence[Found]) -> Iterator[Found]:
    """Give recordings of several sources keys of their own: the folder that each was found in is put before them."""
    by_key: dict[str, list[Found]] = {}
    for each in found:
        by_key.setdefault(each.key.casefold(), []).append(each)
    for same in by_key.values():
        if len(same) == 1:
            yield same[0]
            continue
        paths = [Path(_absolute(each.paths[0])).parts for each in same]
        count = next(
            (n for n in range(1, max(map(len, paths)) + 1) if len({tuple(p[-n:]) for p in paths}) == len(paths)), 0
        )
        if not count:
            raise UsageError(
                f"is found twice under the name {same[0].key}: {same[0].paths[0]} and {same[1].paths[0]}",
                hint="convert them into two folders",
            )
        for each, parts in zip(same, paths, strict=True):
            # As many folders as it takes, before the whole key.
            below = Path(each.key).parts
            before = parts[-max(count, len(below)) : len(parts) - len(below)]
            yield Found("/".join((*before, *below)), each.paths, each.container, each.identity, each.error)


def _refuse_inside(folder: Path, out: Path) -> None:
    """Raise if a folder to be searched is where the batch writes, or in it."""
    if Path(os.path.realpath(folder)).is_relative_to(os.path.realpath(out)):
        raise UsageError(
            f"is searched, and {out} is where scans are written: they would be found as sources",
            path=folder,
            hint="write into a folder beside it, or in it: `destination=" + f"{folder / 'scans'}`",
        )


def _is_rosbag2(folder: Path, search: _Search | None = None) -> bool:
    """Whether a folder is one recording: its metadata.yaml is of rosbag2."""
    if not os.path.lexists(folder / _METADATA):
        return False
    if search is not None and search.known(_absolute(folder), identity_of([folder])):
        return True
    try:
        with opened_bytes(folder / _METADATA) as file:
            return _METADATA_MARK in file.read(_METADATA_HEAD)
    except OSError:
        return False


def _is_new(path: Path, search: _Search) -> bool:
    """Whether a file or folder was not found before, under whatever name."""
    real = os.path.realpath(path)
    is_new = real not in search.files
    search.files.add(real)
    return is_new


def _id(path: Path) -> tuple[int, int] | None:
    try:
        status = os.stat(path)  # noqa: PTH116
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))  # noqa: PTH100  # links keep their names


def _key(path: Path, root: Path) -> str:
    return os.path.relpath(path, root).replace(os.sep, "/").removeprefix("./")


def _entry_order(entry: os.DirEntry[str]) -> list[int | str]:
    return natural_order(Path(entry.name))


def _natural(key: str) -> list[list[int | str]]:
    return [natural_order(Path(part)) for part in key.split("/")]
