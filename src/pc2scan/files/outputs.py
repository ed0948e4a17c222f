"""Outputs: written under a temporary name and renamed at the end, so whole or absent; and what they may replace.

A file that exists is replaced with ``overwrite``. A folder only if a record in it accounts for every file in it: its
``metadata.yaml``, or `RECORD` of an export. What was edited since and would not be written again
stays, and is named in an error. ``metadata.yaml`` has no sizes, so a file that it names counts as unchanged.

The manifest of a batch has names, sizes and times of modification of each result's files. A result that is as it was
recorded is replaced without ``overwrite``, too; one that was edited since stays, and its recording has failed
(`pc2scan.datasets.planning`).

An input of the run is never replaced, removed or hidden, by any of its names (`refuse_overlap`). A symbolic link is
replaced, never followed.
"""

from __future__ import annotations

import json
import os
import shlex
import stat
import unicodedata
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import DestinationError, OutputError, name_list

from .compression import crc32
from .paths import exists, is_dir
from .system import files_below, lock_descriptor, private_folder, remove, sync_directory
from .urls import UrlPath, upload

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    #: The CRC-32 of the files that earlier runs wrote into a folder, by their paths relative to it, with slashes; None
    #: if only the name is known. Times of modification would differ between two exports of the same messages, and are
    #: lost by copying. CRC-32 recognises an edited file and, unlike SHA-256, takes no time beside writing it. It would
    #: not stop a forger; but whoever can write the record can remove the files, too.
    Record = Mapping[str, int | None]

    #: Reads the record of what is in a folder; text if there is none: the reason.
    FolderRecord = Callable[[Path], Record | str]

#: Endings of the files that SQLite reads beside a database.
_LOGS = ("-wal", "-journal", "-shm")


PARTIAL = ".pc2scan-partial"
OLD = ".pc2scan-old"
LOCK = f"{PARTIAL}.lock"

#: Endings of the files that a killed run leaves beside its destination.
LEFTOVERS = (PARTIAL, OLD)


def working_names(dst: Path) -> tuple[Path, ...]:
    """Return the paths beside a destination that a run creates, renames and removes while it writes it.

    No input may have one of them.
    """
    return tuple(dst.with_name(dst.name + ending) for ending in (PARTIAL, OLD, LOCK)) if dst.name else ()


# --- Writing ---


@contextmanager
def staged_output(
    dst: Path, *, overwrite: bool, record_in: FolderRecord | None = None, beginning: bytes | None = None
) -> Iterator[Path]:
    """Yield a path to write to; what is there at the end gets the name of the destination.

    Parameters
    ----------
    dst
        The file or directory to write. Neither it nor one of its `working_names` may be an input.
    overwrite, record_in, beginning
        What may be replaced: see `check_existing`. What is there stays unchanged until the new one is complete.

    Yields
    ------
    Path
        ``<dst>.pc2scan-partial``, which does not exist; at a URL, a path in a folder of its own. After an error, what
        was written there is removed.

    Raises
    ------
    DestinationError
        If ``dst`` exists and may not be replaced (checked first, and again at the end), has no parent directory, or is
        being written by another run.
    OutputError
        If its directory or the result cannot be written.
    """
    check_place(dst)
    check = partial(check_existing, overwrite=overwrite, record_in=record_in, beginning=beginning)
    if isinstance(dst, UrlPath):
        check(dst)
        with private_folder(dst) as folder:
            local = Path(folder, dst.name)
            yield local
            if local.exists():
                check(UrlPath(dst))
                upload(local, dst)
        return
    unfinished = dst.with_name(dst.name + PARTIAL)
    with only_run(dst):
        # A partial file that exists now was left by a run that died, because a running one would hold the lock.
        _recover(dst)
        check(dst)
        try:
            yield unfinished
            if unfinished.exists():
                _commit(unfinished, dst, check)
        except OutputError as err:
            # The error names the final path: the user knows it, and the temporary one is gone.
            if err.path is not None and Path(err.path).is_relative_to(unfinished):
                err.path = dst / Path(err.path).relative_to(unfinished)
            raise
        finally:
            with suppress(OSError):
                remove(unfinished)


