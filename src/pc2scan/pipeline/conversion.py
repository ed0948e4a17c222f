"""What every direction of conversion has in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.core.project import PointCounts
    from pc2scan.model import Buffer

__all__ = ["Conversion", "Converted", "Timing"]


class Converted(NamedTuple):
    """A converted message, serialised, and what became of its points (or beams)."""

    data: bytes
    counts: PointCounts
    empty: bool


@dataclass(frozen=True, slots=True)
class Timing:
    """When the scans of a topic were measured.

    Attributes
    ----------
    scan_time, time_increment
        Seconds, as in the message.
    first_beam_ns
        From the cloud's stamp to the scan's.
    """

    scan_time: float
    time_increment: float = 0.0
    first_beam_ns: int = 0


class Conversion(Protocol):
    """A direction of conversion.

    Attributes
    ----------
    source_type, target_type
        ROS types in ROS 2's spelling.
    target_name
        The last part of the default output topic.
    shrinks_from
        Messages of so many bytes and more become smaller ones.
    """

    source_type: str
    target_type: str
    target_name: str
    shrinks_from: int

    def for_topic(self, topic: str, source: str, target: str) -> Callable[[Buffer], Converted]:
        """Return the conversion of one source topic's messages, each for itself and on any thread.

        Parameters
        ----------
        source, target
            Serialisations: ``ros1`` or ``cdr``.

        Notes
        -----
        What is returned raises a `MessageError` if a message cannot be converted.
        """
        ...
