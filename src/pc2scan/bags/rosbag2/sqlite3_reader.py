"""Reads rosbag2's sqlite3 storage: one ``.db3`` file.

SQLite opens only complete databases, and as immutable ones: it reads no log, and locks and writes nothing. A database
with a log beside it is merged with the log into a temporary copy by `pc2scan.bags.rosbag2.sqlite3_logs`.

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
"""

from __future__ import annotations

import re
import sqlite3
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.bags import zstd
from pc2scan.bags.damage import RECOVER, DamageLog
from pc2scan.bags.qos import latches
from pc2scan.bags.reader import Reader
from pc2scan.bags.units import Unit
from pc2scan.errors import DamageError, RecordingError
from pc2scan.files.compression import ZSTD_MAGIC
from pc2scan.files.limits import MAX_CONNECTIONS
from pc2scan.files.temporary import making_copy, private_folder, sqlite_is_full
from pc2scan.model import Connection, Definition, RawMessage, Summary, declared_counts
from pc2scan.shown import counted

from .sqlite3_checks import TIMES_SUM, index_trouble, table_trouble
from .sqlite3_codes import CORRUPT, ERROR, FULL, IOERR_SHORT_READ, NOTADB, code_of
from .sqlite3_logs import missing_bytes, side_logs, write_merged
from .sqlite3_pages import PageFile, declared_size, rebuilt

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
    from tempfile import TemporaryDirectory

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.formats import ReadOptions
    from pc2scan.bags.units import Item
    from pc2scan.model import ChunkRule

    from .sqlite3_page_log import PageLog

__all__ = ["Sqlite3Reader", "open_reader"]

#: Allowed defaults of columns, neither long nor computed: a default is the value of every row that does not store one.
_SHORT_DEFAULT = re.compile(r"[+-]?\w{1,20}|'[^']{0,40}'|\"[^\"]{0,40}\"")

#: SQLite's codes for a damaged database; ERROR is that of a damaged schema.
_DAMAGE_CODES = (CORRUPT, NOTADB, ERROR, IOERR_SHORT_READ)

#: Messages among which one in CDR is searched, to detect whether they are compressed one by one.
_LOOKED_AT = 1000

