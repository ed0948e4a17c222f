"""Compares facts that a rosbag2 database has twice: small tables with their columns, rows with the index of times.

Unlike SQLite's own check, which reads the whole file, these checks read no message.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    #: Executes a statement with values.
    Query = Callable[[str, Sequence[Any]], Any]

#: A sum over rows that changes if a row has another time or replaces another. It is exact: a sum with one REAL would be
#: rounded, and neither text nor numbers of 64 bits may end it.
TIMES_SUM = "coalesce(sum(CAST(timestamp AS INTEGER) % 2147483647 + CAST(id AS INTEGER) % 2147483647), 0)"


class Trouble(NamedTuple):
    """The problem of a table; ``unreachable`` if there may be rows that its tree does not reach."""

    what: str
    unreachable: bool


def table_trouble(query: Query, table: str) -> Trouble | None:
    """Return the problem that SQLite finds in a small table: damaged pages, or values that its columns do not allow."""
    found = [str(text) for (text,) in query(f"PRAGMA quick_check({table})", ())]
    if found == ["ok"]:
        return None
    # The first line only has the name of the database.
    first = next((line for text in found for line in text.splitlines() if not line.startswith("***")), "no answer")
    return Trouble(f"table {table} contradicts itself: {first}", any(text.startswith("***") for text in found))


def index_trouble(query: Query, index: str, count: int, times_sum: int) -> str | None:
    """Describe how the complete index of times differs from the rows; None if it does not.

    Parameters
    ----------
    query
        Executes a statement.
    index
        Its name, quoted.
    count, times_sum
        Of the rows: how many there are, and their `TIMES_SUM`.
    """
    sql = f"SELECT count(*), {TIMES_SUM} FROM messages INDEXED BY {index}"  # noqa: S608
    indexed, indexed_sum = query(sql, ()).fetchone()
    if indexed != count:
        return f"the index of timestamps has {indexed} messages, the table {count}"
    if indexed_sum != times_sum:
        return "the index of timestamps has other times than the messages"
    return None
