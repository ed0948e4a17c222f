"""The differences between two messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pc2scan.core.compare import ArrayDifference


@dataclass(frozen=True, slots=True)
class Change:
    """A difference between two messages that is not one of values; both sides as text."""

    name: str
    a: str
    b: str


@dataclass(frozen=True, slots=True)
class ValueChange:
    """Differing values of ``ranges``, ``intensities`` or a field of a cloud.

    ``beams`` are angle_min and angle_increment of a scan, rad; None for a cloud.
    """

    name: str
    difference: ArrayDifference
    beams: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class MessageDifference:
    """The differences between two messages.

    Attributes
    ----------
    elements
        Beams or points of the first message.
    changes, values
        The differences after tolerances; empty for equal messages.
    """

    elements: int = 0
    changes: tuple[Change, ...] = ()
    values: tuple[ValueChange, ...] = ()

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return not self.changes and not self.values
