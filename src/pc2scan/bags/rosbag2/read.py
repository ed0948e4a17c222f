"""Reads rosbag2 directories: merges the storage files, and adds information from metadata.yaml.

Versions of metadata.yaml (source: rosbag2_storage/yaml.hpp and bag_metadata.hpp):

========  ==============================================================================
version   additions
========  ==============================================================================
1, 2      (first versions; paths begin with the directory's name)
3         ``compression_format`` and ``compression_mode``
4         ``offered_qos_profiles`` (YAML in a string, enumerations as numbers)
5         ``files``, with times and counts
6         ``custom_data``
7         ``type_description_hash``
8         ``ros_distro``
9         ``offered_qos_profiles`` as a list, enumerations by name
========  ==============================================================================

Keys are read from any version that has them.
"""

from __future__ import annotations

from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any

from pc2scan.bags import zstd
from pc2scan.bags.damage import RECOVER, DamageLog
from pc2scan.bags.folders import METADATA_NAME, refuse_unrelated, storage_files, storage_of
from pc2scan.bags.formats import and_list, storages
from pc2scan.bags.merged import MergedReader
from pc2scan.bags.opening import open_recording, sniff
from pc2scan.bags.reader import ConnectionLimit
from pc2scan.bags.topics import latches
from pc2scan.errors import DamageError, RecordingError
from pc2scan.files.paths import exists
from pc2scan.files.source_file import open_text
from pc2scan.files.yaml import MAX_CHARACTERS, dump_yaml, load_yaml
from pc2scan.model import Connection

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.files.outputs import Record
    from pc2scan.model import Metadata

#: The name of the MCAP metadata record in which rosbag2 repeats metadata.yaml.
RECORD_NAME = "rosbag2"

ROOT = "rosbag2_bagfile_information"
#: The newest version that is read; and the one that is written, which all of ROS 2 since Iron reads.
NEWEST_VERSION, WRITTEN_VERSION = 9, 8
#: Endings of SQLite's files beside a database.
_LOGS = ("-wal", "-shm", "-journal")

_WITHOUT_METADATA = f"move {METADATA_NAME} away to have the files beside it read without it"


@dataclass(frozen=True, slots=True)
class BagInfo:
    """The used contents of metadata.yaml.

    Attributes
    ----------
    topics
        Connections with ids from 1 on.
    message_count
        In all; None if it is not there.
    is_guessed
        Whether there is no metadata.yaml, so that only the files say what the recording is.
    """

    files: tuple[str, ...]
    message_compression: str = "none"
    topics: tuple[Connection, ...] = ()
    message_count: int | None = None
    is_guessed: bool = False


def read_info(folder: Path, log: DamageLog) -> BagInfo:
    """Read metadata.yaml; without one, use the names of the files.

    ``log`` gets the error of one that cannot be parsed; the files are then read without it.

    Raises
    ------
    RecordingError
        If it cannot be read, the recording is of an unsupported kind, or there is none.
    """
    path = folder / METADATA_NAME
    try:
        if not exists(path):
            return replace(_guess_info(folder), is_guessed=True)
        with open_text(path) as file:
            # One more than allowed, so that longer text is refused.
            text = file.read(MAX_CHARACTERS + 1)
        return _parse_info(load_yaml(text))
    except UnicodeDecodeError as err:
        log.note(DamageError(f"is not UTF-8: {err.reason}", path=path, hint=_WITHOUT_METADATA))
    except OSError as err:
        raise RecordingError(f"cannot be read: {err.strerror}", path=Path(err.filename or path)) from err
    except RecordingError as err:
        # It is sound, but the recording is of an unsupported kind.
        err.path, err.hint = path, _WITHOUT_METADATA
        raise
    except ValueError as err:
        log.note(DamageError(str(err), path=path, hint=_WITHOUT_METADATA))
    return _guess_info(folder)


def locate_files(folder: Path, names: Iterable[str]) -> tuple[dict[str, Path | None], list[str]]:
    """Find the files that metadata.yaml names, also if they were compressed, decompressed or renamed since.

    If as many files of a recording are in the directory without being named, they are the missing ones, renamed.
    Returns None for each file that is not there, and remarks about renamed ones.
    """
    paths = {name: _locate_file(folder, name) for name in names}
    missing = [name for name, path in paths.items() if path is None]
    others = [path for path in storage_files(folder) if path not in paths.values()] if missing else []
    renamed = dict(zip(missing, others, strict=True)) if len(missing) == len(others) else {}
    what = "which is not in the directory"
    return paths | renamed, [
        f"{folder / METADATA_NAME} names {name:.300}, {what}; {path.name} is read in its place"
        for name, path in renamed.items()
    ]


