"""What a rosbag2 database has: its topics with their definitions, the times of its messages, and their compression.

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

SQLite stores values of any type in any column, whatever the table declares: an INTEGER column keeps 1e300, text and
blobs as they are. Such values have an order among themselves and with integers. So whatever counts, compares or orders
messages does so with `SOUND` rows only; each other row is damage of its own.

Facts that a database has twice are compared: small tables with their columns, rows with the index of times. Unlike
SQLite's own check, which reads the whole file, these checks read no message.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.damage import MAX_PLACES
from pc2scan.bags.reader import MAX_CONNECTIONS, ConnectionLimit
from pc2scan.bags.topics import latches
from pc2scan.errors import RecordingError
from pc2scan.files.compression import ZSTD_MAGIC
from pc2scan.model import Connection, Definition
from pc2scan.text import counted

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


def _note_unsound(database: Database, noted: DamageLog, count: int, topics: Mapping[int, str]) -> None:
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


def _kinds_of(columns: Sequence[str]) -> str:
    """Return an SQL expression for the columns of text that have something else, and what; empty if all have text.

    NULL, where a column forbids it, is found by `_check_small_tables`.
    """
    return " || ".join(
        f"CASE WHEN typeof({column}) IN ('text', 'null') THEN '' ELSE '{column} is ' || typeof({column}) || ', ' END"
        for column in columns
    )


def _note_kinds(database: Database, noted: DamageLog, row: str, kinds: str) -> None:
    """Note the columns of a row that have no text (see `_kinds_of`); they are read as text."""
    if kinds:
        noted.note(database.damage(f"in {row} {kinds}not text"), key=row, messages_lost=0)


#: A sum over rows that changes if a row has another time or replaces another. It is exact: a sum with one REAL would be
#: rounded, and neither text nor numbers of 64 bits may end it.
_TIMES_SUM = "coalesce(sum(CAST(timestamp AS INTEGER) % 2147483647 + CAST(id AS INTEGER) % 2147483647), 0)"


#: Messages among which one in CDR is searched, to detect whether they are compressed one by one.
_LOOKED_AT = 1000


class Tables(NamedTuple):
    """What the tables of a database have, without the messages.

    Attributes
    ----------
    connections
        A connection for each row of ``topics``.
    start_ns, end_ns
        Log times of the first and the last message; None without messages.
    time_index
        The quoted name of an index by time of all messages; None if there is none.
    packed
        The topics whose messages are compressed one by one.
    """

    connections: tuple[Connection, ...]
    start_ns: int | None
    end_ns: int | None
    time_index: str | None
    packed: frozenset[int]


def read_tables(database: Database, noted: DamageLog, *, message_compression: str) -> Tables:
    """Check and read the tables.

    Parameters
    ----------
    database
        The database.
    noted
        Where damage is noted.
    message_compression
        ``zstd`` if it is declared that every message is compressed by itself.
    """
    _check_tables(database)
    index = _timestamp_index(database)
    with database.ending():
        _check_small_tables(database, noted)
        connections, start_ns, end_ns = _read_connections(database, noted, index)
    packed = _find_compressed(database, connections, declared=message_compression == "zstd")
    return Tables(connections, start_ns, end_ns, index, packed)


def _check_tables(database: Database) -> None:
    """Raise if the tables are not rosbag2's."""
    needed = {
        "topics": {"id", "name", "type", "serialization_format"},
        "messages": {"id", "topic_id", "timestamp", "data"},
    }
    for table, columns in needed.items():
        if missing := columns - database.columns(table):
            raise RecordingError(
                f"is an SQLite database, but not one of rosbag2: table {table} lacks {', '.join(sorted(missing))}",
                path=database.path,
            )
    # A rebuilt database is trusted.
    for table in (*needed, "message_definitions") if not database.is_rebuilt else ():
        database.refuse_made_up(table)


