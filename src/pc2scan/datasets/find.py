"""Finds the recordings of a dataset in folders, globs, lists of paths and single paths.

They are recognised by their content, and in stores by their names.
"""

from __future__ import annotations

import glob
import os
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.folders import continues, groups_of_parts, is_named_as_recording, natural_order
from pc2scan.bags.formats import FORMATS
from pc2scan.bags.opening import open_recordings, sniff
from pc2scan.bags.zstd import without_suffix
from pc2scan.errors import Pc2ScanError, RecordingError, UsageError
from pc2scan.files.places import working_names
from pc2scan.files.source import open_bytes
from pc2scan.files.transfers import fetched
from pc2scan.files.urls import UrlPath, absolute, exists, is_dir, is_file, is_url, local_path, path_or_url

from .manifest import Identity, identity_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    #: Returns the container of a recording that an earlier run has found, by its first path and its files; else "".
    Known = Callable[[Path, Identity], str]

#: Text in the first bytes of a rosbag2 directory's metadata.yaml. Other programs have files of this name, too.
_METADATA, _METADATA_MARK, _METADATA_HEAD = "metadata.yaml", b"rosbag2_bagfile_information", 4096

#: Endings of the names that staging gives to incomplete outputs.
_UNFINISHED = tuple(path.name.removeprefix("x") for path in working_names(Path("x")))

_GLOB = frozenset("*?[")

