"""A database of an untrusted recording: opened without writing, within limits; read on behind damage.

SQLite opens only complete databases, and as immutable ones: it reads no log, and locks and writes nothing. A database
with a log beside it (a write-ahead log ``-wal``, a rollback journal ``-journal``) is copied with it to a private
folder, where SQLite merges them.
"""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.bags.damage import RECOVER
from pc2scan.errors import DamageError, RecordingError
from pc2scan.files.places import TEMPORARY_HINT, copy_errors, private_folder
from pc2scan.files.source import changed_while_read, file_beside, keep_open, open_bytes, state_of
from pc2scan.text import counted, size

from .recover import SQLITE_ERRORS, TABLES, rebuild_database

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from tempfile import TemporaryDirectory

    from pc2scan.bags.damage import DamageLog

ERROR = 1
CORRUPT = 11
FULL = 13
TOOBIG = 18
NOTADB = 26
IOERR_SHORT_READ = 522

#: SQLite's messages for errors, which are the same in all of its versions. They are needed for Python 3.10.
_CODES = {"disk I/O error": 10, "database or disk is full": FULL, "out of memory": 7, "interrupted": 9}


def code_of(error: sqlite3.Error) -> int:
    """Return the extended result code of an error.

    Notes
    -----
    Python 3.10 has the text only: there, what is no error of the disk and no lack of memory is an error of the
    database, and a short read cannot be distinguished from a failing disk.
    """
    code = getattr(error, "sqlite_errorcode", None)
    return _CODES.get(str(error), ERROR) if code is None else int(code)


#: Allowed defaults of columns, neither long nor computed: a default is the value of every row that does not store one.
_SHORT_DEFAULT = re.compile(r"[+-]?\w{1,20}|'[^']{0,40}'|\"[^\"]{0,40}\"")

#: SQLite's codes for a damaged database; ERROR is that of a damaged schema, TOOBIG of a damaged length.
_DAMAGE_CODES = (CORRUPT, NOTADB, ERROR, TOOBIG, IOERR_SHORT_READ)

#: The files that SQLite keeps beside a database, in the order in which they apply.
LOG_SUFFIXES = ("-journal", "-wal")

_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_WAL_HEADER = 32


class _Opened:
    """An open database, which is closed with this object: a connection itself would wait for the garbage collection."""

    __slots__ = ("__weakref__", "connection")

    def __init__(self, connection: sqlite3.Connection) -> None:
        self.connection = connection

    def close(self) -> None:
        """Close it."""
        self.connection.close()

    __del__ = close


class _Cursor(sqlite3.Cursor):
    """A cursor, and the database that stays open for it."""

    opened: _Opened


