"""Finds the points of a cloud that are on the ground: level, sloped, or with kerbs.

Method: the ground is followed outwards from the robot along each direction, cell by cell, by the lowest point of each;
as in Himmelsbach, v. Hundelshausen and Wünsche, "Fast segmentation of 3D point clouds for ground vehicles" (IEEE
Intelligent Vehicles Symposium, 2010), which fits lines to the lowest points of such cells, and as in Autoware's
``ray_ground_filter``, which limits the slope from each point to the next. It needs neither rings nor an order of
points.

A cell continues the ground if its lowest point is on the line of the ground so far, or higher by a kerb, or on a slope.
If it is higher than the ground so far, there must be few points above it, so that the ground does not climb walls, and
the ground must go on behind it: where the next cells are down again, it was an object that one may drive around.
Between these cells the ground is a straight line. Points that are lower, or not much higher, are on the ground.

The ground begins with a plane beneath the robot, at the lowest height at which many cells have another cell of about
the same height behind them, and others beside them, as on a floor but not on walls. Without such a height there is no
ground, as in clouds of a planar lidar, or of one that sees only walls.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .percentiles import median

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: How many directions there are, and the cells along each: the first is twenty centimetres long, each next one 4 %
#: longer.
_SECTORS = 180
_FIRST = 5.0
_GROWTH = math.log(1.04)
_FARTHEST = 150.0
_RINGS = math.ceil(math.log1p(_FARTHEST / _FIRST) / _GROWTH)

#: How many cells must be at the height where the ground begins, and their least share of all cells with one behind
#: them.
_FEWEST = 20
_LEAST_SHARE = 0.15
#: How much the heights of these cells may differ, metres.
_WINDOW = 0.3
#: The largest height of the ground beneath the robot, in its own frame, metres: higher planes are tables or ceilings.
_HIGHEST = 0.3

#: The steepest slope, as its tangent; the highest kerb, metres; and up to which height above the ground points are on
#: it, metres, and `_SPREAD` times their distance.
_STEEPEST, _STEP, _CLEARANCE = math.tan(math.radians(15.0)), 0.2, 0.1

#: The least distance over which slopes are measured, and between two kerbs, metres: stairs are not ground.
_BASE = 1.0
#: How much the ground may rise where there are no points in between, metres.
_RISE = 0.5
#: How far behind a kerb, or the foot of a slope, the ground must not be down again, metres, and how many cells are
#: compared for this at most.
_ON = 3.0
_LOOK = 12
#: How much the heights of points on level ground differ, metres.
_NOISE = 0.08
#: How much higher than the ground a point may be, as a share of its distance.
_SPREAD = 0.008
#: The largest distance between cells that are compared to find where the ground begins, metres.
_APART = 30.0
#: How far the ground extends after the last cell that continues it, metres.
_BEYOND = 3.0


class Cells(NamedTuple):
    """The lowest point of each cell, (rings, sectors): its height and distance, and whether many points are above it.

    Heights and distances are inf where there is no point.
    """

    height: NDArray[np.float32]
    distance: NDArray[np.float32]
    cluttered: NDArray[np.bool_]


def on_ground(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which points are on the ground.

    Parameters
    ----------
    x, y, z
        Coordinates in metres, of one shape, in a frame of the robot whose z axis points up.

    Returns
    -------
    Array of bool, of their shape; false for points that are NaN or infinite, or farther away than 150 m.
    """
    shape = x.shape
    with np.errstate(over="ignore", invalid="ignore"):
        px, py, pz = (np.ravel(axis).astype(np.float32) for axis in (x, y, z))
    with np.errstate(all="ignore"):
        distance = np.hypot(px, py)
        known = np.isfinite(pz) & (distance < _FARTHEST)
        is_ground = np.zeros(px.size, np.bool_)
        if not known.all():
            px, py, pz, distance = px[known], py[known], pz[known], distance[known]
        if not px.size:
            return is_ground.reshape(shape)
        sector = ((np.arctan2(py, px) + np.float32(math.pi)) * np.float32(_SECTORS / (2 * math.pi))).astype(np.int32)
        ring = (np.log1p(distance * np.float32(1 / _FIRST)) * np.float32(1 / _GROWTH)).astype(np.int32)
        ring = np.minimum(ring, _RINGS - 1)
        cell = ring * np.int32(_SECTORS) + np.minimum(sector, _SECTORS - 1)
        edges = _FIRST * np.expm1(np.arange(int(ring.max()) + 2) * _GROWTH)
        cells = _lowest(cell, pz, distance, edges.size - 1)
        plane = _plane_beneath(cells)
        if plane is None:
            return is_ground.reshape(shape)
        slope = np.sum(np.multiply(plane[:2], np.transpose(_directions())), axis=1)
        # From here on, heights are relative to the plane beneath the robot.
        cells = cells._replace(height=cells.height - (slope * cells.distance + plane[2]).astype(np.float32))
        heights = _heights_at(_follow_ground(cells), cells.distance, edges)
        heights += slope * edges[:, np.newaxis] + plane[2]
        slopes = np.diff(heights, axis=0) / np.diff(edges)[:, np.newaxis]
        limit = (heights[:-1] - slopes * edges[:-1, np.newaxis] + _CLEARANCE).astype(np.float32).ravel()
        grade = (slopes + _SPREAD).astype(np.float32).ravel()
        is_ground[known] = pz <= limit[cell] + grade[cell] * distance
    return is_ground.reshape(shape)


