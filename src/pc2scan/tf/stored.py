"""Transforms that are too many for the memory: in a temporary file, of which a lookup reads those around its time.

A recording of hours has millions. The file has those of a child frame in runs, in the order of their stamps; in memory
is where a run begins, and what the last lookup has read.
"""

from __future__ import annotations

import tempfile
from array import array
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any
from weakref import finalize

import numpy as np

from pc2scan.errors import RecordingError
from pc2scan.files.places import TEMPORARY_HINT
from pc2scan.files.system import read_at, scratch, write_at

from .history import ROW, FrameHistory, Samples, time_order

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

#: Samples of a run, of which a lookup reads one or two; and of what is read or written at a time.
_RUN = 1_024
_PART = 4 * _RUN

#: Rows that are as near as this are read together.
_NEAR = 8


class TransformFile:
    """Rows in a file without a name, which is deleted when nobody uses it any more.

    Raises
    ------
    RecordingError
        By all methods, if the file cannot be written or read.
    """

    def __init__(self) -> None:
        self._rows = 0
        with self._errors():
            self._file = tempfile.TemporaryFile(prefix="pc2scan-", dir=scratch.get())  # noqa: SIM115  # closed with this object
            finalize(self, self._file.close)

    def append(self, rows: NDArray[np.void]) -> int:
        """Write rows, and return the number of the first one."""
        first = self._rows
        with self._errors():
            write_at(self._file.fileno(), rows.view(np.uint8).data, first * ROW.itemsize)
        self._rows += len(rows)
        return first

    def rows(self, numbers: NDArray[np.int64]) -> NDArray[np.void]:
        """Return rows by their numbers, (K,), on any thread."""
        rows = np.empty(len(numbers), ROW)
        order = numbers.argsort(kind="stable")
        ordered = numbers[order]
        for begin, end in pairwise([0, *(np.flatnonzero(np.diff(ordered) > _NEAR) + 1).tolist(), len(ordered)]):
            first = ordered[begin]
            rows[order[begin:end]] = self._read(int(first), int(ordered[end - 1]) + 1)[ordered[begin:end] - first]
        return rows

    def _read(self, first: int, stop: int) -> NDArray[np.void]:
        data, length = b"", (stop - first) * ROW.itemsize
        with self._errors():
            while len(data) < length:
                data += read_at(self._file.fileno(), length - len(data), first * ROW.itemsize + len(data))
        return np.frombuffer(data, ROW)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as err:
            folder = scratch.get() or tempfile.gettempdir()
            raise RecordingError(
                f"the transforms do not fit into a temporary file in {folder}: {err.strerror}", hint=TEMPORARY_HINT
            ) from err


class Runs:
    """The transforms of one child frame in a file, while they are collected.

    Attributes
    ----------
    is_ordered
        Whether each stamp is later than the one before.
    """

    def __init__(self, file: TransformFile) -> None:
        self.is_ordered = True
        self._file = file
        self._size = self._last_ns = 0
        self._parent = -1
        self._low, self._high = np.full(7, np.inf), np.full(7, -np.inf)
        # Of each run: the stamp and the place of its first row, and the number of its first sample.
        self._begins, self._places, self._firsts = array("q"), array("q"), array("q")

    def append(self, rows: NDArray[np.void]) -> None:
        """Add transforms, each of which is later than the one before."""
        if self._size and rows["stamp_ns"][0] == self._last_ns:
            # The first to arrive is kept.
            rows = rows[1:]
        if not len(rows):
            return
        stamps, parents = rows["stamp_ns"], rows["parent"]
        begin_ns, parent = int(stamps[0]), int(parents[0])
        if self._size:
            self.is_ordered &= begin_ns > self._last_ns
            parent = parent if parent == self._parent else -1
        self._parent = parent if (parents == parent).all() else -1
        self._last_ns = int(stamps[-1])
        self._low = np.minimum(self._low, rows["pose"].min(axis=0))
        self._high = np.maximum(self._high, rows["pose"].max(axis=0))
        place = self._file.append(rows)
        begins = range(0, len(rows), _RUN)
        self._begins.extend(stamps[::_RUN].tolist())
        self._places.extend(place + begin for begin in begins)
        self._firsts.extend(self._size + begin for begin in begins)
        self._size += len(rows)

    def sorted(self, frames: NDArray[np.int32]) -> Runs:
        """Return them in the order of the stamps, in other runs if need be; of several with one stamp, the first."""
        if self.is_ordered:
            return self
        history = self.history(0, frames, 0)
        order = time_order(history.all_stamps())
        found = Runs(self._file)
        for begin in range(0, len(order), _PART):
            found.append(history.rows(order[begin : begin + _PART]))
        return found

    def history(self, child: int, frames: NDArray[np.int32], received: int) -> StoredHistory:
        """Return the transforms for lookups; ``frames`` are the indices of frames by their numbers in the file."""
        return StoredHistory(
            child,
            False,
            received,
            self._size,
            int(frames[self._parent]) if self._parent >= 0 else -1,
            self._high - self._low,
            self._begins[0],
            self._last_ns,
            self._file,
            frames,
            np.array(self._begins, np.int64),
            np.array(self._places, np.int64),
            np.array([*self._firsts, self._size], np.int64),
        )