#: Lists of paths are read up to this size.
_MAX_LIST_BYTES = 64_000_000


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording, or a file that was expected to be one.

    Attributes
    ----------
    key
        Its name in the dataset: the path below the folder that was searched, with slashes. Unique.
    paths
        One file or folder, or the parts of a split recording in their order.
    container
        The name of its format; empty if it is not a recording.
    identity
        Names, sizes and times of its files.
    error
        Why it cannot be converted; None if no error was found.
    """

    key: str
    paths: tuple[Path, ...]
    container: str
    identity: Identity
    error: Pc2ScanError | None = None


class _Candidate(NamedTuple):
    """A path, the folder that its key is relative to, and whether the user named it.

    A path that a user names and that is not a recording is an error; one that was found in a folder is ignored.
    """

    path: Path
    root: Path
    named: bool


@dataclass(slots=True)
class _Search:
    """The state of one search."""

    out: object
    known: Known
    #: Files that batches have written. They are not sources.
    outputs: frozenset[Path]
    #: Folders that were searched, by device and inode, because links may form loops; files by their resolved paths.
    folders: set[object] = field(default_factory=set)
    files: set[Path] = field(default_factory=set)


def find(
    sources: Sequence[str],
    out: Path,
    *,
    known: Known | None = None,
    outputs: Iterable[Path] = (),
) -> list[Recording]:
    """Find recordings.

    Parameters
    ----------
    sources
        Folders, which are searched; recordings; globs (``**`` for any folders); text files with one path per line,
        relative to the file's folder. All of these may be URLs.
    out
        The folder that the batch writes into. It is not searched.
    known
        Returns the container of a recording that an earlier run has found, so that it need not be opened again.
    outputs
        Files that earlier runs have written. They are skipped.

    Returns
    -------
    list[Found]
        In natural order of their keys. A recording that is found twice is listed once.

    Raises
    ------
    MissingError
        If a source does not exist.
    UsageError
        If a folder to be searched is in ``out``, a glob matches nothing, or two recordings would have one key.
    """
    search = _Search(_device_and_inode(out), known or (lambda _path, _identity: ""), frozenset(map(absolute, outputs)))
    found: list[Recording] = []
    for candidates in _candidates(sources, out):
        named: dict[Path, list[Recording]] = {}
        for candidate in candidates:
            if candidate.named:
                named.setdefault(candidate.path.parent, []).extend(_search_candidate(candidate, search))
            else:
                found += _search_candidate(candidate, search)
        for files in named.values():
            found += _join_parts(files, search)
    return sorted(_make_keys_unique(found), key=lambda each: natural_key(each.key))


def _candidates(sources: Sequence[str], out: Path) -> Iterator[Iterable[_Candidate]]:
    """Yield the candidates of the sources by root; that of single files is the folder that contains them all."""
    files: list[Path] = []
    for source in sources:
        text = local_path(source)
        path = path_or_url(text)
        if path.is_dir():
            _refuse_inside(path, out)
            yield (
                [_Candidate(path, path, named=False)]
                if not _is_rosbag2(path)
                else [_Candidate(path, path.parent, named=True)]
            )
        elif path.exists():
            if (listed := _paths_in_list(path)) is None:
                files.append(path)
            else:
                yield from _candidates_at(listed, out)
        elif _GLOB & set(text):
            root = _literal_part(path)
            found = _matches(path, root)
            if not found:
                raise UsageError(f"{source!r} matches nothing")
            yield [
                _Candidate(match, root, named=not is_dir(match))
                for match in found
                if not is_dir(match) or _is_rosbag2(match)
            ]
        else:
            # The path does not exist: raises an error with a suggestion.
            _sniff(path)
    yield from _candidates_at(files, out)


def _candidates_at(paths: Sequence[Path], out: Path) -> Iterator[list[_Candidate]]:
    """Yield candidates for paths that were named one by one: local ones first, then those at URLs."""
    for remote in (False, True):
        yield from _candidates_below([path for path in paths if isinstance(path, UrlPath) == remote], out)


def _candidates_below(paths: Sequence[Path], out: Path) -> Iterator[list[_Candidate]]:
    """Yield candidates for paths that were named one by one; keys are relative to the folder that contains them all."""
    if not paths:
        return
    parents = [str(absolute(path.parent)) for path in paths]
    try:
        root = path_or_url(os.path.commonpath(parents))
    except ValueError:
        root = Path()
    if not root.name and len(paths) > 1 and (not root.parts or isinstance(paths[0], UrlPath)):
        # On different drives (Windows), or in different stores: there is no common folder.
        yield from ([candidates] for path in paths for (candidates,) in _candidates_below([path], out))
        return
    folders = {path for path in paths if path.is_dir() and not _is_rosbag2(path)}
    for folder in folders:
        _refuse_inside(folder, out)
    yield [_Candidate(path, root, named=path not in folders) for path in paths]


def _matches(pattern: Path, root: Path) -> list[Path]:
    """Return what a glob matches."""
    if isinstance(pattern, UrlPath):
        return sorted(pattern.matches(root))
    return sorted(map(Path, glob.glob(str(pattern), recursive=True)))  # noqa: PTH207  # the text may be absolute


def _literal_part(pattern: Path) -> Path:
    """Return the folders of a glob before the first wildcard: keys are relative to them."""
    folder = pattern.parent
    while _GLOB & set(str(folder)):
        folder = folder.parent
    return folder


def _paths_in_list(path: Path) -> list[Path] | None:
    """Return the paths in a text file; None if it is not a list of paths."""
    if is_named_as_recording(path.name):
        return None
    with suppress(Pc2ScanError):
        _sniff(path)
        return None
    try:
        with open_bytes(path) as file:
            text = file.read(_MAX_LIST_BYTES).decode("utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    lines = [line.strip() for line in text.splitlines()]
    named = [line for line in lines if line and not line.startswith("#")]
    paths = [path_or_url(line) if is_url(line) else path.parent / line for line in map(local_path, named)]
    # A line that looks like a URL makes the file a list, and so does its being at a URL. Else at least one path must
    # exist: otherwise the file is another text, named by mistake.
    return paths if any(isinstance(each, UrlPath) or exists(each) for each in paths) else None


def _search_candidate(candidate: _Candidate, search: _Search) -> Iterator[Recording]:
    path = candidate.path
    if path.is_dir() and not candidate.named:
        yield from _search_folder(path, candidate.root, search)
        return
    if absolute(path) in search.outputs or not _is_new(path, search):
        return
    key = _key_of(path, candidate.root)
    yield from _recognise(path, key, search, named=True)


def _search_folder(folder: Path, root: Path, search: _Search) -> Iterator[Recording]:
    """Find the recordings in a folder and its subfolders."""
    identity = _device_and_inode(folder)
    if identity is None or identity == search.out or identity in search.folders:
        return
    search.folders.add(identity)
    try:
        listed = sorted((path for path in folder.iterdir() if not path.name.startswith(".")), key=natural_order)
    except OSError as err:
        error = RecordingError(f"cannot be searched: {err.strerror}", path=folder)
        yield Recording(_key_of(folder, root) or folder.name, (folder,), "", Identity(), error)
        return
    files: list[Recording] = []
    for path in listed:
        if path.name.endswith(_UNFINISHED) or absolute(path) in search.outputs:
            continue
        if is_dir(path):
            if _is_rosbag2(path, search):
                if _is_new(path, search):
                    yield from _recognise(path, _key_of(path, root), search, named=True)
            else:
                yield from _search_folder(path, root, search)
        elif is_file(path):
            if _is_new(path, search):
                files += _recognise(path, _key_of(path, root), search, named=is_named_as_recording(path.name))
        elif path.is_symlink() and is_named_as_recording(path.name):
            # A broken link.
            files += _recognise(path, _key_of(path, root), search, named=True)
    yield from _join_parts(files, search)


def _recognise(path: Path, key: str, search: _Search, *, named: bool) -> Iterator[Recording]:
    """Yield a file or a rosbag2 directory if it is a recording; if not, yield it with an error if it is ``named``."""
    if isinstance(path, UrlPath) and not named:
        return
    identity = identity_of([path])
    if container := search.known(absolute(path), identity):
        yield Recording(key, (path,), container, identity)
        return
    try:
        container = _sniff(path).partition("+")[0]
        if FORMATS[container].is_magic_shared and not named:
            # Other programs write such files, too: open it to see whether it is a recording.
            with ExitStack() as stack:
                open_recordings([path], stack)
    except Pc2ScanError as err:
        if named:
            yield Recording(key, (path,), "", identity, err)
    else:
        yield Recording(key, (path,), container, identity)


def _sniff(path: Path) -> str:
    """Return a recording's format as `sniff` does; in a store by its name, unless that says nothing."""
    if isinstance(path, UrlPath):
        if path.is_dir():
            return "rosbag2"
        suffix = Path(without_suffix(path.name)).suffix.lower()
        for name, entry in FORMATS.items():
            if suffix and suffix == entry.suffix and path.exists():
                return name
    with fetched([path]) as (copy,):
        return sniff(copy)


