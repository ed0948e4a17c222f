"""Writes rosbag2 directories: storage files, and metadata.yaml."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pc2scan.bags.folders import METADATA_NAME
from pc2scan.bags.formats import storages
from pc2scan.bags.mcap.write import McapWriter
from pc2scan.bags.qos import MAX_CHARACTERS, respell_qos
from pc2scan.errors import OutputError, UnwritableError
from pc2scan.files.system import sync_directory
from pc2scan.files.yaml import dump_yaml
from pc2scan.model import MAX_ROSBAG2_NS, Connection, Metadata

from .read import RECORD_NAME, ROOT, WRITTEN_VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from pathlib import Path

    from pc2scan.model import Attachment, Buffer, StoredChunk
    from pc2scan.threads import Threads


def open_mcap_storage(path: Path, compression: str) -> tuple[McapWriter, Callable[[str], None]]:
    """Start the MCAP file of a directory, which repeats metadata.yaml; see `pc2scan.bags.formats.Format`."""
    writer = McapWriter(path, compression)
    return writer, lambda text: writer.add_metadata(Metadata(RECORD_NAME, {"serialized_metadata": text}))


class Rosbag2Writer:
    """Writes a rosbag2 directory with one storage file; see `pc2scan.model.Writer`.

    Nothing in it depends on the machine: ``ros_distro`` is empty.

    Parameters
    ----------
    path
        The directory; must not exist.
    name
        The final name of the directory; the names of its files begin with it.
    storage
        ``mcap`` or ``sqlite3``.
    compression
        With ``mcap``: ``none``, ``lz4`` or ``zstd``, inside the file. With ``sqlite3``: ``none``, or
        ``zstd``, message by message.

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
    ) -> None:
        self._path = path
        self._storage_name = storage
        entry = storages()[storage]
        self._message_compression = compression if entry.packs_messages else "none"
        self._connections: dict[int, Connection] = {}
        self._counts: dict[int, int] = {}
        self._first_ns, self._last_ns = MAX_ROSBAG2_NS, -MAX_ROSBAG2_NS - 1
        try:
            path.mkdir()
        except OSError as err:
            raise self._write_error(err) from err
        assert entry.open_storage is not None
        self._file = path / f"{name}_0{entry.suffix}"
        self._storage, self._keep_info = entry.open_storage(self._file, compression)

    def keep_ids(self, connections: Collection[Connection]) -> None:
        """Reserve the ids of these connections, so that they keep them when they are declared."""
        self._storage.keep_ids(connections)

    def compress_ahead(self, pool: Threads) -> None:
        """Compress on these threads from now on; the written bytes stay the same."""
        self._storage.compress_ahead(pool)

    def add_connection(self, connection: Connection) -> int:
        """Declare a topic, with type and QoS profiles in rosbag2's spelling."""
        connection = connection.in_utf8
        qos = respell_qos(connection.qos)
        # The MCAP writer prefers the text in the channel's metadata.
        metadata = {key: qos if key == "offered_qos_profiles" else value for key, value in connection.metadata.items()}
        msgtype = connection.ros_type if connection.serialization == "cdr" else connection.msgtype
        spelled = replace(connection, msgtype=msgtype, qos=qos, metadata=metadata)
        handle = self._storage.add_connection(spelled)
        self._connections[handle] = spelled
        self._counts[handle] = 0
        return handle

    def declarations(self) -> frozenset[bytes]:
        """Return the declarations so far that a chunk may repeat."""
        return self._storage.declarations()

    def write(self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0) -> None:
        """Append a message.

        Raises
        ------
        UnwritableError
            If its log time is more than the format can hold; nothing is written then.
        """
        if not -(2**63) <= log_time_ns < 2**63:
            raise UnwritableError(
                f"log time {log_time_ns} ns is beyond the {MAX_ROSBAG2_NS} ns that rosbag2 can hold",
                path=self._path,
                topic=self._connections[handle].topic,
            )
        self._storage.write(handle, log_time_ns, data, publish_time_ns, sequence)
        self._counts[handle] += 1
        # Not `min` and `max`, which take longer than inserting a small row.
        if log_time_ns < self._first_ns:  # noqa: PLR1730
            self._first_ns = log_time_ns
        if log_time_ns > self._last_ns:  # noqa: PLR1730
            self._last_ns = log_time_ns

    def write_chunk(self, chunk: StoredChunk) -> None:
        """Append a whole chunk, if the storage is MCAP."""
        self._storage.write_chunk(chunk)
        for handle, entries in chunk.index.items():
            self._counts[handle] += len(entries)
        first_ns, last_ns = chunk.span_ns()
        self._first_ns, self._last_ns = min(self._first_ns, first_ns), max(self._last_ns, last_ns)

    def add_attachment(self, attachment: Attachment) -> None:
        """Append an attachment, if the storage is MCAP."""
        self._storage.add_attachment(attachment)

    def add_metadata(self, metadata: Metadata) -> None:
        """Append a metadata record, if the storage is MCAP; rosbag2's own about other files is ignored."""
        if metadata.name != RECORD_NAME:
            self._storage.add_metadata(metadata)

    def finish(self) -> None:
        """Finish the storage, write metadata.yaml, and put everything on the disk."""
        info = self._info()
        # The file repeats metadata.yaml's content.
        self._keep_info(dump_yaml(info).rstrip("\n"))
        self._storage.finish()
        _write_info(self._path, info)

    def abort(self) -> None:
        """Release the storage; the caller removes the directory."""
        self._storage.abort()

    def _info(self) -> dict[str, Any]:
        packed = self._message_compression != "none"
        return {
            "version": WRITTEN_VERSION,
            "storage_identifier": self._storage_name,
            **self._extent(),
            "topics_with_message_count": [
                {"topic_metadata": self._topic(connection), "message_count": self._counts[handle]}
                for handle, connection in self._connections.items()
            ],
            "compression_format": self._message_compression if packed else "",
            "compression_mode": "MESSAGE" if packed else "",
            "relative_file_paths": [self._file.name],
            "files": [{"path": self._file.name, **self._extent()}],
            "custom_data": None,
            "ros_distro": "",
        }

    def _extent(self) -> dict[str, Any]:
        """Return the times and the number of messages."""
        return {
            "duration": {"nanoseconds": max(0, self._last_ns - self._first_ns)},
            "starting_time": {"nanoseconds_since_epoch": self._first_ns},
            "message_count": sum(self._counts.values()),
        }

    def _topic(self, connection: Connection) -> dict[str, Any]:
        # A text that is too long for a list of profiles is only in the storage: writing it as YAML would take seconds.
        qos = connection.qos if len(connection.qos) <= MAX_CHARACTERS else ""
        return {
            "name": connection.topic,
            "type": connection.msgtype,
            "serialization_format": connection.serialization,
            "offered_qos_profiles": qos,
            "type_description_hash": connection.digest,
        }

    def _write_error(self, err: OSError) -> OutputError:
        return OutputError(f"cannot be written: {err.strerror}", path=self._path)


def _write_info(folder: Path, info: Mapping[str, Any]) -> None:
    """Write metadata.yaml, and wait until it is on the disk.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    try:
        with (folder / METADATA_NAME).open("x", encoding="utf-8", newline="\n") as file:
            file.write(dump_yaml({ROOT: dict(info)}))
            file.flush()
            os.fsync(file.fileno())
        sync_directory(folder)
    except OSError as err:
        raise OutputError(f"cannot be written: {err.strerror}", path=folder) from err
