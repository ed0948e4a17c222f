"""Writes a new file from start to end; its chunks may be compressed ahead, on other threads."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from pc2scan.errors import OutputError
from pc2scan.threads import InOrder

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from pc2scan.model import Buffer
    from pc2scan.threads import Threads

Prepared = TypeVar("Prepared")

#: Bytes that may wait for each thread.
_BYTES_A_THREAD = 4 << 20


class NewFile:
    """A file being written; every method that fails raises an `OutputError`.

    Parameters
    ----------
    path
        Must not exist.

    Raises
    ------
    OSError
        If it cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        #: The offset at which the next bytes are written.
        self.position = 0
        self._file = path.open("xb")

    def put(self, *parts: Buffer) -> int:
        """Write at the end, and return the offset."""
        start = self.position
        try:
            self._file.writelines(parts)
        except OSError as err:
            raise self._write_error(err) from err
        self.position += sum(map(len, parts))
        return start

    def replace(self, offset: int, data: Buffer) -> None:
        """Overwrite bytes; `put` may not be called after that."""
        try:
            self._file.seek(offset)
            self._file.write(data)
        except OSError as err:
            raise self._write_error(err) from err

    def finish(self) -> None:
        """Write everything to the disk."""
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
        except OSError as err:
            raise self._write_error(err) from err

    def abort(self) -> None:
        """Close the file; the caller removes it."""
        # Closing writes the buffered bytes, which may fail for the same reason as the run.
        with suppress(OSError):
            self._file.close()

    def _write_error(self, err: OSError) -> OutputError:
        return OutputError(f"cannot be written: {err.strerror}", path=self._path)


@dataclass
class FreeIds:
    """Assigns ids to the declarations of a file: reserved ones on request, and others counted from the first one on."""

    _next: int
    _kept: set[int] = field(default_factory=set)
    _taken: set[int] = field(default_factory=set)

    def keep(self, ids: Collection[int]) -> None:
        """Reserve these ids for callers that ask for them."""
        self._kept.update(ids)

    def take(self, wanted: int) -> int:
        """Return ``wanted`` if it is reserved and not taken, else the next id that is neither."""
        if wanted in self._kept and wanted not in self._taken:
            self._taken.add(wanted)
            return wanted
        while self._next in self._kept:
            self._next += 1
        self._next += 1
        return self._next - 1


@dataclass
class WriteAhead:
    """A queue between full chunks and the file.

    Until `use` is called, everything is done at once on the caller's thread. The written bytes are the same.
    """

    _queue: InOrder[Callable[[], None]] | None = None

    def use(self, pool: Threads) -> None:
        """Use these threads from now on."""
        self._queue = InOrder(pool, _BYTES_A_THREAD, 1)

    def put(self, prepare: Callable[[], Prepared], write: Callable[[Prepared], None], size: int) -> None:
        """Call ``prepare`` on any thread, then ``write`` with its result on the caller's, in order.

        Parameters
        ----------
        prepare, write
            Their errors are raised here or in `finish`, in order.
        size
            Bytes that are held until ``write`` is called.
        """
        if self._queue is None:
            write(prepare())
            return
        self._make_room(self._queue, size)
        self._queue.put(lambda: partial(write, prepare()), size)

    def put_ready(self, write: Callable[[], None], size: int) -> None:
        """Call ``write`` in order: at once if nothing waits."""
        if self._queue is not None:
            self._make_room(self._queue, size)
        if self._queue:
            self._queue.put(lambda: write, size, at_its_turn=True)
        else:
            write()

    def finish(self) -> None:
        """Write everything that waits."""
        while self._queue:
            self._queue.take()()

    def cancel(self) -> None:
        """Drop everything that waits."""
        if self._queue is not None:
            self._queue.cancel()

    @staticmethod
    def _make_room(queue: InOrder[Callable[[], None]], size: int) -> None:
        """Write finished chunks, and wait for others until ``size`` more bytes may be queued."""
        while queue and (queue.is_ready() or not queue.has_room(size)):
            queue.take()()
