"""Reads on in a damaged database, behind rows that SQLite cannot read, by plain queries for ranges of rowids."""

from __future__ import annotations

import sqlite3
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

#: What SQLite raises at damage. If a name in the schema is not UTF-8, Python cannot decode the error message; if a
#: length is wrong, SQLite may run out of memory.
SQLITE_ERRORS = (sqlite3.Error, UnicodeDecodeError, MemoryError)

#: Most ranges of rowids that may fail, each of which takes some microseconds.
_MOST_FAILURES = 20_000

_ROWS_OF_A_PAGE = 256
_LEAST_ID = -(2**63)

_DATA_OF = "SELECT data FROM messages WHERE rowid BETWEEN ? AND ? AND +rowid = ? LIMIT 1"

#: The tables, and their columns beside the id.
TABLES = {
    "topics": ("name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"),
    "message_definitions": ("topic_type", "encoding", "encoded_message_definition", "type_description_hash"),
    "messages": ("topic_id", "timestamp"),
}


def rebuild_database(
    damaged: sqlite3.Connection,
    columns: Mapping[str, list[str]],
    size: int,
    bounded: Callable[[Iterable[tuple[Any, ...]]], Iterator[tuple[Any, ...]]],
) -> tuple[sqlite3.Connection, int | None]:
    """Make a database of the rows that can be read, and return the latest log time.

    It lies in a temporary file that SQLite removes itself, and has the messages without their data: these are read from
    the damaged database when they are asked for.

    Parameters
    ----------
    damaged
        The damaged database; it stays open as long as the other one is used.
    columns
        The columns of each table of `TABLES` that are read; none if the table is missing.
    size
        Bytes of the damaged database.
    bounded
        Yields rows as they are, up to the limit of the bytes of all values.
    """

    def data(row_id: int) -> Any:
        # A page with a wrong number of rows is read from the page before it on: SQLite would search in it in vain.
        for first in (row_id, row_id - _ROWS_OF_A_PAGE if row_id > _ROWS_OF_A_PAGE else _LEAST_ID):
            with suppress(*SQLITE_ERRORS):
                for (value,) in damaged.execute(_DATA_OF, (first, row_id, row_id)):
                    return value
        return None

    database = sqlite3.connect("", check_same_thread=False, isolation_level=None)
    database.text_factory = damaged.text_factory
    database.create_function("data_of", 1, data)
    database.execute("BEGIN")
    for table, names in columns.items():
        listed = ", ".join(("id INTEGER PRIMARY KEY", *names))
        place = "places" if table == "messages" else table
        database.execute(f"CREATE TABLE {place}({listed})")
        # A broken tree may lead to a row twice.
        insert = f"INSERT OR IGNORE INTO {place} VALUES (?{', ?' * len(names)})"  # noqa: S608  # constants
        database.executemany(insert, bounded(_readable_rows(damaged, table, names, size)))
    database.execute("CREATE VIEW messages AS SELECT *, data_of(id) AS data FROM places")
    database.execute("COMMIT")
    (last_ns,) = database.execute("SELECT max(timestamp) FROM places WHERE typeof(timestamp) = 'integer'").fetchone()
    return database, last_ns


def _readable_rows(damaged: sqlite3.Connection, table: str, names: list[str], size: int) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a table, with their rowids in front.

    Behind the first row of a range of rowids that fails, ranges that double are read; one that fails at once is halved.
    So what lies near is searched closely, and a file that is cut off costs no more than `_MOST_FAILURES`.
    """
    listed = ", ".join(("rowid", *names))
    # With LIMIT, a row counts whatever lies behind it: Python raises the error of the next row in place of a row.
    sql = f"SELECT {listed} FROM {table} NOT INDEXED WHERE rowid BETWEEN ? AND ? ORDER BY rowid LIMIT ?"  # noqa: S608
    ranges = deque([(_LEAST_ID, 2**63 - 1)] if names else [])
    failures = 0
    # A row takes more than eight bytes.
    most = left = size // 8
    while ranges and failures < _MOST_FAILURES:
        start, last = ranges.popleft()
        # Recorders count from 1 on.
        first = max(start, 1)
        try:
            for row in damaged.execute(sql, (start, last, min(last - start, 2**63 - 2) + 1)):
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
