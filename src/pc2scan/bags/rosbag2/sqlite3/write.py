"""Writes rosbag2's sqlite3 storage: one ``.db3`` file of schema version 4, as rosbag2 does since Iron.

It does not use rosbags' writer, which takes QoS profiles apart and puts them together again, and so refuses those with
keys missing, and which is bound to a directory of its own making.

Source: rosbag2_storage_sqlite3/sqlite_storage.cpp.
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import apsw

from pc2scan.bags.rosbag2.read import WRITTEN_VERSION
from pc2scan.errors import OutputError
from pc2scan.files.compression import compress
from pc2scan.files.new_file import WriteAhead
from pc2scan.files.outputs import sync
from pc2scan.model import Writer

from .database import connect

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from pc2scan.model import Buffer, Connection
    from pc2scan.threads import Threads

_SCHEMA = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(
  id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
  offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(
  id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(
  id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema(schema_version, ros_distro) VALUES (4, '');
"""

#: SQLite reads and writes a page with each system call: with its own 4,096 bytes large messages take twice as long.
_PAGE_BYTES = 32_768

#: Bytes of messages in a transaction. They bound SQLite's memory, and what `repair` cannot recover of a killed run.
_BATCH_BYTES = 1 << 20

#: rosbag2's default level; messages are compressed one by one, so speed matters more than size.
_ZSTD_LEVEL = 1


def open_storage(path: Path, compression: str) -> tuple[Sqlite3Writer, Callable[[str], None]]:
    """Start the file of a directory; see `pc2scan.bags.formats.Format`."""
    writer = Sqlite3Writer(path, compression=compression)
    return writer, writer.add_bag_metadata


class Sqlite3Writer(Writer):
    """Writes a ``.db3`` file; see `pc2scan.model.Writer`.

    The file has schema version 4, as rosbag2 has written it since Iron. ``ros_distro`` is empty: what is
    written must not depend on the machine. QoS profiles and definitions are written verbatim, definitions
    once a type.

    Parameters
    ----------
    path
        Must not exist.
    compression
        ``none``, or ``zstd``: every message is compressed by itself.

    Raises
    ------
    OutputError
        From every method, if the file cannot be written.
    """

    def __init__(self, path: Path, *, compression: str = "none") -> None:
        self._path = path
        self._compresses = compression == "zstd"
        self._ahead = WriteAhead()
        #: Messages to be inserted together, and the bytes of their data.
        self._rows: list[tuple[int, int, Buffer]] = []
        self._pending = 0
        self._defined: set[tuple[str, str]] = set()
        try:
            # SQLite would append to an existing file.
            path.open("xb").close()
            self._database = connect(path, "rw")
        except (OSError, apsw.Error) as err:
            raise self._write_error(err) from err
        try:
            # A file with errors is removed, so neither a journal nor syncing before the end is needed.
            pragmas = f"PRAGMA page_size={_PAGE_BYTES}; PRAGMA journal_mode=MEMORY; PRAGMA synchronous=OFF;"
            # What pages have no use for is zero: the bytes of a file depend on its content alone.
            pragmas += "PRAGMA secure_delete=ON;"
            # A statement is executed when the rows of those before it are read.
            self._database.execute(f"{pragmas} {_SCHEMA} BEGIN").fetchall()
        except apsw.Error as err:
            self.abort()
            raise self._write_error(err) from err

    def compress_ahead(self, pool: Threads) -> None:
        """Compress messages on these threads from now on; the file stays the same."""
        self._ahead.use(pool)

    def add_connection(self, connection: Connection) -> int:
        """Add a row to ``topics``, and its definition if it is the first of its type and hash."""
        self._ahead.finish()
        connection = connection.in_utf8
        definition = connection.definition
        identity = (connection.msgtype, connection.digest)
        if definition.encoding and identity not in self._defined:
            self._defined.add(identity)
            self._insert(
                "INSERT INTO message_definitions(topic_type, encoding, encoded_message_definition, "
                "type_description_hash) VALUES (?, ?, CAST(? AS TEXT), ?)",
                (connection.msgtype, definition.encoding, definition.data, connection.digest),
            )
        return self._insert(
            "INSERT INTO topics(name, type, serialization_format, offered_qos_profiles, "
            "type_description_hash) VALUES (?, ?, ?, ?, ?)",
            (connection.topic, connection.msgtype, connection.serialization, connection.qos, connection.digest),
        )

    def write(
        self,
        handle: int,
        log_time_ns: int,
        data: Buffer,
        publish_time_ns: int,  # noqa: ARG002 - the storage has one time a message
        sequence: int = 0,  # noqa: ARG002 - and no sequence number
    ) -> None:
        """Append a message."""
        if self._compresses:
            # A view would keep the whole chunk in memory.
            insert = partial(self._insert_message, handle, log_time_ns)
            self._ahead.put(partial(_compress, bytes(data)), insert, len(data))
        else:
            self._insert_message(handle, log_time_ns, data)

    def _insert_message(self, handle: int, log_time_ns: int, data: Buffer) -> None:
        self._pending += len(data)
        is_full = self._pending >= _BATCH_BYTES
        self._rows.append((log_time_ns, handle, data if is_full else bytes(data)))
        if is_full:
            self._commit()

    def _commit(self) -> None:
        rows, self._rows, self._pending = self._rows, [], 0
        self._run("INSERT INTO messages(timestamp, topic_id, data) VALUES (?, ?, ?)", rows)
        self._run("COMMIT; BEGIN")

    def add_bag_metadata(self, text: str) -> None:
        """Write rosbag2's metadata.yaml (its ``rosbag2_bagfile_information``) to the file, as rosbag2 does."""
        self._ahead.finish()
        self._insert("INSERT INTO metadata(metadata_version, metadata) VALUES (?, ?)", (WRITTEN_VERSION, text))

    def finish(self) -> None:
        """Commit, close, and put the file on the disk."""
        self._ahead.finish()
        self._commit()
        try:
            self._database.close()
            sync(self._path)
        except (OSError, apsw.Error) as err:
            raise self._write_error(err) from err

    def abort(self) -> None:
        """Close; the file is not a recording."""
        self._ahead.cancel()
        with suppress(apsw.Error):
            self._database.close()

    def _insert(self, sql: str, values: Sequence[Any]) -> int:
        self._run(sql, [values])
        return self._database.last_insert_rowid()

    def _run(self, sql: str, rows: Sequence[Sequence[Any]] = ((),)) -> None:
        """Execute a statement with the values of each row."""
        try:
            self._database.executemany(sql, rows)
        except apsw.Error as err:
            raise self._write_error(err) from err

    def _write_error(self, err: Exception) -> OutputError:
        reason = err.strerror if isinstance(err, OSError) else str(err)
        return OutputError(f"cannot be written: {reason}", path=self._path)


def _compress(data: bytes) -> bytes:
    # One for each message: a compressor works for one thread at a time.
    return bytes(compress("zstd", data, _ZSTD_LEVEL))
