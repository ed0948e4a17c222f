"""The parts of every conversion: a decoder, steps between arrays, and their result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

from pc2scan.messages.clouds import CLOUDS, SCANS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pc2scan.core.rule import PointCounts
    from pc2scan.model import Buffer
    from pc2scan.transforms.placing import LevelTransform, Placer


class Motion(NamedTuple):
    """The largest distance of the sensor from its pose at the scan's time: metres and radians.

    ``gap`` is the longest time that transforms were interpolated over, seconds.
    """

    distance: float
    angle: float
    gap: float = 0.0


# Neither frozen nor a named tuple, because creating those takes two to three times as long, for every message.
@dataclass(slots=True, eq=False)
class ConvertedMessage:
    """The result of a conversion: the new message, and what is counted of it.

    The stages make ``message`` and ``used`` of arrays; the consumer's last step may replace both by their serialised
    form, and says in ``size`` how many bytes they take. ``empty`` is whether the message has no return, or no point;
    ``motion`` is how far the sensor moved, if it was deskewed. ``level`` is the transform of its frame, if that is made
    level. ``used`` are the points that beams read, if they are written. ``removed`` is how many beams had ``returns``,
    how many of these were too ``sparse`` for ``min_points`` or ``reduce``, and how many each beam filter removed; None
    without any of them.
    """

    message: Any
    counts: PointCounts
    empty: bool
    motion: Motion | None = None
    level: LevelTransform | None = None
    used: Any = None
    removed: Mapping[str, int] | None = None
    size: int = 0
    stamp_ns: int | None = None


#: What is done with a decoded message, on any thread: each step takes what the one before returns. The first ones place
#: points and select some; conversions that begin with equal steps share them. The last one makes the new message, or
#: what a message contributes to a scan of several.
Steps: TypeAlias = tuple[Callable[[Any], Any], ...]


def as_it_is(value: Any) -> Any:
    """Return a value: a step that does nothing."""
    return value


class Conversion(Protocol):
    """A conversion between two kinds of messages: clouds to scans, scans to clouds, or scans to scans.

    Attributes
    ----------
    placer
        The recording's transforms.
    """

    placer: Placer

    def steps(self, topic: str) -> Steps:
        """Return what is done with the decoded messages of one topic.

        The steps raise a `MessageError` if a message cannot be converted. Conversions whose first steps are equal share
        their work on each message.
        """


def decoder_of(msgtype: str, serialization: str, echo: str = "first") -> Callable[[Buffer], Any]:
    """Return the decoder of a type of clouds or scans; ``echo`` chooses among several echoes of a beam."""
    return SCANS[msgtype](serialization, echo) if msgtype in SCANS else CLOUDS[msgtype](serialization)


def serialised(encode: Callable[[Any, str], bytes], serialization: str, result: ConvertedMessage) -> ConvertedMessage:
    """Do the last step of a consumer that writes: replace arrays by their form in ``ros1`` or ``cdr``."""
    result.message = encode(result.message, serialization)
    result.size = len(result.message)
    if result.used is not None:
        result.used = result.used.encode(serialization)
        result.size += len(result.used)
    return result
