"""Plans destinations from their names and options, and opens writers for them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import DestinationError
from pc2scan.files.outputs import LEFTOVERS

from . import zstd
from .formats import FORMATS, Format, destinations

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.model import Summary, Writer


class Destination(NamedTuple):
    """A destination with all its options decided.

    Attributes
    ----------
    path
        The path.
    format
        The table's entry of the container.
    file_format
        The table's entry of the files: of a directory the storage's, else the container's.
    compression
        ``none``, ``bz2``, ``lz4`` or ``zstd``.
    profile
        Of an MCAP file: ``ros1`` or ``ros2``; else empty.
    chunk_compressions
        Compressions that chunks copied from the source may have: the given one, else all of the container.
    ros_version
        Of its messages: 1 or 2.
    """

    path: Path
    format: Format
    file_format: Format
    compression: str
    profile: str
    chunk_compressions: frozenset[str]
    ros_version: int

    @property
    def times_ns(self) -> tuple[int, int]:
        """The first and the last log time that it can store."""
        (first, last), (first_in_file, last_in_file) = self.format.times_ns, self.file_format.times_ns
        return max(first, first_in_file), min(last, last_in_file)

    def same_kind(self, source: Summary) -> bool:
        """Return whether the source is in this kind of container, so that messages of any serialisation fit."""
        entry = FORMATS.get(source.container)
        return entry is not None and self.format.name == (entry.written_as or entry.name)

    def same_chunks(self, source: Summary) -> bool:
        """Return whether the source has chunks of the same format, so that they can be copied as a whole."""
        entry = FORMATS.get(source.storage or source.container)
        return entry is not None and entry.has_chunks and entry.name == self.file_format.name


def plan_destination(
    path: Path,
    *,
    storage: str | None = None,
    compression: str | None = None,
    profile: str | None = None,
    source_ros_version: int | None,
    is_directory: bool = False,
) -> Destination:
    """Plan a destination from its name and the options.

    ``*.bag`` is a ROS 1 bag, ``*.mcap`` an MCAP file, and any other name a rosbag2 directory, unless it looks like that
    of a file.

    Parameters
    ----------
    path
        The destination; only its name is used.
    storage
        For a rosbag2 directory: ``mcap`` (default) or ``sqlite3``.
    compression
        Default: ``zstd`` for MCAP, ``lz4`` for ROS 1 bags, ``none`` for sqlite3. Chunks that are copied whole have
        this one only if it is given.
    profile
        For an MCAP file: ``ros1`` or ``ros2``; default: the source's.
    source_ros_version
        1, 2, or None if the source has no ROS messages.
    is_directory
        Whether a directory was asked for, whatever its name looks like.

    Raises
    ------
    DestinationError
        If the name has the suffix of another format, or the options contradict it or each other.
    """
    suffix = path.suffix.lower()
    written, known = _formats_by_suffix(), {entry.suffix for entry in FORMATS.values()}
    # The suffix of a storage is one that a directory must not have.
    if suffix not in written and (suffix in known or (_is_like_a_file(suffix) and not is_directory)):
        names = ", ".join(f"NAME{suffix}" for suffix in written if suffix)
        raise DestinationError(
            f"{suffix} is not a destination",
            path=path,
            hint=f"Use {names}, or NAME for a rosbag2 directory (`to=rosbag2` for any name). Other files are written "
            "by pc2scan export, pc2scan view, pc2scan plot and pc2scan map",
        )
    entry = written.get(suffix, written[""])
    if storage is not None and not entry.storages:
        raise DestinationError(
            "`storage` is for rosbag2 directories",
            path=path,
            hint=f"leave it out, or leave {suffix} out of the name",
        )
    if profile is not None and not entry.profiles:
        suffixes = " and ".join(suffix for suffix, other in written.items() if other.profiles)
        raise DestinationError(f"`profile` is for {suffixes} files", path=path, hint="leave it out")
    if entry.storages:
        storage = _one_of("storage", storage or entry.storages[0], entry.storages, path)
    if entry.profiles:
        default = entry.profiles[0 if source_ros_version == 1 else 1]
        profile = _one_of("profile", profile or default, entry.profiles, path)
    files = FORMATS[storage] if storage else entry
    ros_version = 1 if entry.profiles and profile == entry.profiles[0] else entry.ros_version
    return Destination(
        path=path,
        format=entry,
        file_format=files,
        compression=_one_of("compression", compression or files.default_compression, files.compressions, path),
        profile=profile or "",
        chunk_compressions=frozenset((compression,) if compression else files.compressions),
        ros_version=ros_version,
    )


def _is_like_a_file(suffix: str) -> bool:
    """Whether a suffix is like those of files, such as .mp4: not a version (drive.2), a date, or words."""
    letters = suffix[1:]
    is_version = letters[:1] == "v" and letters[1:].isdigit()
    return len(letters) in range(2, 5) and letters.isalnum() and letters[0].isalpha() and not is_version


def _formats_by_suffix() -> dict[str, Format]:
    """Return the formats that are destinations, by suffix."""
    return {entry.suffix: entry for entry in FORMATS.values() if entry.open_writer is not None}


def _format_of(path: Path) -> Format:
    """Return the format of a destination of this name."""
    written = _formats_by_suffix()
    return written.get(path.suffix.lower(), written[""])


def _one_of(option: str, value: str, allowed: Sequence[str], path: Path) -> str:
    if value not in allowed:
        raise DestinationError(f"`{option}={value}` is not possible here; allowed: {', '.join(allowed)}", path=path)
    return value


def default_destination(
    source: Path, container: str, mark: str = "_scan", *, folder: Path | None = None, to: str | None = None
) -> Path:
    """Name a destination after the first source: ``drive.bag`` becomes ``drive_scan.bag``.

    A bare ``.db3`` file becomes a rosbag2 directory. `default_storage` returns the storage that goes with it.

    Parameters
    ----------
    source, container
        The first source, and the name of its format. What an interrupted run left is named like its destination.
    mark
        What is put behind the name.
    folder
        Where the destination is; None: next to the source.
    to
        One of `pc2scan.bags.formats.destinations`; None: the source's format.
    """
    if source.name in {"", ".."}:
        source = Path(os.path.realpath(source))
    entry = FORMATS[container]
    stem = source.name
    for leftover in LEFTOVERS:
        stem = stem.removesuffix(leftover) or stem
    # A directory's name has no suffix to remove.
    if not entry.is_directory:
        for suffix in _source_suffixes():
            stem = stem[: -len(suffix)] if stem.lower().endswith(suffix) and len(stem) > len(suffix) else stem
    written = FORMATS[entry.written_as or entry.name] if to is None else destinations()[to]
    return (source.parent if folder is None else folder) / f"{stem}{mark}{written.suffix}"


def check_to(path: Path, to: str) -> None:
    """Raise if the suffix of a destination contradicts the requested format.

    Raises
    ------
    DestinationError
        If it does.
    """
    if (wanted := destinations()[to]) is not _format_of(path):
        raise DestinationError(
            f"`to={to}` asks for another format than this name does",
            path=path,
            hint=f"call it {path.with_suffix(wanted.suffix).name}, or leave `to` out",
        )


def _source_suffixes() -> tuple[str, ...]:
    """Return the suffixes of sources in the order in which they are removed: those of storages last."""
    files = sorted((entry for entry in FORMATS.values() if entry.suffix), key=lambda entry: bool(entry.written_as))
    return (*zstd.SUFFIXES, ".active", *(entry.suffix for entry in files))


def default_storage(path: Path, summaries: Sequence[Summary]) -> str | None:
    """Return the storage for a rosbag2 directory made from these: the first source's; None if it has none."""
    if not _format_of(path).storages:
        return None
    first = summaries[0]
    return first.container if first.container in _format_of(path).storages else first.storage or None


def source_form(path: Path, summaries: Sequence[Summary]) -> tuple[str | None, str | None]:
    """Return the first source's storage and compression, as far as a destination of this name can keep them."""
    first = summaries[0]
    entry = _format_of(path)
    storage = default_storage(path, summaries)
    if entry.storages:
        entry = FORMATS[storage or entry.storages[0]]
    own = first.storage or first.container
    compressions = first.compression if own == entry.name else ()
    kept = compressions[0] if len(compressions) == 1 and compressions[0] in entry.compressions else None
    return storage, kept


def open_writer(destination: Destination, staged_path: Path, name: str) -> Writer:
    """Start writing.

    Parameters
    ----------
    destination
        From `plan_destination`.
    staged_path
        The path to write to; see `pc2scan.files.outputs.staged_output`.
    name
        The final name; a rosbag2 directory's file is named after it.

    Raises
    ------
    OutputError
        If it cannot be created.
    """
    options = {"compression": destination.compression}
    if destination.format.storages:
        options |= {"name": name, "storage": destination.file_format.name}
    if destination.format.profiles:
        options["profile"] = destination.profile
    writer = destination.format.open_writer
    assert writer is not None  # a destination without one is never planned
    return writer(staged_path, **options)
