"""Reads the logs beside a database (write-ahead log ``-wal``, rollback journal ``-journal``), and merges them with it.

SQLite itself never opens them here: it would write to them, and delete a file that a journal names.

Sources: https://www.sqlite.org/fileformat2.html#the_write_ahead_log and #the_rollback_journal, and SQLite's ``wal.c``
and ``pager.c``.
"""

from __future__ import annotations

import shutil
import struct
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.files.source import SourceFile, file_beside

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray


class LogProblem(NamedTuple):
    """A problem of a log, its offset, and how many bytes of the log are not used."""

    what: str
    offset: int
    bytes_lost: int = 0


@dataclass(slots=True)
class PageLog:
    """The pages of a log that replace those of the database.

    Attributes
    ----------
    file
        The log.
    page_size, stored
        Bytes of a page of the database, and how many it has itself.
    places
        Where in the log a page is, by the number of the page.
    doubtful
        The numbers of pages whose checksum is wrong, by their places: the number or the content has changed.
    page_count
        Pages that the database has with this log; None if the log does not say.
    problems
        What is wrong with it.
    broken
        Whether pages are missing or doubtful, so that those that are left may not fit together.
    """

    file: SourceFile
    page_size: int
    stored: int
    places: dict[int, int] = field(default_factory=dict)
    doubtful: dict[int, int] = field(default_factory=dict)
    page_count: int | None = None
    problems: list[LogProblem] = field(default_factory=list)
    broken: bool = False

    def note(self, what: str, offset: int, bytes_lost: int = 0, *, broken: bool = True) -> None:
        """Add a problem."""
        self.problems.append(LogProblem(what, offset, bytes_lost))
        self.broken |= broken


_WAL_MAGICS = (0x377F0682, 0x377F0683)
_WAL_HEADER, _FRAME_HEADER = 32, 24

_Sum = tuple[int, int]


class _Frame(NamedTuple):
    """A page in a write-ahead log: its number, the size of the database if it ends a transaction, and its offset."""

    number: int
    commit: int
    place: int


def read_write_ahead(log: PageLog) -> None:
    """Find the latest committed content of each page.

    A frame's checksum continues the checksum of the frame before it, and SQLite ignores everything from the first
    wrong one on. Here each frame continues what the frame before it states, so that damage costs only the frames
    that it hits.
    """
    file, page_size = log.file, log.page_size
    if file.size < _WAL_HEADER:
        log.note(f"is cut off: it has {file.size} bytes, its header has {_WAL_HEADER}", 0, file.size, broken=False)
        return
    head = file.read(0, _WAL_HEADER)
    magic, _, size = struct.unpack_from(">III", head)
    stated: _Sum = struct.unpack_from(">II", head, 24)
    sums = {big: _checksum(head[:24], (0, 0), big=big) for big in (False, True)}
    frames, rest = divmod(file.size - _WAL_HEADER, _FRAME_HEADER + page_size)
    if magic in _WAL_MAGICS and sums[bool(magic & 1)] == stated:
        if size != page_size:
            log.note(f"has pages of {size} bytes, its database of {page_size} bytes", 0, file.size)
            return
        walk = _FrameWalk(log, head[16:24], [stated], [bool(magic & 1)])
    else:
        log.note("has a damaged header", 0, broken=False)
        # A frame has the values of the header, except the byte order of checksums.
        salts = file.read(_WAL_HEADER, 16)[8:] if frames else b""
        walk = _FrameWalk(log, salts, [stated, *sums.values()], list(sums))
    for index in range(frames):
        walk.step(_WAL_HEADER + index * (_FRAME_HEADER + page_size))
    walk.finish()
    if rest:
        log.note(f"is cut off in the middle of a page, which has {rest} bytes", file.size - rest, rest, broken=False)


