"""What is at a URL: its size and identity, its bytes, and errors in one line."""

from __future__ import annotations

import errno
import secrets
from contextlib import contextmanager, suppress
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

from pc2scan.errors import DestinationError, MissingError, OutputError, Pc2ScanError, RecordingError, UsageError

from .urls import LIBRARIES, shown_url, url_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = ["Place"]

#: What tells one version of an object from another; stores differ in which of these they have.
_VERSION = ("size", "ETag", "etag", "md5Hash", "generation", "mtime", "LastModified", "last_modified", "created")

#: Stores in which an upload is visible before it is complete, unless it gets its name afterwards.
_GRADUAL = ("file", "memory")

_DENIED = 403
_NO_RIGHTS = "check the credentials that the store's own tools use (environment, configuration files), and their rights"
_OTHER_NAME = "choose another name, or remove it with the store's own tools"
_NO_ANSWER = "check the network, the name of the host and, for a store of your own, its endpoint"


class Place:
    """A file or a directory at a URL.

    Parameters
    ----------
    path
        A path for which `is_url` is true.

    Raises
    ------
    UsageError
        If a library is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._url = url_of(path)
        self.scheme = self._url.partition(":")[0]
        #: The URL without secrets.
        self.shown = shown_url(self._url)
        try:
            from fsspec.core import url_to_fs  # noqa: PLC0415  # only an extra
        except ImportError as err:
            raise UsageError(
                "a URL needs the library fsspec, which is not installed",
                path=self.shown,
                hint=f"pip install 'pc2scan[remote]'{f' {self._library}' * bool(self._library)}",
            ) from err
        try:
            with self.reported():
                self._fs, self.key = url_to_fs(self._url)
        except ImportError as err:
            raise UsageError(
                f"{self.scheme}:// needs the library {self._library}, which is not installed",
                path=self.shown,
                hint=f"pip install {self._library}",
            ) from err

    @property
    def _library(self) -> str:
        return LIBRARIES[self.scheme]

    @property
    def name(self) -> str:
        """The last part of the path."""
        return PurePosixPath(self.shown).name

    @property
    def parent(self) -> str:
        """The URL of the folder, without secrets."""
        return self.shown.rstrip("/").rpartition("/")[0]

    @property
    def is_read_only(self) -> bool:
        """Whether nothing can be written there."""
        return self.scheme in {"http", "https"}

    def version(self) -> tuple[str, ...]:
        """Return what changes if the file does."""
        found = self._info(self.key)
        return tuple(str(found.get(name)) for name in _VERSION)

    def _exists(self, key: str) -> bool:
        with self.reported():
            self._fs.invalidate_cache()
            return bool(self._fs.exists(key))

    def _info(self, key: str) -> dict[str, Any]:
        with self.reported():
            self._fs.invalidate_cache()
            found: dict[str, Any] = self._fs.info(key)
        return found

    def files(self) -> dict[str, Place] | None:
        """Return the files of a directory by name; None for a file."""
        if self._info(self.key).get("type") != "directory":
            return None
        with self.reported():
            entries = self._fs.ls(self.key, detail=True)
        held = (entry for entry in entries if entry["type"] == "file")
        names = (str(entry["name"]) for entry in held)
        found = {name.rpartition("/")[2]: self._sibling(name) for name in sorted(names)}
        found.pop("", None)
        return found

    def _sibling(self, key: str) -> Place:
        other: Place = object.__new__(Place)
        other.__dict__.update(self.__dict__, key=key, shown=f"{self.shown.rstrip('/')}/{key.rpartition('/')[2]}")
        return other

    def size(self) -> int:
        """Return how many bytes the file has."""
        size = self._info(self.key).get("size")
        if size is None:
            raise RecordingError(
                "the server does not say how large it is", path=self.shown, hint="download it and name the copy"
            )
        return int(size)

    def bytes_at(self, start: int, stop: int) -> bytes:
        """Read a range, and no more if the server can do that."""
        with self.reported():
            data = bytes(self._fs.cat_file(self.key, start=start, end=stop))
        if len(data) != stop - start:
            raise RecordingError(
                f"the server sent {len(data)} bytes, asked for {stop - start}: it does not serve ranges, or the file "
                "changed",
                path=self.shown,
                hint="download it and name the copy",
            )
        return data

    def download(self, target: Path) -> None:
        """Copy the file; an error if it changes meanwhile, or not all of it arrives."""
        before, size = self.version(), self.size()
        with self.reported():
            self._fs.get_file(self.key, str(target))
        if target.stat().st_size != size or self.version() != before:
            raise self.changed()

    def changed(self) -> RecordingError:
        """Make the error for a source that is not what it was."""
        return RecordingError(
            "was changed while it was read", path=self.shown, hint="wait until the recording is complete, or copy it"
        )

    def upload(self, source: Path, name: str) -> None:
        """Copy a directory into this folder, under a name that nothing has yet; nobody sees a part of it.

        A directory's metadata.yaml is the last file, and what makes it a recording.
        """
        key = f"{self.key.rstrip('/')}/{name}"
        files = sorted(source.iterdir(), key=lambda file: (file.name == "metadata.yaml", file.name))
        self._makedirs(key)
        done: list[str] = []
        try:
            for file in files:
                done.append(f"{key}/{file.name}")
                self._put(file, done[-1])
        except BaseException:
            self.remove(done)
            raise

    def upload_file(self, source: Path, name: str) -> str:
        """Copy a file into this folder, under a name; nobody sees a part of it. Returns its key."""
        key = f"{self.key.rstrip('/')}/{name}"
        self._makedirs(self.key)
        self._put(source, key)
        return key

    def refuse_existing(self, name: str, *, overwrite: bool) -> None:
        """Raise if this folder has something of a name that may not be replaced: a folder never is."""
        key = f"{self.key.rstrip('/')}/{name}"
        shown = f"{self.shown.rstrip('/')}/{name}"
        if not self._exists(key):
            return
        with self.reported():
            is_folder = self._fs.isdir(key)
        if is_folder:
            raise DestinationError("is a folder, and no folder of a store is replaced", path=shown, hint=_OTHER_NAME)
        if not overwrite:
            raise DestinationError("exists already", path=shown, hint="`overwrite=True` replaces it")

    def remove(self, keys: list[str]) -> None:
        """Remove what an upload that failed has left, as far as possible."""
        for key in keys:
            with suppress(Exception):
                self._fs.rm_file(key)

    def _makedirs(self, key: str) -> None:
        if self.scheme in _GRADUAL:
            with self.reported(writes=True):
                self._fs.makedirs(key, exist_ok=True)

    def _put(self, source: Path, key: str) -> None:
        """Copy a file; an object store shows it when it is complete."""
        with self.reported(writes=True):
            if self.scheme not in _GRADUAL:
                self._fs.put_file(str(source), key)
                return
            folder, _, name = key.rpartition("/")
            partial = f"{folder}/.pc2scan-{secrets.token_hex(4)}-{name}"
            try:
                self._fs.put_file(str(source), partial)
                self._fs.mv(partial, key)
            finally:
                with suppress(Exception):
                    self._fs.rm_file(partial)

    @contextmanager
    def reported(self, *, writes: bool = False) -> Iterator[None]:
        """Make the errors of fsspec and the stores' libraries ours: one line, without secrets."""
        kind = OutputError if writes else RecordingError
        try:
            yield
        except (Pc2ScanError, ImportError):
            raise
        except FileNotFoundError as err:
            if writes:
                raise OutputError("there is no such bucket or folder", path=self.shown, hint=_NO_RIGHTS) from err
            hint = "check its spelling; capital letters count, and some stores say this where rights are missing"
            raise MissingError("there is nothing of this name", path=self.shown, hint=hint) from err
        except Exception as err:  # noqa: BLE001  # each store's library has errors of its own
            name = type(err).__name__
            # Their texts may have the URL with its signature: they are not shown.
            if isinstance(err, PermissionError) or getattr(err, "status", 0) == _DENIED or "Credential" in name:
                raise kind("access is refused (403, or no credentials)", path=self.shown, hint=_NO_RIGHTS) from None
            if isinstance(err, OSError) and err.errno == errno.ENOSPC:
                raise kind("no room for its local copy", path=self.shown, hint="`scratch` names another disk") from None
            if "Timeout" in name:
                raise kind(f"the store does not answer in time ({name})", path=self.shown, hint=_NO_ANSWER) from None
            status = getattr(err, "status", None)
            why = f"status {status}" if status else name
            does = "written" if writes else "read"
            raise kind(f"cannot be {does}: {why}", path=self.shown, hint=_NO_ANSWER) from None
