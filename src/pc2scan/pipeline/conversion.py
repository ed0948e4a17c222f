"""What every direction of conversion has in common: a decoder, stages between arrays, and an encoder."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.core.counts import PointCounts
    from pc2scan.messages.outputs import OutputType
    from pc2scan.model import Buffer

    from .first_clouds import Sample
    from .stages.deskew import Motion

__all__ = ["Conversion", "Converted", "Measured", "Result"]


# Never changed, but neither frozen nor named tuples: making these takes two to three times as long, for every message.
@dataclass(slots=True, eq=False)
class Result:
    """What the stages make of one message: the new message as arrays, which the output's type encodes.

    ``empty`` is whether it has no return, or no point; ``motion`` is how far the sensor moved, if it was deskewed.
    ``sample`` is for `FirstClouds`, while it wants any.
    """

    message: Any
    counts: PointCounts
    empty: bool
    motion: Motion | None = None
    sample: Sample | None = None


@dataclass(slots=True, eq=False)
class Converted:
    """A `Result` whose message is serialised."""

    data: bytes
    counts: PointCounts
    empty: bool
    motion: Motion | None = None
    sample: Sample | None = None


@dataclass(frozen=True, slots=True)
class Measured:
    """What was measured of the clouds of a topic before their conversion.

    Attributes
    ----------
    scan_time, time_increment
        Seconds, as in the message.
    first_beam_ns
        From the cloud's stamp to the scan's.
    azimuth_step
        How finely the lidar samples azimuth, radians; 0 where it was not asked for.
    """

    scan_time: float
    time_increment: float = 0.0
    first_beam_ns: int = 0
    azimuth_step: float = 0.0


class Conversion(ABC):
    """A direction of conversion.

    Parameters
    ----------
    output_type
        What messages become: a ROS type in ROS 2's spelling.
    output
        Its entry in the table of `pc2scan.messages.outputs`.
    shrinks_from
        Messages of so many bytes and more become smaller ones.
    """

    def __init__(self, output_type: str, output: OutputType[Any], shrinks_from: int) -> None:
        self.output_type = output_type
        self.output = output
        self.shrinks_from = shrinks_from

    @abstractmethod
    def stages(self, topic: str, source: str, source_type: str = "") -> Callable[[Buffer], Result]:
        """Return what decodes the messages of one source topic and takes them through all stages but encoding.

        Parameters
        ----------
        source
            The serialisation of the messages: ``ros1`` or ``cdr``.
        source_type
            Their ROS type; empty means the direction's usual one.

        Notes
        -----
        What is returned takes each message by itself, on any thread. It raises a `MessageError` if a message cannot be
        converted.
        """

    def for_topic(self, topic: str, source: str, target: str, source_type: str = "") -> Callable[[Buffer], Converted]:
        """Return the whole conversion of one source topic's messages, as `stages` does.

        Parameters
        ----------
        target
            The serialisation of what they become: ``ros1`` or ``cdr``.
        """
        return partial(_encoded, self.stages(topic, source, source_type), self.output.encode, target)


def _encoded(
    stages: Callable[[Buffer], Result], encode: Callable[[Any, str], bytes], target: str, data: Buffer
) -> Converted:
    # Stages that combine several messages belong here: they take results, in order, before these are encoded.
    result = stages(data)
    return Converted(encode(result.message, target), result.counts, result.empty, result.motion, result.sample)
