"""Reads and parses the records of MCAP files.

Source of the format: https://mcap.dev/spec and https://mcap.dev/spec/registry.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, TypeVar

from pc2scan.bags.damage import RECOVER
from pc2scan.bags.formats import FORMATS
from pc2scan.errors import DamageError
from pc2scan.files.crc32 import crc32
from pc2scan.files.source import SourceFile

from .record_types import Attachment, Opcode, Record, pack, unpack

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.model import Buffer

#: The first and the last eight bytes of every file.
MAGIC = FORMATS["mcap"].magic
COMPRESSIONS = FORMATS["mcap"].compressions

# Opcode and length of the content: the beginning of every record.
RECORD = struct.Struct("<BQ")
# The same with a message's channel id, sequence, log time and publish time.
MESSAGE = struct.Struct("<BQHIQQ")
# A chunk's first and last log time, uncompressed size, CRC, and the length of its compression's name.
CHUNK = struct.Struct("<QQQII")
UINT64 = struct.Struct("<Q")

# Plain integers: comparing an IntEnum member costs a method call for each message.
OP_MESSAGE, OP_CHUNK, OP_MESSAGE_INDEX = 0x05, 0x06, 0x07

#: Opcodes from here on are for private records. Those between `Opcode` and these are for later specifications.
FIRST_PRIVATE = 0x80


def has_meaning(opcode: int) -> bool:
    """Whether an opcode is one of the specification or a private one."""
    return 0 < opcode <= Opcode.DATA_END or opcode >= FIRST_PRIVATE


class RecordFile(SourceFile):
    """Reads records of an MCAP file; all errors are `RecordingError`."""

    def damage(self, message: str) -> DamageError:
        """Return the error for a damaged file."""
        return DamageError(self.located(message), path=self.path, hint=RECOVER)

    def record(self, offset: int, opcode: Opcode) -> bytes:
        """Read the content of a record of a known kind."""
        actual, length = RECORD.unpack(self.read(offset, RECORD.size))
        if actual != opcode:
            raise self.damage(
                f"a record of kind {opcode} ({opcode.name}) is declared at byte {offset}, found {actual}",
            )
        return self.read(offset + RECORD.size, length)


_Record = TypeVar("_Record", bound=Record)


def parse(kind: type[_Record], content: Buffer, offset: int, file: RecordFile) -> _Record:
    """Parse a record's content; ``offset`` is its place in the file, for the error."""
    try:
        return unpack(kind, content)
    except (struct.error, UnicodeDecodeError) as err:
        raise file.damage(
            f"the {kind.__name__} record at byte {offset} ({len(content)} bytes) contradicts its own lengths",
        ) from err


def split(data: memoryview, origin: int, file: RecordFile) -> Iterator[tuple[int, memoryview]]:
    """Split consecutive records into opcodes and contents; ``origin`` is their place, for the error."""
    position = 0
    while position < len(data):
        start = position + RECORD.size
        if start > len(data):
            break
        opcode, length = RECORD.unpack_from(data, position)
        position = start + length
        if position > len(data):
            break
        yield opcode, data[start:position]
    if position != len(data):
        raise file.damage(f"the records from byte {origin} on do not end after {len(data)} bytes")


def encoded(record: Record) -> bytes:
    """Pack a record, its opcode and length included, and the CRC of an attachment."""
    opcode, content = pack(record)
    if isinstance(record, Attachment):
        content = content[:-4] + struct.pack("<I", crc32(content[:-4]))
    return RECORD.pack(opcode, len(content)) + content
