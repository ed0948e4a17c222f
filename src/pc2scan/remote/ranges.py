"""Reads only the needed ranges of recordings at URLs.

Readers need local files. So each remote file gets a local stand-in: a file of the same size without content, into which
bytes are fetched when they are first read. Databases and compressed files are fetched as a whole, because their
libraries read the file themselves.
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from time import monotonic
from typing import TYPE_CHECKING

from pc2scan.errors import Pc2ScanError, RecordingError
from pc2scan.files.compression import ZSTD_MAGIC
from pc2scan.files.source import on_demand, open_bytes

from .store import LEAST_BYTES, RemotePath, request_size
from .urls import UrlNames, is_url

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from .store import StoredObject

#: Bytes are fetched in blocks of this size. Their transfer takes little time compared with the request itself.
_BLOCK = LEAST_BYTES

#: Maximum number of blocks in a request.
_MOST_BLOCKS = 1 << 9

#: Files up to this size are fetched as a whole.
_SMALL_BYTES = 1 << 17

_READ_WHOLE = (ZSTD_MAGIC, b"SQLite format 3\0")


class StandIns:
    """Local stand-ins of recordings.

    Attributes
    ----------
    paths
        In the order of the recordings. Local recordings keep their paths.
    names
        Replaces paths of stand-ins by URLs in texts for users.
    """

    def __init__(self) -> None:
        self.paths: list[Path] = []
        self.names = UrlNames()


@contextmanager
def stand_ins(paths: Sequence[Path]) -> Iterator[StandIns]:
    """Make recordings readable as local files while the context lasts; errors in it name URLs.

    Raises
    ------
    RecordingError
        If a recording cannot be read, or was changed while it was read.
    """
    found = StandIns()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="pc2scan-"))).resolve()
        read: list[tuple[RemotePath, StoredObject]] = []
        for number, path in enumerate(paths):
            if not is_url(path):
                found.paths.append(path)
                continue
            place = RemotePath(path)
            here = folder / str(number)
            here.mkdir()
            found.names.add(here, place.parent)
            target = here / place.name
            found.paths.append(target)
            files = place.files()
            if files is None:
                read.append((place, place.stat()))
                _add_stand_in(place, target, stack)
            else:
                target.mkdir()
                for name, file in files.items():
                    read.append((file, file.stat()))
                    _add_stand_in(file, target / name, stack)
        try:
            yield found
        except Pc2ScanError as err:
            found.names.error(err)
            raise
        for place, stated in read:
            if place.stat() != stated:
                raise place.change_error()


def add_stand_in(place: RemotePath, target: Path, size: int) -> None:
    """Create a stand-in of this size at a path; its bytes are fetched when they are first read (see `on_demand`).

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    on_demand[target] = _StandIn(place, target, size).fetch


def fetch_whole(path: Path) -> None:
    """Fetch a file as a whole if it is one that a library reads itself; called before it is opened as a recording."""
    files = [file for file in on_demand if file.parent == path] if path.is_dir() else [path]
    for file in files:
        fetch = on_demand.get(file)
        if fetch is None:
            continue
        with open_bytes(file) as opened:
            head = opened.read(_BLOCK)
        if head.startswith(_READ_WHOLE):
            fetch(0, file.stat().st_size)


def _add_stand_in(place: RemotePath, target: Path, stack: ExitStack) -> None:
    size = place.stat().size
    began = monotonic()
    head = (place.bytes_at(0, min(size, _BLOCK)) or b"") if size else b""
    took = monotonic() - began
    if size <= _SMALL_BYTES or head.startswith(_READ_WHOLE):
        place.download(target)
        return
    fetched = _StandIn(place, target, size)
    fetched.took(len(head), took)
    on_demand[target] = fetched.fetch
    stack.callback(on_demand.pop, target)
    fetched.keep(0, head)


class _StandIn:
    """A stand-in that is filled as it is read, by requests that a slow network answers in seconds, too."""

    def __init__(self, place: RemotePath, path: Path, size: int) -> None:
        self._place = place
        self._path = path
        self._size = size
        self._there = bytearray(-(-size // _BLOCK))
        self._lock = Lock()
        #: Blocks in the next request.
        self._most = _MOST_BLOCKS
        try:
            with path.open("xb") as file:
                file.truncate(size)
        except OSError as err:
            raise self._no_copy(err) from err

    def _no_copy(self, err: OSError) -> RecordingError:
        hint = "set the environment variable TMPDIR to a folder with enough space"
        return RecordingError(f"no local copy can be written: {err.strerror}", path=self._place.shown, hint=hint)

    def fetch(self, offset: int, length: int) -> None:
        """Fetch those of these bytes that are missing; any thread may call it."""
        last = min(-(-(offset + length) // _BLOCK), len(self._there))
        with self._lock:
            block = self._there.find(0, offset // _BLOCK, last)
            while block >= 0:
                stop = self._there.find(1, block, last)
                stop = min(last if stop < 0 else stop, block + self._most)
                start = block * _BLOCK
                began = monotonic()
                data = self._place.bytes_at(start, min(stop * _BLOCK, self._size))
                if data is None:
                    self._most = 1
                    continue
                self.took(len(data), monotonic() - began)
                self.keep(start, data)
                block = self._there.find(0, stop, last)

    def took(self, size: int, seconds: float) -> None:
        """Choose the size of the next request by how long one of this size took."""
        self._most = max(1, min(request_size(size, seconds) // _BLOCK, _MOST_BLOCKS))

    def keep(self, start: int, data: bytes) -> None:
        """Write fetched bytes into the stand-in."""
        try:
            with self._path.open("r+b") as file:
                file.seek(start)
                file.write(data)
        except OSError as err:
            raise self._no_copy(err) from err
        blocks = -(-len(data) // _BLOCK)
        first = start // _BLOCK
        self._there[first : first + blocks] = b"\1" * blocks