#: If a name in the schema is not UTF-8, Python cannot decode the error message; if a length is wrong, SQLite may run
#: out of memory.
_SQLITE_ERRORS = (sqlite3.Error, UnicodeDecodeError, MemoryError)


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
        self._path = path
        self._log = DamageLog(strict=strict)
        self._logs: list[PageLog] = []
        self._copy: TemporaryDirectory[str] | None = None
        self._database: sqlite3.Connection | None = None
        self._pages: PageFile | None = None
        self._bytes_read = 0
        try:
            self._size = path.stat().st_size
            self._logs = side_logs(path)
            #: Limit of the size of all values together, bytes.
            self._most = 1_000_000 + self._size + sum(log.file.size for log in self._logs)
            self._note_logs()
            try:
                self._refuse_incomplete()
                self._database = self._open()
                start_ns, end_ns = self._survey(message_compression)
            except DamageError as err:
                self._recover(err)
                start_ns, end_ns = self._survey(message_compression)
            except _SQLITE_ERRORS as err:
                self._recover(self._error(err))
                start_ns, end_ns = self._survey(message_compression)
        except OSError as err:
            self.close()
            raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err
        except BaseException:
            self.close()
            raise
        self._summary = Summary(
            container="sqlite3",
            storage="",
            compression=("zstd" if self._packed_topics else "none",),
            size_bytes=self._size,
            message_count=sum(connection.message_count or 0 for connection in self._connections),
            start_ns=start_ns,
            end_ns=end_ns,
        )

    def _survey(self, message_compression: str) -> tuple[int | None, int | None]:
        """Read the tables; returns the times of the first and the last message."""
        self._check_tables()
        self._index = self._timestamp_index()
        with self._ending():
            self._check_small_tables()
            self._connections, start_ns, end_ns = self._read_connections()
        self._packed_topics = self._find_packed(declared=message_compression == "zstd")
        return start_ns, end_ns

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    @property
    def connections(self) -> Sequence[Connection]:
        """A connection for each row of ``topics``."""
        return self._connections

    @property
    def summary(self) -> Summary:
        """The summary, with counts and times of the table of messages."""
        return self._summary

    @property
    def bytes_read(self) -> int:
        """Bytes of messages read so far."""
        return min(self._bytes_read, self._size)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts that were read."""
        return self._log.found

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
            return Unit(rows[0].log_time_ns, (number,), size, rest, is_quick=size < _WORTH_A_THREAD, is_in_memory=True)

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
        known = {own.id: own for own in self._connections if wanted is None or own.id in wanted}
        expected = sum(own.message_count or 0 for own in known.values())
        while True:
            try:
                rows = self._rows(list(known), start_ns, stop_ns, after)
                for topic_id, time_ns, message_id, data in self._stored(rows):
                    # Pages of a damaged tree may form a loop.
                    expected -= 1
                    if expected < 0:
                        raise RecordingError("has more messages than it counts", path=self._path)
                    if topic_id not in known or not isinstance(time_ns, int):
                        raise RecordingError(
                            f"a message has topic_id {topic_id!r:.40} and timestamp {time_ns!r:.40}", path=self._path
                        )
                    after = (time_ns, message_id)
                    if isinstance(data, bytes) and topic_id not in self._packed_topics:
                        self._bytes_read += len(data)
                        yield after, RawMessage(known[topic_id], time_ns, data, time_ns)
                    elif (message := self._unpacked(known[topic_id], time_ns, message_id, data)) is not None:
                        yield after, message
            except (*_SQLITE_ERRORS, DamageError) as err:
                # The rest is read from the pages, from the next row on.
                self._recover(err if isinstance(err, DamageError) else self._error(err))
            else:
                return

    def _unpacked(self, connection: Connection, time_ns: int, message_id: int, data: object) -> RawMessage | None:
        """Decompress a message; None, with a note, if it cannot be decompressed."""
        try:
            if not isinstance(data, bytes):
                what = "is not in the file any more" if data is None else f"is {type(data).__name__}, not bytes"
                raise self._damage(f"a message's data {what}", connection.topic)
            self._bytes_read += len(data)
            unpacked = zstd.unpacked_message(data, self._path, connection.topic)
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
        sql = f"SELECT topic_id, count(*) FROM messages WHERE {' AND '.join(conditions)} GROUP BY topic_id"  # noqa: S608
        try:
            with self._ending():
                rows = self._query(sql, values).fetchall()
        except (*_SQLITE_ERRORS, DamageError):
            # Damage is reported when the messages are read.
            return {}
        return found | {topic_id: count for topic_id, count in rows if topic_id in found}

    def close(self) -> None:
        """Close the database and remove the copy, if there is one."""
        if self._database is not None:
            self._database.close()
            self._database = None
        if self._pages is not None:
            self._pages.close()
            self._pages = None
        for log in self._logs:
            log.file.close()
        if self._copy is not None:
            self._copy.cleanup()
            self._copy = None

    def _note_logs(self) -> None:
        """Note the problems of the logs."""
        for log in self._logs:
            for problem in log.problems:
                error = DamageError(problem.what, path=log.file.path, hint=RECOVER)
                self._log.note(error, offset=problem.offset, bytes_lost=problem.bytes_lost)

    def _missing_bytes(self) -> int:
        """Return how many bytes the database lacks by its own header or a log; SQLite checks only what it reads."""
        missing = missing_bytes(self._logs)
        return max(0, self._declared_size() - self._size) if missing is None else missing

    def _declared_size(self) -> int:
        """Return the size of the database by its own header, or of the file if the header has none."""
        with self._path.open("rb") as file:
            return declared_size(file.read(100)) or self._size

    def _refuse_incomplete(self) -> None:
        """Raise if pages are missing, in the file itself or in its logs."""
        for log in self._logs:
            if log.broken:
                raise self._damage(f"its pages do not fit together, because {log.file.path.name} is damaged")
        if missing := self._missing_bytes():
            raise self._damage(f"is cut off: it has {self._size} of {self._size + missing} bytes")
        declared = self._declared_size()
        if self._size > declared and missing_bytes(self._logs) is None:
            # Appended bytes are harmless; inserted ones shift the pages after them.
            error = self._damage(f"has {self._size} bytes, {self._size - declared} more than its header declares")
            self._log.note(error, key="size", messages_lost=0)

    def _recover(self, problem: RecordingError) -> None:
        """Continue with the rows that can be found without SQLite's trees."""
        if not isinstance(problem, DamageError) or self._pages is not None:
            raise problem
        if self._log.strict:
            raise problem
        if self._database is not None:
            self._database.close()
        self._pages = PageFile(self._path, self._logs)
        try:
            self._database, last_ns = rebuilt(self._pages)
        except sqlite3.Error as err:
            raise self._error(err) from err
        self._index = None
        if last_ns is None and not self._database.execute("SELECT 1 FROM topics").fetchone():
            raise self._damage(f"nothing of it can be recovered: {problem.message}")
        if any(log.broken for log in self._logs):
            # The missing bytes are noted for the log.
            self._log.note(problem)
        else:
            self._log.note(problem, bytes_lost=self._missing_bytes(), first_ns=last_ns)

    def _open(self) -> sqlite3.Connection:
        """Open as immutable: the database is neither locked nor recovered."""
        path = self._path
        if any(log.page_count is not None for log in self._logs):
            path = self._merged_copy()
        # Other threads use the reader, one at a time.
        database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False)
        # A topic's name may have bytes that are not UTF-8.
        database.text_factory = lambda raw: raw.decode("utf-8", "replace")
        if sys.version_info >= (3, 11):
            # No value is longer than the file, or than SQLite's limit.
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(self._most, 2**31 - 1))
            # No statement of an untrusted recording may open another file, or call functions with effects.
            database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        database.execute("PRAGMA trusted_schema = OFF")
        return database

    def _merged_copy(self) -> Path:
        """Copy the database with the pages of its logs; the copy is at most as large as both."""
        self._copy = private_folder(self._path)
        target = Path(self._copy.name, "merged.db3")
        with making_copy(self._path, target.parent):
            write_merged(self._path, self._logs, target)
        return target

    @contextmanager
    def _ending(self) -> Iterator[None]:
        """Interrupt SQLite if it takes more steps than a file of this size can need."""
        millions = iter(range(5 + self._size // 100_000))
        assert self._database is not None
        self._database.set_progress_handler(lambda: next(millions, None) is None, 1_000_000)
        try:
            yield
        finally:
            self._database.set_progress_handler(None, 0)

    def _query(self, sql: str, values: Sequence[Any] = ()) -> sqlite3.Cursor:
        if self._database is None:
            raise RecordingError("is closed", path=self._path)
        try:
            return self._database.execute(sql, values)
        except UnicodeDecodeError as err:
            # The message quotes a damaged name, which Python cannot decode.
            raise self._damage("SQLite cannot read it, and names what is not text") from err

    def _damage(self, message: str, topic: str | None = None) -> DamageError:
        return DamageError(message, path=self._path, topic=topic, hint=RECOVER)

    def _error(self, err: Exception) -> RecordingError:
        if isinstance(err, sqlite3.Error) and code_of(err) == FULL:
            return sqlite_is_full(self._path)
        message = f"SQLite cannot read it: {str(err) or type(err).__name__}"
        # Failing disks and a lack of memory are not damage.
        if not isinstance(err, sqlite3.Error) or code_of(err) in _DAMAGE_CODES:
            return self._damage(message)
        return RecordingError(message, path=self._path)

    def _stored(self, rows: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield rows as they are, up to the size of the file: rows that share pages may have any number of values."""
        left = self._most
        for row in rows:
            left -= sum(len(value) for value in row if isinstance(value, str | bytes))
            if left < 0:
                raise RecordingError("has more values than the bytes of its file can hold", path=self._path)
            yield row

    def _columns(self, table: str) -> set[str]:
        found = set()
        for _, name, _, _, default, _ in self._query(f"PRAGMA table_info({table})"):
            if default is not None and not _SHORT_DEFAULT.fullmatch(default):
                raise RecordingError(
                    f"table {table} has a column {name!r:.40} with a default value, rosbag2's have none",
                    path=self._path,
                )
            found.add(name)
        return found

    def _check_tables(self) -> None:
        needed = {
            "topics": {"id", "name", "type", "serialization_format"},
            "messages": {"id", "topic_id", "timestamp", "data"},
        }
        for table, columns in needed.items():
            if missing := columns - self._columns(table):
                raise RecordingError(
                    f"is an SQLite database, but not one of rosbag2: table {table} lacks {', '.join(sorted(missing))}",
                    path=self._path,
                )
        # A database rebuilt from the pages is trusted.
        for table in (*needed, "message_definitions") if self._pages is None else ():
            # A view or a virtual table can have an endless number of rows.
            stored = "SELECT min(type = 'table' AND rootpage > 0) FROM sqlite_master WHERE lower(name) = ?"
            if self._query(stored, (table,)).fetchone()[0] == 0:
                raise RecordingError(f"{table} is not a plain table, as rosbag2 makes it", path=self._path)

    def _check_small_tables(self) -> None:
        """Check the tables that describe the messages, unless they are rebuilt from pages."""
        # The first one lists all others; if it is damaged, it may list fewer.
        for table in ("sqlite_master", "topics", "message_definitions") if self._pages is None else ():
            if self._columns(table) and (trouble := table_trouble(self._query, table)):
                error = self._damage(trouble.what)
                if trouble.unreachable:
                    raise error
                self._log.note(error, key=("table", table), messages_lost=0)

    def _timestamp_index(self) -> str | None:
        """Return the quoted name of an index by time of all messages."""
        for row in self._query("PRAGMA index_list(messages)"):
            name = '"' + str(row[1]).replace('"', '""') + '"'
            columns = [column[2] for column in self._query(f"PRAGMA index_info({name})")]
            # An index with a WHERE clause (the fifth column) does not have every row.
            if columns == ["timestamp"] and not row[4]:
                return name
        return None

    def _read_connections(self) -> tuple[tuple[Connection, ...], int | None, int | None]:
        """Return the connections, and the times of the first and the last message."""
        available = self._columns("topics")
        names = ["name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"]
        columns = ", ".join(_column_as_text(name) if name in available else "''" for name in names)
        definitions = self._read_definitions()
        counts = {
            topic_id: numbers
            for topic_id, *numbers in self._query(
                f"SELECT topic_id, count(*), min(timestamp), max(timestamp), {TIMES_SUM} FROM messages "  # noqa: S608
                "GROUP BY topic_id LIMIT ?",
                (MAX_CONNECTIONS,),
            )
        }
        total, times_sum = (sum(numbers[place] for numbers in counts.values()) for place in (0, 3))
        if self._index is not None and (trouble := index_trouble(self._query, self._index, total, times_sum)):
            raise self._damage(trouble)
        connections: list[Connection] = []
        starts, ends = [], []
        for topic_id, topic, msgtype, serialization, qos, digest in self._stored(
            self._query(f"SELECT id, {columns} FROM topics ORDER BY id")  # noqa: S608 - constants
        ):
            count, first_ns, last_ns, _ = counts.get(topic_id, (0, None, None, 0))
            if len(connections) == MAX_CONNECTIONS or not isinstance(topic_id, int):
                raise RecordingError(
                    f"has more than {MAX_CONNECTIONS} topics, or one whose id is no number", path=self._path
                )
            if count and not (isinstance(first_ns, int) and isinstance(last_ns, int)):
                raise RecordingError("has timestamps that are no numbers", path=self._path, topic=topic)
            if count:
                starts.append(first_ns)
                ends.append(last_ns)
            self._note_missing_texts(topic_id, topic, type=msgtype, serialization_format=serialization)
            connections.append(
                Connection(
                    id=topic_id,
                    topic=topic,
                    msgtype=msgtype,
                    serialization=serialization or "cdr",
                    definition=definitions.get((msgtype, digest)) or definitions.get((msgtype, None), Definition()),
                    digest=digest,
                    latching=latches(qos),
                    qos=qos,
                    message_count=count,
                )
            )
        described = {connection.id for connection in connections}
        for topic_id, (count, first_ns, last_ns, _) in counts.items():
            if topic_id not in described:
                timed = isinstance(first_ns, int) and isinstance(last_ns, int)
                self._log.note(
                    self._damage(
                        f"{counted(count, 'message', 'are')} of topic {topic_id!r:.40}, which is not described"
                    ),
                    key=("topic", topic_id),
                    messages_lost=count,
                    first_ns=first_ns if timed else None,
                    last_ns=last_ns if timed else None,
                )
        return tuple(connections), min(starts, default=None), max(ends, default=None)

    def _note_missing_texts(self, topic_id: int, topic: str, **texts: str) -> None:
        """Note what the row of a topic lacks; rosbag2 always writes it, and CDR is its only serialization."""
        if missing := [column for column, text in {"name": topic, **texts}.items() if not text]:
            problem = f"topic {topic or topic_id} has no {' and no '.join(missing)}"
            read_as = "" if texts["serialization_format"] else ", its messages are read as cdr"
            self._log.note(self._damage(problem + read_as), key=("texts", topic_id), messages_lost=0)

    def _read_definitions(self) -> dict[tuple[str, str | None], Definition]:
        """Return definitions by type and hash; without a hash, the first of a type."""
        found: dict[tuple[str, str | None], Definition] = {}
        columns = self._columns("message_definitions")
        if not {"topic_type", "encoding", "encoded_message_definition"} <= columns:
            return found
        digest = _column_as_text("type_description_hash") if "type_description_hash" in columns else "''"
        rows = self._query(
            f"SELECT {_column_as_text('topic_type')}, {_column_as_text('encoding')}, "  # noqa: S608 - constants
            f"CAST(encoded_message_definition AS BLOB), {digest} FROM message_definitions ORDER BY id LIMIT ?",
            (MAX_CONNECTIONS,),
        )
        for msgtype, encoding, data, own_digest in self._stored(rows):
            # rosbag2 writes "unknown" if it did not find the definition.
            if data and encoding not in {"", "unknown"}:
                definition = Definition(encoding, data)
                found.setdefault((msgtype, own_digest), definition)
                found.setdefault((msgtype, None), definition)
        return found

    def _find_packed(self, *, declared: bool) -> frozenset[int]:
        """Return the topics whose messages are compressed one by one.

        Without a declaration the first CDR message decides: CDR begins with a zero byte, and never looks like a zstd
        frame. Messages in other serialisations may begin with any bytes, and stay as they are.
        """
        if declared:
            return frozenset(connection.id for connection in self._connections)
        cdr = frozenset(connection.id for connection in self._connections if connection.serialization == "cdr")
        rows = self._query("SELECT topic_id, substr(data, 1, 4) FROM messages LIMIT ?", (_LOOKED_AT,))
        for topic_id, head in rows:
            if topic_id in cdr:
                return cdr if head == ZSTD_MAGIC else frozenset()
        return frozenset()

    def _rows(
        self, topic_ids: list[int], start_ns: int | None, stop_ns: int | None, after: tuple[int, int] | None
    ) -> Iterator[tuple[int, int, int, object]]:
        """Yield topic, time, id and data of messages by time and id, those after ``after`` (time and id)."""
        times, bounds = _time_conditions(start_ns, stop_ns)
        conditions = [f"topic_id IN ({', '.join('?' * len(topic_ids))})", *times]
        values = [*topic_ids, *bounds]
        if after is not None:
            conditions.append("(timestamp, id) > (?, ?)")
            values += after
        tail = f"WHERE {' AND '.join(conditions)} ORDER BY timestamp, id"
        if self._index is not None:
            # Without INDEXED BY, SQLite may sort whole messages instead of using the index.
            sql = f"SELECT topic_id, timestamp, id, data FROM messages INDEXED BY {self._index} {tail}"  # noqa: S608
            # Not from the cursor itself, which cannot be closed after the database.
            yield from chain(self._query(sql, values))
            return
        # Without an index SQLite has to sort; only ids are sorted, not messages.
        sql = f"SELECT topic_id, timestamp, id FROM messages {tail}"  # noqa: S608
        for topic_id, time_ns, message_id in self._query(sql, values):
            row = self._query("SELECT data FROM messages WHERE id = ?", (message_id,)).fetchone()
            yield topic_id, time_ns, message_id, row and row[0]


def _time_conditions(start_ns: int | None, stop_ns: int | None) -> tuple[list[str], list[int]]:
    """Return SQL conditions for messages with ``start_ns <= timestamp < stop_ns``, and their values."""
    bounds = [(sign, bound) for sign, bound in ((">=", start_ns), ("<", stop_ns)) if bound is not None]
    return [f"timestamp {sign} ?" for sign, _ in bounds], [max(-(2**63), min(bound, 2**63 - 1)) for _, bound in bounds]


def _column_as_text(column: str) -> str:
    """Return a column as text: SQLite allows any value in any column."""
    return f"coalesce(CAST({column} AS TEXT), '')"
