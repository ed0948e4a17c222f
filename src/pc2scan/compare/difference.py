"""What differs between two messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pc2scan.core.compare import ArrayDifference

__all__ = ["Change", "MessageDifference", "ValueChange"]


@dataclass(frozen=True, slots=True)
class Change:
    """Something that is one thing in a message and another in its partner; both as text."""

    name: str
    a: str
    b: str


@dataclass(frozen=True, slots=True)
class ValueChange:
    """Values that differ: of ``ranges``, ``intensities`` or a field of a cloud.

    ``beams`` (angle_min and angle_increment, rad) says where a scan's values are; None for a cloud.
    """

    name: str
    difference: ArrayDifference
    beams: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class MessageDifference:
    """What differs between two messages.

    Attributes
    ----------
    elements
        Beams or points of the first.
    changes, values
        What differs, tolerances applied; empty for messages that are the same.
    """

    elements: int = 0
    changes: tuple[Change, ...] = ()
    values: tuple[ValueChange, ...] = ()

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return not self.changes and not self.values
