"""Sources and destinations of a batch at URLs: local stand-ins of the sources, and the folder of the results.

A local tree of files stands in for what is at URLs: ``s3://drives/a.bag`` is ``<folder>/s3/drives/a.bag``. Recordings
are found in it, and plans are made for it. Only bytes that are read are fetched. The folder of the results has a copy
in the tree, too, with the manifest.
"""

from __future__ import annotations

import json
import os
import socket
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePosixPath
from secrets import token_hex
from threading import Event, Thread
from typing import TYPE_CHECKING

from pc2scan.arguments import local_path
from pc2scan.errors import DestinationError, Pc2ScanError, RecordingError, UsageError
from pc2scan.files.places import parts_among
from pc2scan.files.source import on_demand
from pc2scan.remote.urls import UrlNames, is_url, shown_url, url_of

from .folder import UNFINISHED, is_numbered, unnumbered_name
from .identity import Identity, versions
from .manifest import MANIFEST

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from pc2scan.remote.store import RemotePath, StoredObject

_GLOB = frozenset("*?[")

#: The lock of a folder in a store.
_LOCK = ".pc2scan-lock"

#: Seconds between two signs of life of the run that holds the lock, and after how many without one it counts as dead.
_ALIVE_SECONDS = 20.0
_DEAD_SECONDS = 70.0

#: Seconds between two uploads of the manifest, at least.
_PUSH_SECONDS = 10.0


