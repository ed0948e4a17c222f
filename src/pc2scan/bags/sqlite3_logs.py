"""The logs that SQLite leaves beside a database: a write-ahead log (``-wal``) and a rollback journal (``-journal``).

SQLite itself never opens them: it would write to them, and delete a file that a journal names. This module finds out
which of their pages count instead of the database's own.

Source: https://www.sqlite.org/fileformat2.html, sections 3 and 4; SQLite's ``wal.c`` and ``pager.c``.
"""

from __future__ import annotations

import shutil
import struct
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from .files import SourceFile

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

__all__ = ["LogProblem", "PageLog", "missing_pages", "page_size_of", "side_logs", "write_merged"]

_Sum = tuple[int, int]

_WAL_MAGICS = (0x377F0682, 0x377F0683)
_WAL_HEADER, _FRAME_HEADER = 32, 24

_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_JOURNAL_HEADER = 28
#: A journal's count of records if its writer did not wait for the disk.
_UNCOUNTED = 0xFFFFFFFF
#: The byte that SQLite locks. Its page has no content, and the page's number marks a super-journal's name.
_LOCK_BYTE = 0x40000000


class LogProblem(NamedTuple):
    """What is wrong with a log, where in it, and how many of its bytes are not used."""

    what: str
    offset: int
    bytes_lost: int = 0


