"""URLs: sources at them are fetched into local copies, and results are uploaded when they are complete.

A `UrlPath` shows itself without secrets, and so does the `CopyPath` of what is fetched from there, so results and
messages name the URL. The stores' libraries only notice silence, so each download must also keep a pace.
"""

from __future__ import annotations

import os
import re
from contextlib import ExitStack, contextmanager, suppress
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, ClassVar

from pc2scan.errors import MissingError, OutputError, Pc2ScanError, RecordingError, UsageError

from .system import files_below, private_folder, refuse_without_room

# Up to Python 3.11, Path itself has no subclasses, only that of the system has.
if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence
    from pathlib import PosixPath as _LocalPath
else:
    _LocalPath = type(Path())

#: The library that fsspec needs for a scheme.
LIBRARIES = {"s3": "s3fs", "gs": "gcsfs", "az": "adlfs", "https": "aiohttp", "http": "aiohttp", "memory": "fsspec"}

#: The slowest transfer, on average: 64 KiB a minute.
MINUTE = 60.0
_BYTES_A_MINUTE = 1 << 16

_NOT_FOUND = 404

_AGAIN = "try again; if it fails again, check the network, and your permissions and credentials for the store"


class UrlPath(_LocalPath):
    """A file or a folder at a URL.

    Its text is the URL without secrets; `os.fspath` returns the whole URL. Methods that look something up raise the
    errors of `pc2scan.errors`, not OSErrors. Nothing is a link there. What is read is fetched first: see
    `fetched`.
    """

    def __fspath__(self) -> str:
        """Return the whole URL, with secrets."""
        scheme, _, rest = super().__str__().replace(os.sep, "/").partition(":")
        return f"{scheme}://{rest.lstrip('/')}"

    def __str__(self) -> str:
        """Return the URL without its parts that may be secret: user and password, and over HTTP query and fragment.

        In the other schemes ``?`` and ``#`` are characters of a name.
        """
        url = os.fspath(self)
        if self.is_read_only:
            url = re.split("[?#]", url)[0]
        return re.sub("://[^/]*@", "://", url)

    @property
    def name(self) -> str:
        """The last part, over HTTP without the query."""
        return str(self).rstrip("/").rpartition("/")[2]

    @property
    def is_read_only(self) -> bool:
        """Whether it is on a web server, whose files can only be read."""
        return os.fspath(self).startswith("http")

    @cached_property
    def store(self) -> Any:
        """The file system of fsspec, and what it calls the file."""
        import fsspec  # noqa: PLC0415  # only an extra

        scheme = os.fspath(self).partition(":")[0]
        # A listing that is cached by one thread lacks what another one writes meanwhile.
        options = {"use_listings_cache": False} | _options(scheme, fsspec.config.conf.get(scheme, {}))
        return fsspec.url_to_fs(os.fspath(self), **options)

    def _call(self, method: str, *arguments: Any, **options: Any) -> Any:
        """Return what a method of fsspec's file system returns for the file."""
        with translated_errors(self):
            file_system, key = self.store
            return getattr(file_system, method)(key, *arguments, **options)

    @cached_property
    def details(self) -> dict[str, Any]:
        """What fsspec knows of the file, from a listing or on request; empty if there is none."""
        with suppress(MissingError):
            return dict(self._call("info"))
        return {}

    @property
    def size(self) -> int:
        """The bytes of a file; 0 if the server does not report them."""
        return int(self.details.get("size") or 0)

    def exists(self, *, follow_symlinks: bool = True) -> bool:  # noqa: ARG002  # the signature of Path
        """Return whether anything is there."""
        return bool(self.details)

    def is_dir(self, *, follow_symlinks: bool = True) -> bool:  # noqa: ARG002  # the signature of Path
        """Return whether it is a folder."""
        return self.details.get("type") == "directory"

    def iterdir(self) -> Generator[UrlPath]:
        """Yield what is in a folder."""
        for details in self._call("ls", detail=True):
            place = details["name"].strip("/")
            # Some stores list the folder itself, as an empty file.
            if place != self.store[1].strip("/"):
                child = self / place.rpartition("/")[2]
                child.details = details
                yield child

    def download(self, target: Path) -> None:
        """Write the whole file to a local one; an error if it does not have the size that the store says."""
        from fsspec.callbacks import Callback  # noqa: PLC0415  # only an extra

        begun = monotonic()
        target.touch()

        def arrived(_: object, received: int) -> None:
            # After Ctrl-C there is no target, which is an error and ends the library's thread.
            if target.stat().st_size > self.size:
                raise RecordingError(f"the server declares {self.size:,} bytes, and sends more", path=self, hint=_AGAIN)
            if monotonic() - begun > MINUTE * (1 + received // _BYTES_A_MINUTE):
                raise RecordingError("the transfer is slower than 64 KiB a minute", path=self, hint=_AGAIN)

        self._call("get_file", os.fspath(target), callback=Callback(hooks={"arrived": arrived}))
        if target.stat().st_size != self.size:
            raise RecordingError(f"the server declares {self.size:,} bytes, and sends fewer", path=self, hint=_AGAIN)


class CopyPath(_LocalPath):
    """The local copy of what is at a URL, or a path in it; its text is the URL without secrets."""

    #: The folders that have copies, and what is shown in place of each. Errors show it also after a copy is removed.
    _shown: ClassVar[dict[Path, str]] = {}

    @classmethod
    def of(cls, url: UrlPath, stack: ExitStack) -> CopyPath:
        """Return the path of a copy in a folder of its own, which is removed with the stack."""
        folder = stack.enter_context(private_folder(url))
        cls._shown[Path(folder)] = str(url).rstrip("/").removesuffix(url.name)
        return cls(folder, url.name)

    def __str__(self) -> str:
        place = Path(os.fspath(self))
        folder = next((folder for folder in place.parents if folder in self._shown), None)
        return self._shown[folder] + place.relative_to(folder).as_posix() if folder else os.fspath(self)

    def __fspath__(self) -> str:
        return super().__str__()

    def iterdir(self) -> Generator[CopyPath]:
        """Yield what is in a folder."""
        return (self / name for name in os.listdir(self))  # noqa: PTH208  # Path's own uses the text


# --- Copies of sources, and uploads ---


@contextmanager
def fetched(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Fetch what is at URLs, and yield the paths with local copies in place of URLs, which are removed at the end.

    Raises
    ------
    MissingError
        If nothing is at a URL.
    RecordingError
        If it cannot be fetched, or there is no room: the sizes of all are counted before the first is fetched.
    """
    sources = {path: files_of(path) for path in paths if isinstance(path, UrlPath)}
    refuse_without_room(sum(file.size for files in sources.values() for file in files), next(iter(sources), None))
    with ExitStack() as stack:
        copies: dict[Path, Path] = {path: CopyPath.of(path, stack) for path in sources}
        for path, files in sources.items():
            folder = copies[path] if path.is_dir() else copies[path].parent
            folder.mkdir(exist_ok=True)
            for file in files:
                file.download(folder / file.name)
        yield [copies.get(path, path) for path in paths]


def files_of(path: UrlPath) -> list[UrlPath]:
    """Return the files in a folder, or a file with the logs beside a database."""
    if path.is_dir():
        return [file for file in path.iterdir() if not file.is_dir()]
    logs = [path.with_name(path.name + suffix) for suffix in ("-wal", "-journal") if path.suffix == ".db3"]
    return [path, *(log for log in logs if not path.is_read_only and log.exists())]


def upload(local: Path, dst: UrlPath) -> None:
    """Upload a complete file or folder.

    Raises
    ------
    OutputError
        If it cannot be written. What was uploaded of a folder is removed.
    """

    def remove(place: str) -> None:
        with suppress(Exception):
            file_system.rm_file(place)

    with translated_errors(dst, OutputError), ExitStack() as undo:
        file_system, key = dst.store
        if not local.is_dir():
            file_system.put_file(os.fspath(local), key)
            return
        # A recording is complete when its metadata.yaml is there.
        for name in sorted(files_below(local), key=lambda name: name.endswith("metadata.yaml")):
            undo.callback(remove, f"{key}/{name}")
            file_system.put_file(os.fspath(local / name), f"{key}/{name}")
        undo.pop_all()


# --- The stores' libraries ---


@contextmanager
def translated_errors(path: UrlPath, kind: type[Pc2ScanError] = RecordingError) -> Iterator[None]:
    """Turn errors of fsspec and the stores' libraries into our own; their texts may have the URL with its signature."""
    try:
        yield
    except Pc2ScanError:
        raise
    except ImportError as missing:
        hint = f'pip install "pc2scan[remote]" {LIBRARIES[os.fspath(path).partition(":")[0]]}'
        raise UsageError("needs a library that is not installed", path=path, hint=hint) from missing
    except Exception as error:  # noqa: BLE001  # each store's library has errors of its own
        # fsspec raises FileNotFoundError for every error of a web server.
        err = (error.__cause__ if path.is_read_only else None) or error
        status, errno = getattr(err, "status", None), getattr(err, "errno", None)
        if kind is RecordingError and (isinstance(err, FileNotFoundError) or status == _NOT_FOUND):
            hint = "check its spelling (case matters), and the bucket's; some stores say so if permissions are missing"
            raise MissingError("does not exist", path=path, hint=hint) from None
        why = f"status {status}" if status else os.strerror(errno) if errno else type(err).__name__
        raise kind(f"the transfer failed ({why})", path=path, hint=_AGAIN) from None


def _options(scheme: str, configured: dict[str, Any]) -> dict[str, Any]:
    """Return options of a store: with our patience, and for one stream at a time.

    By default S3 takes minutes to give up, and fetches ten parts of 50 MB at once.
    """
    if scheme in {"http", "https"}:
        from aiohttp import ClientTimeout  # noqa: PLC0415  # only where it is needed

        timeout = ClientTimeout(total=None, sock_connect=MINUTE, sock_read=MINUTE)
        # What a server compresses would have another size than it declares.
        return {"timeout": timeout, "headers": {"Accept-Encoding": "identity"} | configured.get("headers", {})}
    if scheme == "s3":
        # No retries of the S3 library: s3fs itself tries five times.
        ours = {"connect_timeout": 10, "read_timeout": 20, "retries": {"max_attempts": 0}}
        return {"max_concurrency": 1, "config_kwargs": ours | configured.get("config_kwargs", {})}
    return {}