@dataclass(frozen=True, slots=True, eq=False)
class StoredHistory(FrameHistory):
    """Transforms of a child frame in a file."""

    _file: TransformFile
    _frames: NDArray[np.int32]
    _begins: NDArray[np.int64]
    _places: NDArray[np.int64]
    _firsts: NDArray[np.int64]
    #: What was read last, which the next lookup usually needs.
    _last: list[Samples] = field(default_factory=list)

    def near(self, begin_ns: int, end_ns: int) -> Samples:
        """Return the samples of an interval, the one before it and the one after it, if there are any; or more."""
        for last in self._last:
            is_begin = last.first_ns < begin_ns or last.first_ns == self.first_ns
            if is_begin and (last.last_ns > end_ns or last.last_ns == self.last_ns):
                return last
        begin = self._firsts.item(max(int(self._begins.searchsorted(begin_ns)) - 1, 0))
        end = self._firsts.item(int(self._begins.searchsorted(end_ns, "right")))
        found = self._samples(begin, min(end + 1, self.size))
        self._last[:] = [found]
        return found

    def parts(self) -> Iterator[Samples]:
        """Return all samples, some at a time."""
        for begin in range(0, self.size, _PART):
            yield self._samples(begin, min(begin + _PART, self.size))

    def all_stamps(self) -> NDArray[np.int64]:
        """Return the stamps of all samples, (N,) int64, increasing."""
        stamps = np.empty(self.size, np.int64)
        for begin in range(0, self.size, _PART):
            part = np.arange(begin, min(begin + _PART, self.size))
            stamps[part] = self.rows(part)["stamp_ns"]
        return stamps

    def poses_of(self, samples: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the poses of samples, (K, 7), by their numbers, (K,)."""
        poses = np.empty((len(samples), 7))
        for begin in range(0, len(samples), _PART):
            poses[begin : begin + _PART] = self.rows(samples[begin : begin + _PART])["pose"]
        return poses

    def rows(self, samples: NDArray[np.intp]) -> NDArray[np.void]:
        """Return samples as `ROW`, by their numbers, (K,)."""
        runs = self._firsts.searchsorted(samples, "right") - 1
        return self._file.rows(self._places[runs] + samples - self._firsts[runs])

    def _samples(self, begin: int, end: int) -> Samples:
        return Samples.of(*self._columns(begin, end))

    def _columns(self, begin: int, end: int) -> tuple[Any, ...]:
        rows = self.rows(np.arange(begin, end))
        return self.child, rows["stamp_ns"], rows["pose"], self._frames[rows["parent"]], self.received

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes a copy in another process, which does not have the file."""
        return Samples.of, self._columns(0, self.size)
