"""What every direction of conversion has in common."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from pc2scan.bags.model import Buffer
    from pc2scan.core.project import PointCounts

__all__ = ["Conversion", "Converted"]


class Converted(NamedTuple):
    """A converted message, serialised, and what became of its points (or beams)."""

    data: bytes
    counts: PointCounts
    empty: bool


class Conversion(Protocol):
    """A direction of conversion.

    Attributes
    ----------
    source_type, target_type
        ROS types in ROS 2's spelling.
    target_name
        The last part of the default output topic.
    """

    source_type: str
    target_type: str
    target_name: str

    def __call__(self, data: Buffer, source: str, target: str) -> Converted:
        """Convert one message from the serialisation ``source`` to ``target`` (``ros1`` or ``cdr``).

        Raises
        ------
        MessageError
            If this message cannot be converted.
        """
        ...
