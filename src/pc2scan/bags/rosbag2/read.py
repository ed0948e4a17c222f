"""Reads rosbag2 directories: merges the storage files, and adds information from metadata.yaml."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.bags.damage import RECOVER, DamageLog
from pc2scan.bags.folders import METADATA_NAME, refuse_unrelated
from pc2scan.bags.formats import and_list, storages
from pc2scan.bags.merged import MergedReader
from pc2scan.bags.opening import open_recording, sniff
from pc2scan.bags.reader import ConnectionLimit
from pc2scan.errors import DamageError, RecordingError

from .metadata import RECORD_NAME, locate_files, missing_error, read_info

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, Metadata


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
        return (*self._log.found, *super().damage)

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
        lost = [damage.messages_lost for damage in (*self._log.found, *super().damage) if damage.loses]
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