def _locate_file(folder: Path, name: str) -> Path | None:
    plain = zstd.without_suffix(name)
    for candidate in (name, plain, *(plain + suffix for suffix in zstd.SUFFIXES)):
        # The name may be too long.
        with suppress(OSError):
            if (folder / candidate).is_file():
                return folder / candidate
    return None


def missing_error(folder: Path, name: str) -> DamageError:
    """Return the error of a file that metadata.yaml names, and that is not there."""
    return DamageError(
        f"{METADATA_NAME} names {name:.300}, which is not in the directory",
        path=folder,
        hint=f"copy the missing file, or move {METADATA_NAME} away to read the files that are there",
    )


def recorded_in(folder: Path) -> Record | str:
    """Return the record of a directory's files that its metadata.yaml is; text if it is none: the reason.

    A recording's files are its metadata.yaml, the storage files that this names, and the logs beside them.
    """
    if not (folder / METADATA_NAME).is_file():
        return f"it has no {METADATA_NAME}"
    try:
        info = read_info(folder, DamageLog(strict=True))
    except RecordingError as err:
        # If the disk fails, the contents are unknown.
        if isinstance(err.__cause__, OSError):
            raise
        return f"its {METADATA_NAME} is not understood: {err.message}"
    plain = {zstd.without_suffix(name) for name in info.files if storage_of(name) is not None}
    # Not what it names in other folders: versions 1 and 2 begin with the directory's name.
    plain = {name for name in plain if "/" not in name}
    own = (METADATA_NAME, *(name + suffix for name in plain for suffix in ("", *zstd.SUFFIXES, *_LOGS)))
    return dict.fromkeys(own)


def _guess_info(folder: Path) -> BagInfo:
    files = storage_files(folder)
    storages = sorted({storage_of(file.name) or "" for file in files})
    if not files:
        raise RecordingError(f"has neither {METADATA_NAME} nor .db3 or .mcap files", path=folder)
    if len(storages) > 1:
        raise RecordingError(
            f"has {' and '.join(storages)} files, but no {METADATA_NAME} that shows which are the recording",
            path=folder,
            hint="name the files themselves",
        )
    return BagInfo(tuple(file.name for file in files))


def _parse_info(document: Any) -> BagInfo:
    root = _get(document, ROOT, dict, "the file")
    version = _get(root, "version", int, ROOT)
    if not 1 <= version <= NEWEST_VERSION:
        raise RecordingError(f"has version {version}; 1 to {NEWEST_VERSION} are known")
    files = [_file_name(path) for path in _get(root, "relative_file_paths", list, ROOT)]
    if not files:
        raise ValueError("names no files")
    entries = _get(root, "topics_with_message_count", list, ROOT, [])
    topics = tuple(_read_topic(number, entry) for number, entry in enumerate(entries, 1))
    return BagInfo(
        files=tuple(dict.fromkeys(files)),
        message_compression=_message_compression(root),
        topics=topics,
        message_count=_get(root, "message_count", int, ROOT, 0),
    )


def _get(mapping: Any, key: str, kind: type, where: str, default: Any = None) -> Any:
    """Return a value of a mapping, checked; a missing or null value is the default, or an error if that is None."""
    value = mapping.get(key) if isinstance(mapping, dict) else None
    if value is None and default is not None:
        return default
    if not isinstance(value, kind) or isinstance(value, bool):
        fault = "is missing" if value is None else f"is {value!r:.60}"
        raise ValueError(f"{key} of {where} {fault}, expected {_KINDS[kind]}")  # noqa: TRY004 - of a file
    return value


_KINDS = {dict: "a mapping", list: "a list", int: "an integer", str: "text"}


def _file_name(path: Any) -> str:
    """Return the last part of a path, since files outside the directory are not part of the recording."""
    name = PureWindowsPath(path).name if isinstance(path, str) else ""
    if name in {"", ".."}:
        raise ValueError(f"relative_file_paths names {path!r:.60}, expected a file")
    return name


def _message_compression(root: Any) -> str:
    mode = _get(root, "compression_mode", str, ROOT, "").lower()
    if mode in {"", "none", "storage"}:
        return "none"
    if mode not in {"file", "message"}:
        raise RecordingError(f"has compression_mode {mode!r}, expected none, file or message")
    name = _get(root, "compression_format", str, ROOT, "").lower()
    if name != "zstd":
        raise RecordingError(f"has compression_format {name!r}; only zstd can be read")
    # Compressed files are detected by their content.
    return "zstd" if mode == "message" else "none"


