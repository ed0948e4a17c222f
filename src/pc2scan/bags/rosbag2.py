"""rosbag2's directories: metadata.yaml and one or more storage files.

Versions of metadata.yaml (source: rosbag2_storage/yaml.hpp and bag_metadata.hpp):

========  ==============================================================================
version   what it added
========  ==============================================================================
1, 2      the beginning; paths are prefixed with the directory's name
3         ``compression_format`` and ``compression_mode``
4         ``offered_qos_profiles`` (YAML in a string, enumerations as numbers)
5         ``files``, with times and counts
6         ``custom_data``
7         ``type_description_hash``
8         ``ros_distro``
9         ``offered_qos_profiles`` as a list, enumerations by name
========  ==============================================================================

Reading takes keys where they are, whatever the version says.
"""

from __future__ import annotations

import io
import os
import re
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path, PureWindowsPath
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from pc2scan.errors import OutputError, RecordingError

from .merged import MergedReader
from .model import Connection, Metadata

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from .model import Attachment, Buffer, RawMessage, Reader, Summary, Writer

__all__ = ["Rosbag2Reader", "Rosbag2Writer", "is_zstd", "respelled_qos", "storage_files", "unpacked"]

METADATA_NAME = "metadata.yaml"

#: The name of the MCAP metadata record in which rosbag2 repeats metadata.yaml.
RECORD_NAME = "rosbag2"

_ROOT = "rosbag2_bagfile_information"
_NEWEST_VERSION = 9
_SUFFIXES = {".db3": "sqlite3", ".mcap": "mcap"}
_ZSTD_SUFFIXES = (".zstd", ".zst")
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

#: What rosbag2 writes for the start of a recording without messages.
_NEVER_NS = 2**63 - 1

_WITHOUT_METADATA = f"move {METADATA_NAME} away to have the files beside it read without it"

# rmw/types.h: the place in the list is the value of the enumeration.
_QOS_NAMES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": (
        "system_default",
        "automatic",
        "manual_by_node",
        "manual_by_topic",
        "unknown",
        "best_available",
    ),
}


# --- Reading ---


@dataclass(frozen=True, slots=True)
class _BagInfo:
    """What metadata.yaml says, as far as it matters. ``topics`` are connections with ids from 1 on."""

    storage: str
    files: tuple[str, ...]
    message_compression: str = "none"
    topics: tuple[Connection, ...] = ()
    custom_data: Mapping[str, str] = field(default_factory=dict)


