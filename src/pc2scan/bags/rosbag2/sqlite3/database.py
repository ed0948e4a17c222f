"""A database of an untrusted recording: opened without writing, within limits, and rebuilt from its pages if damaged.

SQLite opens only complete databases, and as immutable ones: it reads no log, and locks and writes nothing. A database
with a log beside it is merged with the log into a temporary copy by `pc2scan.bags.rosbag2.sqlite3.logs`.
"""

from __future__ import annotations

import os
import re
import sqlite3
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.bags.damage import RECOVER
from pc2scan.errors import DamageError, RecordingError
from pc2scan.files.places import TEMPORARY_HINT, copy_errors, private_folder
from pc2scan.files.source import changed_while_read, keep_open, state_of

from .logs import missing_bytes, side_logs, write_merged
from .recover import PageFile, declared_size, rebuild_database

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from tempfile import TemporaryDirectory

    from pc2scan.bags.damage import DamageLog

    from .logs import PageLog

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

#: If a name in the schema is not UTF-8, Python cannot decode the error message; if a length is wrong, SQLite may run
#: out of memory.
SQLITE_ERRORS = (sqlite3.Error, UnicodeDecodeError, MemoryError)


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


def _open(path: Path, most: int) -> _Opened:
    """Open a file as immutable, with the limits for untrusted recordings; ``most`` is the length of its values."""
    # Other threads use the reader, one at a time.
    uri = f"{Path(os.fspath(path)).as_uri()}?mode=ro&immutable=1"
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
    DamageError
        If a log is damaged, and damage is an error.
    """

    def __init__(self, path: Path, damage: DamageLog) -> None:
        self.path = path
        self._noted = damage
        self._logs: list[PageLog] = []
        self._copy: TemporaryDirectory[str] | None = None
        #: What `open` opened: the file, and its database, unless it was closed for other files.
        self._file: Path | None = None
        self._opened: Callable[[], _Opened | None] = lambda: None
        #: The rows in the pages, after `recover`.
        self._rebuilt: _Opened | None = None
        self._pages: PageFile | None = None
        try:
            self.size = path.stat().st_size
            self._logs = side_logs(path)
            self.most_bytes = 1_000_000 + self.size + sum(log.file.size for log in self._logs)
            self._note_logs()
        except OSError as err:
            self.close()
            raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err
        except BaseException:
            self.close()
            raise

    @property
    def is_rebuilt(self) -> bool:
        """Whether it was rebuilt from pages. Its tables are trusted then."""
        return self._rebuilt is not None

    def open(self) -> None:
        """Open as immutable: the database is neither locked nor recovered.

        Raises
        ------
        DamageError
            If pages are missing.
        """
        self._refuse_incomplete()
        path = self.path
        if any(log.page_count is not None for log in self._logs):
            path = self._merged_copy()
        self._file = path.absolute()
        self._state = state_of(self._file)
        self._opened = keep_open(_open(self._file, self.most_bytes))

    def _database(self) -> _Opened:
        """Return the open database; it is opened again if it was closed for other files."""
        opened = self._rebuilt or self._opened()
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
        self._pages = PageFile(self.path, self._logs)
        try:
            database, last_ns = rebuild_database(self._pages)
        except sqlite3.Error as error:
            raise self._error(error) from error
        self._rebuilt = _Opened(database)
        if last_ns is None and not database.execute("SELECT 1 FROM topics").fetchone():
            raise DamageError(f"nothing of it can be recovered: {problem.message}", path=self.path)
        if any(log.broken for log in self._logs):
            # The missing bytes are noted for the log.
            self._noted.note(problem)
        else:
            self._noted.note(problem, bytes_lost=self._missing_bytes(), first_ns=last_ns)

    def close(self) -> None:
        """Close the database and remove the copy, if there is one."""
        self._disconnect()
        if self._pages is not None:
            self._pages.close()
            self._pages = None
        for log in self._logs:
            log.file.close()
        if self._copy is not None:
            self._copy.cleanup()
            self._copy = None

    def _disconnect(self) -> None:
        for opened in (self._rebuilt, self._opened()):
            if opened is not None:
                opened.close()
        self._file, self._rebuilt, self._opened = None, None, lambda: None

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

    def damage(self, message: str, topic: str | None = None) -> DamageError:
        """Return an error that the database is damaged."""
        return DamageError(message, path=self.path, topic=topic, hint=RECOVER)

    def _error(self, err: Exception) -> RecordingError:
        if isinstance(err, sqlite3.Error) and code_of(err) == FULL:
            return _sorting_error(self.path)
        message = f"SQLite cannot read it: {str(err) or type(err).__name__}"
        # Failing disks and a lack of memory are not damage.
        if not isinstance(err, sqlite3.Error) or code_of(err) in _DAMAGE_CODES:
            return self.damage(message)
        return RecordingError(message, path=self.path)

    def _note_logs(self) -> None:
        """Note the problems of the logs."""
        for log in self._logs:
            for problem in log.problems:
                error = DamageError(problem.what, path=log.file.path, hint=RECOVER)
                self._noted.note(error, offset=problem.offset, bytes_lost=problem.bytes_lost)

    def _missing_bytes(self) -> int:
        """Return how many bytes the database lacks by its own header or a log; SQLite checks only what it reads."""
        missing = missing_bytes(self._logs)
        return max(0, self._declared_size() - self.size) if missing is None else missing

    def _declared_size(self) -> int:
        """Return the size of the database by its own header, or of the file if the header has none."""
        with self.path.open("rb") as file:
            return declared_size(file.read(100)) or self.size

    def _refuse_incomplete(self) -> None:
        """Raise if pages are missing, in the file itself or in its logs."""
        for log in self._logs:
            if log.broken:
                raise self.damage(f"its pages do not fit together, because {log.file.path.name} is damaged")
        if missing := self._missing_bytes():
            raise self.damage(f"is cut off: it has {self.size} of {self.size + missing} bytes")
        declared = self._declared_size()
        if self.size > declared and missing_bytes(self._logs) is None:
            # Appended bytes are harmless; inserted ones shift the pages after them.
            error = self.damage(f"has {self.size} bytes, {self.size - declared} more than its header declares")
            self._noted.note(error, key="size", messages_lost=0)

    def _merged_copy(self) -> Path:
        """Copy the database with the pages of its logs; the copy is at most as large as both."""
        self._copy = private_folder(self.path)
        target = Path(self._copy.name, "merged.db3")
        with copy_errors(self.path, target.parent):
            write_merged(self.path, self._logs, target)
        return target


def _sorting_error(path: Path) -> RecordingError:
    """Return the error for SQLite's own temporary files, whose folder is not Python's."""
    named = (os.environ.get("SQLITE_TMPDIR"), os.environ.get("TMPDIR"), "/var/tmp", "/usr/tmp", "/tmp")  # noqa: S108
    usable = (place for place in named if place and Path(place).is_dir() and os.access(place, os.W_OK | os.X_OK))
    place = next(usable, ".")
    return RecordingError(
        f"cannot be sorted: SQLite's temporary files do not fit in {place}", path=path, hint=TEMPORARY_HINT
    )
