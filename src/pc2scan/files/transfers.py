"""Fetches sources at URLs into local copies, and uploads results when they are complete.

The rule of ownership is that of `pc2scan.files.ownership`; versions of objects stand for times of modification.
"""

from __future__ import annotations

import shutil
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, RecordingError, name_list
from pc2scan.text import size

from .ownership import check_existing
from .places import private_folder
from .records import files_below
from .store import NO_SPACE
from .system import scratch
from .urls import CopyPath, UrlPath

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from .ownership import Permission


@contextmanager
def fetched(paths: Iterable[Path]) -> Iterator[list[Path]]:
    """Fetch what is at URLs, and yield the paths with local copies in place of URLs, which are removed at the end.

    Raises
    ------
    MissingError
        If nothing is at a URL.
    RecordingError
        If it cannot be fetched, or there is no room: the sizes of all are counted before the first is fetched.
    """
    paths = list(paths)
    sources = {path: _files_of(path) for path in paths if isinstance(path, UrlPath)}
    for first in sources:
        refuse_without_room(sum(file.known().size for files in sources.values() for file in files), first)
        break
    with ExitStack() as stack:
        copies: dict[Path, Path] = {}
        for path, files in sources.items():
            folder = stack.enter_context(private_folder(path))
            copies[path] = copy = CopyPath.of(path, folder)
            place = Path(folder)
            if path.is_dir():
                place /= copy.name
                place.mkdir()
            for file in files:
                file.remote.download(place / file.name, file.known().size)
        yield [copies.get(path, path) for path in paths]


def _files_of(path: UrlPath) -> list[UrlPath]:
    """Return the files in a folder, or a file with the logs beside a database."""
    path.entry = path.remote.entry()
    if path.entry.is_folder:
        return [file for file in path.iterdir() if file.is_file()]
    logs = [path.with_name(path.name + suffix) for suffix in ("-wal", "-journal") if path.suffix == ".db3"]
    return [path, *(log for log in logs if not path.is_read_only and log.exists())]


def refuse_without_room(needed: int, path: Path, hint: str = "") -> None:
    """Raise if so many bytes have no room in the folder for local copies."""
    folder = scratch.get() or Path(tempfile.gettempdir())
    # If there is no such folder, making the copy raises.
    with suppress(OSError):
        if needed > (free := shutil.disk_usage(folder).free):
            message = f"no space for local copies: {size(needed)} are fetched, and {folder} has room for {size(free)}"
            raise RecordingError(message, path=path, hint=hint or NO_SPACE)


@contextmanager
def upload(dst: UrlPath, may: Permission) -> Iterator[tuple[Path, Callable[[], None]]]:
    """Yield a local path to write to, and the function that uploads what is there.

    Raises
    ------
    DestinationError
        If something is there that may not be replaced.
    OutputError
        If it cannot be written.
    """
    with private_folder(dst) as folder:
        partial = Path(folder, dst.name)
        yield partial, lambda: _commit(partial, dst, may)


def _commit(partial: Path, dst: UrlPath, may: Permission) -> None:
    """Remove what the output replaces, and upload it."""
    new: dict[str, Path] = {dst.name: partial}
    if partial.is_dir():
        new = {f"{dst.name}/{name}": partial / name for name in files_below(partial)}
    check_existing(dst, may)
    below = [f"{dst.name}/{path.relative_to(dst).as_posix()}" for path in dst.below()]
    present = below or [dst.name] * dst.exists()
    if kept := [name for name in present if name not in new and name not in (may.owned or ())]:
        raise DestinationError(
            f"has something that this batch did not write, and is not replaced: {name_list(kept, 3)}",
            path=dst,
            hint="move it away, or write to another folder",
        )
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