def _join_parts(found: Sequence[Recording], search: _Search) -> Iterator[Recording]:
    """Join the parts of split recordings."""
    by_path = {each.paths[0]: each for each in found if each.container}
    joined: dict[Path, Recording] = {}
    parts: set[Path] = set()
    for group in groups_of_parts(by_path):
        for chain in _chains([by_path[path] for path in group], search):
            if len(chain) > 1:
                first = chain[0]
                paths = tuple(each.paths[0] for each in chain)
                joined[paths[0]] = Recording(first.key, paths, first.container, identity_of(paths))
                parts.update(paths[1:])
    for each in found:
        if each.paths[0] not in parts:
            yield joined.get(each.paths[0], each)


def _chains(group: Sequence[Recording], search: _Search) -> Iterator[list[Recording]]:
    """Divide files that are named like parts of one recording wherever a file does not continue the one before it."""
    if chains := _known_chains(group, search):
        yield from chains
        return
    chain: list[Recording] = []
    last, opened = None, ExitStack()
    try:
        for each in group:
            reader, stack = None, ExitStack()
            with suppress(Pc2ScanError):
                (reader,) = open_recordings(each.paths, stack)
            if chain and not (last and reader and continues(chain[-1].paths[0], last, each.paths[0], reader)):
                yield chain
                chain = []
            chain.append(each)
            opened.close()
            last, opened = reader, stack
    finally:
        opened.close()
    yield chain


