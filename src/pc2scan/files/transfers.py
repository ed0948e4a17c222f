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

from .ownership import existing_error, ruling, stored_folder_error
from .places import private_folder
from .records import FileState, Record, files_below
from .system import scratch

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from .ownership import Ruling
    from .store import RangeFile, StoredObject
    from .urls import UrlPath

_UNKNOWN = FileState(-1)

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
def upload(dst: UrlPath, *, overwrite: bool, owned: Record | None = None) -> Iterator[tuple[Path, Callable[[], None]]]:
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


def _commit(partial: Path, dst: UrlPath, owned: Record | None, *, overwrite: bool) -> None:
    """Remove what the output replaces, and upload it."""
    new: dict[str, Path] = {dst.name: partial}
    if partial.is_dir():
        new = {f"{dst.name}/{name}": partial / name for name in files_below(partial)}
    present = _present(dst)
    found = _ruling(dst, present, new, owned, overwrite=overwrite)
    # A recording is complete when its metadata.yaml is there. So this is removed first, and uploaded last. Files are
    # replaced in one step.
    gone = [name for name in (*found.removed, *found.replaced) if "/" in name]
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


def _present(dst: UrlPath) -> dict[str, StoredObject]:
    """Return the files at a destination, by their paths relative to its folder."""
    try:
        if dst.is_dir():
            return {f"{dst.name}/{path.relative_to(dst).as_posix()}": path.known() for path in dst.below()}
        return {dst.name: dst.known()}
    except MissingError:
        return {}


def _ruling(
    dst: UrlPath,
    present: dict[str, StoredObject],
    new: dict[str, Path],
    owned: Record | None,
    *,
    overwrite: bool,
) -> Ruling:
    """Return what happens to the files that are there; raise if that is not permitted."""
    record = owned or Record({})
    # Of an upload that was killed, only the name is known.
    overwrite = overwrite or record.files.get(dst.name, _UNKNOWN) is None
    found = ruling(
        present,
        new,
        record,
        overwrite=overwrite,
        is_unchanged=lambda name, left: left is not None and present[name][:2] == (left.size, left.time),
    )
    if owned is None and any("/" in name for name in present):
        raise stored_folder_error(dst)
    if found.refused or (found.kept and not overwrite and not record.files):
        raise existing_error(dst.parent / (found.refused or found.kept)[0])
    if found.kept:
        raise DestinationError(
            "has something that this batch did not write, or that was changed since, and is not replaced: "
            + name_list(found.kept, 3),
            path=dst,
            hint="move it away, or write to another folder",
        )
    return found