class _FrameWalk:
    """From frame to frame.

    Parameters
    ----------
    log
        Gets what is found.
    salts
        What the log's frames have in common; older frames, which the log has not yet overwritten, have others.
    sums
        What the first frame's checksum may continue.
    orders
        Whether checksums are of big-endian numbers; both where it is not known.
    """

    def __init__(self, log: PageLog, salts: bytes, sums: list[_Sum], orders: list[bool]) -> None:
        self._log = log
        self._salts = salts
        self._sums = sums
        self._orders = orders
        self._pending: dict[int, int] = {}
        self._pending_doubtful: dict[int, int] = {}
        #: A frame with a wrong checksum, kept until the next one shows whether only the checksum is damaged.
        self._held: _Frame | None = None
        #: Where frames with other salts begin.
        self._foreign: int | None = None

    def step(self, offset: int) -> None:
        """Check the frame at an offset."""
        header = self._log.file.read(offset, _FRAME_HEADER)
        number, commit = struct.unpack_from(">II", header)
        stated: _Sum = struct.unpack_from(">II", header, 16)
        frame = _Frame(number, commit, offset + _FRAME_HEADER)
        own = header[8:16] == self._salts
        if not own and not self._sums:
            return
        content = header[:8] + self._log.file.read(frame.place, self._log.page_size)
        found = [(_checksum(content, before, big=big), big, before) for big in self._orders for before in self._sums]
        order, before = next(((big, before) for after, big, before in found if after == stated), (None, None))
        if order is not None:
            self._settle(before)
            self._orders = [order]
            self._sums = [stated]
            if not own:
                self._log.note("a page's header is damaged", offset, broken=False)
            self._take(frame, sound=True)
        elif not own:
            self._settle(None)
            self._sums = []
            self._foreign = offset
        elif not self._sums:
            # The checksum that it continues is unknown.
            assert self._foreign is not None
            self._log.note("pages are overwritten", self._foreign, offset - self._foreign)
            self._foreign = None
            self._sums = [stated]
            self._take(frame, sound=True)
        else:
            self._settle(None)
            self._held = frame
            self._sums = [stated, found[0][0]]

    def finish(self) -> None:
        """Check the last frame."""
        self._settle(None)
        unfinished = [*self._pending.values(), *self._pending_doubtful]
        if unfinished:
            self._log.note(
                f"ends with an unfinished transaction, whose {len(unfinished)} pages do not count",
                min(unfinished) - _FRAME_HEADER,
                len(unfinished) * self._log.page_size,
                broken=False,
            )

    def _settle(self, continued: _Sum | None) -> None:
        """Decide about the frame that was kept, by the checksum that the next one continues."""
        frame, self._held = self._held, None
        if frame is None:
            return
        sound = continued == self._sums[1] != self._sums[0]
        if sound:
            self._log.note(
                "a page's checksum is damaged, its content is not", frame.place - _FRAME_HEADER, broken=False
            )
        self._take(frame, sound=sound)

    def _take(self, frame: _Frame, *, sound: bool) -> None:
        if sound:
            self._pending[frame.number] = frame.place
        else:
            self._pending_doubtful[frame.place] = frame.number
        if frame.commit:
            self._log.places |= self._pending
            self._log.doubtful |= self._pending_doubtful
            for place in self._pending_doubtful:
                self._log.note(
                    "a page has a wrong checksum: messages in it may be wrong or missing", place - _FRAME_HEADER
                )
            self._pending, self._pending_doubtful = {}, {}
            if sound:
                self._log.page_count = frame.commit


def _checksum(data: bytes, before: _Sum, *, big: bool) -> _Sum:
    """Continue a checksum over data whose length is a multiple of eight bytes.

    SQLite adds two words at a time: ``s0 += x0 + s1; s1 += x1 + s0``. In the end each word, and each half of the
    checksum before, is multiplied by a Fibonacci number.
    """
    words = np.frombuffer(data, ">u4" if big else "<u4").astype(np.uint32)
    numbers = _fibonacci(len(words) + 1)
    largest, second, third = map(int, numbers[:3])
    even = int(np.dot(numbers[2:], words)) + third * before[0] + second * before[1]
    odd = int(np.dot(numbers[1:-1], words)) + second * before[0] + largest * before[1]
    return even & 0xFFFFFFFF, odd & 0xFFFFFFFF


