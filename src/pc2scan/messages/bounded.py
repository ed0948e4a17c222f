"""Runs rosbags' conversions between the wire formats, bounded by the length of the message.

The functions that rosbags generates check a message's length only at the beginning of a sequence or a string. They
assume that arrays of a fixed size, and messages made of nothing else, are complete: a message of a hundred bytes can
then take gigabytes, or hours. Here each type has a minimum size, which is checked first.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

#: At the end of a message, the generated functions may skip to the alignment of a member that does not exist.
_MAX_PADDING = 7


class BoundedTypes:
    """The types of one conversion.

    Parameters
    ----------
    msgdefs
        rosbags' compiled definitions, by name: of the type itself and all nested types.
    root
        The type's name.
    least
        Minimum size of a message, bytes.
    repeated
        Minimum sizes of the types that are elements of sequences.
    makes_objects
        Whether a message can become as many Python objects as it has bytes.
    """

    __slots__ = ("_least", "_msgdefs", "_root", "makes_objects")

    def __init__(
        self, msgdefs: Mapping[str, Any], root: str, least: int, repeated: Mapping[str, int], *, makes_objects: bool
    ) -> None:
        self._msgdefs = {
            name: _guarded(msgdef, repeated[name]) if repeated.get(name) else msgdef for name, msgdef in msgdefs.items()
        }
        self._root = root
        self._least = least
        self.makes_objects = makes_objects

    def ros1_to_cdr(self, data: memoryview) -> memoryview:
        """Convert a message of ROS 1 to little-endian CDR.

        Raises
        ------
        SerdeError, struct.error, ValueError
            If the bytes contradict the type.
        """
        msgdef = self._msgdefs[self._root]
        types = _Types(self._msgdefs, len(data))
        size = self._measured(data, 0, msgdef.getsize_ros1_to_cdr, types, 0)
        made = memoryview(bytearray(4 + size))
        made[1] = 1
        msgdef.ros1_to_cdr(data, 0, made[4:], 0, types)
        return made.toreadonly()

    def cdr_to_ros1(self, data: memoryview) -> memoryview:
        """Convert a message in little-endian CDR, its header included, to ROS 1's format.

        Raises
        ------
        SerdeError, struct.error, ValueError
            If the bytes contradict the type.
        """
        msgdef = self._msgdefs[self._root]
        body = data[4:]
        types = _Types(self._msgdefs, len(data))
        # Some writers add padding at the end.
        size = self._measured(body, 4, msgdef.getsize_cdr_to_ros1, types, 3)
        made = memoryview(bytearray(size))
        msgdef.cdr_to_ros1(body, 0, made, 0, types)
        return made.toreadonly()

    def _measured(
        self, body: memoryview, head: int, measure: Callable[..., tuple[int, int]], types: _Types, padding: int
    ) -> int:
        """Check that the fields take as many bytes as the message has; return the size of the result."""
        if len(body) < self._least:
            raise ValueError(f"its fields take {head + self._least} or more")
        taken, size = measure(body, 0, None, 0, types)
        if not taken - _MAX_PADDING * (head > 0) <= len(body) <= taken + padding:
            raise ValueError(f"its fields take {head + taken}")
        return size


class _Types:
    """The part of rosbags' store that the generated functions use, for one message."""

    __slots__ = ("_msgdefs", "max_sequence_length")

    def __init__(self, msgdefs: Mapping[str, Any], length: int) -> None:
        self._msgdefs = msgdefs
        # Every element takes at least one byte.
        self.max_sequence_length = max(length, 1)

    def get_msgdef(self, name: str) -> Any:
        return self._msgdefs[name]


def _guarded(msgdef: Any, least: int) -> SimpleNamespace:
    """Wrap a type's functions: its size is computed only if the message has the type's minimum of bytes left."""

    def checked(measure: Callable[..., tuple[int, int]]) -> Callable[..., tuple[int, int]]:
        def measured(body: memoryview, place: int, made: None, size: int, types: _Types) -> tuple[int, int]:
            if place + least > len(body):
                raise ValueError(f"it ends inside a sequence, {place + least} bytes are needed and {len(body)} there")
            return measure(body, place, made, size, types)

        return measured

    return SimpleNamespace(
        getsize_ros1_to_cdr=checked(msgdef.getsize_ros1_to_cdr),
        getsize_cdr_to_ros1=checked(msgdef.getsize_cdr_to_ros1),
        ros1_to_cdr=msgdef.ros1_to_cdr,
        cdr_to_ros1=msgdef.cdr_to_ros1,
    )