def _check_small_tables(database: Database, noted: DamageLog) -> None:
    """Check the tables that describe the messages, unless they are rebuilt."""
    # The first one lists all others; if it is damaged, it may list fewer.
    for table in ("sqlite_master", "topics", "message_definitions") if not database.is_rebuilt else ():
        if not database.columns(table):
            continue
        found = [str(text) for (text,) in database.query(f"PRAGMA quick_check({table})")]
        if found == ["ok"]:
            continue
        # The first line only has the name of the database.
        first = next((line for text in found for line in text.splitlines() if not line.startswith("***")), "no answer")
        error = database.damage(f"table {table} contradicts itself: {first}")
        # There may be rows that its tree does not reach.
        if any(text.startswith("***") for text in found):
            raise error
        noted.note(error, key=("table", table), messages_lost=0)


def _check_index(database: Database, index: str, count: int, times_sum: int) -> None:
    """Raise if the complete index of times, of this quoted name, differs from the rows.

    Parameters
    ----------
    count, times_sum
        Of the rows: how many there are, and their `_TIMES_SUM`.
    """
    sql = f"SELECT count(*), {_TIMES_SUM} FROM messages INDEXED BY {index}"  # noqa: S608
    indexed, indexed_sum = database.query(sql).fetchone()
    if indexed != count:
        raise database.damage(f"the index of timestamps has {indexed} messages, the table {count}")
    if indexed_sum != times_sum:
        raise database.damage("the index of timestamps has other times than the messages")


def _timestamp_index(database: Database) -> str | None:
    """Return the quoted name of an index by time of all messages."""
    for row in database.query("PRAGMA index_list(messages)"):
        name = '"' + str(row[1]).replace('"', '""') + '"'
        columns = [column[2] for column in database.query(f"PRAGMA index_info({name})")]
        # An index with a WHERE clause (the fifth column) does not have every row.
        if columns == ["timestamp"] and not row[4]:
            return name
    return None


def _read_connections(
    database: Database, noted: DamageLog, index: str | None
) -> tuple[tuple[Connection, ...], int | None, int | None]:
    """Return the connections, and the times of the first and the last message."""
    topics = _read_topics(database, noted)
    counts = {
        topic_id: numbers
        for topic_id, *numbers in database.query(
            f"SELECT CASE WHEN {SOUND} THEN topic_id END, count(*), min(timestamp), max(timestamp), "  # noqa: S608
            f"{_TIMES_SUM} FROM messages GROUP BY 1 LIMIT ?",
            (MAX_CONNECTIONS + 2,),
        )
    }
    total, times_sum = (sum(numbers[place] for numbers in counts.values()) for place in (0, 3))
    unsound, *_ = counts.pop(None, (0,))
    ConnectionLimit(database.path).add(count=len(counts))
    if index is not None:
        _check_index(database, index, total, times_sum)
    if unsound:
        _note_unsound(database, noted, unsound, {topic_id: row[0] for topic_id, row in topics.items()})
    definitions = _read_definitions(database, noted)
    connections = [
        Connection(
            id=topic_id,
            topic=topic,
            msgtype=msgtype,
            serialization=serialization,
            definition=definitions.get((msgtype, digest)) or definitions.get((msgtype, None), Definition()),
            digest=digest,
            latching=latches(qos),
            qos=qos,
            message_count=counts[topic_id][0] if topic_id in counts else 0,
        )
        for topic_id, (topic, msgtype, serialization, qos, digest) in topics.items()
    ]
    _note_undescribed(database, noted, {key: numbers for key, numbers in counts.items() if key not in topics})
    times = [numbers for topic_id, numbers in counts.items() if topic_id in topics]
    start_ns = min((first_ns for _, first_ns, _, _ in times), default=None)
    return tuple(connections), start_ns, max((last_ns for _, _, last_ns, _ in times), default=None)


