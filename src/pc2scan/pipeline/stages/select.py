"""Selecting points: filters are applied one after the other, and what each rejects is counted under its name."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.project import packed

from .filters import Frame

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.core.points import Points
    from pc2scan.core.rigid import Rigid
    from pc2scan.tf.placing import Frames, Placement

    from .filters import Filter

__all__ = ["Select", "Selected"]


class Selected(NamedTuple):
    """The points that are kept, the transform that is still to be applied, and how many points each filter rejected."""

    points: Points
    target_from_source: Rigid | None
    rejected: dict[str, int]


class Select:
    """Applies filters one after the other: each sees what those before it have kept.

    Parameters
    ----------
    filters
        In their order.
    frames
        The recording's transforms.
    """

    __slots__ = ("_filters", "_frames")

    def __init__(self, filters: Sequence[Filter], frames: Frames) -> None:
        self._filters = filters
        self._frames = frames

    def __call__(self, points: Points, place: Placement) -> Selected:
        """Select points of a cloud, given where it goes.

        Raises
        ------
        DecodeError
            If a field is missing or cannot be decoded.
        TransformError
            If there is no transform to a filter's frame at the cloud's stamp.
        """
        rejected = {chosen.name: 0 for chosen in self._filters}
        seen: dict[Frame | str, Points] = {Frame.SOURCE: points}
        for chosen in self._filters:
            frame = Frame.TARGET if chosen.frame == place.frame_id else chosen.frame
            if frame not in seen:
                seen[frame] = self._placed(seen[Frame.SOURCE], frame, place)
            with np.errstate(all="ignore"):
                kept = chosen(seen[frame])
            if kept.dtype != np.bool_:
                raise TypeError(f"the filter {chosen.name} returned {kept.dtype}, expected bool")
            if count := kept.size - int(np.count_nonzero(kept)):
                rejected[chosen.name] += count
                seen = {frame: points.select(kept) for frame, points in seen.items()}
        if Frame.TARGET in seen:
            return Selected(seen[Frame.TARGET], None, rejected)
        return Selected(seen[Frame.SOURCE], place.target_from_source, rejected)

    def _placed(self, points: Points, frame: Frame | str, place: Placement) -> Points:
        """The points in another frame."""
        if isinstance(frame, str):
            name, transform = frame, self._frames.transform(frame, points.frame_id, points.stamp_ns)
        else:
            name, transform = place
        return points if transform is None else points.transform(packed(transform.as_float32()), name)
