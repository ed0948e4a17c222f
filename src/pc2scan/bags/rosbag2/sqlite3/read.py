"""Reads rosbag2's sqlite3 storage: one ``.db3`` file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import chain, islice, repeat
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from pc2scan.bags import zstd
from pc2scan.bags.damage import DamageLog
from pc2scan.bags.loading import Chunk
from pc2scan.bags.reader import Reader
from pc2scan.errors import DamageError, RecordingError
from pc2scan.model import RawMessage, Summary, declared_counts

from .database import Database
from .index import SOUND, message_row, read_tables, shown_value
from .recover import SQLITE_ERRORS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from pathlib import Path

    from pc2scan.bags.formats import ReadOptions
    from pc2scan.model import ChunkRule, Connection

#: Limits of a chunk's bytes and rows. Loading less takes less time than handing it to another thread.
_UNIT_BYTES = 1 << 19
_UNIT_ROWS = 256
_WORTH_A_THREAD = 1 << 20

_DATA = itemgetter(3)


#: Topic, log time, id and data of a message.
Row = tuple[int, int, int, bytes]

#: Without the constructor, which takes longer than reading a small row.
_make_message: Callable[[Iterable[object]], RawMessage] = partial(tuple.__new__, RawMessage)


@dataclass(slots=True)
class _Rows:
    """Loads rows that have been read: the first time from memory, which is then released, later from the file."""

    rows: list[Row]
    count: int
    read_again: Callable[[], Iterator[tuple[list[Row], int]]]
    known: Mapping[int, Connection]

    def __call__(self, callback: Callable[[RawMessage], Any]) -> list[Any]:
        rows = self.rows or list(islice(chain.from_iterable(rows for rows, _ in self.read_again()), self.count))
        topics, times, _, data = zip(*rows, strict=True)
        rows.clear()
        fields = zip(map(self.known.__getitem__, topics), times, data, times, repeat(0), strict=False)
        return list(map(callback, map(_make_message, fields)))


def open_reader(path: Path, options: ReadOptions) -> Sqlite3Reader:
    """Open a ``.db3`` file; see `pc2scan.bags.formats.Format`."""
    return Sqlite3Reader(path, message_compression=options.message_compression, strict=options.strict)


class Sqlite3Reader(Reader):
    """Reads a ``.db3`` file.

    Parameters
    ----------
    path
        The file. No file is written. A write-ahead log or a rollback journal that a recorder left beside it is read.
    message_compression
        ``zstd`` if every message is compressed by itself. With ``none`` the first message in CDR is checked, because
        only metadata.yaml, which may be missing, declares the compression.

    strict
        Whether damage is an error; otherwise it is in `damage`, and reading goes on behind what SQLite cannot read.

    Raises
    ------
    RecordingError
        If it cannot be read, or is not one of rosbag2.
    DamageError
        With ``strict``, if it is damaged; without, if nothing of it can be recovered.
    """

    def __init__(self, path: Path, *, message_compression: str = "none", strict: bool = False) -> None:
        self.path = path
        self._log = DamageLog(strict=strict)
        self._database = Database(path, self._log)
        read = partial(read_tables, self._database, self._log, message_compression=message_compression)
        try:
            try:
                self._database.open()
                tables = read()
            except (*SQLITE_ERRORS, DamageError) as err:
                self._database.recover(err)
                tables = read()
        except OSError as err:
            self.close()
            raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err
        except BaseException:
            self.close()
            raise
        self.connections, start_ns, end_ns, self._index, self._packed_topics = tables
        self.summary = Summary(
            container="sqlite3",
            storage="",
            compression=("zstd" if self._packed_topics else "none",),
            size_bytes=self._database.size,
            message_count=sum(connection.message_count or 0 for connection in self.connections),
            start_ns=start_ns,
            end_ns=end_ns,
        )

    def chunks(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,  # noqa: ARG002  # there are no chunks
    ) -> Iterator[Chunk]:
        """Yield rows by log time, as chunks; equal log times are in the order of writing.

        Rows are read while the chunks are iterated over, by the thread that does so: a database is read in order. A
        chunk that is loaded again, which also happens on that thread, reads its rows again.
        """
        wanted = None if connections is None else {connection.id for connection in connections}
        known = {own.id: own for own in self.connections if wanted is None or own.id in wanted}
        read = partial(self._batches, known, start_ns, stop_ns)
        before: tuple[int, int] | None = None
        for number, (rows, size) in enumerate(read()):
            load = _Rows(rows, len(rows), partial(read, before), known)
            before = rows[-1][1:3]
            yield Chunk(rows[0][1], (number,), size, load, is_quick=size < _WORTH_A_THREAD)

    def _batches(
        self,
        known: Mapping[int, Connection],
        start_ns: int | None,
        stop_ns: int | None,
        after: tuple[int, int] | None = None,
    ) -> Iterator[tuple[list[Row], int]]:
        """Yield some rows at a time, with the bytes of their data.

        They are in the order of log time, equal log times in the order of writing. Only those after ``after``, a log
        time and an id.
        """
        expected = sum(own.message_count or 0 for own in known.values())
        left = self._database.most_bytes
        while True:
            is_rebuilt = self._database.is_rebuilt
            try:
                for rows, size in _in_batches(self._select(list(known), start_ns, stop_ns, after)):
                    after = rows[-1][1:3]
                    # Pages of a damaged tree may form a loop.
                    expected -= len(rows)
                    if expected < 0:
                        raise RecordingError("has more messages than it counts", path=self.path)
                    left -= size
                    if left < 0:
                        raise self._database.too_many_values()
                    if self._packed_topics or {bytes} != set(map(type, map(_DATA, rows))):
                        rows = list(self._decompressed(known, rows))  # noqa: PLW2901
                        size = sum(map(len, map(_DATA, rows)))  # noqa: PLW2901
                    if rows:
                        yield rows, size
            except (*SQLITE_ERRORS, DamageError) as err:
                # What was read meanwhile may have rebuilt it.
                if is_rebuilt or not self._database.is_rebuilt:
                    self._database.recover(err)
                    self._index = None
            else:
                return

    def _decompressed(self, known: Mapping[int, Connection], rows: list[Any]) -> Iterator[Row]:
        """Yield rows with decompressed data, without those that have none."""
        for row in rows:
            topic_id, time_ns, row_id, data = row
            if isinstance(data, bytes) and topic_id not in self._packed_topics:
                yield row
            elif (unpacked := self._decompress(known[topic_id], time_ns, row_id, data)) is not None:
                yield topic_id, time_ns, row_id, unpacked

    def _decompress(self, connection: Connection, time_ns: int, message_id: int, data: object) -> bytes | None:
        """Decompress the data of a message; None, with a note, if it cannot be decompressed."""
        try:
            if not isinstance(data, bytes):
                gone = data is None and self._database.is_rebuilt
                what = "has lost its data" if gone else f"has data {shown_value(data)}, not a blob"
                raise self._database.damage(f"{message_row(message_id, connection.topic)} {what}", connection.topic)
            return zstd.decompress_message(data, self.path, connection.topic)
        except DamageError as err:
            self._log.note(err, key=message_id, messages_lost=1, first_ns=time_ns, last_ns=time_ns)
            return None

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count rows, without their data; see `pc2scan.bags.reader.Reader`."""
        if start_ns is None and stop_ns is None:
            return declared_counts(connections)
        found = dict.fromkeys((connection.id for connection in connections), 0)
        conditions, values = _time_conditions(start_ns, stop_ns)
        where = " AND ".join((SOUND, *conditions))
        sql = f"SELECT topic_id, count(*) FROM messages WHERE {where} GROUP BY topic_id"  # noqa: S608
        try:
            with self._database.ending():
                rows = self._database.query(sql, values).fetchall()
        except (*SQLITE_ERRORS, DamageError):
            # Damage is reported when the messages are read.
            return {}
        return found | {topic_id: count for topic_id, count in rows if topic_id in found}

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def _select(
        self, topic_ids: list[int], start_ns: int | None, stop_ns: int | None, after: tuple[int, int] | None
    ) -> Iterator[tuple[int, int, int, Any]]:
        """Return topic, time, id and data of messages by time and id, those after ``after`` (time and id)."""
        times, bounds = _time_conditions(start_ns, stop_ns)
        # Not as values, of which some builds of SQLite allow 32,766.
        conditions = [f"topic_id IN ({', '.join(map(str, topic_ids))})", SOUND, *times]
        values = [*bounds, *(after or ())]
        if after is not None:
            conditions.append("(timestamp, id) > (?, ?)")
        tail = f"WHERE {' AND '.join(conditions)} ORDER BY timestamp, id"
        if self._index is not None:
            # Without INDEXED BY, SQLite may sort whole messages instead of using the index.
            sql = f"SELECT topic_id, timestamp, id, data FROM messages INDEXED BY {self._index} {tail}"  # noqa: S608
            return self._database.query(sql, values)
        # Without an index SQLite has to sort; only ids are sorted, not messages.
        sql = f"SELECT topic_id, timestamp, id FROM messages {tail}"  # noqa: S608
        rows = self._database.query(sql, values)
        return ((*row, self._data(row[2])) for row in rows)

    def _data(self, row_id: int) -> Any:
        row = self._database.query("SELECT data FROM messages WHERE id = ?", (row_id,)).fetchone()
        return row and row[0]


def _in_batches(rows: Iterable[Any]) -> Iterator[tuple[list[Any], int]]:
    """Yield rows in lists, with the bytes of their data; those before an error, too."""
    batch: list[Any] = []
    size = 0
    try:
        for row in rows:
            batch.append(row)
            data = row[3]
            # Faster than isinstance, which shows here.
            if type(data) is bytes or type(data) is str:
                size += len(data)
            if size >= _UNIT_BYTES or len(batch) == _UNIT_ROWS:
                del row, data
                yield batch, size
                batch, size = [], 0
    except SQLITE_ERRORS:
        if batch:
            yield batch, size
        raise
    if batch:
        yield batch, size


def _time_conditions(start_ns: int | None, stop_ns: int | None) -> tuple[list[str], list[int]]:
    """Return SQL conditions for messages with ``start_ns <= timestamp < stop_ns``, and their values."""
    bounds = [(sign, bound) for sign, bound in ((">=", start_ns), ("<", stop_ns)) if bound is not None]
    return [f"timestamp {sign} ?" for sign, _ in bounds], [max(-(2**63), min(bound, 2**63 - 1)) for _, bound in bounds]
