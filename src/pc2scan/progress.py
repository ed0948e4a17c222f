"""The progress of a run: how much of its work is done, and what work costs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

#: Called regularly with the work that is done, the work in all (see `Price`), and the messages read so far, which are 0
#: while transforms are read ahead.
Progress: TypeAlias = Callable[[int, int, int], None]

# What work costs, nanoseconds. Only their ratios matter: of what is read ahead to what is converted, and of small
# messages to clouds. docs/benchmarks.md says how they were measured, and how far the time left is from the truth.

#: To decode a stored byte, and to make a byte of what is stored and compare its CRC, by the compression.
_READ_NS = {"none": (0.0, 0.25), "lz4": (1.0, 0.2), "zstd": (3.6, 0.2), "bz2": (0.0, 35.0)}

#: What is stored of a byte of clouds, about, where it is unknown.
_STORED = 0.5

#: To project a byte of a cloud, and to deskew it.
_PROJECT_NS = 0.2
_DESKEW_NS = 0.5

#: To write a byte of a cloud that is kept, by the compression.
_WRITE_NS = {"none": 2.5, "lz4": 3.0, "zstd": 4.5, "bz2": 60.0}

#: To begin with a chunk, and to read a row of a database.
_CHUNK_NS = 50_000
_ROW_NS = 6_000

#: To read messages ahead, of which a third are transforms, which are decoded; to check scans among other messages.
_AHEAD_NS = 2_000
_CHECK_NS = 4_000

#: To pass a message on to the output, and to re-encode it for the other version of ROS.
_PASS_NS = 5_000
_REENCODE_NS = 8_000

#: Which part of the work on bytes threads share: with two, conversions take two thirds of the time.
_SHARED = 2 / 3


class Price(NamedTuple):
    """What it costs to read messages, and to do something with them.

    Attributes
    ----------
    byte_ns, message_ns
        What is done with each byte, besides reading it, and with each message.
    threads
        How many threads share the work on bytes.
    """

    byte_ns: float = 0.0
    message_ns: int = _AHEAD_NS
    threads: int = 1

    @classmethod
    def of_conversion(
        cls,
        *,
        threads: int,
        projects: bool = True,
        deskews: bool = False,
        writes: str | None = None,
        reencodes: bool = False,
    ) -> Price:
        """Return the price of a conversion.

        Parameters
        ----------
        threads
            How many threads convert.
        projects, deskews
            Whether clouds are projected, and deskewed.
        writes
            The compression in which clouds are written; None: they are not.
        reencodes
            Whether messages are written for the other version of ROS.
        """
        byte_ns = _PROJECT_NS * projects + _DESKEW_NS * deskews + (_WRITE_NS[writes] if writes else 0.0)
        return cls(byte_ns, _PASS_NS + _REENCODE_NS * reencodes, threads)

    def of(
        self, size: int, stored: int | None, messages: int, compression: str, *, are_rows: bool, is_quick: bool
    ) -> int:
        """Return how much work some messages are: about nanoseconds.

        Parameters
        ----------
        size
            Their bytes before compression.
        stored
            Their bytes in the file; None if that is unknown.
        messages
            How many they are; 0 if that is unknown.
        compression
            How they are stored.
        are_rows
            Whether they are rows of a database, not a chunk.
        is_quick
            Whether no other thread gets them; see `pc2scan.bags.units.Unit`.
        """
        decode_ns, made_ns = _READ_NS.get(compression, _READ_NS["none"])
        # What does not become smaller, such as pictures, is stored as it is.
        share = _STORED if stored is None else min(1.0, stored / max(1, size))
        bytes_ns = size * (made_ns + self.byte_ns + share * (1 - share) * decode_ns)
        if not is_quick:
            bytes_ns *= 1 - _SHARED + _SHARED / self.threads
        fixed_ns = messages * _ROW_NS if are_rows else _CHUNK_NS
        return round(bytes_ns) + messages * self.message_ns + fixed_ns


#: The price of what is read ahead or compared, and of scans that are checked.
AHEAD = Price()
CHECK = Price(message_ns=_CHECK_NS)


class Meter:
    """Counts the work of a run, and reports it: when it begins, after each thousandth, and when it ends.

    Parameters
    ----------
    report
        The function to report to.
    price
        The price of what the run is for.

    Attributes
    ----------
    price, ahead
        The price of what the run is for, and of what is read ahead.
    following
        How much work follows what is read ahead.
    messages
        How many messages were read, without those that were read ahead.
    """

    ahead = AHEAD

    def __init__(self, report: Progress, price: Price = AHEAD) -> None:
        self._report = report
        self._done = self._total = self._next = 0
        self.price = price
        self.following = self.messages = 0

    def expect(self, work: int) -> None:
        """Expect this much work from now on, whatever was expected before."""
        self._total = self._done + work
        self._tell(self._done)

    def add(self, work: int) -> None:
        """Add work that is done; what was not expected counts as if it had been."""
        self._done += work
        if self._done >= self._next:
            self._tell(min(self._done, self._total))

    def finish(self) -> None:
        """Report that all is done."""
        self._tell(self._total)

    def _tell(self, done: int) -> None:
        self._report(done, self._total, self.messages)
        self._next = self._done + self._total // 1000
