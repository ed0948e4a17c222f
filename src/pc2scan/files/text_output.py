"""Writes a small file, such as a report, completely or not at all, and never over the user's own files."""

from __future__ import annotations

import functools
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError

from .new_file import NewFile
from .ownership import check_kind
from .places import check_place
from .staging import commit, temporary_path
from .transfers import upload
from .urls import UrlPath

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

#: Characters of a text that are encoded at a time.
_PIECE = 1 << 20


@contextmanager
def text_output(path: Path, *, beginning: bytes, overwrite: bool) -> Iterator[Callable[[str], None]]:
    """Check that a text can be written, and yield the function that writes it; see `file_output`."""
    with _staged_file(path, beginning, overwrite=overwrite) as (put, rename):

        def write(text: str) -> None:
            # Piece by piece: a page is large.
            put(text[start : start + _PIECE].encode("utf-8") for start in range(0, len(text), _PIECE))
            rename()

        yield write


@contextmanager
def file_output(path: Path, *, beginning: bytes | None, overwrite: bool) -> Iterator[Callable[[bytes], None]]:
    """Check that a file can be written, and yield the function that writes it.

    Parameters
    ----------
    path
        The file to write, staged as by `pc2scan.files.staging.staged_output`.
    beginning
        The first bytes of files of this kind. A file that has them, or is empty, may be replaced. None: no file may.
    overwrite
        Whether any other file may be replaced. A symbolic link itself is replaced, not the file that it leads to.

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
    with _staged_file(path, beginning, overwrite=overwrite) as (put, rename):

        def write(data: bytes) -> None:
            put((data,))
            rename()

        yield write


@contextmanager
def files_output(paths: Sequence[Path], *, overwrite: bool) -> Iterator[Callable[[Sequence[bytes]], None]]:
    """Check that several files can be written, and yield the function that writes them; see `file_output`.

    No file gets its final name before all are complete on the disk. Then they get their names in the given order.
    """
    with ExitStack() as stack:
        staged = [stack.enter_context(_staged_file(path, None, overwrite=overwrite)) for path in paths]

        def write(contents: Sequence[bytes]) -> None:
            for (put, _), data in zip(staged, contents, strict=True):
                put((data,))
            for _, rename in staged:
                rename()

        yield write


@contextmanager
def _staged_file(
    path: Path, beginning: bytes | None, *, overwrite: bool
) -> Iterator[tuple[Callable[[Iterable[bytes]], None], Callable[[], object]]]:
    """Yield a function that writes the file under a temporary name, and one that renames it to its final name."""
    with ExitStack() as stack:
        rename: Callable[[], object]
        if isinstance(path, UrlPath):
            check_place(path)
            replaces = _may_replace(path, beginning, overwrite=overwrite)
            partial, rename = stack.enter_context(upload(path, overwrite=replaces))
        else:
            partial = stack.enter_context(temporary_path(path))
            replaces = _may_replace(path, beginning, overwrite=overwrite)
            rename = functools.partial(commit, partial, path, overwrite=replaces)
        try:
            file = NewFile(partial)
        except OSError as err:
            raise _unwritable(path, err) from err

        def put(pieces: Iterable[bytes]) -> None:
            try:
                for data in pieces:
                    file.put(data)
                file.finish()
            except OutputError as err:
                # The error names the final path, which the user knows.
                raise OutputError(err.message, path=path) from err

        try:
            yield put, rename
        finally:
            file.abort()


def check_text_output(path: Path, *, beginning: bytes, overwrite: bool) -> None:
    """Raise what `text_output` would raise at its beginning, without writing anything."""
    check_place(path)
    _may_replace(path, beginning, overwrite=overwrite)


def _may_replace(path: Path, beginning: bytes | None, *, overwrite: bool) -> bool:
    if str(path) == "-":
        raise DestinationError("it is not written to standard output", hint="choose a name: `-` would be a file's name")
    return check_kind(path, beginning, overwrite=overwrite)


def _unwritable(path: Path, err: OSError) -> OutputError:
    return OutputError(f"cannot be written: {err.strerror}", path=path)
