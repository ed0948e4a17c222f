"""Buffers that are reused for reading, and memory that is kept for some time instead of being copied."""

from __future__ import annotations

from contextlib import suppress
from threading import RLock
from typing import NamedTuple
from weakref import ref

#: Buffers have multiples of this size, so that one serves chunks of different sizes.
_ROUNDED_TO = 1 << 20

#: Bytes that may be kept at a time. Above this limit, callers copy the part that they need.
_MAX_KEPT = 64 << 20


class ReadBuffer(bytearray):
    """A buffer, and the object that borrows it."""

    __slots__ = ("borrower",)

    borrower: ref[BorrowedBuffer]


class BufferPool(list[ReadBuffer]):
    """The free buffers. All open files share them, so one for each reading thread is enough."""

    def take(self, length: int) -> ReadBuffer:
        """Return a buffer of at least this size. The caller must append it to this list again."""
        # Not `if self`: another thread may take the buffer between the check and the call.
        with suppress(IndexError):
            buffer = self.pop()
            if len(buffer) >= length:
                return buffer
        return ReadBuffer(-(-length // _ROUNDED_TO) * _ROUNDED_TO)


class BorrowedBuffer:
    """A buffer that is borrowed until nothing refers to this object any more.

    Parameters
    ----------
    buffers
        The list from which the buffer is taken, and to which it is returned.
    length
        Its minimum size.
    """

    __slots__ = ("__weakref__", "_buffers", "buffer")

    def __init__(self, buffers: BufferPool, length: int) -> None:
        self.buffer = buffers.take(length)
        self._buffers = buffers
        self.buffer.borrower = ref(self)

    def __del__(self) -> None:
        with suppress(AttributeError):  # there was no memory for it
            self._buffers.append(self.buffer)


class BorrowedBytes(NamedTuple):
    """Bytes of a file: ``data`` is valid as long as this object exists, because the ``buffer`` is used again."""

    data: memoryview
    buffer: BorrowedBuffer | None


class RetainedMemory:
    """Memory that is neither overwritten nor freed while this object exists."""

    __slots__ = ("_owner", "size")

    #: Bytes that are kept. The lock is reentrant, because garbage collection may run `__del__` while it is held.
    _bytes = 0
    _lock = RLock()

    def __init__(self, owner: object, size: int) -> None:
        self._owner = owner
        self.size = size
        with RetainedMemory._lock:
            RetainedMemory._bytes += size

    def __del__(self) -> None:
        with RetainedMemory._lock:
            RetainedMemory._bytes -= self.size

    @classmethod
    def has_room(cls, size: int) -> bool:
        """Return whether this many more bytes may be kept."""
        return cls._bytes + size <= _MAX_KEPT


def retain(memory: bytes | ReadBuffer) -> RetainedMemory | None:
    """Keep the memory of which data are a view.

    Parameters
    ----------
    memory
        The whole memory, of which the data may be a part.

    Returns
    -------
    RetainedMemory | None
        An object to refer to as long as the data are used; None if the data must be copied, because they may be
        overwritten or too much is kept already.
    """
    if not RetainedMemory.has_room(len(memory)):
        return None
    owner = memory if isinstance(memory, bytes) else memory.borrower()
    return RetainedMemory(owner, len(memory)) if owner is not None else None
