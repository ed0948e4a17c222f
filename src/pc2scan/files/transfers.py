"""Reads whole files at URLs ahead, and writes outputs to URLs.

An output is written into a temporary folder first, then complete or not at all into the store. The rule of ownership is
that of `pc2scan.files.ownership`; versions of objects stand for times of modification.
"""

from __future__ import annotations

from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, MissingError, Pc2ScanError, name_list

from .ownership import existing_error, stored_folder_error
from .places import private_folder
from .records import files_below
from .system import scratch

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator

    from .store import RangeFile
    from .urls import UrlPath

#: Bytes of a request that reads ahead, and threads that do: a connection idles between its requests.
_AHEAD_BYTES = 4 << 20
_AHEAD_THREADS = 2


@contextmanager
def reading_urls(paths: Iterable[UrlPath], folder: Path | None = None) -> Iterator[None]:
    """Fetch whole files or folders, one after the other, in the background while the body reads them.

    What is fetched is kept until the body ends, because it may be there before anything reads it. Errors are left to
    the threads that need the bytes.

    Parameters
    ----------
    paths
        What is read.
    folder
        The folder for local copies while the body runs; None: the system's folder for temporary files.
    """
    before = scratch.set(folder)
    stopped = Event()
    try:
        kept = [file.remote.ranges() for path in paths for file in _files_of(path)]
        parts = _parts_of(kept)
        for _ in range(_AHEAD_THREADS):
            Thread(target=_fetch_parts, args=(parts, stopped), daemon=True).start()
        yield
        del kept
    finally:
        stopped.set()
        scratch.reset(before)


def _files_of(path: UrlPath) -> Iterator[UrlPath]:
    """Yield a file, or the files in a folder."""
    yield from (file for file in (path.iterdir() if path.is_dir() else (path,)) if file.is_file())


def _parts_of(files: Iterable[RangeFile]) -> SimpleQueue[tuple[RangeFile, int]]:
    """Return a queue of parts of files in the order in which they are read: the file, and where a part begins."""
    parts: SimpleQueue[tuple[RangeFile, int]] = SimpleQueue()
    for file in files:
        file.step = _AHEAD_BYTES
        for start in range(0, file.size, _AHEAD_BYTES):
            parts.put((file, start))
    return parts


def _fetch_parts(parts: SimpleQueue[tuple[RangeFile, int]], stopped: Event) -> None:
    with suppress(Empty, Pc2ScanError):
        while not stopped.is_set():
            file, start = parts.get_nowait()
            file.fetch(start, min(_AHEAD_BYTES, file.size - start))


@contextmanager
def upload(
    dst: UrlPath, *, overwrite: bool, owned: Collection[str] | None = None
) -> Iterator[tuple[Path, Callable[[], None]]]:
    """Yield a local path to write to, and a function that uploads what is there.

    Parameters
    ----------
    dst
        The file or folder to write.
    overwrite, owned
        As for `pc2scan.files.staging.staged_output`.

    Yields
    ------
    path, function
        What to write, and how to upload it.

    Raises
    ------
    DestinationError
        If something is there that may not be replaced.
    OutputError
        If it cannot be written.
    """
    with private_folder(dst) as folder:
        partial = Path(folder, dst.name)
        yield partial, lambda: _commit(partial, dst, owned, overwrite=overwrite)


def _commit(partial: Path, dst: UrlPath, owned: Collection[str] | None, *, overwrite: bool) -> None:
    """Remove what the output replaces, and upload it."""
    new: dict[str, Path] = {dst.name: partial}
    if partial.is_dir():
        new = {f"{dst.name}/{name}": partial / name for name in files_below(partial)}
    present = _present(dst)
    _refuse_others(dst, present, new, owned, overwrite=overwrite)
    # A recording is complete when its metadata.yaml is there. So this is removed first, and uploaded last. Files are
    # replaced in one step.
    gone = [name for name in present if "/" in name]
    for name in sorted(gone, key=lambda name: (not name.endswith("/metadata.yaml"), name)):
        (dst.parent / name).remote.delete()
    done: list[UrlPath] = []
    try:
        for name in sorted(new, key=lambda name: name.endswith("metadata.yaml")):
            place = dst.parent / name
            if len(new) > 1:
                done.append(place)
            place.remote.upload(new[name])
    except BaseException:
        for place in done:
            with suppress(Exception):
                place.remote.delete()
        raise


def _present(dst: UrlPath) -> list[str]:
    """Return the files at a destination, by their paths relative to its folder."""
    try:
        if dst.is_dir():
            return [f"{dst.name}/{path.relative_to(dst).as_posix()}" for path in dst.below()]
        dst.known()
    except MissingError:
        return []
    return [dst.name]


def _refuse_others(
    dst: UrlPath, present: list[str], new: Collection[str], owned: Collection[str] | None, *, overwrite: bool
) -> None:
    """Raise if what is there may not be replaced."""
    if owned is None and any("/" in name for name in present):
        raise stored_folder_error(dst)
    if owned is None and present and not overwrite:
        raise existing_error(dst)
    if kept := [name for name in present if name not in new and name not in (owned or ())]:
        raise DestinationError(
            f"has something that this batch did not write, and is not replaced: {name_list(kept, 3)}",
            path=dst,
            hint="move it away, or write to another folder",
        )
