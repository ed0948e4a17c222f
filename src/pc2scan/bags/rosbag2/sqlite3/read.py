"""Reads rosbag2's sqlite3 storage: one ``.db3`` file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from typing import TYPE_CHECKING

from pc2scan.bags import zstd
from pc2scan.bags.damage import DamageLog
from pc2scan.bags.reader import Reader
from pc2scan.bags.units import Unit
from pc2scan.errors import DamageError, RecordingError
from pc2scan.model import RawMessage, Summary, declared_counts

from .database import SQLITE_ERRORS, Database
from .index import SOUND, message_row, read_tables, shown_value

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from pathlib import Path

    from pc2scan.bags.formats import ReadOptions
    from pc2scan.bags.units import Item
    from pc2scan.model import ChunkRule, Connection

#: Limits of a unit's bytes and rows. Loading less takes less time than handing it to another thread.
_UNIT_BYTES = 1 << 19
_UNIT_ROWS = 1024
_WORTH_A_THREAD = 1 << 20


@dataclass(slots=True)
class _Rows:
    """Loads rows that have been read: the first time from memory, which is then released, later from the file."""

    rows: list[RawMessage]
    count: int
    read_again: Callable[[], Iterator[tuple[tuple[int, int], RawMessage]]]

    def __call__(self, callback: Callable[[RawMessage], Item], *, whole: bool) -> list[Item]:  # noqa: ARG002
        rows, self.rows = self.rows, []
        if not rows:
            rows = [message for _, message in islice(self.read_again(), self.count)]
        return list(map(callback, rows))


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
        Whether damage is an error; otherwise it is in `damage`, and rows SQLite cannot reach are read page by page.

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

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,  # noqa: ARG002  # there are no chunks
    ) -> Iterator[Unit]:
        """Yield rows by log time, as units; equal log times are in the order of writing.

        Rows are read while the units are iterated over, by the thread that does so: a database is read in order. A unit
        that is loaded again, which also happens on that thread, reads its rows again.
        """
        wanted = partial(self._messages, connections, start_ns, stop_ns)
        rows: list[RawMessage] = []
        size = number = 0
        before: tuple[int, int] | None = None

        def unit() -> Unit:
            rest = _Rows(rows, len(rows), partial(wanted, before))
            return Unit(
                rows[0].log_time_ns,
                (number,),
                size,
                rest,
                is_quick=size < _WORTH_A_THREAD,
                is_in_memory=True,
            )

        for key, message in wanted():
            rows.append(message)
            size += len(message.data)
            if size >= _UNIT_BYTES or len(rows) == _UNIT_ROWS:
                yield unit()
                rows, size, number, before = [], 0, number + 1, key
            del message
        if rows:
            yield unit()

    def _messages(
        self,
        connections: Collection[Connection] | None,
        start_ns: int | None,
        stop_ns: int | None,
        after: tuple[int, int] | None = None,
    ) -> Iterator[tuple[tuple[int, int], RawMessage]]:
        """Yield messages after ``after`` by log time, equal log times in the order of writing, in bounded memory.

        The key that stands before each is its log time and the row's id.
        """
        wanted = None if connections is None else {connection.id for connection in connections}
        known = {own.id: own for own in self.connections if wanted is None or own.id in wanted}
        expected = sum(own.message_count or 0 for own in known.values())
        while True:
            is_rebuilt = self._database.is_rebuilt
            try:
                rows = self._rows(list(known), start_ns, stop_ns, after)
                for topic_id, time_ns, message_id, data in self._database.bounded_rows(rows):
                    # Pages of a damaged tree may form a loop.
                    expected -= 1
                    if expected < 0:
                        raise RecordingError("has more messages than it counts", path=self.path)
                    after = (time_ns, message_id)
                    if isinstance(data, bytes) and topic_id not in self._packed_topics:
                        yield after, RawMessage(known[topic_id], time_ns, data, time_ns)
                    elif (message := self._decompress(known[topic_id], time_ns, message_id, data)) is not None:
                        yield after, message
            except (*SQLITE_ERRORS, DamageError) as err:
                # The rest is read from the pages, from the next row on; what was read meanwhile may have rebuilt them.
                if is_rebuilt or not self._database.is_rebuilt:
                    self._database.recover(err)
                    self._index = None
            else:
                return

    def _decompress(self, connection: Connection, time_ns: int, message_id: int, data: object) -> RawMessage | None:
        """Decompress a message; None, with a note, if it cannot be decompressed."""
        try:
            if not isinstance(data, bytes):
                gone = data is None and self._database.is_rebuilt
                what = "has lost its data" if gone else f"has data {shown_value(data)}, not a blob"
                raise self._database.damage(f"{message_row(message_id, connection.topic)} {what}", connection.topic)
            unpacked = zstd.decompress_message(data, self.path, connection.topic)
        except DamageError as err:
            self._log.note(err, key=message_id, messages_lost=1, first_ns=time_ns, last_ns=time_ns)
            return None
        return RawMessage(connection, time_ns, unpacked, time_ns)

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

    def _rows(
        self, topic_ids: list[int], start_ns: int | None, stop_ns: int | None, after: tuple[int, int] | None
    ) -> Iterator[tuple[int, int, int, object]]:
        """Yield topic, time, id and data of messages by time and id, those after ``after`` (time and id)."""
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
            # Not from the cursor itself, which cannot be closed after the database.
            yield from chain(self._database.query(sql, values))
            return
        # Without an index SQLite has to sort; only ids are sorted, not messages.
        sql = f"SELECT topic_id, timestamp, id FROM messages {tail}"  # noqa: S608
        for topic_id, time_ns, message_id in self._database.query(sql, values):
            row = self._database.query("SELECT data FROM messages WHERE id = ?", (message_id,)).fetchone()
            yield topic_id, time_ns, message_id, row and row[0]


def _time_conditions(start_ns: int | None, stop_ns: int | None) -> tuple[list[str], list[int]]:
    """Return SQL conditions for messages with ``start_ns <= timestamp < stop_ns``, and their values."""
    bounds = [(sign, bound) for sign, bound in ((">=", start_ns), ("<", stop_ns)) if bound is not None]
    return [f"timestamp {sign} ?" for sign, _ in bounds], [max(-(2**63), min(bound, 2**63 - 1)) for _, bound in bounds]
