"""Searches an MCAP file for another one that begins in it, as in the result of ``cat a.mcap b.mcap``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.bags.parts import AnotherBeginsError

from .record_types import Opcode
from .records import MAGIC, RECORD

if TYPE_CHECKING:
    from .records import RecordFile

#: Bytes that are searched at a time.
_WINDOW = 1 << 20

#: Limit of a Header's size: it has the names of a profile and of a library.
_MAX_HEADER = 1 << 16


def refuse_another(file: RecordFile, start: int, stop: int) -> None:
    """Raise if another file begins in this part of the file, with the magic and a Header."""
    overlap = len(MAGIC) + RECORD.size - 1
    for begin in range(start, stop, _WINDOW):
        window = file.read(begin, min(_WINDOW + overlap, file.size - begin))
        at = window.find(MAGIC)
        while 0 <= at <= len(window) - overlap - 1:
            opcode, length = RECORD.unpack_from(window, at + len(MAGIC))
            if begin + at > 0 and opcode == Opcode.HEADER and length <= _MAX_HEADER:
                raise AnotherBeginsError(begin + at)
            at = window.find(MAGIC, at + 1)