@contextmanager
def files_output(
    paths: Sequence[Path], *, overwrite: bool, beginning: bytes | None = None
) -> Iterator[Callable[[Sequence[str | bytes | Sequence[bytes]]], None]]:
    """Check that small files can be written, and yield the function that writes them; see `staged_output`.

    A file is a text, bytes, or pieces of bytes. No file gets its final name before all are complete. Then they get
    their names in the given order. Without a call of the function there are none.
    """
    with ExitStack() as stack:
        places = [
            stack.enter_context(staged_output(path, overwrite=overwrite, beginning=beginning))
            for path in reversed(paths)
        ]

        def write(contents: Sequence[str | bytes | Sequence[bytes]]) -> None:
            for path, place, content in zip(paths, reversed(places), contents, strict=True):
                whole = content.encode() if isinstance(content, str) else content
                try:
                    with place.open("wb") as file:
                        file.writelines([whole] if isinstance(whole, bytes) else whole)
                except OSError as err:
                    raise OutputError(f"cannot be written: {err.strerror}", path=path) from err

        yield write


def check_destination(
    dst: Path,
    *,
    overwrite: bool,
    record_in: FolderRecord | None = None,
    beginning: bytes | None = None,
    folder: Path | None = None,
) -> None:
    """Raise what `staged_output` would raise at its beginning, as far as that is known without writing anything.

    ``folder`` is the folder of ``dst``, if it will be made; see `output_folder`.
    """
    if folder is not None and not isinstance(dst, UrlPath) and not folder.is_dir():
        check_new_folder(folder)
    else:
        check_place(dst)
        check_existing(dst, overwrite=overwrite, record_in=record_in, beginning=beginning)


def _recover(dst: Path) -> None:
    """Undo or complete what a killed run left; the caller holds the destination's lock."""
    aside = dst.with_name(dst.name + OLD)
    try:
        remove(dst.with_name(dst.name + PARTIAL))
        if os.path.lexists(dst):
            # The new output is in place; only the old one was still to be removed.
            remove(aside)
        elif os.path.lexists(aside):
            aside.rename(dst)
    except OSError as err:
        raise OutputError(f"the files of an interrupted run cannot be removed: {err.strerror}", path=dst) from err


def _commit(unfinished: Path, dst: Path, check: Callable[..., None]) -> None:
    """Rename what is complete at a temporary path to the destination."""
    is_folder = unfinished.is_dir()
    try:
        sync(unfinished)
        # Something may have been added since the beginning.
        check(dst, written=set(files_below(unfinished)) if is_folder else ())
        if os.path.lexists(dst) and (is_folder or (dst.is_dir() and not dst.is_symlink())):
            _exchange(unfinished, dst)
        else:
            unfinished.replace(dst)
        sync_directory(dst.parent)
    except OSError as err:
        raise OutputError(f"cannot be renamed to its final name: {err.strerror}", path=dst) from err


def sync(path: Path) -> None:
    """Wait until a file, or a directory with everything in it, is on the disk."""
    if path.is_dir():
        for entry in path.iterdir():
            sync(entry)
        sync_directory(path)
    else:
        # Not read-only: Windows flushes only files that are open for writing.
        with path.open("rb+") as file:
            os.fsync(file.fileno())


def _exchange(unfinished: Path, dst: Path) -> None:
    """Replace the old output by the new one, where one is a folder; if that fails, restore the old one."""
    aside = dst.with_name(dst.name + OLD)
    dst.rename(aside)
    try:
        unfinished.rename(dst)
    except BaseException:
        # Not if the interruption came after the renaming.
        if not os.path.lexists(dst):
            aside.rename(dst)
        raise
    # The new output must be on the disk before the old one is removed.
    sync_directory(dst.parent)
    remove(aside)


# --- The lock of a run: a destination is written by one run at a time ---


@contextmanager
def only_run(dst: Path) -> Iterator[int]:
    """Hold the lock of a running run; yields its descriptor.

    The kernel releases it when this process and all processes that have inherited the descriptor have ended.
    """
    lock = dst.with_name(dst.name + LOCK)
    try:
        descriptor = _acquire(lock)
    except BlockingIOError as err:
        raise DestinationError("is being written by another run of pc2scan", path=dst) from err
    except OSError as err:
        raise OutputError(f"cannot be written: {err.strerror}", path=dst) from err
    try:
        yield descriptor
    finally:
        # Removed before it is released: a run that locks the removed file notices, in _acquire.
        steps: list[Callable[[], None]] = [lock.unlink, partial(os.close, descriptor)]
        # Windows removes only files that no process has open.
        for step in reversed(steps) if os.name == "nt" else steps:
            with suppress(OSError):
                step()


