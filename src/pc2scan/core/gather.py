"""The projection beyond upstream's: any geometry, any return of a beam, intensities.

Points are dropped for the same reasons and in the same order as in `pc2scan.core.project`, whose path is faster and
knows only the closest return. Here the returns of a cloud are gathered first, and each beam's are reduced to one then.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import kernel
from .grid import centered_slots, upstream_slots
from .project import PointCounts, ProjectedScan
from .reduce import extremes, means, winners

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .params import ProjectionParams
    from .project import Transform

__all__ = ["GatheringProjector"]

#: Points at a time: few enough for the cache.
BLOCK = 16384


class GatheringProjector:
    """The projection with any parameters. Threads may share one.

    Parameters
    ----------
    params
        The projection's parameters; ``target_frame`` is the caller's business.
    """

    __slots__ = ("_layout", "params")

    def __init__(self, params: ProjectionParams) -> None:
        self.params = params
        self._layout = params.layout

    def __call__(
        self,
        x: NDArray[Any],
        y: NDArray[Any],
        z: NDArray[Any],
        target_from_source: Transform | None = None,
        intensities: NDArray[Any] | None = None,
    ) -> ProjectedScan:
        """Project a cloud.

        Parameters
        ----------
        x, y, z
            As `Projector` takes them: metres, of one shape, any real type; rounded to float32.
        target_from_source
            A transform to apply first, in float64.
        intensities
            A value for every point, of the same shape and any real type; None: the scan has no intensities.

        Returns
        -------
        ProjectedScan
            Its arrays are new.

        Raises
        ------
        ValueError
            If the shapes differ, or have not one or two dimensions.
        """
        if not (x.shape == y.shape == z.shape and 1 <= x.ndim <= 2):
            raise ValueError(
                f"x, y and z have the shapes {x.shape}, {y.shape}, {z.shape}, expected one of (M,) or (H, W)"
            )
        if intensities is not None and intensities.shape != x.shape:
            raise ValueError(f"intensities have the shape {intensities.shape}, expected that of x, {x.shape}")
        with np.errstate(all="ignore"):
            values = None if intensities is None else intensities.reshape(-1)
            return self._projected((x.reshape(-1), y.reshape(-1), z.reshape(-1)), target_from_source, values)

    def _projected(
        self, cloud: tuple[NDArray[Any], ...], transform: Transform | None, intensities: NDArray[Any] | None
    ) -> ProjectedScan:
        params, beams = self.params, self._layout.count
        total, nan, height, near_or_far = cloud[0].size, 0, 0, 0
        slots, ranges, values = [], [], []
        # A cloud without points is one empty block.
        for start in range(0, max(1, total), BLOCK):
            block = slice(start, start + BLOCK)
            x, y, z = _coordinates([part[block] for part in cloud], transform)
            numbers = ~(np.isnan(x) | np.isnan(y) | np.isnan(z))
            level = np.flatnonzero(numbers & _within(z, params.min_height, params.max_height))
            known = int(np.count_nonzero(numbers))
            nan += x.size - known
            height += known - level.size
            x, y = x.take(level), y.take(level)
            # float64 holds the squares of float32 exactly, and libm's hypotf adds them in float64.
            reach = np.sqrt(np.square(x, dtype=np.float64) + np.square(y, dtype=np.float64)).astype(np.float32)
            near = np.flatnonzero(_within(reach, params.range_min, params.range_max))
            near_or_far += level.size - near.size
            if near.size < level.size:
                x, y, reach, level = x.take(near), y.take(near), reach.take(near), level.take(near)
            slot = self._slots(x, y)
            seen = slot < beams
            slots.append(slot)
            ranges.append(reach if seen.all() else reach[seen])
            if intensities is not None:
                values.append(intensities[block][level[seen]])
        where = np.concatenate(slots)
        counts = np.bincount(where, minlength=beams + 2)
        past_end, outside = int(counts[beams]), int(counts[beams + 1])
        where = where[where < beams] if past_end + outside else where
        found, lit = self._reduced(
            where, np.concatenate(ranges), counts[:beams], np.concatenate(values) if values else None
        )
        fates = PointCounts(total, where.size, nan, height, near_or_far, outside, past_end)
        return ProjectedScan(found, fates, lit)

    def _slots(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.intp]:
        """The beams of points, contiguous and not NaN, or their other fates; see `pc2scan.core.grid`."""
        angles = np.empty_like(x)
        kernel.angles(x, y, angles)
        return (centered_slots if self.params.geometry == "centered" else upstream_slots)(angles, self._layout)

    def _reduced(
        self,
        beams: NDArray[np.intp],
        ranges: NDArray[np.float32],
        counts: NDArray[np.intp],
        values: NDArray[Any] | None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Ranges and intensities (none without ``values``) of the beams."""
        params = self.params
        found = np.full(counts.size, params.empty_range, np.float32)
        lit = np.zeros(0 if values is None else counts.size, np.float32)
        seen = counts >= max(params.min_points, params.kth)
        if params.reduce == "mean":
            found[seen] = means(beams, ranges, counts)[seen]
            if values is not None:
                lit[seen] = means(beams, values, counts)[seen]
        elif values is None and params.reduce in {"min", "max"}:
            found[seen] = extremes(beams, ranges, counts.size, largest=params.reduce == "max")[seen]
        else:
            winner = winners(beams, ranges, counts, params.reduce, params.kth)[seen]
            found[seen] = ranges[winner]
            if values is not None:
                lit[seen] = values[winner]
        return found, lit


def _coordinates(cloud: list[NDArray[Any]], transform: Transform | None) -> list[NDArray[np.float32]]:
    """Contiguous float32, transformed; written out, for a matrix product may sum in any order."""
    if transform is None:
        return [part.astype(np.float32) for part in cloud]
    x, y, z = (part.astype(np.float64) for part in cloud)
    rotation, translation = transform
    return [
        (x * row[0] + y * row[1] + z * row[2] + offset).astype(np.float32)
        for row, offset in zip(rotation, translation, strict=True)
    ]


def _within(values: NDArray[np.float32], low: float, high: float) -> NDArray[np.bool_]:
    """Compared as float64: the limits are not rounded."""
    exact = values.astype(np.float64)
    inside: NDArray[np.bool_] = (exact >= low) & (exact <= high)
    return inside
