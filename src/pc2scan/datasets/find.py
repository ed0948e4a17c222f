"""Finds the recordings of a dataset in folders, globs and single paths.

They are recognised by their content, and in stores by their names.
"""

from __future__ import annotations

import glob
import os
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.folders import continues, groups_of_parts, is_named_as_recording, natural_order
from pc2scan.bags.formats import FORMATS
from pc2scan.bags.opening import open_recordings, sniff
from pc2scan.bags.zstd import without_suffix
from pc2scan.errors import Pc2ScanError, RecordingError, UsageError
from pc2scan.files.outputs import working_names
from pc2scan.files.paths import absolute, exists, is_dir, local_path, path_or_url
from pc2scan.files.source_file import open_bytes
from pc2scan.files.urls import UrlPath, fetched

from .manifest import Identity, identity_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

#: Text in the first bytes of a rosbag2 directory's metadata.yaml. Other programs have files of this name, too.
_METADATA, _METADATA_MARK, _METADATA_HEAD = "metadata.yaml", b"rosbag2_bagfile_information", 4096

#: Endings of the names that staging gives to incomplete outputs.
_UNFINISHED = tuple(path.name.removeprefix("x") for path in working_names(Path("x")))

_GLOB = frozenset("*?[")


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


class _Search(NamedTuple):
    """Where a search has been."""

    #: Files that batches have written. They are not sources.
    outputs: frozenset[Path]
    #: Folders that were searched, because links may form loops, that of the results, and files; all without links.
    folders: set[Path]
    files: set[Path]


def find(sources: Sequence[str], out: Path, *, outputs: Iterable[Path] = ()) -> list[Recording]:
    """Find recordings.

    Parameters
    ----------
    sources
        Folders, which are searched; recordings; globs (``**`` for any folders). Folders and recordings may be URLs.
    out
        The folder that the batch writes into. It is not searched.
    outputs
        Files that earlier runs have written. They are skipped.

    Returns
    -------
    list[Recording]
        In natural order of their keys, which are their paths below the folder that contains all sources. A recording
        that is found twice is listed once.

    Raises
    ------
    MissingError
        If a source does not exist.
    UsageError
        If a folder to be searched is in ``out``, a glob matches nothing, or two recordings would have one key.
    """
    places = [_place(source, out) for source in sources]
    search = _Search(frozenset(map(absolute, outputs)), {_real(out)}, set())
    common = _common_folder([folder for folder, _ in places])
    by_folder: dict[Path, list[Recording]] = {}
    for folder, paths in places:
        for path in paths:
            for recording in _recordings_at(path, common or folder, search):
                by_folder.setdefault(recording.paths[0].parent, []).append(recording)
    by_key: dict[str, Recording] = {}
    for recording in (recording for beside in by_folder.values() for recording in _join_parts(beside)):
        other = by_key.setdefault(recording.key, recording)
        if other is not recording:
            raise UsageError(
                f"is found twice under the name {recording.key}: {other.paths[0]} and {recording.paths[0]}",
                hint="write their outputs to different folders, in two batches",
            )
    return sorted(by_key.values(), key=lambda recording: natural_key(recording.key))


def _place(source: str, out: Path) -> tuple[Path, list[Path]]:
    """Return the folder that keys are relative to if there is one source, and what is found at the source."""
    text = local_path(source)
    path = path_or_url(text)
    if path.is_dir() and not _is_rosbag2(path):
        if _real(path).is_relative_to(_real(out)):
            raise UsageError(
                f"is a source, and scans are written to {out}: they would be found as sources by the next run",
                path=path,
                hint="write to another folder, such as `destination=" + f"{path / 'scans'}`",
            )
        return path, [path]
    if path.exists():
        return path.parent, [path]
    if isinstance(path, UrlPath) or not _GLOB & set(text):
        # The path does not exist: raises an error with a suggestion.
        _sniff(path)
    folder = path.parent
    while _GLOB & set(str(folder)):
        folder = folder.parent
    paths = sorted(map(Path, glob.glob(text, recursive=True)))  # noqa: PTH207  # the text may be absolute
    if not paths:
        raise UsageError(f"{source!r} matches nothing")
    return folder, [match for match in paths if not is_dir(match) or _is_rosbag2(match)]


