"""A destination appears whole or not at all: written beside its place, then renamed into it."""

from __future__ import annotations

import os
import shutil
import stat
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

__all__ = ["staged", "sync_directory", "sync_file"]

_PARTIAL = ".pc2scan-partial"
_OLD = ".pc2scan-old"

#: What a directory may hold to be taken for a recording that --overwrite may replace.
_RECORDING_SUFFIXES = (".mcap", ".db3", ".zstd", ".zst", ".db3-wal", ".db3-shm", ".db3-journal")


@contextmanager
def staged(dst: Path, *, overwrite: bool, sources: Sequence[Path] = ()) -> Iterator[Path]:
    """Give a path to write to, and make it the destination at the end.

    Parameters
    ----------
    dst
        The file or directory that is to appear.
    overwrite
        Whether a file or a recording's directory that is there may be replaced. It stays untouched until the
        new one is complete.
    sources
        What is being read, and must neither be replaced nor contain the destination.

    Yields
    ------
    Path
        ``<dst>.pc2scan-partial``, where nothing is. The body creates a file or a directory there. If it
        raises anything, that is removed and the error goes on.

    Raises
    ------
    DestinationError
        If ``dst`` exists and ``overwrite`` is false (checked first, and again by the final step), is a source
        or lies in one, cannot be replaced, has no parent directory, or is being written by another run.
    OutputError
        If its directory or the result cannot be written.
    """
    _check_parent(dst)
    _check_sources(dst, sources)
    partial = dst.with_name(dst.name + _PARTIAL)
    with _only_run(partial, dst):
        # What is here now was left by a run that died: a living one holds the lock.
        try:
            _remove(partial)
            _restore(dst)
        except OSError as err:
            raise OutputError(f"what an interrupted run left cannot be removed: {err.strerror}", path=dst) from err
        _check_existing(dst, overwrite=overwrite)
        try:
            yield partial
            _commit(partial, dst, overwrite=overwrite)
        finally:
            with suppress(OSError):
                _remove(partial)


def sync_file(path: Path) -> None:
    """Wait until a file's content is on the disk."""
    # Not read-only: Windows flushes only what it may write.
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def sync_directory(path: Path) -> None:
    """Wait until a directory's entries are on the disk, where the system can do so."""
    if os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _check_parent(dst: Path) -> None:
    if dst.name in {"", ".."}:
        raise DestinationError("is not a name that a recording can have", path=dst)
    parent = dst.parent
    if not parent.exists():
        raise DestinationError("its directory does not exist", path=dst, hint=f"create it: mkdir -p {parent}")
    if not parent.is_dir():
        raise DestinationError(f"{parent} is not a directory", path=dst)
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError("its directory is not writable", path=dst)


def _check_sources(dst: Path, sources: Sequence[Path]) -> None:
    target = dst.resolve()
    for source in sources:
        origin = source.resolve()
        if target == origin or (dst.exists() and source.exists() and dst.samefile(source)):
            raise DestinationError("is a source", path=dst, hint="sources are never changed; choose another name")
        if target.is_relative_to(origin):
            raise DestinationError(f"lies inside the source {source}", path=dst, hint="choose a place outside")
        if origin.is_relative_to(target):
            raise DestinationError(f"contains the source {source}", path=dst, hint="choose another name")


def _restore(dst: Path) -> None:
    """Undo or complete the replacing of a directory, if a run died between its two steps."""
    aside = dst.with_name(dst.name + _OLD)
    if os.path.lexists(dst):
        # The new one was in its place; all that was left was to remove the old.
        _remove(aside)
    elif os.path.lexists(aside):
        aside.rename(dst)


