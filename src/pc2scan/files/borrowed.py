"""Buffers that are reused for reading, and memory that is kept for a while instead of being copied."""

from __future__ import annotations

from contextlib import suppress
from threading import RLock
from weakref import ref

__all__ = ["Borrowed", "Buffers", "Kept", "Memory", "keep"]

#: Buffers have multiples of this size, so that one serves chunks of different sizes.
_ROUNDED_TO = 1 << 20

#: Bytes that may be kept at one time: beyond, callers copy what they need, which is less.
_MAX_KEPT = 64 << 20


class Memory(bytearray):
    """A buffer, and what borrows it."""

    __slots__ = ("borrower",)

    borrower: ref[Borrowed]


class Buffers(list[Memory]):
    """The free buffers. All open files share them, so that each thread that reads needs one."""

    def take(self, length: int) -> Memory:
        """Return a buffer of at least this size; the caller appends it again."""
        # Not checked first: another thread may take the buffer in between.
        with suppress(IndexError):
            buffer = self.pop()
            if len(buffer) >= length:
                return buffer
        return Memory(-(-length // _ROUNDED_TO) * _ROUNDED_TO)


class Borrowed:
    """A buffer that is borrowed until nothing refers to this object any more.

    Parameters
    ----------
    buffers
        Where it is taken from, and where it goes again.
    length
        Its size, or less.
    """

    __slots__ = ("__weakref__", "_buffers", "buffer")

    def __init__(self, buffers: Buffers, length: int) -> None:
        self.buffer = buffers.take(length)
        self._buffers = buffers
        self.buffer.borrower = ref(self)

    def __del__(self) -> None:
        with suppress(AttributeError):  # there was no memory for it
            self._buffers.append(self.buffer)


class Kept:
    """Memory that is neither overwritten nor freed while somebody refers to this object."""

    __slots__ = ("_owner", "size")

    #: Bytes that are kept. The lock may be taken again: the collector of cycles runs anywhere.
    _bytes = 0
    _lock = RLock()

    def __init__(self, owner: object, size: int) -> None:
        self._owner = owner
        self.size = size
        with Kept._lock:
            Kept._bytes += size

    def __del__(self) -> None:
        with Kept._lock:
            Kept._bytes -= self.size

    @classmethod
    def has_room(cls, size: int) -> bool:
        """Whether so many more bytes may be kept."""
        return cls._bytes + size <= _MAX_KEPT


def keep(memory: bytes | Memory) -> Kept | None:
    """Keep the memory that data are a view of.

    Parameters
    ----------
    memory
        All of it.

    Returns
    -------
    Kept | None
        What has to be referred to for as long as the data are used; None if they have to be copied: others may
        overwrite them, or too much is kept already.
    """
    if not Kept.has_room(len(memory)):
        return None
    owner = memory if isinstance(memory, bytes) else memory.borrower()
    return Kept(owner, len(memory)) if owner is not None else None