def _known_chains(group: Sequence[Recording], search: _Search) -> list[list[Recording]]:
    """Return the parts as an earlier run has joined them; empty if a file has changed since."""
    chains: list[list[Recording]] = []
    rest = list(group)
    while rest:
        # The longest first: a file that was a recording of its own may now be the first part of several.
        for count in range(len(rest), 0, -1):
            chain = rest[:count]
            if search.known(absolute(chain[0].paths[0]), identity_of(each.paths[0] for each in chain)):
                chains.append(chain)
                rest = rest[count:]
                break
        else:
            return []
    return chains


def _make_keys_unique(found: Sequence[Recording]) -> Iterator[Recording]:
    """Make the keys of recordings from several sources unique: prefix them with the folders that they were found in."""
    by_key: dict[str, list[Recording]] = {}
    for each in found:
        by_key.setdefault(each.key.casefold(), []).append(each)
    for same in by_key.values():
        if len(same) == 1:
            yield same[0]
            continue
        paths = [Path(str(absolute(each.paths[0]))).parts for each in same]
        count = next(
            (n for n in range(1, max(map(len, paths)) + 1) if len({tuple(p[-n:]) for p in paths}) == len(paths)), 0
        )
        if not count:
            raise UsageError(
                f"is found twice under the name {same[0].key}: {same[0].paths[0]} and {same[1].paths[0]}",
                hint="write their outputs to different folders, in two batches",
            )
        for each, parts in zip(same, paths, strict=True):
            # Prefix the whole key with as many folders as are needed.
            below = Path(each.key).parts
            before = parts[-max(count, len(below)) : len(parts) - len(below)]
            yield Recording("/".join((*before, *below)), each.paths, each.container, each.identity, each.error)


def _refuse_inside(folder: Path, out: Path) -> None:
    """Raise if a folder to be searched is the folder of the batch, or below it."""
    if _real(folder).is_relative_to(_real(out)):
        raise UsageError(
            f"is a source, and scans are written to {out}: they would be found as sources by the next run",
            path=folder,
            hint="write to another folder, such as `destination=" + f"{folder / 'scans'}`",
        )


def _is_rosbag2(folder: Path, search: _Search | None = None) -> bool:
    """Whether a folder is a rosbag2 directory: it has the metadata.yaml of one."""
    if not exists(folder / _METADATA):
        return False
    if search is not None and search.known(absolute(folder), identity_of([folder])):
        return True
    try:
        with open_bytes(folder / _METADATA) as file:
            return _METADATA_MARK in file.read(_METADATA_HEAD)
    except OSError:
        return False


def _is_new(path: Path, search: _Search) -> bool:
    """Whether a file or folder is found for the first time; links to it count as the same."""
    real = _real(path)
    is_new = real not in search.files
    search.files.add(real)
    return is_new


def _real(path: Path) -> Path:
    """Return a path with links resolved."""
    return path.identity if isinstance(path, UrlPath) else Path(os.path.realpath(path))


def _device_and_inode(path: Path) -> object:
    """Return what is equal for paths of one folder; None if it does not exist."""
    if isinstance(path, UrlPath):
        return path.identity
    try:
        status = os.stat(path)  # noqa: PTH116
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _key_of(path: Path, root: Path) -> str:
    return os.path.relpath(str(path), str(root)).replace(os.sep, "/").removeprefix("./")


def natural_key(key: str) -> list[list[int | str]]:
    """Return the sorting key of a recording's name, by which ``2`` comes before ``10``."""
    return [natural_order(Path(part)) for part in key.split("/")]