def _check_existing(dst: Path, *, overwrite: bool) -> None:
    if not os.path.lexists(dst):
        return
    if not overwrite:
        raise _exists(dst)
    if dst.is_symlink() or dst.is_file():
        return
    if not dst.is_dir():
        raise DestinationError("is neither a file nor a directory, and cannot be overwritten", path=dst)
    foreign = next((entry for entry in sorted(dst.iterdir()) if not _belongs_to_recording(entry)), None)
    if foreign is not None:
        raise DestinationError(
            f"is a directory that holds more than a recording ({foreign.name}), and is not overwritten",
            path=dst,
            hint="choose another name, or delete it yourself",
        )


def _belongs_to_recording(entry: Path) -> bool:
    return entry.is_file() and (entry.name == "metadata.yaml" or entry.name.endswith(_RECORDING_SUFFIXES))


def _exists(dst: Path) -> DestinationError:
    return DestinationError("exists already", path=dst, hint="--overwrite replaces it")


@contextmanager
def _only_run(partial: Path, dst: Path) -> Iterator[None]:
    """Hold the lock that tells a living run from a dead one; the kernel releases it when the process ends."""
    lock = partial.with_name(partial.name + ".lock")
    try:
        descriptor = _locked(lock)
    except BlockingIOError as err:
        raise DestinationError("is being written by another run of pc2scan", path=dst) from err
    except OSError as err:
        raise OutputError(f"cannot be written: {err.strerror}", path=dst) from err
    try:
        yield
    finally:
        # Removed before it is released: who gets the lock on a removed file notices, in _locked.
        with suppress(OSError):
            lock.unlink()
        with suppress(OSError):
            os.close(descriptor)


def _locked(lock: Path) -> int:
    """Open a lock file and lock it; BlockingIOError if another process has."""
    try:
        import fcntl  # noqa: PLC0415  (not on Windows)
    except ImportError:
        return os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise
            except OSError:
                # Some network file systems cannot lock. That is no reason not to write there.
                return descriptor
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), lock.stat()):
                    return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        # The run that held it ended, and removed it, between our opening and our locking it.
        os.close(descriptor)


def _commit(partial: Path, dst: Path, *, overwrite: bool) -> None:
    try:
        _sync(partial)
        if overwrite and os.path.lexists(dst):
            _replace(partial, dst)
        elif partial.is_dir():
            _rename_directory(partial, dst)
        else:
            _rename_file(partial, dst)
        sync_directory(dst.parent)
    except OSError as err:
        raise OutputError(f"cannot be put in its place: {err.strerror}", path=dst) from err


def _sync(path: Path) -> None:
    if not path.is_dir():
        sync_file(path)
        return
    for entry in path.iterdir():
        _sync(entry)
    sync_directory(path)


def _rename_file(partial: Path, dst: Path) -> None:
    """Rename, but never over what appeared meanwhile: a link, unlike a rename, refuses to."""
    try:
        os.link(partial, dst)
    except FileExistsError as err:
        raise _exists(dst) from err
    except OSError:
        # FAT, and some network file systems, have no links.
        if os.path.lexists(dst):
            raise _exists(dst) from None
        partial.replace(dst)
    else:
        partial.unlink()


def _rename_directory(partial: Path, dst: Path) -> None:
    """Rename; the system itself refuses unless the name is free or that of an empty directory."""
    if os.path.lexists(dst):
        raise _exists(dst)
    try:
        partial.rename(dst)
    except OSError as err:
        if os.path.lexists(dst):
            raise _exists(dst) from err
        raise


def _replace(partial: Path, dst: Path) -> None:
    """Put the new in the place of the old, which comes back if that fails."""
    if not partial.is_dir() and (dst.is_symlink() or not dst.is_dir()):
        partial.replace(dst)
        return
    aside = dst.with_name(dst.name + _OLD)
    dst.rename(aside)
    try:
        partial.rename(dst)
    except BaseException:
        if not os.path.lexists(dst):
            aside.rename(dst)
        raise
    # The new one is on the disk before the old one goes.
    sync_directory(dst.parent)
    _remove(aside)


def _remove(path: Path) -> None:
    """Delete a file or a directory, if it is there; of a symbolic link only the link."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        shutil.rmtree(path)
    else:
        path.unlink()
