"""The parts of every conversion: a decoder, stages between arrays, and what a consumer of the results does last."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

from pc2scan.errors import MessageError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pc2scan.core.rule import PointCounts
    from pc2scan.model import Buffer
    from pc2scan.transforms.placing import LevelTransform

    from .combine.rebinning import Rebinning

    #: One step between the decoded message and the result.
    Step: TypeAlias = Callable[[Any], Any]


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
    ``motion`` is how far the sensor moved, if it was deskewed. While `FirstClouds` takes samples, ``candidate``
    makes the ``sample`` of the cloud, if it is among the first by the message's log time. ``level`` is the transform of
    its frame, if that is made level. ``rebinned`` counts how beams of scans became other beams. ``used`` are the points
    that beams read, if they are written. ``removed`` is how many beams had ``returns``, how many of these were too
    ``sparse`` for ``min_points`` or ``reduce``, and how many each beam filter removed; None without any of them.
    """

    message: Any
    counts: PointCounts
    empty: bool
    motion: Motion | None = None
    candidate: Callable[[int], Any] | None = None
    sample: Any = None
    level: LevelTransform | None = None
    rebinned: Rebinning | None = None
    used: Any = None
    removed: Mapping[str, int] | None = None
    size: int = 0
    stamp_ns: int | None = None


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

    def serialise(self, serialization: str, result: ConvertedMessage) -> ConvertedMessage:
        """Do the last step of a consumer that writes: replace arrays by their form in ``ros1`` or ``cdr``."""
        # Of the class: a function that is read from an instance would be bound to it.
        result.message = type(self).encode(result.message, serialization)
        result.size = len(result.message)
        if result.used is not None:
            result.used = result.used.encode(serialization)
            result.size += len(result.used)
        return result


def steps_of(
    conversions: Sequence[Conversion], topic: str, source: str, source_type: str, last: Sequence[Step | None]
) -> tuple[Step, ...]:
    """Return the steps that convert one source topic's messages, each of which takes what the one before returns.

    Parameters
    ----------
    conversions
        All of one direction.
    topic, source, source_type
        The topic; see `Conversion.decoder`.
    last
        For each conversion, the consumer's last step; None: there is none.

    Returns
    -------
    tuple of callable
        The first takes serialised messages. The last one returns the result of the only conversion, or a list with a
        result or an error for each of several: the error of one does not stop the others. All raise a `MessageError` if
        the message cannot be decoded, or if the only conversion fails.
    """
    decode = conversions[0].decoder(source, source_type)
    chains = [
        (*conversion.stages(topic), *filter(None, [own])) for conversion, own in zip(conversions, last, strict=True)
    ]
    if len(chains) == 1:
        return (decode, *chains[0])
    tree: list[_StepNode] = []
    for place, chain in enumerate(chains):
        nodes = tree
        for step in chain:
            node = next((node for node in nodes if node.step == step), None)
            if node is None:
                node = _StepNode(step, [], [])
                nodes.append(node)
            node.places.append(place)
            nodes = node.further
    return (decode, partial(_in_tree, tree, len(chains)))


class _StepNode(NamedTuple):
    """A step, the conversions that need it, and their next steps."""

    step: Step
    places: list[int]
    further: list[_StepNode]


def _in_tree(tree: Sequence[_StepNode], count: int, value: Any) -> list[ConvertedMessage | MessageError]:
    found: list[Any] = [None] * count
    _follow(tree, value, found)
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
