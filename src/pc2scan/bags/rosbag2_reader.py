"""Reading rosbag2 directories: the storage files merged, and what metadata.yaml adds to them."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from . import zstd
from .merged import MergedReader
from .rosbag2_metadata import RECORD_NAME, located_file, read_info

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from .model import ChunkRule, Connection, Metadata, RawMessage, Reader, StoredChunk, Summary

__all__ = ["Rosbag2Reader"]


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
        self._info = read_info(path)
        self._unpack_messages = self._info.message_compression == "zstd" and self._info.storage == "mcap"
        files = [located_file(path, name) for name in self._info.files]
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
        packed = self._info.message_compression == "zstd" or any(zstd.is_zstd(file) for file in files)
        self._summary = replace(
            self._inner,
            container="rosbag2",
            storage=self._info.storage,
            compression=zstd.compressions(self._inner.compression) if packed else self._inner.compression,
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

    def messages_or_chunks(
        self,
        rule: ChunkRule,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[RawMessage | StoredChunk]:
        """The same; chunks stay whole unless messages are compressed by themselves."""
        if self._unpack_messages:
            return self.messages(connections, start_ns, stop_ns)
        return super().messages_or_chunks(rule, connections, start_ns, stop_ns)

    def metadata(self) -> Iterator[Metadata]:
        """MCAP metadata records, without rosbag2's copy of metadata.yaml, which is about these files only."""
        return (record for record in super().metadata() if record.name != RECORD_NAME)

    def close(self) -> None:
        """Close the files and remove what was unpacked."""
        super().close()
        self._discard_temporary()

    def _open(self, file: Path, *, verify: bool) -> Reader:
        if zstd.is_zstd(file):
            if self._temporary is None:
                self._temporary = TemporaryDirectory(prefix="pc2scan-")
            file = zstd.unpacked_file(file, Path(self._temporary.name))
        if self._info.storage == "sqlite3":
            from .sqlite3 import Sqlite3Reader  # noqa: PLC0415  (a recording needs one of the two)

            return Sqlite3Reader(file, message_compression=self._info.message_compression)
        from .mcap_reader import McapReader  # noqa: PLC0415

        return McapReader(file, verify=verify)

    def _unpacked_messages(self, messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
        for message in messages:
            data = zstd.unpacked_message(message.data, self._path, message.connection.topic)
            yield message._replace(data=data)

    def _discard_temporary(self) -> None:
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None


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