def _acquire(lock: Path) -> int:
    """Open a lock file and lock it; BlockingIOError if another process has locked it."""
    while True:
        with suppress(FileNotFoundError):
            status = lock.lstat()
            if not stat.S_ISREG(status.st_mode) or status.st_size:
                message = "has the name of the run's lock, but is not one: it is a link, or not empty"
                raise DestinationError(message, path=lock, hint="move it away")
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            lock_descriptor(descriptor)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), lock.lstat()):
                    return descriptor
        except BaseException as err:
            if isinstance(err, OSError) and not isinstance(err, BlockingIOError):
                # Some network file systems cannot lock files. Writing goes on without a lock.
                return descriptor
            os.close(descriptor)
            raise
        # The run that held the lock has removed the file between opening and locking it here.
        os.close(descriptor)


# --- Where a destination can be written ---


def check_place(dst: Path) -> None:
    """Raise if no file with this name can be written."""
    if str(dst) == "-":
        raise DestinationError("it is not written to standard output", hint="choose a name: `-` would be a file's name")
    if isinstance(dst, UrlPath):
        if dst.is_read_only:
            hint = f"give a destination: `destination={dst.name}`"
            raise DestinationError("a web server can only be read", path=dst, hint=hint)
        return
    if dst.name in {"", ".."}:
        raise DestinationError("is not a name that a recording can have", path=dst)
    parent = dst.parent
    if not os.path.lexists(parent):
        hint = f"create it: mkdir -p {shlex.quote(str(parent))}"
        raise DestinationError("its directory does not exist", path=dst, hint=hint)
    if not is_dir(parent):
        raise DestinationError(f"{parent} is not a directory", path=dst)
    # Links there are not replaced either: /dev/stdout is one.
    place = os.path.realpath(parent)
    if place == "/dev" or place.startswith(("/proc/", "/sys/")):
        raise DestinationError(f"{parent} holds devices, not files", path=dst, hint="give a path in another directory")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(
            "its directory is not writable", path=dst, hint="write to another one, or change its permissions"
        )


@contextmanager
def output_folder(folder: Path) -> Iterator[None]:
    """Make a folder to write into, if it does not exist; it is removed again if the body fails and leaves it empty.

    Raises
    ------
    DestinationError
        If it is not a folder, or the folder above it does not exist.
    OutputError
        If it cannot be made.
    """
    # In a store, folders are only a part of names.
    if isinstance(folder, UrlPath) or folder.is_dir():
        yield
        return
    check_new_folder(folder)
    try:
        folder.mkdir()
    except OSError as err:
        raise OutputError(f"cannot be made: {err.strerror}", path=folder) from err
    try:
        yield
    except BaseException:
        with suppress(OSError):
            folder.rmdir()
        raise


def check_new_folder(folder: Path) -> None:
    """Raise if no folder of this name can be made."""
    if os.path.lexists(folder):
        raise DestinationError("is not a folder", path=folder, hint="choose another name")
    check_place(folder)


# --- Records of what was written ---

#: The record in an exported folder.
RECORD = ".pc2scan-files.json"

_PIECE_BYTES = 1 << 20