class Stores:
    """The local tree that stands in for what is at URLs.

    Parameters
    ----------
    scratch
        The folder for local copies; None: the system's folder for temporary files.

    Attributes
    ----------
    names
        Replaces paths in the tree by URLs in texts for users.
    """

    def __init__(self, scratch: Path | None) -> None:
        self._scratch = scratch
        self._stack = ExitStack()
        self._tree: Path | None = None
        #: URLs by their paths in the tree, including secrets such as signatures.
        self._urls: dict[Path, str] = {}
        self._made: list[Path] = []
        self._out: Path | None = None
        self.names = UrlNames()

    @property
    def are_used(self) -> bool:
        """Whether anything is at a URL."""
        return self._tree is not None

    def close(self) -> None:
        """Remove the tree."""
        self.forget()
        self._stack.close()

    def located(self, text: str) -> str:
        """Return the local path of a source; for a URL, make stand-ins of what is there.

        Raises
        ------
        MissingError, RecordingError
            If nothing is there, or it cannot be listed.
        """
        return self._listed(url_of(Path(text))) if is_url(Path(text)) else local_path(text)

    def beside(self, path: Path, name: str) -> str:
        """Resolve a path that a list of paths contains; if the list is at a URL, the result is a URL, too."""
        name = local_path(name)
        if is_url(Path(name)) or not self.is_remote(path):
            return name if is_url(Path(name)) else str(path.parent / name)
        return f"{self.url_of(path).partition('?')[0].rpartition('/')[0]}/{name}"

    def url_of(self, path: Path) -> str:
        """Return the URL of a path in the tree, secrets included; another path is made absolute."""
        absolute = Path(os.path.abspath(path))  # noqa: PTH100  # links keep their names
        for folder in (absolute, *absolute.parents):
            if url := self._urls.get(folder):
                below = absolute.relative_to(folder).as_posix()
                return url if below == "." else f"{url.rstrip('/')}/{below}"
        return str(absolute)

    def shown(self, path: Path) -> str:
        """Return the URL of a path in the tree without secrets; another path is made absolute."""
        url = self.url_of(path)
        return shown_url(url) if is_url(Path(url)) else url

    def is_remote(self, path: Path) -> bool:
        """Return whether a path is in the tree."""
        return self._tree is not None and path.is_relative_to(self._tree)

    def complete(self, path: Path) -> None:
        """Fetch files that must be complete before a recording can be opened, such as databases."""
        if self._tree is not None:
            from pc2scan.remote.ranges import fetch_whole  # noqa: PLC0415  # loads fsspec

            fetch_whole(path)

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Replace paths in the tree by URLs in errors that the body raises."""
        try:
            yield
        except Pc2ScanError as err:
            self.names.error(err)
            raise

    def forget(self) -> None:
        """Remove the stand-ins. They are not needed after the recordings are found."""
        for path in self._made:
            on_demand.pop(path, None)
            versions.pop(str(path), None)
            path.unlink(missing_ok=True)
        self._made.clear()

    def output(self, url: str) -> StoreFolder:
        """Return the folder of the results at a URL."""
        from pc2scan.remote.store import RemotePath  # noqa: PLC0415  # loads fsspec

        place = RemotePath(Path(url))
        if place.is_read_only:
            raise DestinationError(f"{place.scheme}:// can only be read", path=place.shown)
        self._out = self._path_of(place, url)
        self._out.mkdir(parents=True, exist_ok=True)
        return StoreFolder(place, self._out)

    def folder(self) -> Path:
        """Return a folder for local copies."""
        if self._tree is None:
            from pc2scan.remote.scratch import scratch_folder  # noqa: PLC0415  # few batches have URLs

            self._tree = self._stack.enter_context(scratch_folder(self._scratch)) / "tree"
        return self._tree.parent

    def _path_of(self, place: RemotePath, url: str) -> Path:
        """Return the path in the tree for a URL, and note the URL."""
        # Not by urllib: a key in a store may have ? and # in it.
        scheme, _, rest = place.shown.partition("://")
        host, _, name = rest.partition("/")
        root = self.folder() / "tree" / scheme / (host or "_")
        self.names.add(root, f"{scheme}://{host}")
        path = Path(os.path.normpath(root / name.strip("/")))
        self._urls[path] = url
        return path

    def _listed(self, url: str) -> str:
        """Make stand-ins of everything that a source may refer to."""
        from pc2scan.remote.store import RemotePath  # noqa: PLC0415  # loads fsspec

        base, pattern = url, ""
        if not url.startswith("http") and _GLOB & set(url):
            cut = url.rindex("/", 0, min(url.index(sign) for sign in _GLOB if sign in url))
            base, pattern = url[:cut], url[cut:]
        place = RemotePath(Path(base))
        path = self._path_of(place, base)
        if path == self._out or (self._out is not None and path.is_relative_to(self._out)):
            # `find` refuses it.
            return str(path) + pattern
        objects = {} if place.is_read_only else place.below()
        if objects:
            for below, found in objects.items():
                parts = below.split("/")
                # Not hidden names, and not `.` or `..`, which would lead elsewhere.
                if all(parts) and not any(part.startswith(".") for part in parts):
                    self._stand_in(place.child(below), path / below, found)
        elif not pattern:
            self._stand_in(place, path, place.stat())
        return str(path) + pattern

    def _stand_in(self, place: RemotePath, path: Path, found: StoredObject) -> None:
        from pc2scan.remote.ranges import add_stand_in  # noqa: PLC0415  # loads fsspec

        if path in on_demand or (self._out is not None and path.is_relative_to(self._out)):
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.is_dir():
                raise FileExistsError
            versions[str(path)] = found.version
            self._made.append(path)
            add_stand_in(place, path, found.size)
        except (FileExistsError, NotADirectoryError) as err:
            raise RecordingError(
                "is both a file and a folder with files", path=place.shown, hint="give the folders below it as sources"
            ) from err
        except OSError as err:
            raise UsageError(f"`scratch`: {self._scratch or 'the folder'} cannot be written: {err.strerror}") from err


class StoreFolder:
    """The folder of the results in a store.

    The manifest and the note of outputs that are being written are local files. They are uploaded from time to time
    while recordings are converted, and at the end.

    Attributes
    ----------
    folder
        The local folder with these files.
    """

    def __init__(self, place: RemotePath, folder: Path) -> None:
        self._place = place
        self.folder = folder
        self._objects: dict[str, StoredObject] | None = None
        self._pushed: dict[str, bytes] = {}
        self._next = 0.0
        self._lost = Event()

    def pull(self) -> None:
        """Fetch the files of the last run."""
        for name in (MANIFEST, UNFINISHED):
            data = self._place.child(name).read()
            if data is not None:
                self._pushed[name] = data
                (self.folder / name).write_bytes(data)

    def present(self, output: str, left: Identity | None = None) -> Identity:
        """Return the identity that an output had when the folder was listed first; ``left``: see `identity_in`."""
        if self._objects is None:
            self._objects = self._place.below()
        return identity_in(self._objects, output, left)

    def existing(self, outputs: Iterable[str]) -> set[str]:
        """Return those outputs that exist now."""
        objects = self._place.below()
        names = {str(parent) for key in objects for parent in (key, *PurePosixPath(key).parents)}
        return {each for each in outputs if each in names or (is_numbered(each) and identity_in(objects, each).files)}

    def push(self, *, at_once: bool = False) -> None:
        """Upload the files that have changed, if the last upload is long enough ago.

        Raises
        ------
        DestinationError
            If another run has taken over the folder.
        OutputError
            If they cannot be written.
        """
        if self._lost.is_set():
            raise DestinationError(
                "another batch has taken over this folder, because this run gave no sign of life for a while",
                path=self._place.shown,
            )
        began = time.monotonic()
        if began < self._next and not at_once:
            return
        for name in (UNFINISHED, MANIFEST):
            place, path = self._place.child(name), self.folder / name
            data = path.read_bytes() if path.exists() else None
            if data is None and name in self._pushed:
                place.delete()
                del self._pushed[name]
            elif data is not None and data != self._pushed.get(name):
                place.write(data)
                self._pushed[name] = data
        self._next = time.monotonic() + max(_PUSH_SECONDS, 10 * (time.monotonic() - began))

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the lock: an object that only one run can create, and which it rewrites regularly as a sign of life.

        Raises
        ------
        DestinationError
            If another run holds it.
        """
        lock = self._place.child(_LOCK)
        sign = {"host": socket.gethostname(), "pid": os.getpid(), "run": token_hex(8), "sign": 0}
        self._take(lock, sign)
        ended = Event()

        def live() -> None:
            while not ended.wait(_ALIVE_SECONDS):
                # The network may fail for a while.
                with suppress(Pc2ScanError):
                    if json.loads(lock.read() or b"{}").get("run") != sign["run"]:
                        self._lost.set()
                        return
                    sign["sign"] += 1  # type: ignore[operator]
                    lock.write(json.dumps(sign).encode())

        thread = Thread(target=live, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join(_ALIVE_SECONDS)
            if not self._lost.is_set():
                with suppress(Pc2ScanError):
                    lock.delete()

    def _take(self, lock: RemotePath, sign: dict[str, object]) -> None:
        deadline = time.monotonic() + _DEAD_SECONDS
        data, seen = json.dumps(sign).encode(), None
        while not lock.write(data, is_new=True):
            found = lock.read()
            if found is None:
                continue
            other = _lock_of(found)
            if seen is not None and found != seen:
                raise self._busy(other)
            if _is_dead_here(other) or time.monotonic() > deadline:
                lock.delete()
            elif other.get("host") == sign["host"] and other.get("pid"):
                # The run that holds the lock is a process of this machine, and is alive.
                raise self._busy(other)
            else:
                seen = found
                time.sleep(min(5.0, _ALIVE_SECONDS / 4))

    def _busy(self, other: dict[str, object]) -> DestinationError:
        return DestinationError(
            f"another batch is writing into this folder, on {other.get('host')}, process {other.get('pid')}",
            path=self._place.shown,
        )


def identity_in(objects: Mapping[str, StoredObject], output: str, left: Identity | None = None) -> Identity:
    """Return the identity of an output (a file, a folder, or numbered files) from a listing of the store.

    ``left`` says which files a numbered output has; without it, all with such names are listed.
    """
    if is_numbered(output):
        folder, _, name = unnumbered_name(output).rpartition("/")
        here = {key.rpartition("/")[2]: found for key, found in objects.items() if key.rpartition("/")[0] == folder}
        names = parts_among(here, name) if left is None else [file for file, _, _ in left.files if file in here]
        return Identity(tuple((name, *here[name]) for name in names))
    if found := objects.get(output):
        return Identity(((output.rpartition("/")[2], found.size, found.version),))
    below = f"{output}/"
    files = [(key[len(below) :], *found) for key, found in sorted(objects.items()) if key.startswith(below)]
    return Identity(tuple(files))


def _lock_of(data: bytes) -> dict[str, object]:
    try:
        found = json.loads(data)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _is_dead_here(other: dict[str, object]) -> bool:
    """Return whether the run that holds the lock was on this machine and has ended."""
    pid = other.get("pid")
    if other.get("host") != socket.gethostname() or not isinstance(pid, int) or os.name == "nt":
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except OSError:
        pass
    return False
