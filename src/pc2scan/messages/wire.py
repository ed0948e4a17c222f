"""Reads and writes the primitives of ROS's two wire formats, as far as pc2scan needs them.

ROS 1: little-endian, packed; a string is a uint32 length and bytes. ROS 2: CDR (XCDR version 1): a 4-byte
encapsulation header has the byte order, primitives are aligned to their size counted from the end of that
header, a string's length includes its NUL.

Sources: http://wiki.ros.org/ROS/Technical%20Overview (message serialization), OMG DDS-XTypes 1.3, 7.4.1.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING

from pc2scan.errors import DecodeError

if TYPE_CHECKING:
    from pc2scan.model import Buffer

#: Parts that messages have in common are kept if they are no longer than this: an untrusted recording may have
#: thousands of topics with megabytes each. Real parts take some 200 bytes.
MAX_CACHED_BYTES = 1 << 10


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

    Raises
    ------
    DecodeError
        If the encapsulation is unknown; from every method, if the data ends too early.
    """

    __slots__ = ("_aligned", "_order", "base", "data", "position")

    def __init__(self, data: Buffer, serialization: str) -> None:
        self.data = memoryview(data).toreadonly()
        self._aligned = serialization == "cdr"
        self._order = "<"
        self.base = 0
        if self._aligned:
            if len(self.data) < 4:
                raise DecodeError(f"message of {len(self.data)} bytes is too short for a CDR header")
            # Representation identifiers 0 and 1: plain CDR, big and little endian.
            if self.data[0] != 0 or self.data[1] > 1:
                raise DecodeError(f"unknown CDR encapsulation {bytes(self.data[:2]).hex()}, expected 0001 or 0000")
            self._order = "<" if self.data[1] else ">"
            self.base = 4
        self.position = self.base

    @property
    def ros1(self) -> bool:
        """Whether this is ROS 1's format (the header then has a sequence number)."""
        return not self._aligned

    @property
    def byte_order(self) -> str:
        """``<`` or ``>``, as `struct` and NumPy spell it."""
        return self._order

    def read(self, code: str) -> tuple[int, ...]:
        """Read primitives that need no padding between them: `struct` codes, aligned to the first."""
        layout, alignment = _compile(self._order + code)
        start = self.position
        if self._aligned:
            start += (self.base - start) % alignment
        self.position = end = start + layout.size
        if end > len(self.data):
            raise DecodeError(f"message ends after {len(self.data)} bytes, {end} are needed")
        return layout.unpack_from(self.data, start)

    def uint8(self) -> int:
        """Read a uint8 (or bool)."""
        return self.read("B")[0]

    def uint32(self) -> int:
        """Read a uint32."""
        return self.read("I")[0]

    def float32s(self, count: int) -> tuple[float, ...]:
        """Read ``count`` float32."""
        return self.read(f"{count}f")

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
        raw = bytes(self.take(self.read("I")[0]))
        if self._aligned:
            raw = raw[:-1] if raw.endswith(b"\0") else raw
        return raw.decode("utf-8", "surrogateescape")

    def stamp_ns(self) -> int:
        """Read a stamp: ROS 1's (uint32, uint32) or ROS 2's (int32, uint32), as nanoseconds."""
        seconds, nanoseconds = self.read("iI" if self._aligned else "II")
        return seconds * 1_000_000_000 + nanoseconds

    def sequence(self) -> int:
        """Read the sequence number that ROS 1 has in front of a stamp; 0 in ROS 2."""
        return 0 if self._aligned else self.uint32()

    def header(self) -> tuple[int, int, str]:
        """Read a std_msgs/Header: sequence number, stamp in nanoseconds, frame_id."""
        return self.sequence(), self.stamp_ns(), self.string()


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
    """Writes primitives in order; the inverse of `Cursor`, always little-endian."""

    __slots__ = ("_aligned", "_parts", "_size")

    def __init__(self, serialization: str) -> None:
        self._aligned = serialization == "cdr"
        self._parts: list[Buffer] = []
        self._size = 0

    @property
    def ros1(self) -> bool:
        """Whether this is ROS 1's format."""
        return not self._aligned

    def align(self, size: int) -> None:
        """Pad before a primitive of ``size`` bytes; ROS 1 has no padding."""
        if self._aligned and (padding := -self._size % size):
            self.raw(bytes(padding))

    def raw(self, data: Buffer) -> None:
        """Append bytes as they are."""
        self._parts.append(data)
        self._size += len(data)

    def write(self, code: str, *values: float) -> None:
        """Append primitives that need no padding between them: `struct` codes, aligned to the last."""
        layout, alignment = _compile("<" + code)
        if self._aligned and self._size % alignment:
            self.align(alignment)
        self._parts.append(layout.pack(*values))
        self._size += layout.size

    def string(self, text: str) -> None:
        """Append a string."""
        data = text.encode("utf-8", "surrogateescape")
        if self._aligned:
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

    def body(self) -> bytes:
        """Return what was appended."""
        return b"".join(self._parts)

    def finish(self) -> bytes:
        """Return the message, in ROS 2 with CDR's encapsulation header."""
        return b"".join((b"\x00\x01\x00\x00", *self._parts)) if self._aligned else self.body()