def write_record(folder: Path) -> None:
    """Write the record of a complete folder into it. Folders with the same files get the same bytes.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    try:
        files = {name: _crc_of(folder / name) for name in sorted(files_below(folder)) if name != RECORD}
        text = json.dumps({"pc2scan files": 2, "files": files}, ensure_ascii=True, indent=0) + "\n"
        with (folder / RECORD).open("x", encoding="ascii") as file:
            file.write(text)
    except OSError as err:
        raise OutputError(f"its record cannot be written: {err.strerror}", path=folder) from err


def read_record(folder: Path) -> Record | str:
    """Return the record in a folder; text if there is none that can be read: the reason."""
    try:
        path = folder / RECORD
        noted = json.loads(path.read_bytes() if stat.S_ISREG(path.lstat().st_mode) else b"")
        files: dict[str, int | None] = {str(name): int(crc) for name, crc in noted["files"].items()}
    except FileNotFoundError:
        return f"it has no {RECORD}, which lists what an export wrote"
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return f"its {RECORD} cannot be read as a record of pc2scan"
    return {**files, RECORD: None}


def _is_unchanged(path: Path, crc: int | None) -> bool:
    """Return whether a file is as it was left, as far as that is recorded."""
    try:
        mode = path.lstat().st_mode
        if crc is None:
            return stat.S_ISREG(mode) or stat.S_ISLNK(mode)
        return stat.S_ISREG(mode) and _crc_of(path) == crc
    except OSError:
        return False


def _crc_of(path: Path) -> int:
    value = 0
    with path.open("rb") as file:
        while piece := file.read(_PIECE_BYTES):
            value = crc32(piece, value)
    return value


# --- What may be replaced ---


def check_existing(
    dst: Path,
    *,
    overwrite: bool,
    record_in: FolderRecord | None = None,
    beginning: bytes | None = None,
    written: Collection[str] | None = None,
) -> None:
    """Raise if there is something at a destination that this run may not replace.

    Parameters
    ----------
    dst
        The destination.
    overwrite
        Whether anything may be replaced. A symbolic link itself is replaced, not the file that it leads to.
    record_in
        Reads the record of what is in a folder. Without it no folder is replaced.
    beginning
        The first bytes of files of this kind. One that has them, or is empty, is replaced in any case. None: no file.
    written
        The paths in the folder that the run writes; None while they are unknown. Then only the names are checked.

    Raises
    ------
    DestinationError
        If it exists and may not be replaced: it is neither a file nor a folder, or a folder with anything that no
        record names, or that was changed and is not written by this run.
    """
    if not exists(dst):
        return
    is_folder = is_dir(dst) and not dst.is_symlink()
    if is_folder and (record_in is None or isinstance(dst, UrlPath)):
        raise DestinationError("cannot be written: it is a directory", path=dst, hint="choose another name")
    if not overwrite and (beginning is None or not _begins_with(dst, beginning)):
        # Only kinds of files with a known beginning can be recognised as written by pc2scan.
        other = "" if beginning is None else ", and was not written by pc2scan"
        raise DestinationError(f"exists already{other}", path=dst, hint="`overwrite=True` replaces it")
    if is_folder and record_in is not None:
        _refuse_others(dst, record_in(dst), written)
    elif not isinstance(dst, UrlPath) and dst.exists() and not dst.is_file():
        # A link itself is replaced, not its target; but a link to a device means the device.
        raise DestinationError("is neither a file nor a directory, and cannot be overwritten", path=dst)


def _begins_with(path: Path, beginning: bytes) -> bool:
    """Return whether a file has this beginning, or is empty."""
    with suppress(OSError):
        if not isinstance(path, UrlPath) and stat.S_ISREG(path.lstat().st_mode):
            with path.open("rb") as file:
                return file.read(len(beginning)) in (beginning, b"")
    return False


def _refuse_others(folder: Path, record: Record | str, written: Collection[str] | None) -> None:
    """Raise if a folder has anything that its record does not account for."""
    known: Record = {} if isinstance(record, str) else record
    if others := [
        name
        for name in sorted(files_below(folder))
        if name not in known
        or (written is not None and name not in written and not _is_unchanged(folder / name, known[name]))
    ]:
        why = record if isinstance(record, str) else "no record names it, or it was changed since"
        message = f"is a directory, and is not overwritten, because of {name_list(others, 3)}: {why}"
        raise DestinationError(message, path=folder, hint="choose another name, or move it away")


# --- Inputs ---


class InputPath(NamedTuple):
    """A file or folder of a run, and its role: ``source``, the option that names it, or ``destination``."""

    path: Path
    role: str = "source"


def inputs_of(
    sources: Iterable[Path], tf_from: Iterable[Path] = (), files: Mapping[str, Path] | None = None
) -> list[InputPath]:
    """Return the inputs of a run: its sources, recordings of transforms, and the files of options, by option."""
    named = [*(("`tf_from`", path) for path in tf_from), *(files or {}).items()]
    return [*map(InputPath, sources), *(InputPath(path, f"file of {option}") for option, path in named)]


def refuse_overlap(inputs: Iterable[InputPath], destinations: Iterable[Path]) -> None:
    """Raise if an output of a run is one of its inputs, or another output.

    Files and folders are compared by device and inode, through hard links, symbolic links, links to folders, and names
    that a file system does not distinguish. An output includes the names that it has while it is written; a folder
    includes its entries; a file includes the logs that SQLite reads beside a database.

    Parameters
    ----------
    inputs
        The inputs; they need not exist.
    destinations
        What the run writes.

    Raises
    ------
    DestinationError
        If an output is an input, is inside one, or contains one, or if this is true of two outputs.
    """
    used = Inputs(inputs)
    for path in destinations:
        used.refuse(path)
        used.add_destination(path)


class Inputs:
    """All paths of the inputs, by name and by device and inode, and the folders above them.

    Parameters
    ----------
    inputs
        The inputs; they need not exist.
    """

    def __init__(self, inputs: Iterable[InputPath]) -> None:
        self._files: dict[FileId, InputPath] = {}
        self._folders: dict[FileId, InputPath] = {}
        for given in inputs:
            entries: list[Path] = []
            with suppress(OSError):
                entries = [] if isinstance(given.path, UrlPath) else list(given.path.iterdir())
            for place in (place for path in (given.path, *entries) for place in path_identities(path)):
                # SQLite reads logs beside a database, if they are files; also one that does not exist yet.
                logs = (Path(f"{place}{suffix}") for suffix in _LOGS)
                for name in (place, *(log for log in logs if not os.path.isdir(log))):  # noqa: PTH112  # faster
                    for file_id in file_ids(name):
                        self._files.setdefault(file_id, given)
                for folder in place.parents:
                    if folder in self._folders:
                        break
                    for file_id in file_ids(folder):
                        self._folders.setdefault(file_id, given)

    def add_destination(self, path: Path) -> None:
        """Add a path that the run writes, on file systems that ignore case, too."""
        given = InputPath(path, "destination")
        for name in (path, *working_names(path)):
            place = next(path_identities(name))
            self._files.setdefault(name_key(place.as_posix()), given)
            for folder in place.parents:
                self._folders.setdefault(name_key(folder.as_posix()), given)

    def refuse(self, output: Path) -> None:
        """Raise if an output, or a name that it has while it is written, is an input, is inside one or contains one.

        Raises
        ------
        DestinationError
            If it does; the message says how the two are related.
        """
        for path in (output, *working_names(output)):
            places = list(path_identities(path))
            above = [folder for place in places for folder in place.parents]
            relations = [
                ("is", self._files, places),
                ("contains", self._folders, places),
                ("is inside", self._files, above),
            ]
            for relation, known, paths in relations:
                keys = (key for path in paths for key in (*file_ids(path), name_key(path.as_posix())))
                used = next((known[key] for key in keys if key in known), None)
                if used is None:
                    continue
                what = f"{'the' if used.role == 'destination' else 'a'} {used.role}"
                if path != output:
                    # What a killed run left may be a source.
                    message = f"needs the name {path.name} while it is written, which is {what}"
                    raise DestinationError(message, path=output, hint=f"choose another name, or rename the {used.role}")
                what = what if relation == "is" else f"the {used.role} {used.path}"
                raise DestinationError(f"{relation} {what}", path=path, hint="choose another name")


#: Device and inode; or a path: a URL, or one of this name; or the `name_key` of a path.
FileId = tuple[int, int] | Path | str

#: Links that lead to links: the system follows at most this many.
_MAX_LINKS = 40


def path_identities(path: Path) -> Iterator[Path]:
    """Return a path without links in its folders, and if it is a symbolic link each path that it leads to."""
    if isinstance(path, UrlPath):
        yield path
        return
    for _ in range(_MAX_LINKS):
        has_name = path.name not in {"", ".."}
        path = Path(os.path.realpath(path.parent), path.name) if has_name else Path(os.path.realpath(path))
        yield path
        try:
            path = path.parent / path.readlink()
        except OSError:
            return


def file_ids(path: Path) -> set[FileId]:
    """Return a path, and device and inode if it exists; for a symbolic link, its own and its target's."""
    ids: set[FileId] = {path}
    with suppress(OSError):
        status = path.lstat()
        ids.add((status.st_dev, status.st_ino))
        if stat.S_ISLNK(status.st_mode):
            status = path.stat()
            ids.add((status.st_dev, status.st_ino))
    return ids


def name_key(name: str) -> str:
    """Return a key that is equal for names that may be one on a file system that ignores case or Unicode's forms."""
    return unicodedata.normalize("NFC", name).casefold()