def _lowest(cell: NDArray[np.int32], z: NDArray[np.float32], distance: NDArray[np.float32], rings: int) -> Cells:
    count = _SECTORS * rings
    height = np.full(count, np.inf, np.float32)
    np.minimum.at(height, cell, z)
    above = z - height[cell]
    lowest = np.flatnonzero(above == 0)
    where = np.full(count, np.inf, np.float32)
    np.minimum.at(where, cell[lowest], distance[lowest])
    low = np.bincount(cell[above <= 0.3], minlength=count)
    standing = np.bincount(cell[(above > 0.3) & (above <= 2.0)], minlength=count)
    grid = rings, _SECTORS
    return Cells(height.reshape(grid), where.reshape(grid), (standing > low).reshape(grid))


def _plane_beneath(cells: Cells) -> tuple[float, float, float] | None:
    """Return the plane beneath the robot, ``z = a x + b y + c``; None if no ground is visible."""
    floor = _floor_like(cells)
    ring, sector = np.nonzero(floor & (cells.height <= _HIGHEST + _STEEPEST * cells.distance))
    heights, distances = cells.height[ring, sector], cells.distance[ring, sector]
    order = np.argsort(heights, kind="stable")
    low = heights[order]
    low = low[low <= _HIGHEST]
    if low.size < _FEWEST:
        return None
    counts = np.searchsorted(low, low + np.float32(_WINDOW), "right") - np.arange(low.size)
    enough = np.flatnonzero(counts >= max(_FEWEST, _LEAST_SHARE * low.size))
    if not enough.size:
        return None
    first = int(enough[0])
    # The fullest of the windows that begin in this one.
    begin = first + int(counts[first : first + counts[first]].argmax())
    level = median(low[begin : begin + counts[begin]])
    across, along = (part[sector] * distances for part in _directions())
    near = distances <= 3 * np.sort(distances)[distances.size // 3]
    plane = np.array([0.0, 0.0, level])
    design = np.stack([across, along, np.ones(across.size)], axis=1)
    for _ in range(4):
        inside = near & (np.abs(heights - design @ plane) < _WINDOW)
        # Cells on one side determine no slope towards the other, so the plane is level there.
        square = design[inside].T @ design[inside] + np.diag([_FEWEST, _FEWEST, 0.0])
        fitted = np.linalg.solve(square, design[inside].T @ heights[inside]) if inside.sum() >= _FEWEST else plane
        if math.hypot(fitted[0], fitted[1]) > _STEEPEST or fitted[2] > _HIGHEST:
            break
        plane = fitted
    a, b, c = plane.tolist()
    return a, b, c


def _directions() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return cosine and sine of the middle of each sector."""
    angles = (np.arange(_SECTORS) + 0.5) * (2 * math.pi / _SECTORS) - math.pi
    return np.cos(angles), np.sin(angles)


def _floor_like(cells: Cells) -> NDArray[np.bool_]:
    """Return whether cells have another cell of about the same height behind them, as on a floor but not on walls."""
    floor = np.zeros(cells.height.shape, np.bool_)
    height, distance = np.full(_SECTORS, np.inf, np.float32), np.full(_SECTORS, np.inf, np.float32)
    # From far to near.
    for ring in range(len(floor) - 1, -1, -1):
        low, where = cells.height[ring], cells.distance[ring]
        known = np.isfinite(low)
        apart = distance - where
        most = np.where(apart < _APART, _NOISE + 0.2 * apart, 0)
        followed = known & (apart > 0.2 + 0.1 * where) & (np.abs(height - low) < most)
        floor[ring] = followed
        # Cells of a wall are close together, so the cell to compare with is used until one is far enough from it.
        renewed = known & (followed | (low < height - most))
        height, distance = np.where(renewed, low, height), np.where(renewed, where, distance)
    return floor & _has_neighbour_beside(cells, 1) & _has_neighbour_beside(cells, -1)


def _has_neighbour_beside(cells: Cells, step: int) -> NDArray[np.bool_]:
    """Return whether cells have a cell of about the same height in the next sector.

    On a wall at a small angle, each sector has another part, nearer or farther away.
    """
    # With coarse lidars every other sector is empty.
    empty: NDArray[np.bool_] = np.logical_not(np.any(np.isfinite(cells.height), axis=0))
    order = np.arange(_SECTORS) - step
    order = np.where(empty[order % _SECTORS], order - step, order) % _SECTORS
    height = cells.height[:, order]
    reach: NDArray[np.float32] = np.asarray(_NOISE + 0.01 * cells.distance)
    alike: NDArray[np.bool_] = np.asarray(np.abs(height - cells.height) < reach)
    alike[1:] |= np.abs(height[:-1] - cells.height[1:]) < reach[1:]
    alike[:-1] |= np.abs(height[1:] - cells.height[:-1]) < reach[:-1]
    return alike


def _follow_ground(cells: Cells) -> NDArray[np.float64]:
    """Return the ground's height in the cells that continue it, (rings, sectors), NaN in others."""
    behind, far_behind = _lowest_behind(cells)
    places = np.stack(cells[:2], axis=1).astype(np.float64)
    # How much the ground rises at most to a cell: by a share of the distance, and in all.
    share, most = np.where(cells.cluttered, 0.02, _STEEPEST), np.where(cells.cluttered, np.inf, _RISE)
    # Height and distance of the last cell of the ground, and of the one that slopes are measured from.
    last, begin = at = np.zeros((2, *places.shape[1:]))
    slope, kerb = np.zeros(_SECTORS), np.full(_SECTORS, -np.inf)
    ground = np.full(cells.height.shape, np.nan)
    for ring in np.flatnonzero(np.isfinite(cells.height).any(axis=1)).tolist():
        here = z, r = places[ring]
        (rise, apart), (over, base) = here - at
        fall = _STEEPEST * base
        sloped = (over <= fall + _NOISE) & (rise <= np.minimum(share[ring] * apart + _NOISE, most[ring]))
        kerbed = (rise > 0) & (rise <= _STEP) & (r - kerb >= _BASE) & ~(cells.cluttered[ring] | sloped)
        kerbed &= (slope <= _STEEPEST / 2) & (over <= fall / 2 + (_STEP + _NOISE))
        # Where no ground is known yet, the top of an object may be seen before the ground in front of it.
        goes_on = np.where(last[1] > 0, behind[ring], far_behind[ring]) >= z - rise / 2
        goes_on |= (rise <= _NOISE) | (sloped & (over <= slope * base + _NOISE))
        # Comparisons with the height of a cell without points, which is inf or NaN, are false.
        taken = (over >= -fall - _STEP) & (sloped | kerbed) & goes_on
        kerbed &= taken
        # A kerb is not a slope, so slopes are measured from its top.
        risen = taken & (base >= _BASE) & ~kerbed
        np.copyto(kerb, r, where=kerbed)
        np.copyto(slope, np.minimum(np.maximum(over / base, 0), _STEEPEST), where=risen)
        np.copyto(begin, here, where=kerbed | risen)
        np.copyto(last, here, where=taken)
        np.copyto(ground[ring], z, where=taken)
    return ground


def _lowest_behind(cells: Cells) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the height of the lowest cell behind each one: within `_ON` metres, and within its distance if it is more.

    The first cell beyond counts, too: objects hide what is behind them. Cells that are higher than a slope from here do
    not count, because they are obstacles. -inf if no cell counts.
    """
    # The cells with points, from near to far.
    sector, ring = np.nonzero(np.isfinite(cells.height.T))
    filled = np.bincount(sector, minlength=_SECTORS)
    order = np.arange(sector.size) - (np.cumsum(filled) - filled)[sector]
    height, distance = np.full((2, int(filled.max()), _SECTORS), np.inf, np.float32)
    height[order, sector], distance[order, sector] = cells.height[ring, sector], cells.distance[ring, sector]
    reaches = np.full_like(distance, _ON), np.maximum(distance, np.float32(_ON))
    lowest = np.full((2, *height.shape), np.inf, np.float32)
    last = np.zeros_like(height)
    for away in range(1, min(_LOOK, len(height) - 1) + 1):
        here, behind = slice(None, -away), slice(away, None)
        apart = distance[behind] - distance[here]
        counts = height[behind] <= height[here] + (_NOISE + _STEEPEST * apart)
        for grid, reach in zip(lowest, reaches, strict=True):
            lower = counts & (last[here] <= reach[here]) & (height[behind] < grid[here])
            np.copyto(grid[here], height[behind], where=lower)
        np.copyto(last[here], apart, where=counts)
    lowest[lowest == np.inf] = -np.inf
    by_cell = np.full((2, *cells.height.shape), -np.inf, np.float32)
    by_cell[:, ring, sector] = lowest[:, order, sector]
    return by_cell[0], by_cell[1]


def _heights_at(
    ground: NDArray[np.float64], distance: NDArray[np.float32], edges: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the ground's height at the edges of cells, (rings + 1, sectors); -inf where it is unknown."""
    rings, sectors = ground.shape
    known, number, sector = ~np.isnan(ground), np.arange(rings)[:, np.newaxis], np.arange(sectors)
    # The last cell before each edge, or -1, and the first one behind it, or the number of rings. Both stand for the
    # place beneath the robot, where the line before the first cell begins.
    begin, end = np.full((1, sectors), -1), np.full((1, sectors), rings)
    before = np.maximum.accumulate(np.concatenate([begin, np.where(known, number, -1)]), axis=0)
    after = np.minimum.accumulate(np.concatenate([np.where(known, number, rings), end])[::-1], axis=0)[::-1]
    places = np.concatenate([np.stack([ground, distance]), np.zeros((2, 1, sectors))], axis=1).reshape(2, -1)
    (z0, r0), (z1, r1) = (places.take(ring * sectors + sector, axis=1) for ring in (before, after))
    along = edges[:, np.newaxis]
    edge_heights: NDArray[np.float64] = np.where(after < rings, (z1 - z0) / (r1 - r0) * (along - r0) + z0, z0)
    # After the last cell the ground continues for some metres.
    last = before[-1]
    edge_heights[(along > edges[last + 1] + _BEYOND) | (last < 0)] = -np.inf
    return edge_heights
