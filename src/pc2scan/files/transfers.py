"""Fetches sources at URLs into local copies, and uploads results when they are complete."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.errors import RecordingError
from pc2scan.text import size

from .ownership import files_below
from .places import private_folder
from .store import NO_SPACE
from .system import scratch
from .urls import CopyPath, UrlPath

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


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
    refuse_without_room(sum(file.entry.size for files in sources.values() for file in files), next(iter(sources), None))
    with ExitStack() as stack:
        copies: dict[Path, Path] = {}
        for path, files in sources.items():
            place = Path(stack.enter_context(private_folder(path)))
            copies[path] = CopyPath.of(path, str(place))
            if path.entry.is_folder:
                place /= path.name
                place.mkdir()
            for file in files:
                file.download(place / file.name)
        yield [copies.get(path, path) for path in paths]


def _files_of(path: UrlPath) -> list[UrlPath]:
    """Return the files in a folder, or a file with the logs beside a database."""
    if path.entry.is_folder:
        return [file for file in path.iterdir() if file.is_file()]
    logs = [path.with_name(path.name + suffix) for suffix in ("-wal", "-journal") if path.suffix == ".db3"]
    return [path, *(log for log in logs if not path.is_read_only and log.exists())]


def refuse_without_room(needed: int, path: Path | None, hint: str = NO_SPACE) -> None:
    """Raise if so many bytes have no room in the folder for local copies."""
    folder = scratch.get() or Path(tempfile.gettempdir())
    # If there is no such folder, making the copy raises.
    with suppress(OSError):
        if needed > (free := shutil.disk_usage(folder).free):
            message = f"no space for local copies: {size(needed)} are fetched, and {folder} has room for {size(free)}"
            raise RecordingError(message, path=path, hint=hint)


def upload(local: Path, dst: UrlPath) -> None:
    """Upload a complete file or folder.

    Raises
    ------
    OutputError
        If it cannot be written. What was uploaded of a folder is removed.
    """
    if not local.is_dir():
        dst.upload(local)
        return
    begun: list[UrlPath] = []
    try:
        # A recording is complete when its metadata.yaml is there.
        for name in sorted(files_below(local), key=lambda name: name.endswith("metadata.yaml")):
            begun.append(dst / name)
            begun[-1].upload(local / name)
    except BaseException:
        for place in begun:
            with suppress(Exception):
                place.delete()
        raise
