"""The parts of every conversion: a decoder, steps that place and select points, and their result."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from pc2scan.core.points import NUMBER
from pc2scan.errors import UnconnectedError
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.request.filters import Frame

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.core.points import Points
    from pc2scan.core.rigid import MovingTransform, Rigid
    from pc2scan.core.rule import PointCounts
    from pc2scan.model import Buffer
    from pc2scan.request.filters import Filter
    from pc2scan.transforms.placing import LevelTransform, Placement, Placer

    from .deskew import Deskew, MovingCloud


# Neither frozen nor a named tuple, because creating those takes two to three times as long, for every message.
@dataclass(slots=True, eq=False)
class ConvertedMessage:
    """The result of a conversion: the new message, and what is counted of it.

    The stages make ``message`` and ``used`` of arrays; the consumer's last step may replace both by their serialised
    form, and says in ``size`` how many bytes they take. ``empty`` is whether the message has no return, or no point;
    ``gap_ns`` is the longest time over which transforms were interpolated, if it was deskewed. ``level`` is the
    transform of its frame, if that is made level. ``used`` are the points that beams read, if they are written.
    ``removed`` is how many beams had ``returns``, how many of these were too ``sparse`` for ``min_points`` or
    ``reduce``, and how many each beam filter removed; None without any of them.
    """

    message: Any
    counts: PointCounts
    empty: bool
    gap_ns: int = 0
    level: LevelTransform | None = None
    used: Any = None
    removed: Mapping[str, int] | None = None
    size: int = 0
    stamp_ns: int | None = None


def as_it_is(value: Any) -> Any:
    """Return a value: a step that does nothing."""
    return value


class Steps(NamedTuple):
    """What is done with a decoded message, on any thread: each step takes what the one before returns.

    Attributes
    ----------
    place
        Places a cloud; None: ``project`` does that, too.
    select
        Selects some of its points; None: all are used.
    project
        Makes the new message, or what a message contributes to a scan of several.
    """

    place: Callable[[Any], Any] | None = None
    select: Callable[[Any], Any] | None = None
    project: Callable[[Any], Any] = as_it_is


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

        They raise a `MessageError` if a message cannot be converted. Conversions that place and select alike, by equal
        steps, share this work on each message.
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


_NOTHING: Mapping[str, int] = {}


# Instances are never changed. They are neither frozen nor named tuples, because creating those takes two to three times
# as long, for every message.
@dataclass(slots=True, eq=False)
class PlacedCloud:
    """A cloud between its decoder and the projection.

    Attributes
    ----------
    points
        The points that were not rejected.
    stamp_ns
        The scan's stamp.
    place
        The frame that the cloud is converted in, and the transform to it.
    moving
        The motion of its sensor; None if it is not deskewed.
    transform
        The transform that is still to be applied to ``points``; of a deskewed cloud, to each at its own time.
    rejected
        How many points were rejected so far, by reason.
    whole
        All points of the message, as decoded.
    """

    points: Points
    stamp_ns: int
    place: Placement
    moving: MovingCloud | None
    transform: Rigid | MovingTransform | None
    rejected: Mapping[str, int]
    whole: Points


@dataclass(frozen=True, slots=True)
class PlaceStage:
    """Places clouds: looks up the frame and the transform of each. Instances with equal attributes are equal.

    Attributes
    ----------
    placer
        The recording's transforms.
    deskew
        Places points at their own times; None: all points of a cloud are placed at its stamp.
    """

    placer: Placer
    deskew: Deskew | None = None

    def __call__(self, points: Points) -> PlacedCloud:
        """Place a cloud.

        Raises
        ------
        DecodeError
            If it is deskewed, and its points have no times.
        TransformError
            If there is no transform.
        """
        moving = None if self.deskew is None else self.deskew(points)
        if moving is None:
            place = self.placer.place(points.frame_id, points.stamp_ns)
            return PlacedCloud(points, points.stamp_ns, place, None, place.target_from_source, _NOTHING, points)
        place = self.placer.place(points.frame_id, moving.stamp_ns)
        return PlacedCloud(moving.points, moving.stamp_ns, place, moving, moving.transform, _NOTHING, points)


#: The selected points, the transform that is still to be applied, and how many points each filter rejected.
Selected: TypeAlias = "tuple[Points, Rigid | MovingTransform | None, dict[str, int]]"


@dataclass(frozen=True, slots=True)
class SelectStage:
    """Applies filters one after the other. Each sees the points that those before it have kept.

    Instances with equal attributes are equal.

    Attributes
    ----------
    filters
        The filters in order.
    placer
        The recording's transforms.
    numbered
        Whether points get the field `NUMBER`.
    """

    filters: tuple[Filter, ...]
    placer: Placer
    numbered: bool = False

    def __hash__(self) -> int:
        # Filters of users may have no hash.
        return hash(tuple(chosen.name for chosen in self.filters))

    def __call__(self, placed: PlacedCloud) -> PlacedCloud:
        """Select points of a placed cloud; see `apply`."""
        points = placed.points
        if self.numbered:
            shape = points.xyz()[0].shape
            points = points.replace({NUMBER: np.arange(math.prod(shape)).reshape(shape)}, points.frame_id)
        points, transform, rejected = self.apply(points, placed.place, placed.moving)
        return replace(placed, points=points, transform=transform, rejected=rejected)

    def apply(self, points: Points, place: Placement, moving: MovingCloud | None = None) -> Selected:
        """Select points of a cloud.

        Parameters
        ----------
        place
            The frame that it is converted in.
        moving
            The motion of its sensor, if it is deskewed. Then filters in the target frame are applied last, to points
            that are placed at their own times. All others are applied to the recorded points, so that parts of the
            robot are at their fixed place.

        Raises
        ------
        DecodeError
            If a field is missing or cannot be decoded.
        TransformError
            If there is no transform to a filter's frame at the cloud's stamp.
        """
        rejected = {chosen.name: 0 for chosen in self.filters}
        # The points that are kept so far, in each frame that a filter needed.
        seen: dict[Frame | str, Points] = {Frame.SOURCE: points}
        steps = [(chosen.frame, chosen) for chosen in self.filters]
        if moving is not None:
            steps.sort(key=lambda step: step[0] is Frame.TARGET)
        else:
            steps = [(Frame.TARGET if frame == place.frame_id else frame, chosen) for frame, chosen in steps]
        for frame, chosen in steps:
            if frame is Frame.TARGET and frame not in seen and moving is not None:
                seen[frame], placed, lost = moving.place(seen[Frame.SOURCE])
                rejected.update(lost)
                seen = seen if placed is None else {each: own.select(placed) for each, own in seen.items()}
            elif frame not in seen:
                seen[frame] = self._placed(seen[Frame.SOURCE], frame, place, chosen.name)
            with np.errstate(all="ignore"):
                mask = chosen(seen[frame])
            if mask.dtype != np.bool_:
                raise TypeError(f"the filter {chosen.name} returned {mask.dtype}, expected bool")
            if count := mask.size - int(np.count_nonzero(mask)):
                rejected[chosen.name] += count
                seen = {each: own.select(mask) for each, own in seen.items()}
        if Frame.TARGET in seen:
            return seen[Frame.TARGET], None, rejected
        kept = seen[Frame.SOURCE]
        return kept, place.target_from_source if moving is None else moving.transform_of(kept), rejected

    def _placed(self, points: Points, frame: Frame | str, place: Placement, name: str) -> Points:
        """Return points in the frame of a filter."""
        frame_id, transform, _ = place
        if isinstance(frame, str):
            try:
                frame_id, transform = frame, self.placer.transform(frame, points.frame_id, points.stamp_ns)
            except UnconnectedError as err:
                err.message = f"the frame of `{name}`: {err.message}"
                raise
        return points if transform is None else points.transform(transform.as_float32(), frame_id)
