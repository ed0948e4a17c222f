"""Writes a small file, such as a report, completely or not at all, and never over the user's own files."""

from __future__ import annotations

import stat
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError

from .staging import check_destination, staged
from .urls import UrlPath, exists, is_dir

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path


@contextmanager
def file_output(
    path: Path, *, overwrite: bool, beginning: bytes | None = None
) -> Iterator[Callable[[str | bytes], None]]:
    """Check that a file can be written, and yield the function that writes it.

    Parameters
    ----------
    path
        The file to write, staged as by `pc2scan.files.staging.staged`.
    overwrite
        Whether any other file may be replaced. A symbolic link itself is replaced, not the file that it leads to.
    beginning
        The first bytes of files of this kind. A file that has them, or is empty, may be replaced. None: no file may.

    Yields
    ------
    function
        Writes the file; called at most once. Without the call there is no file.

    Raises
    ------
    DestinationError
        If another file, or something else, has this path.
    OutputError
        If it cannot be written; by the function too.
    """
    with files_output([path], overwrite=overwrite, beginning=beginning) as write:
        yield lambda content: write([content])


@contextmanager
def files_output(
    paths: Sequence[Path], *, overwrite: bool, beginning: bytes | None = None
) -> Iterator[Callable[[Sequence[str | bytes]], None]]:
    """Check that several files can be written, and yield the function that writes them; see `file_output`.

    No file gets its final name before all are complete on the disk. Then they get their names in the given order.
    """
    with ExitStack() as stack:
        permissions = [_may_replace(path, beginning, overwrite=overwrite) for path in paths]
        outputs = [
            stack.enter_context(staged(path, overwrite=may)) for path, may in zip(paths, permissions, strict=True)
        ]

        def write(contents: Sequence[str | bytes]) -> None:
            for path, (partial, _), content in zip(paths, outputs, contents, strict=True):
                try:
                    partial.write_bytes(content.encode() if isinstance(content, str) else content)
                except OSError as err:
                    # The error names the final path, which the user knows.
                    raise OutputError(f"cannot be written: {err.strerror}", path=path) from err
            for _, finish in outputs:
                finish()

        yield write


def check_file_output(path: Path, *, overwrite: bool, beginning: bytes | None = None) -> None:
    """Raise what `file_output` would raise at its beginning, without writing anything."""
    check_destination(path, overwrite=_may_replace(path, beginning, overwrite=overwrite))


def _may_replace(path: Path, beginning: bytes | None, *, overwrite: bool) -> bool:
    """Return whether what has this path, if anything, is a file that may be replaced; raise if it is something else."""
    if str(path) == "-":
        raise DestinationError("it is not written to standard output", hint="choose a name: `-` would be a file's name")
    if not exists(path):
        return overwrite
    if is_dir(path) and not path.is_symlink():
        raise DestinationError("cannot be written: it is a directory", path=path, hint="choose another name")
    if not overwrite and not _is_of_kind(path, beginning):
        # Only kinds of files with a known beginning can be recognised as written by pc2scan.
        raise DestinationError(
            "exists already" if beginning is None else "exists already, and was not written by pc2scan",
            path=path,
            hint="choose another name; or `overwrite=True` replaces it",
        )
    return True


def _is_of_kind(path: Path, beginning: bytes | None) -> bool:
    """Return whether a file has this beginning, or is empty."""
    length = len(beginning or b" ")
    try:
        if isinstance(path, UrlPath) or not stat.S_ISREG(path.lstat().st_mode):
            return False
        with path.open("rb") as file:
            return file.read(length) in (beginning, b"")
    except OSError as err:
        raise OutputError(f"cannot be written: {err.strerror}", path=path) from err
