"""Builds an occupancy grid from laser scans with known poses: which cells are free, and which are occupied.

Sources of the rules:

- Each cell has the log-odds of being occupied, and each observation adds to them: Thrun, Burgard and Fox,
  *Probabilistic Robotics*, chapter 9 (occupancy grid mapping with an inverse sensor model).
- The numbers are those of Hornung et al., *OctoMap* (Autonomous Robots 34, 2013): 0.85 for a hit and -0.4 for a miss
  (probabilities of 0.7 and 0.4), clamped to -2 and 3.5. They are multiples of 0.05, so that a cell is one int8.
- As in OctoMap, a scan changes each cell at most once, and a cell that is hit is not missed by another beam of this
scan.
- The cells of a beam are those of Bresenham's line from the cell of the sensor to the cell where the beam ends, as
  Karto (slam_toolbox) and the costmaps of nav2 draw it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from pc2scan.errors import DecodeError, UsageError

from . import kernel
from .plain import UNKNOWN
from .rigid import lerp, rotation_matrices, slerp

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .rigid import Rigid

#: A rectangle of cells: columns and rows from the first two numbers to the last two (exclusive).
_Bounds: TypeAlias = tuple[int, int, int, int]

#: Values of cells, as nav_msgs/OccupancyGrid has them.
UNSEEN, FREE, OCCUPIED = -1, 0, 100

#: Indices of cells beyond this are not exact as float64, and do not fit into int32.
_FARTHEST = 2**30

#: How many cells the beams of a scan may cross: 1,080 beams of 1.5 km at 5 cm, which take some hundredths of a second.
_MOST_CROSSED = 1 << 25

#: How many cells one beam may cross.
LONGEST = 1 << 16

#: Limits of the side of a cell, metres.
_FINEST, _COARSEST = 0.001, 1.0

#: A grid grows by a fourth of its size on each side, so that it is not copied for every scan.
_GROWTH = 4


class ObservingBeams(NamedTuple):
    """The beams of a scan that observe free or occupied space.

    Attributes
    ----------
    numbers
        (N,), their indices in ``ranges``.
    lengths
        (N,), metres.
    hits
        (N,), whether there is an object at their ends; the space before the end is free in any case.
    """

    numbers: NDArray[np.intp]
    lengths: NDArray[np.float64]
    hits: NDArray[np.bool_]


class Occupancy(NamedTuple):
    """A map.

    Attributes
    ----------
    cells
        (H, W) int8, one of `UNSEEN`, `FREE` and `OCCUPIED`; the first row has the smallest y.
    resolution
        The side of a cell, metres.
    x, y
        The corner of the first cell, metres.
    """

    cells: NDArray[np.int8]
    resolution: float
    x: float
    y: float


def observing_beams(
    ranges: NDArray[np.float32],
    range_min: float,
    range_max: float,
    *,
    longest: float = math.inf,
) -> ObservingBeams:
    """Return the beams of a scan that observe free or occupied space.

    A range from ``range_min`` to less than ``range_max`` is a return, as for laser_geometry. Beams without a return
    (inf, or from ``range_max`` on), NaN, and ranges below ``range_min`` are ignored, as in gmapping and slam_toolbox: a
    scan of a cloud also has no return where all points were too high or too low.

    Parameters
    ----------
    ranges
        (M,), metres.
    range_min, range_max
        Limits of the scan, metres.
    longest
        A return beyond it only clears the way up to it, metres; ``maxUrange`` of gmapping.
    """
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        lengths = ranges.astype(np.float64)
        returns = (lengths >= range_min) & (lengths < range_max) & np.isfinite(lengths)
    numbers = np.flatnonzero(returns)
    return ObservingBeams(numbers, np.minimum(lengths[numbers], longest), lengths[numbers] <= longest)


def place_beams(
    beams: ObservingBeams, directions: NDArray[np.float64], count: int, start: Rigid, end: Rigid | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the beams in coordinates of the map.

    Parameters
    ----------
    beams
        The result of `observing_beams`.
    directions
        (2, M): cosines and sines of all beams of the scan.
    count
        M, how many beams the scan has.
    start, end
        map_from_sensor when the first and the last beam of the scan were measured; between them it is interpolated as
        laser_geometry does. Without ``end`` all beams have the same transform.

    Returns
    -------
    origins, ends
        (N, 2) float64 each, metres: x and y of the sensor, and of the end of each beam. A tilted scan is projected onto
        the x-y plane.
    """
    ahead, left = directions[:, beams.numbers] * beams.lengths
    if end is None or count < 2:
        matrix = start.matrix
        x, y, _ = start.translation.tolist()
        ends = np.stack((matrix[0, 0] * ahead + matrix[0, 1] * left, matrix[1, 0] * ahead + matrix[1, 1] * left), 1)
        origins = np.broadcast_to(start.translation[:2], ends.shape)
        return origins, ends + np.array((x, y))
    ratio = beams.numbers / (count - 1)
    matrices = rotation_matrices(slerp(start.quaternion, end.quaternion, ratio).T)
    origins = lerp(start.translation, end.translation, ratio)[:, :2]
    ends = origins + np.stack([row[0] * ahead + row[1] * left for row in matrices[:2]], 1)
    return origins, ends


