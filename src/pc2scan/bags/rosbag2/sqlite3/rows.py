"""Which rows of a rosbag2 database are sound, and how others are reported.

SQLite stores values of any type in any column, whatever the table declares: an INTEGER column keeps 1e300, text and
blobs as they are. Such values have an order among themselves and with integers. So whatever counts, compares or orders
messages does so with `SOUND` rows only; each other row is damage of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.bags.damage import MAX_PLACES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pc2scan.bags.damage import DamageLog

    from .database import Database

#: The columns that place a message.
_COLUMNS = ("id", "topic_id", "timestamp")

#: The condition for rows of ``messages`` that have a place in the recording.
SOUND = " AND ".join(f"typeof({column}) = 'integer'" for column in _COLUMNS)

#: Characters or bytes of a wrong value that are shown.
_SHOWN = 40


def shown_value(value: object) -> str:
    """Return a value as SQL writes it, shortened.

    >>> shown_value(None), shown_value(1e300), shown_value(b"a"), shown_value("x")
    ('NULL', '1e+300', "x'61'", "'x'")
    """
    if value is None:
        return "NULL"
    if isinstance(value, str | bytes):
        value = value[:_SHOWN]
    return f"x'{value.hex()}'" if isinstance(value, bytes) else f"{value!r}"


def message_row(row_id: object, topic: str | None) -> str:
    """Name a row of ``messages``."""
    of_topic = "" if topic is None else f", of topic {topic!r:.80},"
    return f"row {shown_value(row_id)} of messages{of_topic}"


def note_unsound(database: Database, noted: DamageLog, count: int, topics: Mapping[int, str]) -> None:
    """Note the rows of ``messages`` that are not sound, of which there are ``count``; topics have names by id."""
    # Not the values themselves, which may be long.
    short = ", ".join(
        f"CASE WHEN length(CAST({column} AS BLOB)) > {_SHOWN} THEN substr({column}, 1, {_SHOWN}) ELSE {column} END"
        for column in _COLUMNS
    )
    rows = database.query(f"SELECT {short} FROM messages WHERE NOT ({SOUND}) LIMIT ?", (MAX_PLACES,))  # noqa: S608
    for number, row in enumerate(rows):
        row_id, topic_id, time_ns = row
        wrong = [(name, value) for name, value in zip(_COLUMNS, row, strict=True) if not isinstance(value, int)]
        values = " and ".join(f"{name} {shown_value(value)}" for name, value in wrong)
        topic = topics.get(topic_id) if isinstance(topic_id, int) else None
        allowed = "not an integer" if len(wrong) == 1 else "not integers"
        time = time_ns if isinstance(time_ns, int) else None
        noted.note(
            database.damage(f"{message_row(row_id, topic)} has {values}, {allowed}"),
            key=("messages", number),
            messages_lost=1,
            first_ns=time,
            last_ns=time,
        )
    if (more := count - MAX_PLACES) > 0:
        error = database.damage(f"{more} further rows of messages have values that are no integers")
        noted.note(error, key=("messages", "further"), messages_lost=more)


def kinds_of(columns: Sequence[str]) -> str:
    """Return an SQL expression for the columns of text that have something else, and what; empty if all have text.

    NULL, where a column forbids it, is found by `table_trouble`.
    """
    return " || ".join(
        f"CASE WHEN typeof({column}) IN ('text', 'null') THEN '' ELSE '{column} is ' || typeof({column}) || ', ' END"
        for column in columns
    )


def note_kinds(database: Database, noted: DamageLog, row: str, kinds: str) -> None:
    """Note the columns of a row that have no text (see `kinds_of`); they are read as text."""
    if kinds:
        noted.note(database.damage(f"in {row} {kinds}not text"), key=row, messages_lost=0)
