"""Reads rosbag2's sqlite3 storage: one ``.db3`` file.

The versions of the layout differ only in tables and columns, so these are checked instead of the version:

========  ====================================================================
version   what it added
========  ====================================================================
1         tables ``topics`` and ``messages``
2         ``topics.offered_qos_profiles``
3         tables ``schema`` and ``metadata``
4         ``topics.type_description_hash``, table ``message_definitions``
========  ====================================================================

Source: rosbag2_storage_sqlite3/sqlite_storage.cpp.

SQLite stores values of any type in any column, whatever the table declares: an INTEGER column keeps 1e300, text and
blobs as they are. So whatever counts, compares or orders messages does so with `_SOUND` rows only; others are damage.

The number of rows is compared with that of times in their index. Unlike SQLite's own check, this reads no message.
"""

from __future__ import annotations

from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeAlias

from pc2scan.bags import zstd
from pc2scan.bags.damage import DamageLog
from pc2scan.bags.reader import MAX_CONNECTIONS, Chunk, ConnectionLimit, Reader
from pc2scan.bags.topics import latches
from pc2scan.errors import DamageError, RecordingError
from pc2scan.files.compression import ZSTD_MAGIC
from pc2scan.model import Connection, Definition, RawMessage, Summary, declared_counts
from pc2scan.text import counted

from .database import BLOB, SQLITE_ERRORS, TABLES, Database, as_integer, as_text

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from pathlib import Path

    from apsw import Cursor

    from pc2scan.bags.reader import Wanted

#: Limits of a chunk's bytes and rows. Loading less takes less time than handing it to another thread.
_CHUNK_BYTES, _CHUNK_ROWS = 1 << 19, 256
_WORTH_A_THREAD = 1 << 20

#: Topic, log time, rowid and data of a message.
Row: TypeAlias = tuple[int, int, int, bytes]

#: A row takes more in the file.
_ROW_BYTES = 8

#: rosbag2's index of messages by time.
_INDEX = "timestamp_idx"

#: The condition for rows of ``messages`` that have a place in the recording.
_SOUND = " AND ".join(f"typeof({column}) = 'integer'" for column in ("topic_id", "timestamp"))

_BLOB = f"SELECT {BLOB} FROM messages WHERE rowid = ?"  # noqa: S608  # constants

#: Makes messages without the constructor, which takes longer than reading a small row.
_make: Any = tuple.__new__


