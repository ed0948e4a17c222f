"""Finds the ground in clouds: which plane of a cloud it is, and how the cloud's frame is mounted above it.

Method: planes by RANSAC (Fischler and Bolles, "Random sample consensus", Communications of the ACM 24 (6), 1981), the
largest first, each refined by weighted least squares, its inliers removed before the next. The triplets follow a
low-discrepancy sequence instead of random numbers, so that the same cloud always has the same planes. Points are first
thinned to one per cell, because a spinning lidar measures near objects a hundred times as densely as far ones.

A plane alone is no proof of the ground: a wall beside a level lidar looks like the ground under a lidar that lies on
its side, and a ceiling like the ground under one that hangs upside down. So a frame is called tilted or upside down
only if no other explanation fits the points; `_doubt` has the conditions, and if one fails, the kind is ``unknown``.
They were tuned on simulated clouds: 16 to 128 rings, scattering lidars and depth cameras, in halls, offices, corridors,
warehouses, garages, streets, fields, woods, yards and on ramps, with and without floor and ceiling, mounted at any roll
and pitch from -90 to 180 degrees. For each, the result is right to within 3 degrees or unknown, and no level one is
called anything else (``tests/core/test_ground.py`` repeats a part). It is also right for every cloud of the real
recordings that were available (a highway, a lidar close to the floor, a car park, a depth camera).

If no plane can be called the ground, two planes at right angles that are neither level nor upright still show that z is
not up: the frame is slanted.

Two cases cannot be distinguished by a cloud: a low ceiling of a hall whose floor is not visible is the mirror image of
open ground, and a lidar that hangs upside down just below a ceiling is that of a lidar just above the floor. Transforms
can distinguish them; see `pc2scan.transforms.mounting`.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

from .floor import FEWEST_POINTS, LEVEL, cells_of, level_floor, tolerances
from .percentiles import median, percentiles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

Kind = Literal["level", "tilted", "upside-down", "optical", "slanted", "unknown"]

_Points: TypeAlias = "NDArray[np.float64]"
_Direction: TypeAlias = tuple[float, float, float]

#: A plane whose normal is this far from the frame's z axis, radians, is as likely a wall as the ground.
_STEEPEST = math.radians(50.0)

#: Planes with this share of a cloud, and at most this share behind them, show how a room is turned. Those that are
#: slanted are this far from z, radians; two of them are at right angles within so many degrees.
_LARGE, _MOST_BEYOND = 0.08, 0.3
_SLANTED = (math.radians(12.0), math.radians(78.0))
_RIGHT_ANGLE = 3.0

#: body_from_optical: REP 103's optical frames have x to the right, y down and z forward.
_BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

#: The plastic number to the powers of -1, -2 and -3: the golden ratio's counterpart in three dimensions (Roberts,
#: 2018).
_PLASTIC = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)

#: The most planes of a cloud, the triplets tried for each, and the smallest share of the cloud that is a plane.
_PLANES = 8
_TRIPLETS = 250
_LEAST_SHARE = 0.03


class Plane(NamedTuple):
    """A plane in a cloud.

    Attributes
    ----------
    up
        Its normal, a unit vector that points to the side of the sensor.
    height
        The sensor's distance from it, metres.
    share
        Its share of the cloud's cells.
    beyond
        Share of the cloud's cells that lie behind it.
    width
        Twice the standard deviation of its cells along the shorter of its two directions, metres.
    nearest
        Distance of its nearer cells (tenth percentile) from the sensor, metres.
    """

    up: _Direction
    height: float
    share: float
    beyond: float
    width: float
    nearest: float

    @property
    def tilt(self) -> float:
        """Angle between its normal and the z axis, radians."""
        return math.acos(max(-1.0, min(1.0, self.up[2])))


class Ground(NamedTuple):
    """How a frame is mounted, judged by its clouds.

    Attributes
    ----------
    kind
        ``level``; ``tilted``; ``upside-down``; ``optical`` (z is forward, as in a camera's optical frame); ``slanted``:
        z is not up, but which plane is the ground is not known; ``unknown``: there is not enough evidence.
    up
        The direction of up in the frame, a unit vector; None if no ground is visible.
    height
        Height of the frame's origin above the floor, metres; None if no ground is visible.
    ceiling
        From the origin up to the ceiling, metres; None if no ceiling is visible.
    clouds, sampled
        How many clouds agree, and how many were examined.
    """

    kind: Kind
    up: _Direction | None = None
    height: float | None = None
    ceiling: float | None = None
    clouds: int = 1
    sampled: int = 1

    @property
    def off(self) -> bool:
        """Whether z is not up in this frame, so that heights in it have no meaning."""
        return self.kind in {"tilted", "upside-down", "optical", "slanted"}

    @property
    def level_from_frame(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw, radians, that turn the frame level, its forward axis ahead.

        Without a ground, an optical frame is rotated as if its camera looked straight ahead.
        """
        forward = np.array([0.0, 0.0, 1.0] if self.kind == "optical" else [1.0, 0.0, 0.0])
        up = np.array(self.up if self.up is not None else (0.0, -1.0, 0.0) if self.kind == "optical" else (0, 0, 1.0))
        ahead = forward - (forward @ up) * up
        ahead /= np.linalg.norm(ahead)
        left = np.cross(up, ahead)
        return (
            math.atan2(up[1], up[2]),
            math.asin(max(-1.0, min(1.0, -float(up[0])))),
            math.atan2(left[0], ahead[0]),
        )

    @property
    def tilt(self) -> float:
        """Angle between up and the z axis, radians; for a frame that is upside down, between up and -z."""
        up = self.up or (0.0, 0.0, 1.0)
        cosine = -up[2] if self.kind == "upside-down" else up[2]
        return math.acos(max(-1.0, min(1.0, cosine)))


def common_ground(looks: Sequence[Ground]) -> Ground:
    """Return how a frame is mounted by several of its clouds: the result of most, if none contradicts it.

    The ground keeps its place while a robot drives; a wall that was mistaken for it does not.
    """
    if not looks:
        return Ground("unknown", clouds=0, sampled=0)
    kinds = {look.kind for look in looks} - {"unknown"}
    if len(kinds) != 1:
        return Ground("unknown", clouds=0, sampled=len(looks))
    (kind,) = kinds
    same = [look for look in looks if look.kind == kind]
    if 2 * len(same) < len(looks):
        return Ground("unknown", clouds=0, sampled=len(looks))
    seen = [look for look in same if look.up is not None]
    ceilings = [look.ceiling for look in same if look.ceiling is not None]
    ceiling = median(ceilings) if 2 * len(ceilings) >= len(same) else None
    if 2 * len(seen) < len(same):
        return Ground(kind, clouds=len(same), sampled=len(looks))
    middle = np.array([median(axis) for axis in zip(*(look.up for look in seen if look.up is not None), strict=True)])
    up = middle / np.linalg.norm(middle)
    heights = [look.height for look in seen if look.height is not None]
    height = median(heights)
    if kind != "level":
        apart = max(math.acos(max(-1.0, min(1.0, float(up @ np.array(look.up))))) for look in seen)
        moved = max(abs(other - height) for other in heights)
        if apart > math.radians(4.0) or moved > max(0.06, 0.2 * height):
            rest: Kind = "optical" if kind == "optical" else "unknown"
            return Ground(rest, clouds=len(same) if kind == "optical" else 0, sampled=len(looks))
    return Ground(kind, (float(up[0]), float(up[1]), float(up[2])), height, ceiling, len(same), len(looks))


def find_ground(points: _Points) -> Ground:
    """Return how the frame of a cloud is mounted, by this cloud alone.

    Parameters
    ----------
    points
        The result of `pc2scan.core.floor.thin_points`, metres.
    """
    if len(points) < FEWEST_POINTS:
        return Ground("unknown")
    if not _is_optical(points):
        return _level_ground(cells_of(points)) or _choose_ground(points)
    turned = points @ _BODY_FROM_OPTICAL.T
    found = _choose_ground(turned, level_needs_proof=True)
    if found.up is None:
        return Ground("optical")
    up = _BODY_FROM_OPTICAL.T @ np.array(found.up)
    return Ground("optical", (float(up[0]), float(up[1]), float(up[2])), found.height, found.ceiling)


def _is_optical(points: _Points) -> bool:
    """Whether all points lie in a cone around the z axis, which is not so for a lidar that turns about it."""
    directions = points / np.linalg.norm(points, axis=1)[:, None]
    middle = directions.mean(axis=0)
    ahead = float(middle[2] / max(float(np.linalg.norm(middle)), 1e-9))
    return bool((directions[:, 2] > 0.5).mean() > 0.995) and ahead > 0.85


def _level_ground(cells: _Points) -> Ground | None:
    """Return the ground if the cloud has an obvious level floor; None otherwise."""
    floor = level_floor(cells)
    if floor is None:
        return None
    return Ground("level", floor.up, floor.height, _ceiling_over(cells, tolerances(cells)))


def _ceiling_over(cells: _Points, tolerance: NDArray[np.float64]) -> float | None:
    """Return the height of the highest level plane, if there are no points above it."""
    (high,) = percentiles(cells[:, 2], 99)
    if high < 0.3:
        return None
    ceiling = _refine(cells, tolerance, np.abs(cells[:, 2] - high) < 2 * tolerance)
    if ceiling is None or ceiling.tilt < math.pi - LEVEL or ceiling.share < _LEAST_SHARE or ceiling.beyond > 0.02:
        return None
    # The uppermost ring of a lidar makes a level line on the walls, too, but with the next ring below it.
    at = np.abs(cells @ np.array(ceiling.up) + ceiling.height) < tolerance
    squares = np.floor(cells[:, :2] / 0.3).astype(np.int64) @ np.array([1, 1 << 20])
    under = ~at & (cells[:, 2] > high - 0.8)
    continued = set(squares[under].tolist())
    share = np.mean([square in continued for square in squares[at].tolist()])
    return ceiling.height if share < 0.4 else None


def planes_of(cells: _Points) -> list[Plane]:
    """Return the planes of a cloud, the largest first."""
    planes: list[Plane] = []
    tolerance = tolerances(cells)
    rest = np.ones(len(cells), bool)
    least = max(_LEAST_SHARE * len(cells), 25)
    while len(planes) < _PLANES and rest.sum() > least:
        start = _largest(cells[rest], tolerance[rest])
        if start is None:
            break
        inliers = np.zeros(len(cells), bool)
        inliers[rest] = start
        found = _refine(cells, tolerance, inliers, rest)
        if found is None or found.share * len(cells) < least:
            break
        planes.append(found)
        rest &= ~(np.abs(cells @ np.array(found.up) + found.height) < tolerance)
    return planes


def _largest(points: _Points, tolerance: NDArray[np.float64]) -> NDArray[np.bool_] | None:
    """Return the points near the plane, of those through three points, that has most points; None if all are lines."""
    corners = points[_triplets(len(points))]
    normals = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    lengths = np.linalg.norm(normals, axis=1)
    good = lengths > 1e-3 * median((points * points).sum(axis=1))
    if not good.any():
        return None
    normals = normals[good] / lengths[good, None]
    offsets = (normals * corners[0][good]).sum(axis=1)
    # One row for each plane, in place: with new arrays, and a column for each, it takes ten times as long.
    distances = normals.astype(np.float32) @ points.T.astype(np.float32)
    distances -= offsets.astype(np.float32)[:, None]
    near = np.abs(distances, out=distances) < tolerance.astype(np.float32)
    return np.asarray(near[int(np.count_nonzero(near, axis=1).argmax())])


def _triplets(count: int) -> NDArray[np.intp]:
    """Return triplets of indices, (3, N): one half from the whole cloud, the other half neighbours in its order."""
    steps = np.arange(1, _TRIPLETS + 1)
    far = np.stack([(steps * ratio % 1.0 * count).astype(np.intp) for ratio in _PLASTIC])
    reach = max(count // 12, 8)
    near = np.stack([far[0], *((far[0] + 1 + far[axis] * reach // count) % count for axis in (1, 2))])
    return np.concatenate([far, near], axis=1)


def _refine(
    cells: _Points,
    tolerance: NDArray[np.float64],
    inliers: NDArray[np.bool_],
    among: NDArray[np.bool_] | None = None,
) -> Plane | None:
    """Return the least-squares plane through the points near it, beginning with these; None for too few points."""
    normal, offset, squared = np.zeros(3), 0.0, tolerance**2
    for _ in range(4):
        if inliers.sum() < 10:
            return None
        members = cells[inliers]
        weights = 1 / squared[inliers]
        middle = weights @ members / weights.sum()
        centred = members - middle
        normal = np.linalg.eigh((centred * weights[:, None]).T @ centred)[1][:, 0]
        offset = float(normal @ middle)
        inliers = np.abs(cells @ normal - offset) < tolerance
        if among is not None:
            inliers &= among
    if inliers.sum() < 10:
        return None
    if offset > 0:
        normal, offset = -normal, -offset
    members = cells[inliers]
    variances = np.linalg.eigvalsh(np.cov(members.T))
    return Plane(
        (float(normal[0]), float(normal[1]), float(normal[2])),
        -offset,
        len(members) / len(cells),
        float((cells @ normal - offset < -2.5 * tolerance).mean()),
        2 * math.sqrt(max(float(variances[1]), 0.0)),
        percentiles(np.linalg.norm(members, axis=1), 10)[0],
    )


class _FieldOfView:
    """The directions that a sensor sees, in cells of about 10 by 5 degrees, and where it had no return.

    A direction is seen if the sensor has a return at that azimuth, and at that elevation in some other.
    """

    _COLUMNS = 36

    def __init__(self, points: _Points) -> None:
        azimuth = np.arctan2(points[:, 1], points[:, 0])
        elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
        low, high = percentiles(elevation, 0.5, 99.5)
        columns, rows = self._COLUMNS, int(min(18, max(1, round(math.degrees(high - low) / 5))))
        row = np.floor((elevation - low) / max(high - low, 1e-9) * rows).astype(np.intp)
        column = np.floor((azimuth + math.pi) / math.tau * columns).astype(np.intp) % columns
        inside = (row >= 0) & (row < rows)
        counts = np.bincount(row[inside] * columns + column[inside], minlength=rows * columns).reshape(rows, columns)
        seen = counts.any(axis=0)
        tilt = (low + (np.arange(rows) + 0.5) * (high - low) / rows)[:, None]
        angle = (np.arange(columns)[seen] + 0.5) * (math.tau / columns) - math.pi
        self._directions = np.stack(
            np.broadcast_arrays(np.cos(tilt) * np.cos(angle), np.cos(tilt) * np.sin(angle), np.sin(tilt)), axis=-1
        ).reshape(-1, 3)
        self._weights = np.broadcast_to(np.cos(tilt), (rows, len(angle))).ravel()
        self._empty = (counts[:, seen] == 0).ravel()

    def missing(self, up: _Direction, low: float, high: float) -> float | None:
        """Return the share of the directions between two elevations (as sines) that have no return."""
        sines = self._directions @ np.array(up)
        chosen = (sines > low) & (sines < high)
        if chosen.sum() < 8:
            return None
        return float((self._empty * self._weights)[chosen].sum() / self._weights[chosen].sum())


def _choose_ground(points: _Points, *, level_needs_proof: bool = False) -> Ground:
    """Return which of a cloud's planes is the ground."""
    planes = planes_of(cells_of(points))
    view = _FieldOfView(points)
    level = [plane for plane in planes if plane.tilt <= LEVEL and plane.beyond < 0.35]
    if level:
        floor = max(level, key=lambda plane: plane.share * (plane.beyond < 0.05))
        if level_needs_proof and _doubt(floor, planes, view, upside_down=False):
            return Ground("unknown")
        return _ground_of("level", floor, planes)
    for plane in planes:
        upside_down = plane.tilt >= math.pi - _STEEPEST
        if (upside_down or plane.tilt <= _STEEPEST) and not _doubt(plane, planes, view, upside_down=upside_down):
            return _ground_of("upside-down" if upside_down else "tilted", plane, planes)
    return Ground("slanted" if _are_slanted(planes) else "unknown")


def floor_at_side(points: _Points) -> Plane | None:
    """Return the plane that is the ground if the sensor lies on its side; None if there is none.

    It may also be a wall beside a level sensor that sees no floor: only a transform can distinguish them.
    """
    planes, view = planes_of(cells_of(points)), _FieldOfView(points)
    steep = (plane for plane in planes if _STEEPEST < plane.tilt < math.pi - _STEEPEST)
    return next((plane for plane in steep if not _doubt(plane, planes, view, upside_down=False)), None)


def _are_slanted(planes: Sequence[Plane]) -> bool:
    """Whether two planes at right angles, such as floor and wall, are neither level nor upright, and none is level."""
    large = [plane for plane in planes if plane.share >= _LARGE and plane.beyond < _MOST_BEYOND]
    tilts = [min(plane.tilt, math.pi - plane.tilt) for plane in large]
    slanted = [plane for plane, tilt in zip(large, tilts, strict=True) if _SLANTED[0] < tilt < _SLANTED[1]]
    return min(tilts, default=0.0) >= 2 * LEVEL and any(
        abs(_angle_between(one, other) - 90) < _RIGHT_ANGLE for one, other in combinations(slanted, 2)
    )


def _ground_of(kind: Kind, floor: Plane, planes: Sequence[Plane]) -> Ground:
    ceiling = _opposite_plane(floor, planes)
    return Ground(kind, floor.up, floor.height, None if ceiling is None else ceiling.height)


def _angle_between(one: Plane, other: Plane) -> float:
    """Return the angle between two planes' normals, degrees."""
    return math.degrees(math.acos(max(-1.0, min(1.0, float(np.dot(one.up, other.up))))))


def _opposite_plane(plane: Plane, planes: Sequence[Plane]) -> Plane | None:
    """Return the ceiling of a floor, or the opposite wall of a wall."""
    return next((other for other in planes if _angle_between(plane, other) > 172 and other.beyond < 0.05), None)


def _doubt(plane: Plane, planes: Sequence[Plane], view: _FieldOfView, *, upside_down: bool) -> str:
    """Return why a plane may be something other than the ground; empty if no other explanation fits."""
    if plane.share < (0.15 if upside_down else 0.08):
        return "it is small"
    if plane.beyond > 0.04:
        return "something is behind it"
    if plane.width < max(0.4, plane.height * (1.6 if plane.height > 1.2 else 0.8)):
        return "it is narrow"
    holes = view.missing(plane.up, -1.0, -0.2)
    if holes is None or holes > 0.12:
        return "directions that would meet the ground have no return, as beside a wall"
    for other in planes:
        between = _angle_between(plane, other)
        nearer = other.nearest < plane.nearest or other.height < 0.9 * plane.height
        if 4 <= between < 20 and nearer and other.share > _LEAST_SHARE and other.beyond < 0.3:
            return "there is ground of another slope nearer by"
        if 70 < between < 110 and other.height < 1.1 * plane.height:
            return "it may be a wall: a plane at right angles to it is as near"
    ceiling = _opposite_plane(plane, planes)
    if ceiling is None:
        sky, horizon = view.missing(plane.up, 0.2, 1.0), view.missing(plane.up, -0.03, 0.1)
        is_open = (sky is None or sky > 0.6) and horizon is not None and horizon > 0.3
        nearest_ceiling = 0.7 if upside_down else 1.2
        return "" if is_open or plane.height < nearest_ceiling else "it may be the ceiling of a closed room"
    if upside_down or ceiling.height < 1.75 * plane.height:
        return "it may be the ceiling"
    return ""
