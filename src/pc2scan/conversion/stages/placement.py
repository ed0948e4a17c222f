"""The stage that places clouds: looks up the scan's frame and time, and the motion of a deskewed cloud."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pc2scan.core.moving import MovingTransform
    from pc2scan.core.points import Points
    from pc2scan.core.rigid import Rigid
    from pc2scan.transforms.placing import Placement, Placer

    from .deskew import Deskew, MovingCloud

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
