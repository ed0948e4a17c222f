"""Which format a recording has, by its content, and which one a destination gets, by its name."""

from __future__ import annotations

import os
import shlex
import stat
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pc2scan.errors import DestinationError, RecordingError
from pc2scan.files.source import opened_bytes
from pc2scan.files.staging import LEFTOVERS, working_names
from pc2scan.files.temporary import private_folder
from pc2scan.model import MAX_ROSBAG2_NS

from . import zstd
from .damage import DamageLog
from .reader import Reader

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence
    from contextlib import ExitStack

    from pc2scan.model import Attachment, ChunkRule, Connection, Metadata, Summary, Writer

    from .damage import Damage
    from .units import Unit

__all__ = [
    "Container",
    "Destination",
    "beside_recording",
    "default_destination",
    "default_storage",
    "kept_form",
    "open_recording",
    "open_recordings",
    "open_writer",
    "plan_destination",
    "sniff",
]

Container = Literal["rosbag1", "mcap", "rosbag2"]

_MAGICS = {b"#ROSBAG V2.0\n": "rosbag1", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "sqlite3"}
_HEAD_SIZE = max(map(len, _MAGICS))

#: Not recordings, but what one finds where a recording was expected.
_LOOKALIKES = {
    b"\x1f\x8b": "gzip-compressed",
    b"BZh": "bzip2-compressed",
    b"\xfd7zXZ": "xz-compressed",
    b"\x04\x22\x4d\x18": "lz4-compressed",
    b"PK\x03\x04": "a ZIP archive",
    b"7z\xbc\xaf": "a 7z archive",
    b"version https://": "a Git LFS pointer, not the file itself",
    b"\xd4\xc3\xb2\xa1": "a packet capture (pcap)",
    b"\x0a\x0d\x0d\x0a": "a packet capture (pcapng)",
    b"# .PCD": "a single point cloud (PCD)",
    b"\x89MCAP": "MCAP of an unknown version",
}
_READABLE = "ROS 1 bags, rosbag2 directories, .db3 files and MCAP can be read"

_COMPRESSIONS = {
    "rosbag1": ("none", "bz2", "lz4"),
    "mcap": ("none", "lz4", "zstd"),
    "sqlite3": ("none", "zstd"),
}
_DEFAULT_COMPRESSION = {"rosbag1": "lz4", "mcap": "zstd", "sqlite3": "none"}
_STORAGES = ("mcap", "sqlite3")
_PROFILES = ("ros1", "ros2")
_METADATA_VERSIONS = (8, 9)
_CONTAINERS: dict[str, Container] = {".bag": "rosbag1", ".mcap": "mcap"}

#: Names that promise something that is not written; a directory called so would only confuse.
_REFUSED_SUFFIXES = {
    **dict.fromkeys((".db3", ".sqlite3", ".db"), "rosbag2 keeps .db3 files in a directory: name that directory"),
    **dict.fromkeys((".yaml", ".yml"), "metadata.yaml is written inside a directory: name that directory"),
    **dict.fromkeys(
        (".zip", ".gz", ".tgz", ".bz2", ".xz", ".7z", ".tar", ".lz4", ".zst", ".zstd"),
        "recordings are compressed inside: `compression` chooses how",
    ),
    **dict.fromkeys(
        (".active", ".pcap", ".pcd", ".ply", ".las", ".laz", ".csv", ".json", ".txt", ".npy", ".npz"),
        "this format is not written",
    ),
}
_SOURCE_SUFFIXES = (".zstd", ".zst", ".active", ".bag", ".mcap", ".db3")


# --- Reading ---