def _common_folder(folders: Sequence[Path]) -> Path | None:
    """Return the folder that contains all; None on different drives (Windows), or in different stores."""
    try:
        common = path_or_url(os.path.commonpath([str(absolute(folder)) for folder in folders]))
    except ValueError:
        return None
    return common if common.name or not isinstance(folders[0], UrlPath) else None


def _recordings_at(path: Path, root: Path, search: _Search) -> Iterator[Recording]:
    """Yield a recording that is named, or those in a folder and its subfolders."""
    if not is_dir(path) or _is_rosbag2(path):
        yield from _recognise(path, root, search, named=True)
        return
    real = _real(path)
    if real in search.folders:
        return
    search.folders.add(real)
    try:
        listed = sorted((entry for entry in path.iterdir() if not entry.name.startswith(".")), key=natural_order)
    except OSError as err:
        error = RecordingError(f"cannot be searched: {err.strerror}", path=path)
        yield Recording(_key_of(path, root), (path,), "", Identity(), error)
        return
    for entry in listed:
        if entry.name.endswith(_UNFINISHED):
            continue
        if is_dir(entry):
            yield from _recordings_at(entry, root, search)
        else:
            yield from _recognise(entry, root, search, named=is_named_as_recording(entry.name))


def _recognise(path: Path, root: Path, search: _Search, *, named: bool) -> Iterator[Recording]:
    """Yield a file or a rosbag2 directory if it is a recording; if not, yield it with an error if it is ``named``.

    Files are found once; links to one count as the same.
    """
    real = _real(path)
    if absolute(path) in search.outputs or real in search.files:
        return
    search.files.add(real)
    if isinstance(path, UrlPath) and not named:
        return
    key, identity = _key_of(path, root), identity_of([path])
    try:
        container = _sniff(path).partition("+")[0]
        if container == "sqlite3" and not named:
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


def _join_parts(recordings: Sequence[Recording]) -> Iterator[Recording]:
    """Join the parts of split recordings."""
    by_path = {recording.paths[0]: recording for recording in recordings if recording.container}
    joined: dict[Path, Recording] = {}
    parts: set[Path] = set()
    for group in groups_of_parts(by_path):
        for chain in _chains([by_path[path] for path in group]):
            if len(chain) > 1:
                first = chain[0]
                paths = tuple(recording.paths[0] for recording in chain)
                joined[paths[0]] = Recording(first.key, paths, first.container, identity_of(paths))
                parts.update(paths[1:])
    for recording in recordings:
        if recording.paths[0] not in parts:
            yield joined.get(recording.paths[0], recording)


def _chains(group: Sequence[Recording]) -> Iterator[list[Recording]]:
    """Divide files that are named like parts of one recording wherever a file does not continue the one before it."""
    chain: list[Recording] = []
    last, opened = None, ExitStack()
    try:
        for recording in group:
            reader, stack = None, ExitStack()
            with suppress(Pc2ScanError):
                (reader,) = open_recordings(recording.paths, stack)
            if chain and not (last and reader and continues(last, reader)):
                yield chain
                chain = []
            chain.append(recording)
            opened.close()
            last, opened = reader, stack
    finally:
        opened.close()
    yield chain


def _is_rosbag2(folder: Path) -> bool:
    """Whether a folder is a rosbag2 directory: it has the metadata.yaml of one."""
    if not exists(folder / _METADATA):
        return False
    try:
        with open_bytes(folder / _METADATA) as file:
            return _METADATA_MARK in file.read(_METADATA_HEAD)
    except OSError:
        return False


def _real(path: Path) -> Path:
    """Return a path with links resolved."""
    return path if isinstance(path, UrlPath) else Path(os.path.realpath(path))


def _key_of(path: Path, root: Path) -> str:
    key = os.path.relpath(str(absolute(path)), str(absolute(root))).replace(os.sep, "/").removeprefix("./")
    return path.name if key == "." else key


def natural_key(key: str) -> list[list[int | str]]:
    """Return the sorting key of a recording's name, by which ``2`` comes before ``10``."""
    return [natural_order(Path(part)) for part in key.split("/")]