def _read_topic(number: int, entry: Any) -> Connection:
    where = f"topic {number}"
    topic = _get(entry, "topic_metadata", dict, where)
    qos = topic.get("offered_qos_profiles") or ""
    if not isinstance(qos, str):
        qos = dump_yaml(qos)
    return Connection(
        id=number,
        topic=_get(topic, "name", str, where),
        msgtype=_get(topic, "type", str, where),
        serialization=_get(topic, "serialization_format", str, where, "cdr"),
        digest=_get(topic, "type_description_hash", str, where, ""),
        latching=latches(qos),
        qos=qos,
        message_count=_get(entry, "message_count", int, where, 0),
    )


# --- The directory ---


class Rosbag2Reader(MergedReader):
    """Reads a rosbag2 directory.

    The files of a split recording are merged by time. Without metadata.yaml the storage files are read in the
    natural order of their names. Where metadata.yaml and the storage disagree, the storage is right; what it
    lacks (QoS profiles and hashes in older files, topics without messages) comes from metadata.yaml.

    Parameters
    ----------
    path
        The directory. Only files in it are opened, whatever metadata.yaml names.
    strict
        Whether damage is an error, and so are a missing file and messages that metadata.yaml counts and the files do
        not have; otherwise everything else is read, and `damage` has the rest.

    Raises
    ------
    RecordingError
        If metadata.yaml declares something that is not supported, or no file can be read.
    UsageError
        Without metadata.yaml, if the files are several recordings.
    DamageError
        With ``strict``, if metadata.yaml cannot be understood, or a file is missing or damaged.
    """

    def __init__(self, path: Path, *, strict: bool = False) -> None:
        self.path = path
        self._log = DamageLog(strict=strict)
        self._info = read_info(path, self._log)
        opened: list[Reader] = []
        limit = ConnectionLimit(path)
        with ExitStack() as undo:
            located, self._remarks = locate_files(path, self._info.files)
            for name, file in located.items():
                try:
                    if file is None:
                        raise missing_error(path, name)
                    reader = self._open(file)
                except DamageError as err:
                    if strict or (name == self._info.files[-1] and not opened):
                        raise
                    self._log.note(err, key=name)
                    continue
                undo.callback(reader.close)
                limit.add_file(reader.connections, reader.summary.size_bytes)
                opened.append(reader)
            if self._info.is_guessed:
                refuse_unrelated(path, opened)
            super().__init__(opened, path)
            self._compare_counts()
            undo.pop_all()
        amended, added = _complete_connections(self.connections, self._info.topics)
        self._amend(amended, added)
        # With the counts and times of the storage, not of metadata.yaml.
        inner = self.summary
        compression = set(inner.compression)
        if self._info.message_compression == "zstd":
            compression = compression - {"none"} | {"zstd"}
        self.summary = inner._replace(
            container="rosbag2",
            storage=opened[0].summary.container,
            compression=tuple(sorted(compression)),
            size_bytes=sum(reader.path.stat().st_size for reader in opened),
        )

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage: that of the directory first, then file by file."""
        return (*self._log.places, *super().damage)

    @property
    def remarks(self) -> Sequence[str]:
        """What differs from metadata.yaml, and what was noticed about the messages."""
        return [*self._remarks, *super().remarks]

    def metadata(self) -> Iterator[Metadata]:
        """Yield MCAP metadata records, without rosbag2's copy of metadata.yaml, which is valid for these files only."""
        return (record for record in super().metadata() if record.name != RECORD_NAME)

    def _open(self, file: Path) -> Reader:
        try:
            name = sniff(file).partition("+")[0]
        except RecordingError as err:
            if isinstance(err.__cause__, OSError):
                raise
            raise DamageError(err.message, path=file, hint=err.hint) from err
        if name not in storages():
            raise DamageError(f"is {name}; the files of a directory are {and_list(sorted(storages()))}", path=file)
        return open_recording(file, strict=self._log.strict)

    def _compare_counts(self) -> None:
        """Note if the files have fewer messages than metadata.yaml counts."""
        stored, declared = self.summary.message_count, self._info.message_count
        # What the files themselves lack by their own damage is noted there.
        lost = [damage.messages_lost for damage in (*self._log.places, *super().damage) if damage.loses]
        if stored is None or declared is None or None in lost:
            return
        missing = declared - stored - sum(filter(None, lost))
        if missing > 0:
            problem = f"{METADATA_NAME} counts {declared} messages, its files have {stored}"
            self._log.note(DamageError(problem, path=self.path, hint=RECOVER), key="count", messages_lost=missing)


def _complete_connections(
    stored: Sequence[Connection], listed: Sequence[Connection]
) -> tuple[dict[int, Connection], list[Connection]]:
    """Return what metadata.yaml adds to the storage's connections: missing attributes, and further connections."""
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
    return amended, [replace(topic, id=unused + offset, message_count=0) for offset, topic in enumerate(missing)]