class Rosbag2Reader(MergedReader):
    """A rosbag2 directory; satisfies `pc2scan.bags.model.Reader`.

    The files of a split recording are merged by time. Without metadata.yaml the storage files are read in the
    natural order of their names. Where metadata.yaml and the storage disagree, the storage is right; what it
    lacks (QoS profiles and hashes in older files, topics without messages) comes from metadata.yaml.

    Parameters
    ----------
    path
        The directory. Only files in it are opened, whatever metadata.yaml names.
    verify
        Whether checksums of MCAP files are verified.

    Raises
    ------
    RecordingError
        If metadata.yaml cannot be understood, or a file is missing or cannot be read.
    """

    def __init__(self, path: Path, *, verify: bool = True) -> None:
        self._path = path
        self._temporary: TemporaryDirectory[str] | None = None
        self._info = _read_info(path)
        self._unpack_messages = self._info.message_compression == "zstd" and self._info.storage == "mcap"
        files = [_located(path, name) for name in self._info.files]
        opened: list[Reader] = []
        with ExitStack() as undo:
            undo.callback(self._discard_temporary)
            for file in files:
                reader = self._open(file, verify=verify)
                undo.callback(reader.close)
                opened.append(reader)
            super().__init__(opened)
            undo.pop_all()
        amended, added = _completed(self.connections, self._info.topics)
        self._amend(amended, added)
        self._inner = super().summary
        packed = self._info.message_compression == "zstd" or any(is_zstd(file) for file in files)
        self._summary = replace(
            self._inner,
            container="rosbag2",
            storage=self._info.storage,
            compression=_compressions(self._inner.compression) if packed else self._inner.compression,
            size_bytes=sum(file.stat().st_size for file in files),
        )

    @property
    def path(self) -> Path:
        """The directory."""
        return self._path

    @property
    def summary(self) -> Summary:
        """Counts and times are the storage's, not metadata.yaml's."""
        return self._summary

    @property
    def bytes_read(self) -> int:
        """Bytes consumed so far; of compressed files the share."""
        return super().bytes_read * self._summary.size_bytes // max(1, self._inner.size_bytes)

    @property
    def custom_data(self) -> Mapping[str, str]:
        """metadata.yaml's ``custom_data``."""
        return self._info.custom_data

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[RawMessage]:
        """Messages of all files by log time; equal log times in the order of the files."""
        messages = super().messages(connections, start_ns, stop_ns)
        return self._unpacked_messages(messages) if self._unpack_messages else messages

    def metadata(self) -> Iterator[Metadata]:
        """MCAP metadata records, without rosbag2's copy of metadata.yaml, which is about these files only."""
        return (record for record in super().metadata() if record.name != RECORD_NAME)

    def close(self) -> None:
        """Close the files and remove what was unpacked."""
        super().close()
        self._discard_temporary()

    def _open(self, file: Path, *, verify: bool) -> Reader:
        if is_zstd(file):
            if self._temporary is None:
                self._temporary = TemporaryDirectory(prefix="pc2scan-")
            file = unpacked(file, Path(self._temporary.name))
        if self._info.storage == "sqlite3":
            from .sqlite3 import Sqlite3Reader  # noqa: PLC0415  (a recording needs one of the two)

            return Sqlite3Reader(file, message_compression=self._info.message_compression)
        from .mcap import McapReader  # noqa: PLC0415

        return McapReader(file, verify=verify)

    def _unpacked_messages(self, messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
        from .sqlite3 import decompressed_message  # noqa: PLC0415

        for message in messages:
            data = decompressed_message(message.data, self._path, message.connection.topic)
            yield message._replace(data=data)

    def _discard_temporary(self) -> None:
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None


def storage_files(folder: Path) -> list[Path]:
    """Files of a directory that are named like rosbag2's storages, in natural order: 2 comes before 10."""
    found = [path for path in folder.iterdir() if path.is_file() and _storage_of(path.name) is not None]
    return sorted(
        found, key=lambda path: [int(part) if part.isdigit() else part for part in _parts(path.name)]
    )


def is_zstd(path: Path) -> bool:
    """Whether a file is compressed as a whole, by its content."""
    try:
        with path.open("rb") as file:
            return file.read(4) == _ZSTD_MAGIC
    except OSError as err:
        raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err


def unpacked(path: Path, folder: Path) -> Path:
    """Decompress a zstd file into a directory, in pieces; returns the new file.

    Raises
    ------
    RecordingError
        If it is damaged, or the result does not fit.
    """
    import zstandard  # noqa: PLC0415  (only compressed recordings need it)

    name = path.name
    for suffix in _ZSTD_SUFFIXES:
        name = name.removesuffix(suffix)
    target = folder / name
    try:
        with path.open("rb") as packed, target.open("wb") as out:
            complete = True
            decoder = zstandard.ZstdDecompressor().decompressobj()
            # Small pieces: zeros shrink to a thirty-thousandth, and a piece's result is held in memory.
            while piece := packed.read(1 << 14):
                while piece:
                    out.write(decoder.decompress(piece))
                    complete, piece = decoder.eof, decoder.unused_data
                    if complete:
                        # Another frame may follow: pzstd writes many.
                        decoder = zstandard.ZstdDecompressor().decompressobj()
        if not complete:
            raise RecordingError("cannot be decompressed: it is cut off", path=path)
    except zstandard.ZstdError as err:
        raise RecordingError(f"cannot be decompressed: {err}", path=path) from err
    except OSError as err:
        raise RecordingError(
            f"cannot be decompressed: {err.strerror}",
            path=path,
            hint=f"it is unpacked in {folder.parent}; the environment variable TMPDIR names another place",
        ) from err
    return target


def _parts(name: str) -> list[str]:
    # Text and numbers take turns, so that only like is compared with like.
    return re.split(r"(\d+)", name, flags=re.ASCII)


def _storage_of(name: str) -> str | None:
    for suffix in _ZSTD_SUFFIXES:
        name = name.removesuffix(suffix)
    return _SUFFIXES.get(Path(name).suffix)


def _located(folder: Path, name: str) -> Path:
    """A file that metadata.yaml names, or its like: files get packed and unpacked without it being told."""
    plain = name
    for suffix in _ZSTD_SUFFIXES:
        plain = plain.removesuffix(suffix)
    for candidate in (name, plain, *(plain + suffix for suffix in _ZSTD_SUFFIXES)):
        if (folder / candidate).is_file():
            return folder / candidate
    raise RecordingError(
        f"{METADATA_NAME} names {name}, which is not in the directory",
        path=folder,
        hint=f"copy the missing file, or move {METADATA_NAME} away to read the files that are there",
    )


def _compressions(stored: Sequence[str]) -> tuple[str, ...]:
    """With zstd around it, the storage's own ``none`` is none no longer."""
    return tuple(sorted({"zstd", *stored} - {"none"}))


def _read_info(folder: Path) -> _BagInfo:
    path = folder / METADATA_NAME
    try:
        if not os.path.lexists(path):
            return _guessed_info(folder)
        text = path.read_text("utf-8")
    except UnicodeDecodeError as err:
        raise RecordingError(f"is not UTF-8: {err.reason}", path=path, hint=_WITHOUT_METADATA) from err
    except OSError as err:
        raise RecordingError(f"cannot be read: {err.strerror}", path=Path(err.filename or path)) from err
    try:
        return _parsed_info(_parsed_yaml(text))
    except ValueError as err:
        raise RecordingError(str(err), path=path, hint=_WITHOUT_METADATA) from err


def _guessed_info(folder: Path) -> _BagInfo:
    files = storage_files(folder)
    storages = sorted({_storage_of(file.name) or "" for file in files})
    if not files:
        raise RecordingError(f"has neither {METADATA_NAME} nor .db3 or .mcap files", path=folder)
    if len(storages) > 1:
        raise RecordingError(
            f"has {' and '.join(storages)} files, but no {METADATA_NAME} that tells which are the recording",
            path=folder,
            hint="name the files themselves",
        )
    return _BagInfo(storages[0], tuple(file.name for file in files))


def _parsed_yaml(text: str) -> Any:
    from ruamel.yaml import YAML  # noqa: PLC0415  (only rosbag2 directories need it)
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    try:
        return YAML(typ="safe", pure=True).load(text)
    except (YAMLError, RecursionError) as err:
        mark = getattr(err, "problem_mark", None)
        place = f" in line {mark.line + 1}" if mark is not None else ""
        raise ValueError(f"is not valid YAML{place}: {getattr(err, 'problem', None) or err}") from err


def _parsed_info(document: Any) -> _BagInfo:
    root = _get(document, _ROOT, dict, "the file")
    version = _get(root, "version", int, _ROOT)
    if not 1 <= version <= _NEWEST_VERSION:
        raise ValueError(f"has version {version}; 1 to {_NEWEST_VERSION} are known")
    storage = _get(root, "storage_identifier", str, _ROOT)
    if storage not in _SUFFIXES.values():
        raise ValueError(f"has storage {storage!r}; {' and '.join(sorted(_SUFFIXES.values()))} can be read")
    files = [_file_name(path) for path in _get(root, "relative_file_paths", list, _ROOT)]
    if not files:
        raise ValueError("names no files")
    return _BagInfo(
        storage=storage,
        files=tuple(dict.fromkeys(files)),
        message_compression=_message_compression(root),
        topics=tuple(
            _topic(number, entry)
            for number, entry in enumerate(_get(root, "topics_with_message_count", list, _ROOT, []), 1)
        ),
        custom_data={
            str(key): str(value) for key, value in _get(root, "custom_data", dict, _ROOT, {}).items()
        },
    )


def _get(mapping: Any, key: str, kind: type, where: str, default: Any = None) -> Any:
    """One value of a mapping, checked; absent or null gives the default, which None makes an error."""
    value = mapping.get(key) if isinstance(mapping, dict) else None
    if value is None and default is not None:
        return default
    if not isinstance(value, kind) or isinstance(value, bool):
        found = "is missing" if value is None else f"is {value!r:.60}"
        raise ValueError(f"{key} of {where} {found}, expected {_KINDS[kind]}")  # noqa: TRY004 - of a file
    return value


_KINDS = {dict: "a mapping", list: "a list", int: "an integer", str: "text"}


def _file_name(path: Any) -> str:
    """The last part of a path: what lies outside the directory is not part of the recording."""
    name = PureWindowsPath(path).name if isinstance(path, str) else ""
    if name in {"", ".."}:
        raise ValueError(f"relative_file_paths names {path!r:.60}, expected a file")
    return name


def _message_compression(root: Any) -> str:
    mode = _get(root, "compression_mode", str, _ROOT, "").lower()
    if mode in {"", "none", "storage"}:
        return "none"
    if mode not in {"file", "message"}:
        raise ValueError(f"has compression_mode {mode!r}, expected none, file or message")
    name = _get(root, "compression_format", str, _ROOT, "").lower()
    if name != "zstd":
        raise ValueError(f"has compression_format {name!r}; only zstd can be read")
    # Compressed files are recognised by their content.
    return "zstd" if mode == "message" else "none"


def _topic(number: int, entry: Any) -> Connection:
    from .mcap import latches  # noqa: PLC0415

    where = f"topic {number}"
    topic = _get(entry, "topic_metadata", dict, where)
    qos = topic.get("offered_qos_profiles") or ""
    if not isinstance(qos, str):
        qos = _dumped(qos)
    return Connection(
        id=number,
        topic=_get(topic, "name", str, where),
        msgtype=_get(topic, "type", str, where),
        serialization=_get(topic, "serialization_format", str, where, "cdr"),
        digest=_get(topic, "type_description_hash", str, where, ""),
        latching=latches(qos),
        qos=qos,
        message_count=0,
    )


def _completed(
    stored: Sequence[Connection], listed: Sequence[Connection]
) -> tuple[dict[int, Connection], list[Connection]]:
    """What metadata.yaml adds to the storage's connections: their missing parts, and further connections."""
    by_name = {(topic.topic, topic.msgtype): topic for topic in reversed(listed)}
    amended = {}
    for connection in stored:
        topic = by_name.get((connection.topic, connection.msgtype))
        if topic is not None:
            amended[connection.id] = replace(
                connection,
                serialization=connection.serialization or topic.serialization,
                digest=connection.digest or topic.digest,
                latching=connection.latching if connection.qos else topic.latching,
                qos=connection.qos or topic.qos,
            )
    names = {(connection.topic, connection.msgtype) for connection in stored}
    unused = max((connection.id for connection in stored), default=0) + 1
    missing = [topic for topic in listed if (topic.topic, topic.msgtype) not in names]
    return amended, [replace(topic, id=unused + offset) for offset, topic in enumerate(missing)]


# --- Writing ---


class Rosbag2Writer:
    """A rosbag2 directory being written, with one storage file; satisfies `pc2scan.bags.model.Writer`.

    Nothing in it depends on the machine: ``ros_distro`` is empty.

    Parameters
    ----------
    path
        The directory; must not exist.
    name
        What the directory will be called, which its files' names begin with.
    storage
        ``mcap`` or ``sqlite3``.
    compression
        With ``mcap``: ``none``, ``lz4`` or ``zstd``, inside the file. With ``sqlite3``: ``none``, or
        ``zstd``, message by message.
    metadata_version
        8 (to ROS 2 Iron) or 9 (from Jazzy on). QoS profiles are spelled accordingly: enumerations as numbers
        or by name. Profiles that cannot be understood, and unknown or missing keys, stay as they are.
    custom_data
        For metadata.yaml.

    Raises
    ------
    OutputError
        From every method, if it cannot be written.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        *,
        storage: str = "mcap",
        compression: str = "none",
        metadata_version: int = 8,
        custom_data: Mapping[str, str] | None = None,
    ) -> None:
        self._path = path
        self._storage_name = storage
        self._version = metadata_version
        self._custom_data = dict(custom_data or {})
        self._message_compression = compression if storage == "sqlite3" else "none"
        self._file_name = f"{name}_0.{'db3' if storage == 'sqlite3' else 'mcap'}"
        self._connections: dict[int, Connection] = {}
        self._counts: dict[int, int] = {}
        self._span_ns: tuple[int, int] | None = None
        try:
            path.mkdir()
        except OSError as err:
            raise self._failed(err) from err
        self._storage: Writer
        self._keep_info: Callable[[str], None]
        file = path / self._file_name
        if storage == "sqlite3":
            from .sqlite3 import Sqlite3Writer  # noqa: PLC0415  (a recording needs one of the two)

            database = Sqlite3Writer(file, compression=compression)
            self._keep_info = lambda text: database.add_bag_metadata(metadata_version, text)
            self._storage = database
        else:
            from .mcap import McapWriter  # noqa: PLC0415

            mcap = McapWriter(file, compression, "ros2")
            self._keep_info = lambda text: mcap.add_metadata(
                Metadata(RECORD_NAME, {"serialized_metadata": text})
            )
            self._storage = mcap

    def add_connection(self, connection: Connection) -> int:
        """Declare a topic, with type and QoS profiles as rosbag2 spells them."""
        qos = respelled_qos(connection.qos, by_name=self._version >= _NEWEST_VERSION)
        # The MCAP writer prefers the text among the channel's metadata.
        metadata = {
            key: qos if key == "offered_qos_profiles" else value for key, value in connection.metadata.items()
        }
        msgtype = connection.ros_type if connection.serialization == "cdr" else connection.msgtype
        spelled = replace(connection, msgtype=msgtype, qos=qos, metadata=metadata)
        handle = self._storage.add_connection(spelled)
        self._connections[handle] = spelled
        self._counts[handle] = 0
        return handle

    def write(
        self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0
    ) -> None:
        """Append a message."""
        self._storage.write(handle, log_time_ns, data, publish_time_ns, sequence)
        self._counts[handle] += 1
        first_ns, last_ns = self._span_ns or (log_time_ns, log_time_ns)
        self._span_ns = (min(first_ns, log_time_ns), max(last_ns, log_time_ns))

    def add_attachment(self, attachment: Attachment) -> None:
        """Append an attachment, if the storage is MCAP."""
        self._storage.add_attachment(attachment)

    def add_metadata(self, metadata: Metadata) -> None:
        """Append a metadata record, if the storage is MCAP; rosbag2's own about other files is ignored."""
        if metadata.name != RECORD_NAME:
            self._storage.add_metadata(metadata)

    def finish(self) -> None:
        """Finish the storage, write metadata.yaml, and put everything on the disk."""
        from .staging import sync_directory  # noqa: PLC0415

        info = self._info()
        self._keep_info(_dumped(info).rstrip("\n"))
        self._storage.finish()
        try:
            with (self._path / METADATA_NAME).open("x", encoding="utf-8", newline="\n") as file:
                file.write(_dumped({_ROOT: info}))
                file.flush()
                os.fsync(file.fileno())
            sync_directory(self._path)
        except OSError as err:
            raise self._failed(err) from err

    def abort(self) -> None:
        """Release the storage; the directory is left for the caller to remove."""
        self._storage.abort()

    def _info(self) -> dict[str, Any]:
        packed = self._message_compression != "none"
        return {
            "version": self._version,
            "storage_identifier": self._storage_name,
            **self._extent(),
            "topics_with_message_count": [
                {"topic_metadata": self._topic(connection), "message_count": self._counts[handle]}
                for handle, connection in self._connections.items()
            ],
            "compression_format": self._message_compression if packed else "",
            "compression_mode": "MESSAGE" if packed else "",
            "relative_file_paths": [self._file_name],
            "files": [{"path": self._file_name, **self._extent()}],
            "custom_data": self._custom_data or None,
            "ros_distro": "",
        }

    def _extent(self) -> dict[str, Any]:
        first_ns, last_ns = self._span_ns or (_NEVER_NS, _NEVER_NS)
        return {
            "duration": {"nanoseconds": last_ns - first_ns},
            "starting_time": {"nanoseconds_since_epoch": first_ns},
            "message_count": sum(self._counts.values()),
        }

    def _topic(self, connection: Connection) -> dict[str, Any]:
        qos: Any = connection.qos
        if self._version >= _NEWEST_VERSION:
            profiles = _profiles(qos) if qos else []
            qos = qos if profiles is None else profiles
        return {
            "name": connection.topic,
            "type": connection.msgtype,
            "serialization_format": connection.serialization,
            "offered_qos_profiles": qos,
            "type_description_hash": connection.digest,
        }

    def _failed(self, err: OSError) -> OutputError:
        return OutputError(f"cannot be written: {err.strerror}", path=self._path)


def respelled_qos(text: str, *, by_name: bool) -> str:
    r"""Spell the enumerations of QoS profiles as names (metadata version 9) or as numbers (before).

    Text that is spelled so already, or is not a list of profiles, is returned verbatim. Unknown or missing
    keys and values stay as they are.

    >>> respelled_qos("- depth: 10\n  durability: 1", by_name=True)
    '- depth: 10\n  durability: transient_local'
    """
    profiles = _profiles(text) if text else None
    if profiles is None:
        return text
    changed = [
        {
            key: _respelled(key, value, by_name=by_name) if key in _QOS_NAMES else value
            for key, value in profile.items()
        }
        for profile in profiles
    ]
    return text if changed == profiles else _dumped(changed).rstrip("\n")


def _respelled(key: str, value: Any, *, by_name: bool) -> Any:
    names = _QOS_NAMES[key]
    if by_name and isinstance(value, int) and not isinstance(value, bool):
        return names[value] if 0 <= value < len(names) else value
    if not by_name and isinstance(value, str) and value.lower() in names:
        return names.index(value.lower())
    return value


def _profiles(text: str) -> list[dict[str, Any]] | None:
    with suppress(ValueError):
        loaded = _parsed_yaml(text)
        if isinstance(loaded, list) and all(isinstance(profile, dict) for profile in loaded):
            return loaded
    return None


def _dumped(value: Any) -> str:
    """YAML in block style, keys in the order given, strings on one line."""
    from ruamel.yaml import YAML  # noqa: PLC0415  (only rosbag2 directories need it)

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # declared as None
    yaml.allow_unicode = True
    yaml.width = 1 << 20
    stream = io.StringIO()
    yaml.dump(value, stream)
    return stream.getvalue()
