"""Facts that a database of rosbag2 has twice, compared: small tables with their columns, rows with the index of times.

SQLite's own check reads the whole file. These read no message.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    #: Executes a statement with values.
    Query = Callable[[str, Sequence[Any]], Any]

__all__ = ["TIMES_SUM", "Trouble", "index_trouble", "table_trouble"]

#: Of rows: changes if one of them has another time, or one takes the place of another.
TIMES_SUM = "coalesce(sum(timestamp % 2147483647 + id), 0)"


class Trouble(NamedTuple):
    """What is wrong with a table; ``unreachable`` if rows may be there that its tree does not lead to."""

    what: str
    unreachable: bool


def table_trouble(query: Query, table: str) -> Trouble | None:
    """What SQLite finds wrong with a small table: its pages, and values that its columns do not allow."""
    found = [str(text) for (text,) in query(f"PRAGMA quick_check({table})", ())]
    if found == ["ok"]:
        return None
    # The line in front of those about pages names the database only.
    first = next((line for text in found for line in text.splitlines() if not line.startswith("***")), "no answer")
    return Trouble(f"table {table} contradicts itself: {first}", any(text.startswith("***") for text in found))


def index_trouble(query: Query, index: str, count: int, times_sum: int) -> str | None:
    """How the index of times, all of it, differs from the rows; None if it does not.

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
