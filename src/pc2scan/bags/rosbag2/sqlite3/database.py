"""A database of an untrusted recording: opened without writing, within limits; read on behind damage.

SQLite opens only complete databases, and as immutable ones: it reads no log, and locks and writes nothing. A database
with a log beside it (a write-ahead log ``-wal``, a rollback journal ``-journal``) is copied with it to a private
folder, where SQLite merges them.
"""

from __future__ import annotations

import shutil
import tempfile
from collections import deque
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import apsw

from pc2scan.bags.damage import RECOVER
from pc2scan.errors import DamageError, RecordingError
from pc2scan.files.source_file import file_beside, keep_open, open_bytes
from pc2scan.files.system import TEMPORARY_HINT, copy_errors, private_folder, refuse_without_room
from pc2scan.text import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from tempfile import TemporaryDirectory

    from pc2scan.bags.damage import DamageLog

#: What SQLite raises at damage; a name that is not UTF-8 cannot be decoded.
SQLITE_ERRORS = (apsw.Error, UnicodeDecodeError, MemoryError)

#: Errors that are no damage.
_NO_DAMAGE = (apsw.FullError, apsw.IOError, apsw.InterruptError, apsw.CantOpenError)

#: The files that SQLite keeps beside a database, in the order in which they apply.
_LOG_SUFFIXES = ("-journal", "-wal")

_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_WAL_HEADER = 32

#: The tables, and their columns beside the id.
TABLES = {
    "topics": ("name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"),
    "message_definitions": ("topic_type", "encoding", "encoded_message_definition", "type_description_hash"),
    "messages": ("topic_id", "timestamp"),
}

#: Most ranges of rowids that may fail, each of which takes some microseconds.
_MOST_FAILURES = 20_000

_ROWS_OF_A_PAGE = 256
_LEAST_ID = -(2**63)

#: The data of a message, if they are bytes.
BLOB = "CASE WHEN typeof(data) = 'blob' THEN data END"
_DATA_OF = f"SELECT {BLOB} FROM messages WHERE rowid BETWEEN ? AND ? AND +rowid = ? LIMIT 1"  # noqa: S608  # constants


def as_integer(column: str) -> str:
    """Return a column where it is an integer."""
    return f"CASE WHEN typeof({column}) = 'integer' THEN {column} END"


def as_text(column: str) -> str:
    """Return a column as the bytes of its text: SQLite allows any value in any column, and any bytes in text."""
    return f"CAST(coalesce(CAST({column} AS TEXT), '') AS BLOB)"


def connect(file: Path, mode: str) -> apsw.Connection:
    """Open a database with a mode of SQLite's URIs. It is closed as soon as nothing uses it."""
    return apsw.Connection(
        f"{file.absolute().as_uri()}?mode={mode}", flags=apsw.SQLITE_OPEN_READWRITE | apsw.SQLITE_OPEN_URI
    )


