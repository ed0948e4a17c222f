"""Reads and writes the primitives of ROS's two wire formats, as far as pc2scan needs them.

ROS 1: little-endian, packed; a string is a uint32 length and bytes. ROS 2: CDR (XCDR version 1): a 4-byte
encapsulation header has the byte order, primitives are aligned to their size counted from the end of that
header, a string's length includes its NUL.

Sources: http://wiki.ros.org/ROS/Technical%20Overview (message serialization), OMG DDS-XTypes 1.3, 7.4.1.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING, Any

from pc2scan.errors import DecodeError

if TYPE_CHECKING:
    from pc2scan.model import Buffer

#: Parts that messages have in common are kept if they are no longer than this: an untrusted recording may have
#: thousands of topics with megabytes each. Real parts take some 200 bytes.
MAX_CACHED_BYTES = 1 << 10


#: CDR's encapsulation header.
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


@cache
def _compile(code: str) -> tuple[struct.Struct, int]:
    """Compile codes; returns the alignment of the last one, too."""
    return struct.Struct(code), struct.calcsize(code[-1])


class Cursor:
    """Reads primitives in order, in either wire format.

    Parameters
    ----------
    data
        A whole serialised message.
    serialization
        ``ros1`` or ``cdr``.

    Attributes
    ----------
    ros1
        Whether this is ROS 1's format (the header then has a sequence number, and nothing is aligned).
    byte_order
        ``<`` or ``>``, as `struct` and NumPy spell it.
    base
        Where the message begins in the data.
    position
        Where the next primitive is read.

    Raises
    ------
    DecodeError
        If the encapsulation is unknown; from every method, if the data ends too early.
    """

    __slots__ = ("base", "byte_order", "data", "position", "ros1")

    def __init__(self, data: Buffer, serialization: str) -> None:
        self.data = data = memoryview(data).toreadonly()
        self.ros1 = serialization == "ros1"
        self.byte_order = "<"
        self.base = 0
        if not self.ros1:
            if len(data) < 4:
                raise DecodeError(f"message of {len(data)} bytes is too short for a CDR header")
            # Representation identifiers 0 and 1: plain CDR, big and little endian.
            if data[0] != 0 or data[1] > 1:
                raise DecodeError(f"unknown CDR encapsulation {bytes(data[:2]).hex()}, expected 0001 or 0000")
            self.byte_order = "<" if data[1] else ">"
            self.base = 4
        self.position = self.base

    def read(self, code: str) -> tuple[Any, ...]:
        """Read primitives that need no padding between them: `struct` codes, aligned to the first."""
        layout, alignment = _compile(self.byte_order + code)
        start = self.position
        if not self.ros1:
            start += (self.base - start) % alignment
        self.position = end = start + layout.size
        if end > len(self.data):
            raise DecodeError(f"message ends after {len(self.data)} bytes, {end} are needed")
        return layout.unpack_from(self.data, start)

    def take(self, size: int) -> memoryview:
        """Read ``size`` bytes as a view."""
        end = self.position + size
        if end > len(self.data):
            raise DecodeError(
                f"message ends after {len(self.data)} bytes, {size} more are declared from byte {self.position} on"
            )
        view = self.data[self.position : end]
        self.position = end
        return view

    def string(self) -> str:
        """Read a string; bytes that are not UTF-8 are kept as surrogates."""
        (size,) = self.read("I")
        raw = bytes(self.take(size))
        if not self.ros1:
            raw = raw.removesuffix(b"\0")
        return raw.decode("utf-8", "surrogateescape")

    def stamp(self) -> tuple[int, int]:
        """Read the sequence number that only ROS 1 has (else 0), and a stamp as nanoseconds.

        ROS 1's stamps are (uint32, uint32), those of ROS 2 (int32, uint32).
        """
        sequence, seconds, nanoseconds = self.read("III") if self.ros1 else (0, *self.read("iI"))
        return sequence, seconds * 1_000_000_000 + nanoseconds

    def header(self) -> tuple[int, int, str]:
        """Read a std_msgs/Header: sequence number, stamp in nanoseconds, frame_id."""
        return (*self.stamp(), self.string())


def seconds_of(stamp_ns: int, *, ros1: bool) -> tuple[int, int]:
    """Return the seconds and nanoseconds of a stamp in a message.

    Raises
    ------
    DecodeError
        If it does not fit: ROS 1 counts uint32 seconds, ROS 2 int32.
    """
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    low, high = (0, 2**32 - 1) if ros1 else (-(2**31), 2**31 - 1)
    if not low <= seconds <= high:
        message = f"a stamp of {seconds} s does not fit into ROS {1 if ros1 else 2}'s {low} to {high} s"
        raise DecodeError(message, stamp_ns=stamp_ns)
    return seconds, nanoseconds


class Packer:
    """Writes primitives in order; the inverse of `Cursor`, always little-endian.

    Parameters
    ----------
    serialization
        ``ros1`` or ``cdr``.

    Attributes
    ----------
    ros1
        Whether this is ROS 1's format.
    """

    __slots__ = ("_parts", "_size", "ros1")

    def __init__(self, serialization: str) -> None:
        self.ros1 = serialization == "ros1"
        self._parts: list[Buffer] = [] if self.ros1 else [_LITTLE_ENDIAN]
        #: Bytes after the encapsulation header.
        self._size = 0

    def raw(self, data: Buffer) -> None:
        """Append bytes as they are."""
        self._parts.append(data)
        self._size += len(data)

    def write(self, code: str, *values: float) -> None:
        """Append primitives that need no padding between them: `struct` codes, aligned to the last."""
        layout, alignment = _compile("<" + code)
        if not self.ros1 and (padding := -self._size % alignment):
            self.raw(bytes(padding))
        self._parts.append(layout.pack(*values))
        self._size += layout.size

    def string(self, text: str) -> None:
        """Append a string."""
        data = text.encode("utf-8", "surrogateescape")
        if not self.ros1:
            data += b"\0"
        self.write("I", len(data))
        self.raw(data)

    def header(self, sequence: int, stamp_ns: int, frame_id: str) -> None:
        """Append a std_msgs/Header; see `stamp`."""
        self.stamp(sequence, stamp_ns)
        self.string(frame_id)

    def stamp(self, sequence: int, stamp_ns: int) -> None:
        """Append a sequence number (ROS 1 only) and a stamp.

        Raises
        ------
        DecodeError
            See `seconds_of`.
        """
        if self.ros1:
            self.write("I", sequence)
        self.write("II" if self.ros1 else "iI", *seconds_of(stamp_ns, ros1=self.ros1))

    def finish(self) -> bytes:
        """Return the message, in ROS 2 with CDR's encapsulation header."""
        return b"".join(self._parts)
