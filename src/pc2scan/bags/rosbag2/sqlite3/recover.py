"""Reads the rows of a damaged rosbag2 database page by page.

SQLite reaches rows through trees, and fails at the first missing inner page. The rows are in leaf pages, which can be
read by themselves; long rows continue in a chain of overflow pages. rosbag2 only appends rows, and all its tables have
different columns, so the table of a row is detected from its values.

Source: https://www.sqlite.org/fileformat2.html.
"""

from __future__ import annotations

import sqlite3
import struct
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.files.source import SourceFile

from .logs import page_size_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from .logs import PageLog

_HEADER_SIZE = 100
_LEAF = 0x0D

#: First number for doubtful pages; no database has as many pages.
_DOUBTFUL = 1 << 32

#: Text and numbers are read up to this size; a message's data is read when it is needed.
_LONGEST_VALUE = 1 << 20

#: Bytes of a blob that are kept, for a report of one that is in the wrong place.
_SHOWN_BYTES = 40

#: The schema of the rebuilt database: all readable rows, without the data of messages.
_SCHEMA = """
CREATE TABLE topics(
  id INTEGER PRIMARY KEY, name, type, serialization_format, offered_qos_profiles, type_description_hash);
CREATE TABLE message_definitions(
  id INTEGER PRIMARY KEY, topic_type, encoding, encoded_message_definition, type_description_hash);
CREATE TABLE places(id INTEGER PRIMARY KEY, topic_id, timestamp, page, offset);
CREATE TABLE unsound(id INTEGER PRIMARY KEY, topic_id, timestamp, page, offset);
CREATE VIEW messages AS SELECT id, topic_id, timestamp, payload(page, offset) AS data FROM places;
"""

Value = int | float | str | bytes | None


class Cell(NamedTuple):
    """A row: its place (page and byte), its rowid, and its values, with the first bytes of blobs."""

    page: int
    offset: int
    rowid: int
    values: tuple[Value, ...]

    @property
    def is_message(self) -> bool:
        """Whether it is a row of ``messages``: id, topic_id, timestamp, data. The values may be of any type."""
        return len(self.values) == 4 and self.values[0] is None and not self.is_topic

    @property
    def is_sound_message(self) -> bool:
        """Whether it is a row of ``messages`` with values of the right types."""
        v = self.values
        return self.is_message and isinstance(v[1], int) and isinstance(v[2], int) and isinstance(v[3], bytes)

    @property
    def is_definition(self) -> bool:
        """Whether it is a row of ``message_definitions``."""
        v = self.values
        return len(v) == 5 and v[0] is None and all(isinstance(x, str) for x in v[1:]) and v[2] in _ENCODINGS

    @property
    def is_topic(self) -> bool:
        """Whether it is a row of ``topics``: id, name, type, serialization_format, and up to two more."""
        v = self.values
        return (
            4 <= len(v) <= 6
            and v[0] is None
            and all(isinstance(x, str) for x in v[1:])
            and not self.is_definition
            and "/" in str(v[2])
        )


_ENCODINGS = ("ros2msg", "ros2idl", "unknown")


def declared_size(head: bytes) -> int | None:
    """Return the size of a database by its own header (its first 100 bytes); None if that has none."""
    if len(head) < _HEADER_SIZE:
        return None
    (pages,) = struct.unpack_from(">I", head, 28)
    # SQLite before 3.7 did not update the number; newer versions mark that they did.
    return pages * page_size_of(head) if pages and head[24:28] == head[92:96] else None