class Database:
    """A database and the logs beside it. `open` opens it; `recover` replaces it by one of the rows in its pages.

    Parameters
    ----------
    path
        The file. No file is written.
    damage
        Where damage is noted.

    Attributes
    ----------
    path, size
        The file, and its size in bytes.
    most_bytes
        Limit of the size of all values together.
    is_rebuilt
        Whether it was rebuilt. Its tables are trusted then.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """

    def __init__(self, path: Path, damage: DamageLog) -> None:
        self.path = path
        self.is_rebuilt = False
        self._noted = damage
        self._copy: TemporaryDirectory[str] | None = None
        #: What is read: the file or its copy; None when it is closed. Its database may be closed for other files.
        self._file: Path | None = path.absolute()
        self._opened: Callable[[], apsw.Connection | None] = lambda: None
        #: After `recover`, the damaged database and that of its rows.
        self._recovered: list[apsw.Connection] = []
        try:
            self.size = path.stat().st_size
            self._logs = {suffix: log for suffix in _LOG_SUFFIXES if (log := _log_beside(path, suffix))}
            self.most_bytes = 1_000_000 + self.size + sum(log.stat().st_size for log in self._logs.values())
        except OSError as err:
            raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err

    def open(self) -> None:
        """Open as immutable: the database is neither locked nor recovered. With logs, a copy is opened.

        Raises
        ------
        RecordingError
            If a log is of a transaction over several databases, or there is no room for a copy.
        DamageError
            If pages are missing.
        """
        if self._logs:
            self._merge_logs()
        assert self._file is not None
        declared, stored = _declared_size(self._file), self._file.stat().st_size
        if stored < declared:
            raise self.damage(f"is cut off: it has {stored} of {declared} bytes")
        if journal := self._logs.get("-journal"):
            # SQLite stops in silence where a journal is damaged.
            with self.ending():
                problems = self.query("PRAGMA quick_check(1)").fetchall()
            if problems != [("ok",)]:
                raise self.damage(f"its pages do not fit together after {journal.name}: {problems[0][0]}")

    def recover(self, err: Exception) -> None:
        """Continue with the rows that can be found without SQLite's trees.

        Parameters
        ----------
        err
            Why. It is raised if it is no damage, or damage is an error, or the database was rebuilt before.
        """
        problem = err if isinstance(err, RecordingError) else self._error(err)
        if not isinstance(problem, DamageError) or self.is_rebuilt or self._noted.strict:
            raise problem
        assert self._file is not None
        missing = max(0, _declared_size(self._file) - self._file.stat().st_size)
        try:
            files, stored = [self._file], self._file.stat().st_size
            # SQLite takes missing bytes of a page for zeros: rows that are others with other bytes depend on them.
            if rest := -stored % (_page_bytes(_header(self._file)) or stored):
                files.append(self._copied(self._file, "filled.db3", stored))
                with files[1].open("ab") as file:
                    file.write(b"\xff" * rest)
            self._recovered = damaged = [self._connect(file) for file in files]
            for database in damaged:
                # Without it, SQLite reads nothing of a database that is cut off.
                database.execute("PRAGMA writable_schema = ON")
            columns = {}
            for table, names in TABLES.items():
                available = self.columns(table)
                columns[table] = [name for name in names if name in available]
            rebuilt, last_ns = self._rebuild(damaged, columns)
            if last_ns is None and not rebuilt.execute("SELECT 1 FROM topics").fetchone():
                raise problem
        except (*SQLITE_ERRORS, DamageError) as error:
            raise DamageError(f"nothing of it can be recovered: {problem.message}", path=self.path) from error
        self.is_rebuilt = True
        self._recovered = [*damaged, rebuilt]
        self._noted.note(problem, bytes_lost=missing, first_ns=last_ns)

    def close(self) -> None:
        """Close the database and remove the copy, if there is one."""
        for opened in filter(None, (*self._recovered, self._opened())):
            opened.close()
        self._file, self._recovered, self._opened = None, [], lambda: None
        if self._copy is not None:
            self._copy.cleanup()

    def _database(self) -> apsw.Connection:
        """Return the open database; it is opened again if it was closed for other files."""
        opened = self._recovered[-1] if self._recovered else self._opened()
        if opened is None:
            if self._file is None:
                raise RecordingError("is closed", path=self.path)
            opened = self._connect(self._file)
            self._opened = keep_open(opened)
        return opened

    def _connect(self, file: Path, mode: str = "ro&immutable=1") -> apsw.Connection:
        """Open a file with the limits for untrusted recordings."""
        opened = connect(file, mode)
        # No value is longer than the file, or than SQLite's limit.
        opened.limit(apsw.SQLITE_LIMIT_LENGTH, min(self.most_bytes, 2**31 - 1))
        # No statement of an untrusted recording may open another file, or call functions with effects.
        opened.limit(apsw.SQLITE_LIMIT_ATTACHED, 0)
        opened.execute("PRAGMA trusted_schema = OFF")
        return opened

    def query(self, sql: str, values: Sequence[int | str] = ()) -> apsw.Cursor:
        """Execute a statement; raises one of `SQLITE_ERRORS` or `RecordingError`."""
        return self._database().execute(sql, values)

    def text(self, value: bytes) -> str:
        """Return text that was selected as bytes: SQLite stores any bytes as text."""
        ((encoding,),) = self.query("PRAGMA encoding")
        return value.decode(encoding, "replace")

    @contextmanager
    def ending(self) -> Iterator[None]:
        """Interrupt SQLite if it takes more steps than a file of this size can need."""
        millions = iter(range(5 + self.size // 100_000))
        opened = self._database()
        opened.set_progress_handler(lambda: next(millions, None) is None, 1_000_000)
        try:
            yield
        finally:
            opened.set_progress_handler(None)

    def bounded_rows(self, rows: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield rows as they are, up to the size of the file: rows that share pages may have any number of values."""
        left = self.most_bytes
        for row in rows:
            left -= sum(len(value) for value in row if isinstance(value, bytes))
            if left < 0:
                raise self.too_many_values()
            yield row

    def too_many_values(self) -> RecordingError:
        """Return the error for values that are together longer than the file."""
        return RecordingError("has more values than the bytes of its file can hold", path=self.path)

    def columns(self, table: str) -> set[str]:
        """Return the names of a table's columns; none if there is no such table, an error if it is not a plain one."""
        # A view or a virtual table can have an endless number of rows.
        made_up = "SELECT 1 FROM sqlite_master WHERE lower(name) = ? AND NOT (type = 'table' AND rootpage > 0)"
        if not self.is_rebuilt and self.query(made_up, (table,)).fetchone():
            raise RecordingError(f"{table} is not a plain table, as rosbag2 makes it", path=self.path)
        names = set()
        # Damaged names may be no text.
        sql = "SELECT CAST(name AS BLOB), CAST(dflt_value AS BLOB) FROM pragma_table_info(?)"
        for name, default in self.query(sql, (table,)):
            names.add(self.text(name))
            # It is the value of every row that does not store one, and may be long, or computed.
            if len(default or b"") > 40 or b"(" in (default or b""):
                column = f"a column {self.text(name)!r:.40}"
                raise RecordingError(f"table {table} has {column} with a default value", path=self.path)
        return names

    def damage(self, message: str) -> DamageError:
        """Return an error that the database is damaged."""
        return DamageError(message, path=self.path, hint=RECOVER)

    def _error(self, err: Exception) -> RecordingError:
        message = f"SQLite cannot read it: {str(err) or type(err).__name__}"
        if isinstance(err, apsw.FullError):
            message = f"{message}: its temporary files in {tempfile.gettempdir()}"
            return RecordingError(message, path=self.path, hint=TEMPORARY_HINT)
        return RecordingError(message, path=self.path) if isinstance(err, _NO_DAMAGE) else self.damage(message)

    # --- Logs ---

    def _copied(self, file: Path, name: str, needed: int) -> Path:
        """Copy a file to the private folder, if there is room for so many bytes."""
        refuse_without_room(needed, self.path)
        self._copy = self._copy or private_folder(self.path)
        target = Path(self._copy.name, name).absolute()
        with copy_errors(self.path, target.parent):
            shutil.copyfile(file, target)
        return target

    def _merge_logs(self) -> None:
        """Copy the database and its logs, and let SQLite merge them."""
        # What a write-ahead log has is written into the database.
        needed = 2 * self.most_bytes - self.size if "-wal" in self._logs else self.most_bytes
        self._file = target = self._copied(self.path, "copy.db3", needed)
        with copy_errors(self.path, target.parent):
            for suffix, log in self._logs.items():
                shutil.copyfile(log, f"{target}{suffix}")
            if journal := self._logs.get("-journal"):
                self._check_journal(Path(f"{target}-journal").read_bytes(), journal)
            with closing(self._connect(target, "rw")) as opened:
                opened.execute("PRAGMA locking_mode = EXCLUSIVE")
                # Reads the logs, but no table.
                opened.execute("PRAGMA schema_version")
                if wal := self._logs.get("-wal"):
                    ((page_size,),) = opened.execute("PRAGMA page_size")
                    ((_, taken, _),) = opened.execute("PRAGMA wal_checkpoint")
                    self._note_left(Path(f"{target}-wal"), wal, max(0, taken), page_size)
        if (merged := target.stat().st_size) > self.most_bytes:
            raise self.damage(f"has {merged} bytes by its logs, more than all its files")

    def _note_left(self, copy: Path, log: Path, taken: int, page_size: int) -> None:
        """Note the pages of a write-ahead log that SQLite did not take.

        These have one of the log's two salts; older ones, which the log has not yet overwritten, have none. If SQLite
        takes no page, the header is damaged, and all belong to it.
        """
        start, stop, step = _WAL_HEADER + taken * (24 + page_size), copy.stat().st_size, 24 + page_size
        with copy.open("rb") as file:
            salts = file.read(_WAL_HEADER)[16:]
            if taken:
                left = 0
                for place in range(start, stop, step):
                    file.seek(place + 8)
                    own = file.read(8)
                    left += own[:4] == salts[:4] or own[4:] == salts[4:8] or len(own) < 8
            else:
                start, left = 0, max(1, -(-(stop - _WAL_HEADER) // step))
        if left:
            what = f"{counted(left, 'page')} from here on {'is' if left == 1 else 'are'} not used"
            why = "a damaged page, or the end of an unfinished transaction"
            error = DamageError(f"{what}: SQLite reads up to {why}", path=log, hint=RECOVER)
            self._noted.note(error, offset=start, bytes_lost=left * page_size)

    def _check_journal(self, data: bytes, log: Path) -> None:
        """Refuse a journal that names another file, which SQLite would delete; note one that SQLite does not use."""
        if data.endswith(_JOURNAL_MAGIC):
            raise RecordingError(
                "is of a transaction over several databases (it names a super-journal), which no recorder makes",
                path=log,
                hint=f"move {log.name} to another folder to read the database without it",
            )
        if not data.startswith(_JOURNAL_MAGIC):
            what = "has a damaged header: the transaction that it would undo is not undone"
            self._noted.note(DamageError(what, path=log, hint=RECOVER), offset=0, messages_lost=0)

    # --- Damage ---

    def _rebuild(
        self, damaged: Sequence[apsw.Connection], columns: Mapping[str, list[str]]
    ) -> tuple[apsw.Connection, int | None]:
        """Make a database of the rows that can be read and are the same in all, and return the latest log time.

        It lies in a temporary file that SQLite removes itself, and has the messages without their data: these are read
        from the damaged database when they are asked for.
        """

        def data(*row_id: Any) -> Any:
            values = {_data_of(database, *row_id) for database in damaged}
            return values.pop() if len(values) == 1 else None

        database = apsw.Connection("")
        database.create_scalar_function("data_of", data, 1)
        ((encoding,),) = damaged[0].execute("PRAGMA encoding")
        database.execute(f"PRAGMA encoding = '{encoding}'; BEGIN")
        for table, names in columns.items():
            place = "places" if table == "messages" else table
            database.execute(f"CREATE TABLE {place}({', '.join(('id INTEGER PRIMARY KEY', *names))})")
            # A broken tree may lead to a row twice.
            insert = f"INSERT OR IGNORE INTO {place} VALUES (?{', ?' * len(names)})"  # noqa: S608  # constants
            rows, *others = (_readable_rows(cursor, table, names, self.size) for cursor in damaged)
            if table != "messages":
                # Of messages, the data come last.
                same = list(map(set, others))
                rows = (row for row in rows if all(row in other for other in same))
            database.executemany(insert, self.bounded_rows(rows))
        database.execute("CREATE VIEW messages AS SELECT *, id AS rowid, data_of(id) AS data FROM places")
        database.execute("COMMIT")
        ((last_ns,),) = database.execute("SELECT max(timestamp) FROM places")
        return database, last_ns


def _data_of(damaged: apsw.Connection, row_id: int) -> Any:
    """Return the data of a message; None if they cannot be read."""
    # A page with a wrong number of rows is read from the page before it on: SQLite would search it in vain.
    for first in (row_id, row_id - _ROWS_OF_A_PAGE if row_id > _ROWS_OF_A_PAGE else _LEAST_ID):
        with suppress(*SQLITE_ERRORS):
            for (value,) in damaged.execute(_DATA_OF, (first, row_id, row_id)):
                return value
    return None


def _readable_rows(damaged: apsw.Connection, table: str, names: list[str], size: int) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a table, with their rowids in front.

    Behind the first row of a range of rowids that fails, ranges that double are read; one that fails at once is halved.
    So what lies near is searched closely, and a file that is cut off costs no more than `_MOST_FAILURES`.
    """
    column = as_integer if table == "messages" else as_text
    listed = ", ".join(("rowid", *map(column, names)))
    sql = f"SELECT {listed} FROM {table} NOT INDEXED WHERE rowid BETWEEN ? AND ? ORDER BY rowid"  # noqa: S608
    ranges = deque([(_LEAST_ID, 2**63 - 1)] if names else [])
    failures = 0
    # A row takes more than eight bytes.
    most = left = size // 8
    while ranges and failures < _MOST_FAILURES:
        start, last = ranges.popleft()
        # Recorders count from 1 on.
        first = max(start, 1)
        try:
            for row in damaged.execute(sql, (start, last)):
                left -= 1
                if left < 0:
                    # The tree leads back to pages.
                    return
                # The id of a row in a damaged page may be wrong.
                if first <= row[0] <= first + most:
                    first = row[0] + 1
                yield row
        except SQLITE_ERRORS:
            failures += 1
            if start == last:
                continue
            last = min(last, first + most)
            width = 1 if first > start or first == 1 else (last - first + 1) // 2
            while first <= last:
                stop = min(last, first + width - 1)
                ranges.append((first, stop))
                first = stop + 1
                width *= 2


def _declared_size(file: Path) -> int:
    """Return the size of a database by its own header, or of the file if the header has none."""
    head = _header(file)
    # SQLite before 3.7 did not update the number of pages; newer versions mark that they did.
    declared = int.from_bytes(head[28:32], "big") * _page_bytes(head) if head[24:28] == head[92:96] else 0
    return declared or file.stat().st_size


def _header(file: Path) -> bytes:
    with file.open("rb") as opened:
        return opened.read(100).ljust(100, b"\0")


def _page_bytes(head: bytes) -> int:
    size = int.from_bytes(head[16:18], "big")
    return 65536 if size == 1 else size


def _log_beside(path: Path, suffix: str) -> Path | None:
    """Return a log that has something; for a database that is a link, also one beside its target, as SQLite does."""
    for place in (path, path.resolve()):
        side = file_beside(place, suffix)
        if side is not None:
            with open_bytes(side) as file:
                # A journal that begins with zero is kept for the next transaction.
                first = file.read(1)
            if first and (suffix == "-wal" or first != b"\0"):
                return side
    return None
