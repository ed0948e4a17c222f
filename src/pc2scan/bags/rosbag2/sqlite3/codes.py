"""SQLite's result codes (https://sqlite.org/rescode.html), which Python 3.10's `sqlite3` does not have."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import sqlite3

ERROR = 1
CORRUPT = 11
FULL = 13
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