def sniff(path: Path) -> str:
    """Tell a recording's format by its content, never by its name.

    Parameters
    ----------
    path
        A file or a directory.

    Returns
    -------
    str
        ``rosbag1``, ``mcap``, ``sqlite3`` (a ``.db3`` file) or ``rosbag2`` (a directory); ``+zstd`` is
        appended for a file that zstd has to unpack first.

    Raises
    ------
    RecordingError
        If nothing is there, it is not permitted to read it, or it is no recording.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            return _sniff_directory(path)
        if not stat.S_ISREG(mode):
            raise RecordingError("is neither a file nor a directory", path=path, hint="save it as a file first")
        with opened_bytes(path) as file:
            head = file.read(64)
    except FileNotFoundError as err:
        raise RecordingError("there is nothing of this name", path=path, hint=_interrupted(path)) from err
    except OSError as err:
        raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err
    if head.startswith(zstd.MAGIC):
        return f"{_recognised(_unpacked_head(path), path, ' (after zstd decompression)')}+zstd"
    return _recognised(head, path)


def open_recording(path: Path, *, verify: bool = True, strict: bool = False) -> Reader:
    """Open a recording of any format.

    Parameters
    ----------
    path
        A ROS 1 bag, an MCAP or ``.db3`` file, one of these compressed by zstd, or a rosbag2 directory.
    verify
        Whether checksums of MCAP files are verified.
    strict
        Whether damage is an error; otherwise it is read around, and the reader's ``damage`` tells it.

    Raises
    ------
    RecordingError
        If it cannot be read.
    DamageError
        With ``strict``, if it is damaged; without, if nothing of it can be recovered.
    """
    form, _, packed = sniff(path).partition("+")
    if packed:
        return _UnpackedReader(path, form, verify=verify, strict=strict)
    return _open(path, form, verify=verify, strict=strict)


def open_recordings(
    paths: Iterable[Path], stack: ExitStack, *, verify: bool = True, strict: bool = False
) -> list[Reader]:
    """Open several, each as `open_recording` does, to be closed with the stack."""
    readers = []
    for path in paths:
        reader = open_recording(path, verify=verify, strict=strict)
        stack.callback(reader.close)
        readers.append(reader)
    return readers


def _open(path: Path, form: str, *, verify: bool, strict: bool) -> Reader:
    # Each format brings its libraries along: only the one that is read is imported.
    if form == "rosbag1":
        from pc2scan.bags.rosbag1.reader import Rosbag1Reader  # noqa: PLC0415

        return Rosbag1Reader(path, strict=strict)
    if form == "mcap":
        from pc2scan.bags.mcap.reader import McapReader  # noqa: PLC0415

        return McapReader(path, verify=verify, strict=strict)
    if form == "sqlite3":
        from pc2scan.bags.rosbag2.sqlite3_reader import Sqlite3Reader  # noqa: PLC0415

        return Sqlite3Reader(path, strict=strict)
    from pc2scan.bags.rosbag2.reader import Rosbag2Reader  # noqa: PLC0415

    return Rosbag2Reader(path, verify=verify, strict=strict)


class _UnpackedReader(Reader):
    """A file that was compressed as a whole, read from a temporary copy."""

    def __init__(self, path: Path, form: str, *, verify: bool, strict: bool) -> None:
        self._path = path
        self._log = DamageLog(strict=strict)
        self._temporary = private_folder(path)
        try:
            unpacked = zstd.unpacked_file(path, Path(self._temporary.name), self._log)
            self._inner = _open(unpacked, form, verify=verify, strict=strict)
        except BaseException:
            self._temporary.cleanup()
            raise
        inner = self._inner.summary
        self._inner_size = inner.size_bytes
        self._summary = replace(
            inner,
            compression=zstd.compressions(inner.compression),
            size_bytes=path.stat().st_size,
        )

    @property
    def path(self) -> Path:
        return self._path

    @property
    def connections(self) -> Sequence[Connection]:
        return self._inner.connections

    @property
    def summary(self) -> Summary:
        return self._summary

    @property
    def bytes_read(self) -> int:
        return self._inner.bytes_read * self._summary.size_bytes // max(1, self._inner_size)

    @property
    def damage(self) -> tuple[Damage, ...]:
        return (*self._log.found, *(replace(place, path=self._path) for place in self._inner.damage))

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterable[Unit]:
        return self._inner.units(connections, start_ns, stop_ns, rule)

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        return self._inner.counts(connections, start_ns, stop_ns)

    def attachments(self) -> Iterator[Attachment]:
        return self._inner.attachments()

    def metadata(self) -> Iterator[Metadata]:
        return self._inner.metadata()

    def close(self) -> None:
        self._inner.close()
        self._temporary.cleanup()


def _interrupted(path: Path) -> str | None:
    """What to do about a recording that is not there because the run that was writing it was killed."""
    partial, old, _ = working_names(path) or (path, path, path)
    # Not Path.exists: with the ending the name may be too long.
    if os.path.lexists(old):
        return f"an interrupted run has set it aside: mv {shlex.quote(str(old))} {shlex.quote(str(path))}"
    if os.path.lexists(partial):
        return f"an interrupted run left a part of it: pc2scan repair {shlex.quote(str(partial))}"
    return None


def _sniff_directory(path: Path) -> str:
    from pc2scan.bags.rosbag2.metadata import METADATA_NAME, storage_files  # noqa: PLC0415

    if (path / METADATA_NAME).exists() or storage_files(path):
        return "rosbag2"
    bags = sorted(entry.name for entry in path.iterdir() if entry.suffix == ".bag")
    raise RecordingError(
        "is a directory without a rosbag2 recording (no metadata.yaml, .db3 or .mcap files)",
        path=path,
        hint=f"name the bags in it themselves: {', '.join(bags[:3])}" if bags else None,
    )


def beside_recording(folder: Path) -> str:
    """What a folder has in it beside a rosbag2 recording; empty for nothing."""
    from .rosbag2 import metadata  # noqa: PLC0415  # it reads YAML, which few runs need

    return metadata.beside_recording(folder)


def _unpacked_head(path: Path) -> bytes:
    import zstandard  # noqa: PLC0415  (only compressed recordings need it)

    try:
        with opened_bytes(path) as file:
            return zstandard.ZstdDecompressor().stream_reader(file).read(64)
    except (OSError, zstandard.ZstdError) as err:
        raise RecordingError(f"cannot be decompressed: {err}", path=path) from err


def _recognised(head: bytes, path: Path, state: str = "") -> str:
    for magic, form in _MAGICS.items():
        if head.startswith(magic):
            return form
    if not head:
        raise RecordingError(f"is empty{state}", path=path)
    if any(magic.startswith(head) for magic in _MAGICS):
        raise RecordingError(f"is cut off after {len(head)} bytes: there is nothing to recover{state}", path=path)
    if head.startswith(b"#ROSBAG V1"):
        raise RecordingError(
            f"is a ROS bag of version {_shown(head[9:12])}{state}, only 2.0 can be read",
            path=path,
            hint="ROS 1's rosbag reindex converts it",
        )
    if head.startswith(b"rosbag2_bagfile_information"):
        raise RecordingError(
            f"is the metadata.yaml of a rosbag2 recording{state}",
            path=path,
            hint="name the directory it is in",
        )
    for magic, description in _LOOKALIKES.items():
        if head.startswith(magic):
            raise RecordingError(f"is no recording: it is {description}{state}", path=path, hint=_READABLE)
    raise RecordingError(f"is no recording: it begins with {_shown(head[:16])}{state}", path=path, hint=_READABLE)


def _shown(head: bytes) -> str:
    """Bytes of unknown origin for a terminal: printable ASCII as it is, everything else escaped."""
    return repr(head)[1:]


# --- Writing ---


@dataclass(frozen=True, slots=True)
class Destination:
    """What will be written, decided and consistent.

    Attributes
    ----------
    path
        Where.
    container
        ``rosbag1``, ``mcap`` or ``rosbag2`` (a directory).
    storage
        Of a rosbag2 directory: ``mcap`` or ``sqlite3``; else empty.
    compression
        ``none``, ``bz2``, ``lz4`` or ``zstd``.
    profile
        Of an MCAP file: ``ros1`` or ``ros2``; else empty.
    metadata_version
        Of a rosbag2 directory: 8 or 9.
    chunk_compressions
        Those that chunks copied from the source may have: the one that was asked for, else any that the container
        knows.
    """

    path: Path
    container: Container
    storage: str
    compression: str
    profile: str
    metadata_version: int
    chunk_compressions: frozenset[str]

    @property
    def chunks(self) -> str:
        """Whose chunks its messages lie in: ``rosbag1`` or ``mcap``; empty for none."""
        return {"sqlite3": "", "mcap": "mcap"}.get(self.storage, self.container)

    @property
    def times_ns(self) -> tuple[int, int]:
        """The first and the last log time that it can hold."""
        if self.storage == "sqlite3":
            return -MAX_ROSBAG2_NS - 1, MAX_ROSBAG2_NS
        return 0, {"rosbag1": (1 << 32) * 1_000_000_000 - 1, "mcap": (1 << 64) - 1}.get(self.container, MAX_ROSBAG2_NS)

    def same_kind(self, source: Summary) -> bool:
        """Whether the source is in this kind of container, so that whatever serialisation it holds fits."""
        return self.container == ("rosbag2" if source.container == "sqlite3" else source.container)

    @property
    def generation(self) -> int:
        """The ROS generation whose messages it holds: 1 or 2."""
        return 1 if self.container == "rosbag1" or self.profile == "ros1" else 2

    @property
    def serialization(self) -> str:
        """How those are serialised: ``ros1`` or ``cdr``."""
        return "ros1" if self.generation == 1 else "cdr"


def plan_destination(
    path: Path,
    *,
    storage: str | None = None,
    compression: str | None = None,
    profile: str | None = None,
    metadata_version: int = 8,
    source_generation: int | None,
) -> Destination:
    """Decide what a destination's name and the options mean.

    ``*.bag`` is a ROS 1 bag, ``*.mcap`` an MCAP file, and any other name a rosbag2 directory.

    Parameters
    ----------
    path
        The destination. Not looked at, only its name is.
    storage
        For a rosbag2 directory: ``mcap`` (default) or ``sqlite3``.
    compression
        Default: ``zstd`` for MCAP, ``lz4`` for ROS 1 bags, ``none`` for sqlite3. Chunks that are copied whole have
        this one only if it is given.
    profile
        For an MCAP file: ``ros1`` or ``ros2``; default: the source's.
    metadata_version
        For a rosbag2 directory: 8 or 9.
    source_generation
        1, 2, or None if the source has no ROS messages.

    Raises
    ------
    DestinationError
        If the name promises what is not written, or the options contradict it or each other.
    """
    suffix = path.suffix.lower()
    if suffix in _REFUSED_SUFFIXES:
        raise DestinationError(
            f"{suffix} is not a destination",
            path=path,
            hint=f"{_REFUSED_SUFFIXES[suffix]}. Use NAME.bag, NAME.mcap, or NAME for a rosbag2 directory",
        )
    container = _CONTAINERS.get(suffix, "rosbag2")
    if storage is not None and container != "rosbag2":
        raise DestinationError(
            "`storage` is for rosbag2 directories",
            path=path,
            hint=f"leave it out, or leave {suffix} out of the name",
        )
    if profile is not None and container != "mcap":
        raise DestinationError("`profile` is for .mcap files", path=path, hint="leave it out")
    storage = _one_of("storage", storage or "mcap", _STORAGES, path) if container == "rosbag2" else ""
    if container == "mcap":
        profile = _one_of("profile", profile or ("ros1" if source_generation == 1 else "ros2"), _PROFILES, path)
    if metadata_version not in _METADATA_VERSIONS:
        raise DestinationError(f"metadata version {metadata_version} cannot be written, only 8 and 9", path=path)
    form = storage or container
    return Destination(
        path=path,
        container=container,
        storage=storage,
        compression=_one_of("compression", compression or _DEFAULT_COMPRESSION[form], _COMPRESSIONS[form], path),
        profile=profile or "",
        metadata_version=metadata_version,
        chunk_compressions=frozenset((compression,) if compression else _COMPRESSIONS[form]),
    )


def _one_of(option: str, value: str, allowed: Sequence[str], path: Path) -> str:
    if value not in allowed:
        raise DestinationError(f"`{option}={value}` is not possible here; allowed: {', '.join(allowed)}", path=path)
    return value


def default_destination(sources: Sequence[Path], summaries: Sequence[Summary], mark: str = "_scan") -> Path:
    """Name a destination beside the first source, in its format: ``drive.bag`` becomes ``drive_scan.bag``.

    ``mark`` is put behind the name. What an interrupted run left is named like its destination. A bare ``.db3`` file
    becomes a rosbag2 directory. `default_storage` returns the storage that goes with it.
    """
    source = sources[0]
    if source.name in {"", ".."}:
        source = source.resolve()
    container = summaries[0].container
    stem = source.name
    for leftover in LEFTOVERS:
        stem = stem.removesuffix(leftover) or stem
    if container != "rosbag2":
        for suffix in _SOURCE_SUFFIXES:
            stem = stem[: -len(suffix)] if stem.lower().endswith(suffix) and len(stem) > len(suffix) else stem
    ending = {"rosbag1": ".bag", "mcap": ".mcap"}.get(container, "")
    return source.with_name(f"{stem}{mark}{ending}")


def default_storage(summaries: Sequence[Summary]) -> str | None:
    """Tell the storage for a rosbag2 directory made from these: the first source's; None if it has none."""
    first = summaries[0]
    return "sqlite3" if first.container == "sqlite3" else first.storage or None