class Sqlite3Reader(Reader):
    """Reads a ``.db3`` file.

    Parameters
    ----------
    path
        The file. No file is written. A write-ahead log or a rollback journal that a recorder left beside it is read.
    strict
        Whether damage is an error; otherwise it is in `damage`, and reading goes on behind what SQLite cannot read.

    Raises
    ------
    RecordingError
        If it cannot be read, or is not one of rosbag2.
    DamageError
        With ``strict``, if it is damaged; without, if nothing of it can be recovered.
    """

    def __init__(self, path: Path, *, strict: bool = False) -> None:
        self.path = path
        self._log = DamageLog(strict=strict)
        self._database = Database(path, self._log)
        try:
            try:
                self._database.open()
                self._read_tables()
            except (*SQLITE_ERRORS, DamageError) as err:
                self._database.recover(err)
                self._read_tables()
        except OSError as err:
            self.close()
            raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err
        except BaseException:
            self.close()
            raise

    def _read_tables(self) -> None:
        """Check and read what the tables have without the messages."""
        database = self._database
        _check_tables(database)
        columns = database.query("SELECT name = 'timestamp' FROM pragma_index_info(?)", (_INDEX,))
        self._is_indexed = columns.fetchall() == [(1,)]
        with database.ending():
            self.connections, span = _read_connections(database, self._log, is_indexed=self._is_indexed)
        #: The topics whose messages are compressed one by one.
        self._packed_topics = _find_compressed(database, self.connections)
        self.summary = Summary(
            container="sqlite3",
            storage="",
            compression=("zstd" if self._packed_topics else "none",),
            size_bytes=database.size,
            message_count=sum(connection.message_count or 0 for connection in self.connections),
            start_ns=span[0],
            end_ns=span[1],
        )

    def chunks(self, wanted: Wanted) -> Iterator[Chunk]:
        """Yield rows by log time, as chunks; equal log times are in the order of writing.

        Rows are read while the chunks are iterated over, by the thread that does so: a database is read in order.
        """
        ids = None if wanted.connections is None else {connection.id for connection in wanted.connections}
        known = {own.id: own for own in self.connections if ids is None or own.id in ids}
        for number, (messages, size) in enumerate(self._batches(known, wanted)):
            load = partial(_load, messages)
            yield Chunk(messages[0].log_time_ns, (number,), size, load, is_quick=size < _WORTH_A_THREAD)
            # They must not stay in memory while the next ones are read.
            del messages, load

    def _batches(self, known: Mapping[int, Connection], wanted: Wanted) -> Iterator[tuple[list[RawMessage], int]]:
        """Yield some messages at a time, by log time and rowid, with the bytes of their data."""
        after: tuple[int, int] | None = None
        left = self._database.most_bytes
        while True:
            is_rebuilt = self._database.is_rebuilt
            try:
                cursor = self._select(known, wanted, after)
                rows, size = self._fetched(cursor)
                while rows:
                    after = rows[-1][1:3]
                    # Pages of a damaged tree may form a loop, and rows may share pages.
                    left -= size + _ROW_BYTES * len(rows)
                    if left < 0:
                        raise self._database.too_many_values()
                    if self._packed_topics or None in [row[3] for row in rows]:
                        rows, size = self._decompressed(known, rows)
                    if rows:
                        yield (
                            [_make(RawMessage, (known[own], stamp, data, stamp, 0)) for own, stamp, _, data in rows],
                            size,
                        )
                    del rows
                    rows, size = self._fetched(cursor)
            except (*SQLITE_ERRORS, DamageError) as err:
                # What was read meanwhile may have rebuilt it.
                if is_rebuilt or not self._database.is_rebuilt:
                    self._database.recover(err)
                    self._is_indexed = False
            else:
                return

    def _fetched(self, cursor: Cursor) -> tuple[list[Row], int]:
        """Return the next rows, up to a chunk's size, and the bytes of their data."""
        rows, size = [], 0
        for row in islice(cursor, _CHUNK_ROWS):
            data = row[3]
            rows.append(row)
            if data is None:
                (data,) = self._database.query(_BLOB, row[2:3]).fetchone() or (None,)
                rows[-1] = (*row[:3], data)
            size += len(data or b"")
            if size >= _CHUNK_BYTES:
                break
        return rows, size

    def _decompressed(self, known: Mapping[int, Connection], rows: list[Row]) -> tuple[list[Row], int]:
        """Return rows with decompressed data, and the bytes of these; rows without data are noted."""
        readable = []
        for topic_id, time_ns, row_id, data in rows:
            topic = known[topic_id].topic
            try:
                if data is None:
                    raise self._database.damage(f"row {row_id} of messages, of topic {topic!r:.80}, has no data")
                packed = topic_id in self._packed_topics
                unpacked = bytes(zstd.decompress_message(data, self.path, topic)) if packed else data
                readable.append((topic_id, time_ns, row_id, unpacked))
            except DamageError as err:
                self._log.note_message(err, row_id, time_ns)
        return readable, sum(len(row[3]) for row in readable)

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count rows, without their data; see `pc2scan.bags.reader.Reader`."""
        if start_ns is None and stop_ns is None:
            return declared_counts(connections)
        counts: dict[Any, Any] = dict.fromkeys((connection.id for connection in connections), 0)
        conditions, values = _time_conditions(start_ns, stop_ns)
        where = " AND ".join((_SOUND, *conditions))
        try:
            with self._database.ending():
                sql = f"SELECT topic_id, count(*) FROM messages WHERE {where} GROUP BY 1"  # noqa: S608
                rows = self._database.query(sql, values).fetchall()
        except (*SQLITE_ERRORS, DamageError):
            # Damage is reported when the messages are read.
            return {}
        return counts | {topic_id: count for topic_id, count in rows if topic_id in counts}

    def close(self) -> None:
        """Close the database."""
        self._database.close()
        super().close()

    def _select(self, topic_ids: Iterable[int], wanted: Wanted, after: tuple[int, int] | None) -> Cursor:
        """Select topic, time, rowid and data, by time and rowid, after ``after`` (time and rowid)."""
        times, bounds = _time_conditions(wanted.start_ns, wanted.stop_ns)
        # Not as values, of which some builds of SQLite allow 32,766.
        conditions = [f"topic_id IN ({', '.join(map(str, topic_ids))})", _SOUND, *times]
        values = [*bounds, *(after or ())]
        if after is not None:
            conditions.append("(timestamp, rowid) > (?, ?)")
        # Without INDEXED BY, SQLite may sort whole messages instead of using the index. Without an index it has to
        # sort; only ids are sorted, not messages.
        index, data = (f"INDEXED BY {_INDEX}", BLOB) if self._is_indexed else ("", "NULL")
        where = " AND ".join(conditions)
        sql = f"SELECT topic_id, timestamp, rowid, {data} FROM messages {index} WHERE {where} ORDER BY 2, 3"  # noqa: S608
        return self._database.query(sql, values)


def _load(messages: list[RawMessage], callback: Callable[[RawMessage], Any]) -> list[Any]:
    """Hand out messages; see `pc2scan.bags.reader.Chunk`."""
    return list(map(callback, messages))


def _time_conditions(start_ns: int | None, stop_ns: int | None) -> tuple[list[str], list[int]]:
    """Return SQL conditions for messages with ``start_ns <= timestamp < stop_ns``, and their values."""
    bounds = [(sign, bound) for sign, bound in ((">=", start_ns), ("<", stop_ns)) if bound is not None]
    return [f"timestamp {sign} ?" for sign, _ in bounds], [max(-(2**63), min(bound, 2**63 - 1)) for _, bound in bounds]


# --- What the tables have ---


def _check_tables(database: Database) -> None:
    """Raise if the tables are not rosbag2's."""
    needed = {
        "topics": {"id", "name", "type", "serialization_format"},
        "messages": {"id", "topic_id", "timestamp", "data"},
    }
    for table, columns in needed.items():
        if missing := columns - database.columns(table):
            raise RecordingError(
                f"is an SQLite database, but not one of rosbag2: table {table} lacks {', '.join(sorted(missing))}",
                path=database.path,
            )