@dataclass(slots=True)
class PageLog:
    """The pages of a log that count instead of the database's own.

    Attributes
    ----------
    file
        The log.
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
    places: dict[int, int] = field(default_factory=dict)
    doubtful: dict[int, int] = field(default_factory=dict)
    page_count: int | None = None
    problems: list[LogProblem] = field(default_factory=list)
    broken: bool = False

    def note(self, what: str, offset: int, bytes_lost: int = 0, *, broken: bool = True) -> None:
        """Add a problem."""
        self.problems.append(LogProblem(what, offset, bytes_lost))
        self.broken |= broken


def page_size_of(head: bytes) -> int:
    """Bytes of a page by the first bytes of a database; SQLite's default if what they say is impossible."""
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
        for suffix, read in (("-journal", _read_journal), ("-wal", _read_write_ahead)):
            side = _beside(path, suffix)
            if side is not None:
                with path.open("rb") as file:
                    page_size = page_size_of(file.read(100))
                logs.append(PageLog(SourceFile(side)))
                read(logs[-1], page_size, path.stat().st_size // page_size)
    except BaseException:
        for log in logs:
            log.file.close()
        raise
    return logs


def missing_pages(stored: int, logs: Sequence[PageLog]) -> int:
    """Count the pages that a database must have with these logs, but neither it (``stored`` pages) nor they have."""
    count = next((log.page_count for log in reversed(logs) if log.page_count is not None), 0)
    logged = {number for log in logs for number in log.places if stored < number <= count}
    return max(0, count - stored - len(logged))


def write_merged(path: Path, logs: Sequence[PageLog], target: Path) -> None:
    """Write the database as it is with its logs, none of which may be broken.

    Raises
    ------
    OSError
        If the database cannot be read, or the target not written.
    """
    shutil.copyfile(path, target)
    with target.open("r+b") as out:
        page_size = page_size_of(out.read(100))
        for log in logs:
            count = log.page_count or 0
            for number, place in log.places.items():
                if 0 < number <= count:
                    out.seek((number - 1) * page_size)
                    out.write(log.file.read(place, page_size))
            if log.page_count is not None:
                out.truncate(log.page_count * page_size)


def _beside(path: Path, suffix: str) -> Path | None:
    """Return a log that has content; of a database that is a link also one where the link leads, as SQLite does."""
    for place in (path, path.resolve()):
        side = place.with_name(place.name + suffix)
        if side.is_file() and side.stat().st_size:
            return side
    return None


# --- Write-ahead logs ---


class _Frame(NamedTuple):
    """A page in a write-ahead log: its number, the database's pages if it ends a transaction, and where it is."""

    number: int
    commit: int
    place: int


def _read_write_ahead(log: PageLog, page_size: int, stored: int) -> None:
    """Find the latest committed content of each page.

    A frame's checksum continues the checksum of the frame before it, and SQLite ignores everything from the first
    wrong one on. Here each frame continues what the frame before it states, so that damage costs only the frames
    that it hits.
    """
    file = log.file
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
        walk = _Walk(log, page_size, stored + frames, head[16:24], [stated], [bool(magic & 1)])
    else:
        log.note("has a damaged header", 0, broken=False)
        # A frame has everything but the order of bytes in checksums.
        salts = file.read(_WAL_HEADER, 16)[8:] if frames else b""
        walk = _Walk(log, page_size, stored + frames, salts, [stated, *sums.values()], list(sums))
    for index in range(frames):
        walk.step(_WAL_HEADER + index * (_FRAME_HEADER + page_size))
    walk.finish()
    if rest:
        log.note(f"is cut off in the middle of a page, which has {rest} bytes", file.size - rest, rest, broken=False)
    if missing := missing_pages(stored, [log]):
        # Nothing of that size may be made of it.
        log.note(f"counts {log.page_count} pages; {missing} of them are neither in it nor in the database", 0)


class _Walk:
    """From frame to frame.

    Parameters
    ----------
    log
        Gets what is found.
    page_size, page_limit
        Bytes of a page, and the largest possible number of pages.
    salts
        What the log's frames have in common; older frames, which the log has not yet overwritten, have others.
    sums
        What the first frame's checksum may continue.
    orders
        Whether checksums are of big-endian numbers; both where it is not known.
    """

    def __init__(
        self, log: PageLog, page_size: int, page_limit: int, salts: bytes, sums: list[_Sum], orders: list[bool]
    ) -> None:
        self._log = log
        self._page_size = page_size
        self._page_limit = page_limit
        self._salts = salts
        self._sums = sums
        self._orders = orders
        self._pending: dict[int, int] = {}
        self._pending_doubtful: dict[int, int] = {}
        #: A frame with a wrong checksum, until the next one shows whether only the checksum itself is damaged.
        self._held: _Frame | None = None
        #: Where frames with other salts begin.
        self._foreign: int | None = None

    def step(self, offset: int) -> None:
        """Judge the frame at a place."""
        header = self._log.file.read(offset, _FRAME_HEADER)
        number, commit = struct.unpack_from(">II", header)
        stated: _Sum = struct.unpack_from(">II", header, 16)
        frame = _Frame(number, commit, offset + _FRAME_HEADER)
        own = header[8:16] == self._salts
        if not own and not self._sums:
            return
        content = header[:8] + self._log.file.read(frame.place, self._page_size)
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
            # Nothing is known that its checksum could continue.
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
        """Judge what was left open."""
        self._settle(None)
        unfinished = [*self._pending.values(), *self._pending_doubtful]
        if unfinished:
            self._log.note(
                f"ends with an unfinished transaction, whose {len(unfinished)} pages do not count",
                min(unfinished) - _FRAME_HEADER,
                len(unfinished) * self._page_size,
                broken=False,
            )

    def _settle(self, continued: _Sum | None) -> None:
        """Take the frame that is held, now that it is known what the next one's checksum continues."""
        frame, self._held = self._held, None
        if frame is None:
            return
        sound = continued == self._sums[1] != self._sums[0]
        self._log.note("a page has a wrong checksum", frame.place - _FRAME_HEADER, broken=False)
        self._take(frame, sound=sound)

    def _take(self, frame: _Frame, *, sound: bool) -> None:
        if sound:
            self._pending[frame.number] = frame.place
        else:
            self._pending_doubtful[frame.place] = frame.number
        if frame.commit and (sound or frame.commit <= self._page_limit):
            self._log.places |= self._pending
            self._log.doubtful |= self._pending_doubtful
            self._log.broken |= bool(self._pending_doubtful)
            self._pending, self._pending_doubtful = {}, {}
            if sound:
                self._log.page_count = frame.commit


def _checksum(data: bytes, before: _Sum, *, big: bool) -> _Sum:
    """Continue a checksum over data whose length is a multiple of eight bytes.

    SQLite adds two words at a time: ``s0 += x0 + s1; s1 += x1 + s0``. After all of them, each word counts as often
    as a Fibonacci number says, which is a sum of products.
    """
    import numpy as np  # noqa: PLC0415  (only recordings with a log need it)

    words = np.frombuffer(data, ">u4" if big else "<u4").astype(np.uint32)
    size = len(words)
    numbers = _fibonacci(size)
    states = np.array(before, np.uint32)
    first = int(np.dot(numbers[2 : size + 2], words)) + int(np.dot(numbers[[2, 1]], states))
    second = int(np.dot(numbers[1 : size + 1], words)) + int(np.dot(numbers[[1, 0]], states))
    return first & 0xFFFFFFFF, second & 0xFFFFFFFF


@cache
def _fibonacci(size: int) -> NDArray[np.uint32]:
    """Fibonacci's numbers from the one of ``size + 1`` down to that of 0, without what exceeds 32 bits."""
    import numpy as np  # noqa: PLC0415

    numbers = [0, 1]
    for _ in range(size):
        numbers.append((numbers[-1] + numbers[-2]) & 0xFFFFFFFF)
    return np.array(numbers[::-1], np.uint32)


# --- Rollback journals ---


def _read_journal(log: PageLog, page_size: int, stored: int) -> None:
    """Find the pages as they were before a transaction that did not end.

    What the journal says of a transaction over several databases is ignored: no recorder makes one, and whether it
    ended would be known only from a file that the journal names.
    """
    file = log.file
    head = file.read(0, min(file.size, _JOURNAL_HEADER))
    if head[0] == 0:
        # A journal that is kept for the next transaction.
        return
    position = 0
    sector, size = struct.unpack_from(">II", head.ljust(_JOURNAL_HEADER, b"\0"), 20)
    if head[:8] != _JOURNAL_MAGIC or not (32 <= sector <= 65536 and sector & (sector - 1) == 0):
        log.note("has a damaged header: the transaction that it would undo is not undone", 0, file.size)
        return
    if size not in (0, page_size):
        log.note(f"has pages of {size} bytes, its database of {page_size} bytes", 0, file.size)
        return
    (log.page_count,) = struct.unpack_from(">I", head, 16)
    if name := _super_journal(file):
        what = f"names the file {name!r:.200} (a super-journal), which is ignored: no recorder writes this"
        log.note(what, 0, broken=False)
    while position + sector <= file.size:
        head = file.read(position, _JOURNAL_HEADER) if position + _JOURNAL_HEADER <= file.size else b""
        if head[:8] != _JOURNAL_MAGIC:
            break
        end = _read_records(log, page_size, position + sector, *struct.unpack_from(">II", head, 8))
        if end is None:
            break
        position = -(-end // sector) * sector
    if missing := missing_pages(stored, [log]):
        log.note(f"counts {log.page_count} pages; {missing} of them are neither in it nor in the database", 0)


def _read_records(log: PageLog, page_size: int, start: int, count: int, nonce: int) -> int | None:
    """Read the records behind one header; returns where the next header may be, None if there is none."""
    file = log.file
    length = page_size + 8
    there = (file.size - start) // length
    if count != _UNCOUNTED and count > there:
        end = start + there * length
        log.note(f"is cut off: {there} of {count} pages are there", end, file.size - end)
    wrong: list[int] = []
    for index in range(min(count, there)):
        place = start + index * length
        record = file.read(place, length)
        (number,) = struct.unpack_from(">I", record)
        if count == _UNCOUNTED and number in (0, _LOCK_BYTE // page_size + 1):
            break
        (stated,) = struct.unpack_from(">I", record, length - 4)
        if (nonce + sum(record[4 : length - 4][page_size - 200 : 0 : -200])) & 0xFFFFFFFF != stated:
            wrong.append(place)
            continue
        # Records that nobody counted end with what was on the disk before, whose checksums are wrong too.
        _note_records(log, wrong)
        if 0 < number <= (log.page_count or 0):
            log.places.setdefault(number, place + 4)
    if count == _UNCOUNTED:
        return None
    _note_records(log, wrong)
    return start + count * length


def _note_records(log: PageLog, wrong: list[int]) -> None:
    for place in wrong:
        log.note("a page has a wrong checksum, and is not undone", place)
    wrong.clear()


def _super_journal(file: SourceFile) -> str:
    """The file that a journal names at its end; empty if it names none."""
    if file.size < 16 + _JOURNAL_HEADER:
        return ""
    length, stated, magic = struct.unpack(">II8s", file.read(file.size - 16, 16))
    if magic != _JOURNAL_MAGIC or not 0 < length <= min(file.size - 16, 4096):
        return ""
    name = file.read(file.size - 16 - length, length)
    return name.decode("utf-8", "replace") if sum(name) & 0xFFFFFFFF == stated else ""