def _read_topics(database: Database, noted: DamageLog) -> dict[int, list[str]]:
    """Return name, type, serialization format, QoS profiles and hash of each topic; missing columns are empty."""
    names = ("name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash")
    available = database.columns("topics")
    columns = ", ".join(_column_as_text(name) if name in available else "''" for name in names)
    kinds = _kinds_of([name for name in names if name in available])
    found: dict[int, list[str]] = {}
    limit = ConnectionLimit(database.path, database.size)
    for topic_id, kind, *values in database.bounded_rows(
        database.query(f"SELECT id, {kinds}, {columns} FROM topics ORDER BY id")  # noqa: S608 - constants
    ):
        if not isinstance(topic_id, int) or topic_id in found:
            what = "the id of another row" if topic_id in found else "not an integer"
            error = database.damage(f"topic {values[0]!r:.80} has id {shown_value(topic_id)}, {what}")
            noted.note(error, key=("topics", topic_id, values[0]), messages_lost=0)
            continue
        _note_kinds(database, noted, f"row {topic_id} of topics", kind)
        found[topic_id] = values
        limit.add(sum(map(len, values)))
    return found


def _note_undescribed(database: Database, noted: DamageLog, counts: Mapping[int, Sequence[Any]]) -> None:
    """Note messages of topics without a row."""
    for topic_id, (count, first_ns, last_ns, _) in counts.items():
        error = database.damage(f"{counted(count, 'message', 'are')} of topic {topic_id}, which is not described")
        noted.note(error, key=("topic", topic_id), messages_lost=count, first_ns=first_ns, last_ns=last_ns)


def _read_definitions(database: Database, noted: DamageLog) -> dict[tuple[str, str | None], Definition]:
    """Return definitions by type and hash; without a hash, the first of a type."""
    found: dict[tuple[str, str | None], Definition] = {}
    columns = database.columns("message_definitions")
    if not {"topic_type", "encoding", "encoded_message_definition"} <= columns:
        return found
    names = ["topic_type", "encoding", *(["type_description_hash"] if "type_description_hash" in columns else [])]
    digest = _column_as_text("type_description_hash") if "type_description_hash" in columns else "''"
    rows = database.query(
        f"SELECT id, {_kinds_of(names)}, {_column_as_text('topic_type')}, {_column_as_text('encoding')}, "  # noqa: S608
        f"CAST(encoded_message_definition AS BLOB), {digest} FROM message_definitions ORDER BY id LIMIT ?",
        (MAX_CONNECTIONS,),
    )
    for row_id, kind, msgtype, encoding, data, own_digest in database.bounded_rows(rows):
        _note_kinds(database, noted, f"row {shown_value(row_id)} of message_definitions", kind)
        # rosbag2 writes "unknown" if it did not find the definition.
        if data and encoding not in {"", "unknown"}:
            definition = Definition(encoding, data)
            found.setdefault((msgtype, own_digest), definition)
            found.setdefault((msgtype, None), definition)
    return found


def _find_compressed(database: Database, connections: Sequence[Connection], *, declared: bool) -> frozenset[int]:
    """Return the topics whose messages are compressed one by one.

    Without a declaration the first CDR message decides: CDR begins with a zero byte, and never looks like a zstd
    frame. Messages in other serialisations may begin with any bytes, and stay as they are.
    """
    if declared:
        return frozenset(connection.id for connection in connections)
    cdr = frozenset(connection.id for connection in connections if connection.serialization == "cdr")
    rows = database.query("SELECT topic_id, substr(data, 1, 4) FROM messages LIMIT ?", (_LOOKED_AT,))
    for topic_id, head in rows:
        if topic_id in cdr and isinstance(head, bytes):
            return cdr if head == ZSTD_MAGIC else frozenset()
    return frozenset()


def _column_as_text(column: str) -> str:
    """Return a column as text: SQLite allows any value in any column."""
    return f"coalesce(CAST({column} AS TEXT), '')"