def _read_connections(
    database: Database, noted: DamageLog, *, is_indexed: bool
) -> tuple[tuple[Connection, ...], tuple[int | None, int | None]]:
    """Return the connections, and the first and the last log time; messages without a topic are noted."""
    topics = _read_topics(database, noted)
    sql = f"SELECT CASE WHEN {_SOUND} THEN topic_id END, count(*) FROM messages NOT INDEXED GROUP BY 1 LIMIT ?"  # noqa: S608
    counts: dict[Any, int] = dict(database.query(sql, (MAX_CONNECTIONS + 2,)))
    unsound = counts.pop(None, 0)
    ConnectionLimit(database.path).add(count=len(counts))
    if is_indexed:
        sql = f"SELECT count(*) FROM messages INDEXED BY {_INDEX} WHERE typeof(timestamp) = 'integer'"  # noqa: S608
        ((indexed,),), sound = database.query(sql), sum(counts.values())
        if not sound <= indexed <= sound + unsound:
            raise database.damage(f"the index of timestamps has {indexed} messages, the table {sound}")
    if unsound:
        what = f"{counted(unsound, 'row')} of messages with a topic or a time that is no integer"
        noted.note(database.damage(f"has {what}"), key="rows", messages_lost=unsound)
    for topic_id, count in counts.items():
        if topic_id not in topics:
            error = database.damage(f"{counted(count, 'message', 'are')} of topic {topic_id}, which is not described")
            noted.note(error, key=("topic", topic_id), messages_lost=count)
    definitions = _read_definitions(database)
    connections = tuple(
        Connection(
            id=topic_id,
            topic=topic,
            msgtype=msgtype,
            serialization=serialization,
            definition=definitions.get((msgtype, digest)) or definitions.get((msgtype, None), Definition()),
            digest=digest,
            latching=latches(qos),
            qos=qos,
            message_count=counts.get(topic_id, 0),
        )
        for topic_id, (topic, msgtype, serialization, qos, digest) in topics.items()
    )
    # Each by itself is read from the index.
    where = f"FROM messages WHERE {_SOUND} AND topic_id IN ({', '.join(map(str, topics))})"
    (span,) = database.query(f"SELECT (SELECT min(timestamp) {where}), (SELECT max(timestamp) {where})")
    return connections, span


def _rows(database: Database, table: str) -> Iterator[Any]:
    """Yield the ids of a table's rows, and their texts as bytes; missing columns are empty."""
    if available := database.columns(table):
        columns = ", ".join(as_text(name) if name in available else "x''" for name in TABLES[table])
        sql = f"SELECT {as_integer('id')}, {columns} FROM {table} ORDER BY id LIMIT ?"  # noqa: S608  # constants
        yield from database.bounded_rows(database.query(sql, (MAX_CONNECTIONS + 1,)))


def _read_topics(database: Database, noted: DamageLog) -> dict[int, list[str]]:
    """Return name, type, serialization format, QoS profiles and hash of each topic."""
    topics: dict[int, list[str]] = {}
    limit = ConnectionLimit(database.path, database.size)
    for topic_id, *stored in _rows(database, "topics"):
        values = list(map(database.text, stored))
        if topic_id is None or topic_id in topics:
            error = database.damage(f"topic {values[0]!r:.80} has no id of its own")
            noted.note(error, key=("topics", topic_id, values[0]), messages_lost=0)
            continue
        topics[topic_id] = values
        limit.add(sum(map(len, values)))
    return topics


def _read_definitions(database: Database) -> dict[tuple[str, str | None], Definition]:
    """Return definitions by type and hash; without a hash, the first of a type."""
    definitions: dict[tuple[str, str | None], Definition] = {}
    for _, msgtype, encoding, data, digest in _rows(database, "message_definitions"):
        # rosbag2 writes "unknown" if it did not find the definition.
        if data and encoding not in {b"", b"unknown"}:
            definition = Definition(database.text(encoding), data)
            definitions.setdefault((database.text(msgtype), database.text(digest)), definition)
            definitions.setdefault((database.text(msgtype), None), definition)
    return definitions


def _find_compressed(database: Database, connections: Iterable[Connection]) -> frozenset[int]:
    """Return the topics whose messages are compressed one by one.

    The first CDR message decides: CDR begins with a zero byte, and never looks like a zstd frame. Messages in other
    serialisations may begin with any bytes, and stay as they are.
    """
    cdr = [
        connection.id for connection in connections if connection.serialization == "cdr" and connection.message_count
    ]
    sql = f"SELECT substr(data, 1, 4) FROM messages WHERE topic_id IN ({', '.join(map(str, cdr))}) LIMIT 1"  # noqa: S608
    return frozenset(cdr) if cdr and database.query(sql).fetchone() == (ZSTD_MAGIC,) else frozenset()