def kept_form(path: Path, summaries: Sequence[Summary]) -> tuple[str | None, str | None]:
    """Tell the storage and the compression that a destination of this name can keep of the first source's."""
    first = summaries[0]
    container = _CONTAINERS.get(path.suffix.lower(), "rosbag2")
    storage = default_storage(summaries) if container == "rosbag2" else None
    form = storage or ("mcap" if container == "rosbag2" else container)
    own = first.storage or first.container
    compressions = first.compression if own == form else ()
    kept = compressions[0] if len(compressions) == 1 and compressions[0] in _COMPRESSIONS[form] else None
    return storage, kept


def open_writer(destination: Destination, staged_path: Path, name: str) -> Writer:
    """Start writing.

    Parameters
    ----------
    destination
        From `plan_destination`.
    staged_path
        Where to write now; see `pc2scan.files.staging.staged`.
    name
        What it will be called in the end: a rosbag2 directory's files are named after it.

    Raises
    ------
    OutputError
        If it cannot be created.
    """
    if destination.container == "rosbag1":
        from pc2scan.bags.rosbag1.writer import Rosbag1Writer  # noqa: PLC0415  (each format brings its libraries along)

        return Rosbag1Writer(staged_path, destination.compression)
    if destination.container == "mcap":
        from pc2scan.bags.mcap.writer import McapWriter  # noqa: PLC0415

        return McapWriter(staged_path, destination.compression, destination.profile)
    from pc2scan.bags.rosbag2.writer import Rosbag2Writer  # noqa: PLC0415

    return Rosbag2Writer(
        staged_path,
        name,
        storage=destination.storage,
        compression=destination.compression,
        metadata_version=destination.metadata_version,
    )