def _open(path: Path, most: int, mode: str = "ro&immutable=1") -> _Opened:
    """Open a file, as immutable, with the limits for untrusted recordings; ``most`` is the length of its values."""
    # Other threads use the reader, one at a time.
    uri = f"{Path(os.fspath(path)).as_uri()}?mode={mode}"
    database = sqlite3.connect(uri, uri=True, check_same_thread=False)
    # A topic's name may have bytes that are not UTF-8.
    database.text_factory = lambda raw: raw.decode("utf-8", "replace")
    if sys.version_info >= (3, 11):
        # No value is longer than the file, or than SQLite's limit.
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(most, 2**31 - 1))
        # No statement of an untrusted recording may open another file, or call functions with effects.
        database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    database.execute("PRAGMA trusted_schema = OFF")
    return _Opened(database)


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

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """

    def __init__(self, path: Path, damage: DamageLog) -> None:
        self.path = path
        self._noted = damage
        self._copy: TemporaryDirectory[str] | None = None
        #: What is read: the file or its copy, and its database, unless it was closed for other files.
        self._file: Path | None = None
        self._opened: Callable[[], _Opened | None] = lambda: None
        #: The rows of a damaged database, after `recover`, and this itself.
        self._rebuilt: _Opened | None = None
        self._damaged: _Opened | None = None
        try:
            self.size = path.stat().st_size
            self._logs = {suffix: log for suffix in LOG_SUFFIXES if (log := _log_beside(path, suffix))}
            stored = self.size + sum(log.stat().st_size for log in self._logs.values())
        except OSError as err:
            raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err
        self.most_bytes = 1_000_000 + stored

    @property
    def is_rebuilt(self) -> bool:
        """Whether it was rebuilt. Its tables are trusted then."""
        return self._rebuilt is not None

    def open(self) -> None:
        """Open as immutable: the database is neither locked nor recovered. With logs, a copy is opened.

        Raises
        ------
        RecordingError
            If a log is of a transaction over several databases, or there is no room for a copy.
        DamageError
            If pages are missing.
        """
        self._file = self.path.absolute()
        if self._logs:
            self._file = self._merged_copy()
        self._state = state_of(self._file)
        self._refuse_incomplete(self._file)
        self._opened = keep_open(_open(self._file, self.most_bytes))
        if "-journal" in self._logs:
            self._check_undone()

    def _database(self) -> _Opened:
        """Return the open database; it is opened again if it was closed for other files."""
        opened = self._rebuilt or self._damaged or self._opened()
        if opened is None:
            if self._file is None:
                raise RecordingError("is closed", path=self.path)
            if state_of(self._file) != self._state:
                raise changed_while_read(self.path)
            opened = _open(self._file, self.most_bytes)
            self._opened = keep_open(opened)
        return opened

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
        self._disconnect()
        if self._file is None:
            raise problem
        missing = self._missing_bytes(self._file)
        try:
            self._end_at_whole_page()
            self._damaged = _open(self._file, self.most_bytes)
            # Without it, SQLite reads nothing of a database that is cut off.
            self._damaged.connection.execute("PRAGMA writable_schema = ON")
            columns = {}
            for table, names in TABLES.items():
                self.refuse_made_up(table)
                available = self.columns(table)
                columns[table] = [name for name in names if name in available]
            database, last_ns = rebuild_database(self._damaged.connection, columns, self.size, self.bounded_rows)
        except (*SQLITE_ERRORS, DamageError) as error:
            raise self._lost(problem) from error
        self._rebuilt = _Opened(database)
        if last_ns is None and not database.execute("SELECT 1 FROM topics").fetchone():
            raise self._lost(problem)
        self._noted.note(problem, bytes_lost=missing, first_ns=last_ns)

    def close(self) -> None:
        """Close the database and remove the copy, if there is one."""
        self._disconnect()
        self._file = None
        if self._copy is not None:
            self._copy.cleanup()
            self._copy = None

    def _disconnect(self) -> None:
        for opened in (self._rebuilt, self._damaged, self._opened()):
            if opened is not None:
                opened.close()
        self._rebuilt, self._damaged, self._opened = None, None, lambda: None

    def query(self, sql: str, values: Sequence[Any] = ()) -> sqlite3.Cursor:
        """Execute a statement; raises one of `SQLITE_ERRORS` or `RecordingError`."""
        opened = self._database()
        cursor = opened.connection.cursor(_Cursor)
        cursor.opened = opened
        try:
            return cursor.execute(sql, values)
        except UnicodeDecodeError as err:
            # The message quotes a damaged name, which Python cannot decode.
            raise self.damage("SQLite cannot read it, and names what is not text") from err

    @contextmanager
    def ending(self) -> Iterator[None]:
        """Interrupt SQLite if it takes more steps than a file of this size can need."""
        millions = iter(range(5 + self.size // 100_000))
        opened = self._database()
        opened.connection.set_progress_handler(lambda: next(millions, None) is None, 1_000_000)
        try:
            yield
        finally:
            opened.connection.set_progress_handler(None, 0)

    def bounded_rows(self, rows: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield rows as they are, up to the size of the file: rows that share pages may have any number of values."""
        left = self.most_bytes
        for row in rows:
            left -= sum(len(value) for value in row if isinstance(value, str | bytes))
            if left < 0:
                raise self.too_many_values()
            yield row

    def too_many_values(self) -> RecordingError:
        """Return the error for values that are together longer than the file."""
        return RecordingError("has more values than the bytes of its file can hold", path=self.path)

    def columns(self, table: str) -> set[str]:
        """Return the names of a table's columns; none if there is no such table."""
        found = set()
        for _, name, _, _, default, _ in self.query(f"PRAGMA table_info({table})"):
            if default is not None and not _SHORT_DEFAULT.fullmatch(default):
                raise RecordingError(
                    f"table {table} has a column {name!r:.40} with a default value, rosbag2's have none",
                    path=self.path,
                )
            found.add(name)
        return found

    def refuse_made_up(self, table: str) -> None:
        """Raise if this is not a plain table: a view or a virtual table can have an endless number of rows."""
        stored = "SELECT min(type = 'table' AND rootpage > 0) FROM sqlite_master WHERE lower(name) = ?"
        if self.query(stored, (table,)).fetchone()[0] == 0:
            raise RecordingError(f"{table} is not a plain table, as rosbag2 makes it", path=self.path)

    def damage(self, message: str, topic: str | None = None) -> DamageError:
        """Return an error that the database is damaged."""
        return DamageError(message, path=self.path, topic=topic, hint=RECOVER)

    def _lost(self, problem: DamageError) -> DamageError:
        return DamageError(f"nothing of it can be recovered: {problem.message}", path=self.path)

    def _error(self, err: Exception) -> RecordingError:
        if isinstance(err, sqlite3.Error) and code_of(err) == FULL:
            return _sorting_error(self.path)
        message = f"SQLite cannot read it: {str(err) or type(err).__name__}"
        # Failing disks and a lack of memory are not damage.
        if not isinstance(err, sqlite3.Error) or code_of(err) in _DAMAGE_CODES:
            return self.damage(message)
        return RecordingError(message, path=self.path)

    def _missing_bytes(self, file: Path) -> int:
        """Return how many bytes the database lacks by its own header; SQLite checks only what it reads."""
        return max(0, _declared_size(file) - file.stat().st_size)

    def _refuse_incomplete(self, file: Path) -> None:
        """Raise if pages are missing."""
        declared, size = _declared_size(file), file.stat().st_size
        if size < declared:
            raise self.damage(f"is cut off: it has {size} of {declared} bytes")
        if size > declared:
            # Appended bytes are harmless; inserted ones shift the pages after them.
            error = self.damage(f"has {size} bytes, {size - declared} more than its header declares")
            self._noted.note(error, key="size", messages_lost=0)

    def _end_at_whole_page(self) -> None:
        """If it ends within a page, read a copy without this page: SQLite takes missing bytes for zeros."""
        assert self._file is not None
        stored = self._file.stat().st_size
        if rest := stored % (_page_bytes(_header(self._file)) or stored):
            if self._copy is None:
                self._file = self._merged_copy()
            os.truncate(self._file, stored - rest)

    def _merged_copy(self) -> Path:
        """Copy the database and its logs, and let SQLite merge them."""
        self._copy = private_folder(self.path)
        target = Path(self._copy.name, "copy.db3")
        with copy_errors(self.path, target.parent):
            # What a write-ahead log has is written into the database.
            needed = 2 * self.most_bytes - self.size if "-wal" in self._logs else self.most_bytes
            free = shutil.disk_usage(target.parent).free
            if free < needed:
                raise RecordingError(
                    f"cannot be copied to {target.parent.parent}: this takes {size(needed)}, {size(free)} are free",
                    path=self.path,
                    hint=TEMPORARY_HINT,
                )
            shutil.copyfile(self.path, target)
            for suffix, log in self._logs.items():
                shutil.copyfile(log, f"{target}{suffix}")
            if "-journal" in self._logs:
                self._check_journal(Path(f"{target}-journal"))
            if self._logs:
                self._merge(target)
        return target

    def _merge(self, target: Path) -> None:
        """Let SQLite merge a copy with its logs, and note the pages of a write-ahead log that it does not take."""
        self._file = target
        opened = _open(target, self.most_bytes, "rw")
        try:
            opened.connection.execute("PRAGMA locking_mode = EXCLUSIVE")
            # Reads the logs, but no table.
            opened.connection.execute("PRAGMA schema_version").fetchone()
            if "-wal" in self._logs:
                (page_size,) = opened.connection.execute("PRAGMA page_size").fetchone()
                _, taken, _ = opened.connection.execute("PRAGMA wal_checkpoint").fetchone()
                place, left = _left_of_log(Path(f"{target}-wal"), max(0, taken), 24 + page_size)
                if left:
                    what = f"{counted(left, 'page')} from here on {'is' if left == 1 else 'are'} not used"
                    why = "a damaged page, or the end of an unfinished transaction"
                    error = DamageError(f"{what}: SQLite reads up to {why}", path=self._logs["-wal"], hint=RECOVER)
                    self._noted.note(error, offset=place, bytes_lost=left * page_size)
        finally:
            opened.close()
        if (merged := target.stat().st_size) > self.most_bytes:
            raise self.damage(f"has {merged} bytes by its logs, more than all its files")

    def _check_journal(self, copy: Path) -> None:
        """Refuse a journal that names another file, which SQLite would delete; note one that SQLite does not use."""
        with copy.open("rb") as file:
            head = file.read(len(_JOURNAL_MAGIC))
            file.seek(-min(len(_JOURNAL_MAGIC), copy.stat().st_size), os.SEEK_END)
            tail = file.read()
        log = self._logs["-journal"]
        if tail == _JOURNAL_MAGIC:
            raise RecordingError(
                "is of a transaction over several databases (it names a super-journal), which no recorder makes",
                path=log,
                hint=f"move {log.name} to another folder to read the database without it",
            )
        if head != _JOURNAL_MAGIC:
            error = DamageError(
                "has a damaged header: the transaction that it would undo is not undone", path=log, hint=RECOVER
            )
            self._noted.note(error, offset=0, messages_lost=0)

    def _check_undone(self) -> None:
        """Raise if pages do not fit together after a journal was applied: SQLite stops at a damaged one in silence."""
        with self.ending():
            (found,) = self.query("PRAGMA quick_check(1)").fetchone()
        if found != "ok":
            raise self.damage(f"its pages do not fit together after {self._logs['-journal'].name}: {found}")


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