@cache
def _fibonacci(count: int) -> NDArray[np.uint32]:
    """Return the Fibonacci numbers from that of ``count`` down to that of 0, modulo 2^32."""
    numbers = [0, 1]
    while len(numbers) <= count:
        numbers.append((numbers[-1] + numbers[-2]) & 0xFFFFFFFF)
    return np.array(numbers[::-1], np.uint32)


_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_JOURNAL_HEADER = 28

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
    head = file.read(0, min(file.size, _JOURNAL_HEADER))
    if head[0] == 0:
        # An empty journal, kept for the next transaction.
        return
    position = 0
    sector, size = struct.unpack_from(">II", head.ljust(_JOURNAL_HEADER, b"\0"), 20)
    if head[:8] != _JOURNAL_MAGIC or not (32 <= sector <= 65536 and sector & (sector - 1) == 0):
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
        head = file.read(position, _JOURNAL_HEADER) if position + _JOURNAL_HEADER <= file.size else b""
        if head[:8] != _JOURNAL_MAGIC:
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
    if file.size < 16 + _JOURNAL_HEADER:
        return ""
    length, stated, magic = struct.unpack(">II8s", file.read(file.size - 16, 16))
    if magic != _JOURNAL_MAGIC or not 0 < length <= min(file.size - 16, 4096):
        return ""
    name = file.read(file.size - 16 - length, length)
    return name.decode("utf-8", "replace") if sum(name) & 0xFFFFFFFF == stated else ""


def page_size_of(head: bytes) -> int:
    """Return the page size in the first bytes of a database; SQLite's default if it is impossible."""
    (size,) = struct.unpack_from(">H", head.ljust(18, b"\0"), 16)
    size = 65536 if size == 1 else size
    return size if size >= 512 and size & (size - 1) == 0 else 4096


def side_logs(path: Path) -> list[PageLog]:
    """Read the logs beside a database, in the order in which they apply. The caller closes their files.

    Parameters
    ----------
    path
        The database.

    Raises
    ------
    OSError
        If the database cannot be read.
    RecordingError
        If a log cannot be read.
    """
    logs: list[PageLog] = []
    try:
        for suffix, read in (("-journal", read_journal), ("-wal", read_write_ahead)):
            side = _beside(path, suffix)
            if side is not None:
                with path.open("rb") as file:
                    page_size = page_size_of(file.read(100))
                logs.append(PageLog(SourceFile(side), page_size, path.stat().st_size // page_size))
                read(logs[-1])
    except BaseException:
        for log in logs:
            log.file.close()
        raise
    return logs


def missing_bytes(logs: Sequence[PageLog]) -> int | None:
    """Count the bytes that neither a database nor its logs have; None if no log has the database's size."""
    last = next((log for log in reversed(logs) if log.page_count is not None), None)
    if last is None or last.page_count is None:
        return None
    logged = {number for log in logs for number in log.places if last.stored < number <= last.page_count}
    return max(0, last.page_count - last.stored - len(logged)) * last.page_size


def write_merged(path: Path, logs: Sequence[PageLog], target: Path) -> None:
    """Write the database merged with its logs, which must be sound.

    Raises
    ------
    OSError
        If the database cannot be read, or the target not written.
    """
    shutil.copyfile(path, target)
    with target.open("r+b") as out:
        for log in logs:
            count, size = log.page_count, log.page_size
            if count is None:
                continue
            for number, place in log.places.items():
                if 0 < number <= count:
                    out.seek((number - 1) * size)
                    out.write(log.file.read(place, size))
            out.truncate(count * size)


def _beside(path: Path, suffix: str) -> Path | None:
    """Return a log that is not empty; for a database that is a link, also one beside its target, as SQLite does."""
    for place in (path, path.resolve()):
        side = file_beside(place, suffix)
        if side is not None and side.stat().st_size:
            return side
    return None