class OccupancyGrid:
    """A grid that scans are drawn into; it grows where the robot drives.

    Parameters
    ----------
    resolution
        The side of a cell, metres.
    most
        How many cells it may have.

    Raises
    ------
    UsageError
        If cells would be finer than any lidar measures, or so coarse that they show nothing.
    """

    def __init__(self, resolution: float, most: int) -> None:
        if not _FINEST <= resolution <= _COARSEST:
            # A resolution of 5 nearly always means centimetres.
            meant = resolution / 100
            hint = f"for {resolution:g} cm write `resolution={meant:g}`" if _FINEST <= meant <= _COARSEST else None
            raise UsageError(
                f"`resolution` is {resolution:g} m, it must be from {_FINEST:g} to {_COARSEST:g}", hint=hint
            )
        self.resolution = resolution
        self._most = most
        #: Log-odds, and the mark of a scan; see `pc2scan.core.plain.trace`.
        self._cells = np.empty((0, 0), np.int16)
        #: Column and row of the grid's first cell, counted from the cell at the frame's origin.
        self._first = (0, 0)
        #: The cells that were drawn, without the reserve around them.
        self._needed: _Bounds | None = None
        self._scans = 0

    def add(self, origins: NDArray[np.float64], ends: NDArray[np.float64], hits: NDArray[np.bool_]) -> None:
        """Draw the beams of a scan.

        Parameters
        ----------
        origins, ends
            (N, 2), metres: where each beam begins and ends.
        hits
            (N,): whether there is an object at the end.

        Raises
        ------
        UsageError
            If the grid would have too many cells.
        DecodeError
            If the beams cross too many cells.
        """
        if not len(hits):
            return
        with np.errstate(all="ignore"):
            places = np.floor(np.concatenate([origins, ends], 1) / self.resolution)
        if not (np.abs(places) < _FARTHEST).all():
            farthest = float(np.abs(np.concatenate([origins, ends])).max())
            raise UsageError(
                f"a beam of a scan ends {farthest:g} m from the origin of the map, more than {_FARTHEST:,} cells",
                hint="`start` and `end` cut the recording; pc2scan tf shows its transforms",
            )
        cells = places.astype(np.int64)
        if int(np.abs(cells[:, 2:] - cells[:, :2]).max(axis=1).sum()) > _MOST_CROSSED:
            raise DecodeError(
                f"the beams of a scan cross more than {_MOST_CROSSED:,} cells",
                hint="a larger `resolution` makes them fewer",
            )
        columns, rows = cells[:, 0::2], cells[:, 1::2]
        self._grow((int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1))
        cells -= np.array(self._first * 2)
        # The mark is one byte, which distinguishes 255 scans.
        self._scans = self._scans % 255 + 1
        if self._scans == 1:
            self._cells &= ~255
        kernel.trace(
            self._cells,
            self._cells.shape[1],
            self._scans,
            np.ascontiguousarray(cells, np.int32),
            np.ascontiguousarray(hits, np.bool_),
        )

    def _grow(self, needed: _Bounds) -> None:
        """Enlarge the grid to contain a rectangle of cells."""
        height, width = self._cells.shape
        old = (*self._first, self._first[0] + width, self._first[1] + height) if width else needed
        needed = _enclosing_bounds(self._needed or needed, needed)
        if _grid_with_bounds(needed) > self._most:
            width, height = needed[2] - needed[0], needed[3] - needed[1]
            size = self.resolution
            raise UsageError(
                f"the map would have {width:,} x {height:,} cells of {size:g} m ({width * size:,.0f} x "
                f"{height * size:,.0f} m); at most {self._most:,} cells are possible",
                hint="a larger `resolution` makes larger cells, `start` and `end` cut",
            )
        self._needed = needed
        if width and _enclosing_bounds(old, needed) == old:
            return
        left, below, right, above = _enclosing_bounds(old, needed)
        # A reserve for the next scans.
        across, up = ((needed[k + 2] - needed[k]) // _GROWTH for k in (0, 1))
        with_room = (left - across, below - up, right + across, above + up)
        chosen = with_room if _grid_with_bounds(with_room) <= self._most else needed
        self._cells = _resize(self._cells, old, chosen)
        self._first = chosen[:2]

    def occupancy(self) -> Occupancy | None:
        """Return the map: the cells that were observed, and the rectangle around them; None if there are none.

        A cell is occupied if this is more probable than not.
        """
        odds = self._cells >> 8
        known = odds != UNKNOWN
        rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        if not rows.size:
            return None
        inside = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        cells = np.full(odds[inside].shape, UNSEEN, np.int8)
        cells[known[inside]] = FREE
        cells[odds[inside] > 0] = OCCUPIED
        x, y = (self._first[0] + int(columns[0])), (self._first[1] + int(rows[0]))
        return Occupancy(cells, self.resolution, x * self.resolution, y * self.resolution)


def _enclosing_bounds(one: _Bounds, other: _Bounds) -> _Bounds:
    """Return the smallest rectangle around two."""
    return min(one[0], other[0]), min(one[1], other[1]), max(one[2], other[2]), max(one[3], other[3])


def _grid_with_bounds(bounds: _Bounds) -> int:
    return (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])


def _resize(cells: NDArray[np.int16], old: _Bounds, new: _Bounds) -> NDArray[np.int16]:
    """Return a grid with other bounds; its new cells are unobserved."""
    moved = np.full((new[3] - new[1], new[2] - new[0]), UNKNOWN * 256, np.int16)
    left, below, right, above = max(old[0], new[0]), max(old[1], new[1]), min(old[2], new[2]), min(old[3], new[3])
    if cells.size and left < right and below < above:
        moved[below - new[1] : above - new[1], left - new[0] : right - new[0]] = cells[
            below - old[1] : above - old[1], left - old[0] : right - old[0]
        ]
    return moved