def _left_of_log(log: Path, taken: int, step: int) -> tuple[int, int]:
    """Return where the pages begin that SQLite did not take of a write-ahead log, and how many belong to it.

    These have one of the log's two salts; older ones, which the log has not yet overwritten, have none. If SQLite takes
    no page, the header is damaged, and all belong to it.
    """
    with log.open("rb") as file:
        salts = file.read(_WAL_HEADER)[16:]
        start, stop = _WAL_HEADER + taken * step, log.stat().st_size
        if not taken:
            return 0, -(-(stop - _WAL_HEADER) // step) if stop >= _WAL_HEADER else 1
        left = 0
        for place in range(start, stop, step):
            file.seek(place + 8)
            own = file.read(8)
            left += own[:4] == salts[:4] or own[4:] == salts[4:8] or len(own) < 8
    return start, left


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


def _sorting_error(path: Path) -> RecordingError:
    """Return the error for SQLite's own temporary files, whose folder is not Python's."""
    named = (os.environ.get("SQLITE_TMPDIR"), os.environ.get("TMPDIR"), "/var/tmp", "/usr/tmp", "/tmp")  # noqa: S108
    usable = (place for place in named if place and Path(place).is_dir() and os.access(place, os.W_OK | os.X_OK))
    place = next(usable, ".")
    return RecordingError(
        f"cannot be sorted: SQLite's temporary files do not fit in {place}", path=path, hint=TEMPORARY_HINT
    )
