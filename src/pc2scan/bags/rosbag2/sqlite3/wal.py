"""Reads the committed pages of a database's write-ahead log (``-wal``).

Source: https://www.sqlite.org/fileformat2.html#the_write_ahead_log, and SQLite's ``wal.c``.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .page_log import PageLog

_MAGICS = (0x377F0682, 0x377F0683)
_HEADER, _FRAME_HEADER = 32, 24

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
    if file.size < _HEADER:
        log.note(f"is cut off: it has {file.size} bytes, its header has {_HEADER}", 0, file.size, broken=False)
        return
    head = file.read(0, _HEADER)
    magic, _, size = struct.unpack_from(">III", head)
    stated: _Sum = struct.unpack_from(">II", head, 24)
    sums = {big: _checksum(head[:24], (0, 0), big=big) for big in (False, True)}
    frames, rest = divmod(file.size - _HEADER, _FRAME_HEADER + page_size)
    if magic in _MAGICS and sums[bool(magic & 1)] == stated:
        if size != page_size:
            log.note(f"has pages of {size} bytes, its database of {page_size} bytes", 0, file.size)
            return
        walk = _Walk(log, head[16:24], [stated], [bool(magic & 1)])
    else:
        log.note("has a damaged header", 0, broken=False)
        # A frame has the values of the header, except the byte order of checksums.
        salts = file.read(_HEADER, 16)[8:] if frames else b""
        walk = _Walk(log, salts, [stated, *sums.values()], list(sums))
    for index in range(frames):
        walk.step(_HEADER + index * (_FRAME_HEADER + page_size))
    walk.finish()
    if rest:
        log.note(f"is cut off in the middle of a page, which has {rest} bytes", file.size - rest, rest, broken=False)


class _Walk:
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
    import numpy as np  # noqa: PLC0415  (only recordings with a log need it)

    words = np.frombuffer(data, ">u4" if big else "<u4").astype(np.uint32)
    numbers = _fibonacci(len(words) + 1)
    largest, second, third = map(int, numbers[:3])
    even = int(np.dot(numbers[2:], words)) + third * before[0] + second * before[1]
    odd = int(np.dot(numbers[1:-1], words)) + second * before[0] + largest * before[1]
    return even & 0xFFFFFFFF, odd & 0xFFFFFFFF


@cache
def _fibonacci(count: int) -> NDArray[np.uint32]:
    """Return the Fibonacci numbers from that of ``count`` down to that of 0, modulo 2^32."""
    import numpy as np  # noqa: PLC0415

    numbers = [0, 1]
    while len(numbers) <= count:
        numbers.append((numbers[-1] + numbers[-2]) & 0xFFFFFFFF)
    return np.array(numbers[::-1], np.uint32)
