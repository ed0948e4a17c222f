"""The parts of every conversion: a decoder, stages between arrays, and an encoder."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

from pc2scan.errors import MessageError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pc2scan.core.counts import PointCounts
    from pc2scan.core.params import ProjectionParams
    from pc2scan.messages.used_points import UsedPoints
    from pc2scan.model import Buffer
    from pc2scan.tf.placing import LevelTransform

    from .combine.rebinning import Rebinning
    from .motion import Motion

    #: One step between the decoded message and the result.
    Step: TypeAlias = Callable[[Any], Any]


# Instances are never changed. They are neither frozen nor named tuples, because creating those takes two to three times
# as long, for every message.
@dataclass(slots=True, eq=False)
class ConvertedMessage:
    """The result of the stages for one message: the new message as arrays, which the output's encoder serialises.

    ``empty`` is whether it has no return, or no point; ``motion`` is how far the sensor moved, if it was deskewed.
    ``sample`` is for `FirstClouds`, as long as that takes samples, and a candidate until the message's log time is
    known. ``level`` is the transform of its frame, if that is made level. ``rebinned`` counts how beams of scans became
    other beams. ``used`` are the points that beams read, if they are written. ``removed`` is how many beams had
    ``returns``, how many of these were too ``sparse`` for ``min_points`` or ``kth``, and how many each beam filter
    removed; None without any of them.
    """

    message: Any
    counts: PointCounts
    empty: bool
    motion: Motion | None = None
    sample: object = None
    level: LevelTransform | None = None
    rebinned: Rebinning | None = None
    used: UsedPoints | None = None
    removed: Mapping[str, int] | None = None


@dataclass(slots=True, eq=False)
class EncodedMessage:
    """A `ConvertedMessage` whose message is serialised."""

    data: bytes
    counts: PointCounts
    empty: bool
    motion: Motion | None = None
    sample: object = None
    level: LevelTransform | None = None
    rebinned: Rebinning | None = None
    used: bytes | None = None
    removed: Mapping[str, int] | None = None

    @property
    def size(self) -> int:
        """Size in bytes."""
        return len(self.data) + len(self.used or b"")


class Measurements(NamedTuple):
    """What was measured in the first clouds of a topic before the conversion.

    Attributes
    ----------
    scan_time, time_increment
        Seconds, as in the message.
    first_beam_ns
        Nanoseconds from the cloud's stamp to the scan's.
    azimuth_step
        How finely the lidar samples azimuth, radians; 0 if it was not measured.
    """

    scan_time: float
    time_increment: float = 0.0
    first_beam_ns: int = 0
    azimuth_step: float = 0.0

    def resolve(self, params: ProjectionParams) -> ProjectionParams:
        """Return parameters whose ``beams`` is not auto: as measured, or without clouds as ``angle_increment`` says."""
        if params.beams != "auto":
            return params
        return params.at_resolution(self.azimuth_step) if self.azimuth_step else replace(params, beams=0)


class Conversion(ABC):
    """A conversion between two kinds of messages: clouds to scans, scans to clouds, or scans to scans.

    Attributes
    ----------
    made_type
        The type of the new messages: a ROS type in ROS 2's spelling.
    encode
        Serialises a new message as ``ros1`` or ``cdr``.
    shrinks_from
        A message of this size in bytes, or larger, becomes a smaller one.
    """

    made_type: ClassVar[str]
    encode: ClassVar[Callable[[Any, str], bytes]]
    shrinks_from: int

    @abstractmethod
    def decoder(self, source: str, source_type: str) -> Callable[[Buffer], Any]:
        """Return the decoder of messages; conversions of one direction share it.

        Parameters
        ----------
        source
            The serialisation of the messages: ``ros1`` or ``cdr``.
        source_type
            Their ROS type; empty for the usual type of this direction.
        """

    @abstractmethod
    def stages(self, topic: str) -> tuple[Step, ...]:
        """Return the stages between decoder and encoder of one topic's messages: the last returns a `ConvertedMessage`.

        Conversions that begin with equal stages share the work of these on each message.

        Notes
        -----
        Stages process each message by itself, on any thread. They raise a `MessageError` if a message cannot be
        converted.
        """

    def for_topic(
        self, topic: str, source: str, target: str, source_type: str = ""
    ) -> Callable[[Buffer], EncodedMessage]:
        """Return the whole conversion of one source topic's messages.

        Parameters
        ----------
        source, source_type
            See `decoder`.
        target
            The serialisation of what they become: ``ros1`` or ``cdr``.
        """
        return partial(_in_turn, self._steps(topic, source, target, source_type))

    def _steps(self, topic: str, source: str, target: str, source_type: str) -> tuple[Step, ...]:
        return self.decoder(source, source_type), *self.stages(topic), self.encoder(target)

    def encoder(self, target: str) -> Callable[[ConvertedMessage], EncodedMessage]:
        """Return the encoder that serialises results as ``ros1`` or ``cdr``."""
        return partial(_encoded, type(self).encode, target)


def converter(
    conversions: Sequence[Conversion], topic: str, source: str, target: str, source_type: str = ""
) -> Callable[[Buffer], Sequence[EncodedMessage | MessageError]]:
    """Return the function that converts one source topic's messages, with one result for each conversion.

    Parameters
    ----------
    conversions
        All of one direction.
    topic, source, target, source_type
        As for `Conversion.for_topic`.

    Returns
    -------
    callable
        It returns a result or an error for each conversion: the error of one does not stop the others. It raises the
        `MessageError` of a message that cannot be decoded, and the error of a conversion that is the only one.
    """
    first = conversions[0]
    if len(conversions) == 1:
        return partial(_alone, first._steps(topic, source, target, source_type))  # noqa: SLF001  # of this module
    tree: list[_StepNode] = []
    for place, conversion in enumerate(conversions):
        nodes = tree
        for step in (*conversion.stages(topic), conversion.encoder(target)):
            node = next((node for node in nodes if node.step == step), None)
            if node is None:
                node = _StepNode(step, [], [])
                nodes.append(node)
            node.places.append(place)
            nodes = node.further
    return partial(_all, first.decoder(source, source_type), tree, len(conversions))


class _StepNode(NamedTuple):
    """A step, the conversions that need it, and their next steps."""

    step: Step
    places: list[int]
    further: list[_StepNode]


def _all(
    decode: Callable[[Buffer], Any], tree: Sequence[_StepNode], count: int, data: Buffer
) -> list[EncodedMessage | MessageError]:
    found: list[Any] = [None] * count
    _follow(tree, decode(data), found)
    return found


def _follow(nodes: Sequence[_StepNode], value: Any, found: list[Any]) -> None:
    """Apply each step to a value, and the steps after it to the result."""
    for step, places, further in nodes:
        made: Any
        try:
            made = step(value)
        except MessageError as err:
            made, further = err, []  # noqa: PLW2901  # no further steps
        if further:
            _follow(further, made, found)
        else:
            for place in places:
                found[place] = made


def _in_turn(steps: Sequence[Step], value: Any) -> Any:
    for step in steps:
        value = step(value)
    return value


def _alone(steps: Sequence[Step], value: Any) -> tuple[Any]:
    # Not by `_in_turn`: a call takes time for every message.
    for step in steps:
        value = step(value)
    return (value,)


def _encoded(encode: Callable[[Any, str], bytes], target: str, result: ConvertedMessage) -> EncodedMessage:
    data = encode(result.message, target)
    used = None if result.used is None else result.used.encode(target)
    return EncodedMessage(
        data,
        result.counts,
        result.empty,
        result.motion,
        result.sample,
        result.level,
        result.rebinned,
        used,
        result.removed,
    )
