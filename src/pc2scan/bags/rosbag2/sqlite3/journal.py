"""Reads the rollback journal of a database (``-journal``): the pages before a transaction that did not end.

Source: https://www.sqlite.org/fileformat2.html#the_rollback_journal, and SQLite's ``pager.c``.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pc2scan.files.source import SourceFile

    from .page_log import PageLog

_MAGIC = bytes.fromhex("d9d505f920a163d7")
_HEADER = 28

#: The count of records in a journal whose writer did not sync it.
_UNCOUNTED = b"\xff" * 4

#: The byte that SQLite locks. Its page has no content; its number marks the name of a super-journal.
_LOCK_BYTE = 0x40000000


def read_journal(log: PageLog) -> None:
    """Find the pages before a transaction that did not end.

    What the journal says of a transaction over several databases is ignored: no recorder makes one, and whether it
    ended would be known only from a file that the journal names.
    """
    file = log.file
    head = file.read(0, min(file.size, _HEADER))
    if head[0] == 0:
        # An empty journal, kept for the next transaction.
        return
    position = 0
    sector, size = struct.unpack_from(">II", head.ljust(_HEADER, b"\0"), 20)
    if head[:8] != _MAGIC or not (32 <= sector <= 65536 and sector & (sector - 1) == 0):
        log.note("has a damaged header: the transaction that it would undo is not undone", 0, file.size)
        return
    if size not in (0, log.page_size):
        log.note(f"has pages of {size} bytes, its database of {log.page_size} bytes", 0, file.size)
        return
    (log.page_count,) = struct.unpack_from(">I", head, 16)
    name = _super_journal(file)
    if name:
        what = f"names the file {name!r:.200} (a super-journal), which is ignored: no recorder writes this"
        log.note(what, 0, broken=False)
    if file.size < sector:
        log.note(f"is cut off: it has {file.size} bytes, its header has {sector}", 0, file.size)
    rest = (file.size - sector) % (log.page_size + 8)
    if rest and head[8:12] == _UNCOUNTED and not name:
        log.note("is cut off in the middle of a page", file.size - rest, rest)
    while position + sector <= file.size:
        head = file.read(position, _HEADER) if position + _HEADER <= file.size else b""
        if head[:8] != _MAGIC:
            break
        counted = head[8:12] != _UNCOUNTED
        end = _read_records(log, position + sector, *struct.unpack_from(">II", head, 8), counted=counted)
        if not counted:
            break
        position = -(-end // sector) * sector


def _read_records(log: PageLog, start: int, count: int, nonce: int, *, counted: bool) -> int:
    """Read the records after one header; returns their end."""
    file, size = log.file, log.page_size
    length = size + 8
    there = (file.size - start) // length
    if counted and count > there:
        end = start + there * length
        log.note(f"is cut off: {there} of {count} pages are there", end, file.size - end)
    wrong: list[int] = []
    for place in range(start, start + min(count, there) * length, length):
        record = file.read(place, length)
        number, stated = int.from_bytes(record[:4], "big"), int.from_bytes(record[-4:], "big")
        if not counted and number in (0, _LOCK_BYTE // size + 1):
            break
        # The checksum has every two hundredth byte of a page, from the end.
        summed = (nonce + sum(record[size - 196 : 4 : -200])) & 0xFFFFFFFF
        if summed != stated or not 0 < number <= (log.page_count or 0) or number in log.places:
            wrong.append(place)
            continue
        # Without a count, records of an older journal may follow, whose checksums are wrong too.
        _note_records(log, wrong)
        log.places[number] = place + 4
    if counted:
        _note_records(log, wrong)
    return start + count * length


def _note_records(log: PageLog, wrong: list[int]) -> None:
    for place in wrong:
        log.note("a page has a wrong number or checksum, and is not restored", place)
    wrong.clear()


def _super_journal(file: SourceFile) -> str:
    """Return the file name at the end of a journal; empty if there is none."""
    if file.size < 16 + _HEADER:
        return ""
    length, stated, magic = struct.unpack(">II8s", file.read(file.size - 16, 16))
    if magic != _MAGIC or not 0 < length <= min(file.size - 16, 4096):
        return ""
    name = file.read(file.size - 16 - length, length)
    return name.decode("utf-8", "replace") if sum(name) & 0xFFFFFFFF == stated else ""
