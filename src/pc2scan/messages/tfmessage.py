"""Decodes and encodes TFMessage, in ROS 1's wire format and in CDR.

``tf/tfMessage``, ``tf2_msgs/TFMessage`` and ``tf2_msgs/msg/TFMessage`` share one layout: a sequence of
geometry_msgs/TransformStamped. A recording has a thousand times more of them than clouds. For speed, the loops unpack
several primitives at once; `Cursor` reads only the beginning.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from pc2scan.errors import DecodeError

from .wire import Cursor, Packer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.core.rigid import TransformRow
    from pc2scan.model import Buffer

#: The types that this module decodes, in ROS 2's spelling (`pc2scan.model.normalized_type`).
TF_TYPES = frozenset({"tf/msg/tfMessage", "tf2_msgs/msg/TFMessage"})

#: A message with more transforms than this is damaged: each takes half a kilobyte once decoded.
MAX_TRANSFORMS = 100_000

#: Seconds, nanoseconds and the length of frame_id, behind ROS 1's sequence number; a length; and a pose.
_ROS1 = [struct.Struct(code) for code in ("<4x3I", "<I", "<7d")]
_CDR = {order: [struct.Struct(order + code) for code in ("i2I", "I", "7d")] for order in "<>"}


def decode_transforms(data: Buffer, serialization: str) -> list[TransformRow]:
    """Decode a TFMessage.

    Parameters
    ----------
    data
        The whole serialised message.
    serialization
        ``ros1`` or ``cdr``.

    Returns
    -------
    list of tuple
        ``(parent, child, stamp_ns, tx, ty, tz, qx, qy, qz, qw)``: ``parent_from_child`` in metres, names and
        numbers as the message has them (leading slashes, NaN and zero quaternions included).

    Raises
    ------
    DecodeError
        If the message ends too early, declares more than `MAX_TRANSFORMS`, or its encapsulation is unknown.
    """
    cursor = Cursor(data, serialization)
    (count,) = cursor.read("I")
    if count > MAX_TRANSFORMS:
        raise DecodeError(f"TFMessage declares {count} transforms, at most {MAX_TRANSFORMS} are allowed")
    # Positions count from the end of the encapsulation header, as CDR's alignment does.
    body = bytes(cursor.data[cursor.base :])
    position = cursor.position - cursor.base
    rows: list[TransformRow] = []
    try:
        _decode_rows(body, position, count, None if cursor.ros1 else cursor.byte_order, rows)
    except struct.error as err:
        raise DecodeError(
            f"TFMessage ends after {len(cursor.data)} bytes, inside transform {len(rows) + 1} of {count}"
        ) from err
    return rows


def _decode_rows(body: bytes, position: int, count: int, order: str | None, rows: list[TransformRow]) -> None:
    """Decode transforms in CDR of a byte order; None: in ROS 1's format, which neither aligns nor ends strings."""
    head, length_of, pose = (layout.unpack_from for layout in (_CDR[order] if order else _ROS1))
    size, end, four, eight = (12, b"\0", -4, -8) if order else (16, b"", -1, -1)
    for _ in range(count):
        position = -(-position & four)
        seconds, nanoseconds, length = head(body, position)
        start = position + size
        position = start + length
        parent = body[start:position].removesuffix(end).decode("utf-8", "surrogateescape")
        position = -(-position & four)
        start = position + 4
        position = start + length_of(body, position)[0]
        child = body[start:position].removesuffix(end).decode("utf-8", "surrogateescape")
        position = -(-position & eight)
        rows.append((parent, child, seconds * 1_000_000_000 + nanoseconds, *pose(body, position)))
        position += 56


def encode_transforms(rows: Sequence[TransformRow], serialization: str) -> bytes:
    """Encode a TFMessage; the inverse of `decode_transforms`.

    Parameters
    ----------
    rows
        As `decode_transforms` returns them.
    serialization
        ``ros1`` (sequence numbers are 0) or ``cdr`` (little-endian).
    """
    packer = Packer(serialization)
    packer.write("I", len(rows))
    for parent, child, stamp_ns, *pose in rows:
        packer.header(0, stamp_ns, parent)
        packer.string(child)
        packer.write("7d", *pose)
    return packer.finish()
