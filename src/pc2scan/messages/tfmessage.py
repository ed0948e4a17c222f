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

# Sequence number, seconds, nanoseconds, length of frame_id.
_ROS1_HEAD = struct.Struct("<4I")
_ROS1_LENGTH = struct.Struct("<I")
_ROS1_POSE = struct.Struct("<7d")
# The same without a sequence number and with signed seconds, by byte order.
_CDR_HEAD = {order: struct.Struct(f"{order}i2I") for order in "<>"}
_CDR_LENGTH = {order: struct.Struct(f"{order}I") for order in "<>"}
_CDR_POSE = {order: struct.Struct(f"{order}7d") for order in "<>"}


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
        if cursor.ros1:
            _decode_ros1(body, position, count, rows)
        else:
            _decode_cdr(body, position, count, cursor.byte_order, rows)
    except struct.error as err:
        raise DecodeError(
            f"TFMessage ends after {len(cursor.data)} bytes, inside transform {len(rows) + 1} of {count}"
        ) from err
    return rows


def _decode_ros1(body: bytes, position: int, count: int, rows: list[TransformRow]) -> None:
    head, length_of, pose = _ROS1_HEAD.unpack_from, _ROS1_LENGTH.unpack_from, _ROS1_POSE.unpack_from
    for _ in range(count):
        _, seconds, nanoseconds, length = head(body, position)
        start = position + 16
        position = start + length
        parent = body[start:position].decode("utf-8", "surrogateescape")
        start = position + 4
        position = start + length_of(body, position)[0]
        child = body[start:position].decode("utf-8", "surrogateescape")
        rows.append((parent, child, seconds * 1_000_000_000 + nanoseconds, *pose(body, position)))
        position += 56


def _decode_cdr(body: bytes, position: int, count: int, order: str, rows: list[TransformRow]) -> None:
    head, length_of, pose = (
        _CDR_HEAD[order].unpack_from,
        _CDR_LENGTH[order].unpack_from,
        _CDR_POSE[order].unpack_from,
    )
    for _ in range(count):
        position = (position + 3) & -4
        seconds, nanoseconds, length = head(body, position)
        start = position + 12
        position = start + length
        parent = _cdr_text(body[start:position])
        position = (position + 3) & -4
        start = position + 4
        position = start + length_of(body, position)[0]
        child = _cdr_text(body[start:position])
        position = (position + 7) & -8
        rows.append((parent, child, seconds * 1_000_000_000 + nanoseconds, *pose(body, position)))
        position += 56


def _cdr_text(raw: bytes) -> str:
    return raw.removesuffix(b"\0").decode("utf-8", "surrogateescape")


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