class PageFile(SourceFile):
    """The pages of a database, replaced by those of the logs beside it.

    Parameters
    ----------
    path
        The database; may be cut off anywhere.
    logs
        What is beside it, in the order in which it applies. Rows in doubtful pages count where no other page has them.
    """

    def __init__(self, path: Path, logs: Sequence[PageLog] = ()) -> None:
        super().__init__(path)
        head = self.read(0, min(self.size, _HEADER_SIZE)).ljust(_HEADER_SIZE, b"\0")
        self._page_size = page_size_of(head)
        self._usable = max(self._page_size - head[20], 480)
        self._logged: dict[int, tuple[SourceFile, int]] = {}
        for log in logs:
            self._logged |= {number: (log.file, place) for number, place in log.places.items()}
        self._stored = range(1, -(-self.size // self._page_size) + 1)
        # A log may have any page number; only existing pages are read.
        self._only_logged = sorted(number for number in self._logged if number not in self._stored)
        doubtful = [(log.file, place, number) for log in logs for place, number in log.doubtful.items()]
        self._doubtful = range(_DOUBTFUL, _DOUBTFUL + len(doubtful))
        for own, (file, place, number) in zip(self._doubtful, doubtful, strict=True):
            self._logged[own] = file, place
            # A page that exists only in the log may continue a long row.
            if number not in self._stored:
                self._logged.setdefault(number, (file, place))
        self._latest = (0, b"")

    def cells(self) -> Iterator[Cell]:
        """Yield all readable rows, in the order of the pages."""
        for number in chain(self._stored, self._only_logged, self._doubtful):
            page = self._page(number)
            base = _HEADER_SIZE if number == 1 else 0
            if len(page) < base + 8 or page[base] != _LEAF:
                continue
            (count,) = struct.unpack_from(">H", page, base + 3)
            stop = min(base + 8 + 2 * count, len(page) - 1)
            for at in range(base + 8, stop, 2):
                (offset,) = struct.unpack_from(">H", page, at)
                cell = self._cell(number, page, offset)
                if cell is not None:
                    yield cell

    def payload(self, number: int, offset: int) -> Value:
        """Return the last value of the row at a place, a message's data; None if part of it is missing."""
        page = self._page(number)
        head = _varint(page, offset)
        rowid = head and _varint(page, head[1])
        if head is None or rowid is None:
            return None
        record = self._record(page, rowid[1], head[0], head[0])
        if len(record) < head[0]:
            return None
        kind = (_serial_types(record) or [0])[-1]
        data = record[len(record) - _size_of(kind) :]
        return data if kind >= 12 and kind % 2 == 0 else _value(kind, data)

    def _page(self, number: int) -> bytes:
        if self._latest[0] != number:
            start = (number - 1) * self._page_size
            if number in self._logged:
                log, place = self._logged[number]
                page = log.read(place, self._page_size)
            elif number < 1 or start >= self.size:
                page = b""
            else:
                page = self.read(start, min(self._page_size, self.size - start))
            self._latest = (number, page)
        return self._latest[1]

    def _cell(self, number: int, page: bytes, offset: int) -> Cell | None:
        length = _varint(page, offset)
        rowid = length and _varint(page, length[1])
        if length is None or rowid is None:
            return None
        size = length[0]
        record = self._record(page, rowid[1], size, 0)
        types = _serial_types(record)
        if types is None:
            return None
        header = _varint(record, 0)
        position = header[0] if header else 0
        # The declared length and those of the values must agree, which random bytes hardly do.
        if position + sum(map(_size_of, types)) != size:
            return None
        if size > len(record) and any(kind >= 12 and kind % 2 for kind in types):
            # Long text in overflow pages: QoS profiles, definitions.
            record = self._record(page, rowid[1], size, min(size, _LONGEST_VALUE))
        values: list[Value] = []
        for kind in types:
            width = _size_of(kind)
            values.append(_value(kind, record[position : position + width]))
            if values[-1] is None and kind:
                return None
            position += width
        # SQLite's integers are signed.
        return Cell(number, offset, rowid[0] - (rowid[0] >> 63 << 64), tuple(values))

    def _record(self, page: bytes, start: int, size: int, wanted: int) -> bytes:
        """Return at least ``wanted`` bytes of a row, if they exist, beginning with those in the page itself."""
        usable = self._usable
        local = size
        if size > usable - 35:
            least = (usable - 12) * 32 // 255 - 23
            local = least + (size - least) % (usable - 4)
            local = local if local <= usable - 35 else least
        parts = [page[start : start + local]]
        found = len(parts[0])
        if local == size or wanted <= local or found < local or start + local + 4 > len(page):
            return parts[0]
        (following,) = struct.unpack_from(">I", page, start + local)
        for _ in range(len(self._stored) + len(self._logged)):  # a chain may be a loop
            if found >= wanted or not following:
                break
            overflow = self._page(following)
            if len(overflow) < 4:
                break
            part = overflow[4 : min(usable, 4 + size - found)]
            if not part:
                break
            parts.append(part)
            found += len(part)
            (following,) = struct.unpack_from(">I", overflow)
        return b"".join(parts)


def _varint(data: bytes, position: int) -> tuple[int, int] | None:
    """Read an integer of one to nine bytes; returns it and its end, or None if it is cut off."""
    value = 0
    for index in range(9):
        if position + index >= len(data):
            return None
        byte = data[position + index]
        if index == 8:
            return value << 8 | byte, position + 9
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, position + index + 1
    return None


def _serial_types(record: bytes) -> list[int] | None:
    """Return the types of a row's values from its header; None if it has none."""
    head = _varint(record, 0)
    if head is None or not head[1] < head[0] <= len(record):
        return None
    types = []
    size, position = head
    while position < size:
        kind = _varint(record, position)
        if kind is None or kind[0] in (10, 11):
            return None
        types.append(kind[0])
        position = kind[1]
    return types if position == size else None


def _size_of(kind: int) -> int:
    return (kind - 12) // 2 if kind >= 12 else (0, 1, 2, 3, 4, 6, 8, 8, 0, 0, 0, 0)[kind]


def _value(kind: int, data: bytes) -> Value:
    """Return a value; None also for one that is cut off. Of a blob the first bytes are enough."""
    if kind >= 12 and kind % 2 == 0:
        return data[:_SHOWN_BYTES]
    if len(data) < _size_of(kind) or kind == 0:
        return None
    if kind >= 12:
        return data.decode("utf-8", "replace")
    if kind == 7:
        value: float = struct.unpack(">d", data)[0]
        return value
    return kind - 8 if kind in (8, 9) else int.from_bytes(data, "big", signed=True)


def rebuild_database(pages: PageFile) -> tuple[sqlite3.Connection, int | None]:
    """Make a database of the readable rows, and return the latest time.

    It lies in a temporary file that SQLite removes itself, and of the messages it has only the places: their data
    are read from the pages when they are asked for.
    """
    database = sqlite3.connect("", check_same_thread=False, isolation_level=None)
    database.create_function("payload", 2, pages.payload)
    database.executescript(_SCHEMA)
    database.execute("BEGIN")
    for cell in pages.cells():
        values = cell.values
        if cell.is_message:
            table = "places" if cell.is_sound_message else "unsound"
            database.execute(
                f"INSERT OR IGNORE INTO {table} VALUES (?, ?, ?, ?, ?)",  # noqa: S608 - constants
                (cell.rowid, *values[1:3], cell.page, cell.offset),
            )
        elif cell.is_topic:
            row = (cell.rowid, *values[1:], "", "")[:6]
            database.execute("INSERT OR IGNORE INTO topics VALUES (?, ?, ?, ?, ?, ?)", row)
        elif cell.is_definition:
            database.execute(
                "INSERT OR IGNORE INTO message_definitions VALUES (?, ?, ?, ?, ?)", (cell.rowid, *values[1:])
            )
    (last_ns,) = database.execute("SELECT max(timestamp) FROM places").fetchone()
    # A row that some page has sound is sound, whatever an older page has.
    database.execute("INSERT OR IGNORE INTO places SELECT * FROM unsound")
    database.execute("DROP TABLE unsound")
    database.execute("COMMIT")
    return database, last_ns
