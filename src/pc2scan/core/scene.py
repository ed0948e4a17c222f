"""What clouds show of the place around a sensor: its floor, what is overhead, and how the cloud's frame is mounted.

Planes are found by RANSAC (Fischler and Bolles, "Random sample consensus", Communications of the ACM 24 (6), 1981), the
largest first, each refined by weighted least squares, its inliers removed before the next. The triplets follow a
low-discrepancy sequence instead of random numbers, so that the same cloud always has the same planes. Points are first
thinned to one per cell, because a spinning lidar measures near objects a hundred times as densely as far ones. A large
level floor, the most frequent case, is found without RANSAC in a millisecond.

A plane alone is no proof of the ground: a wall beside a level lidar looks like the ground under a lidar that lies on
its side, and a ceiling like the ground under one that hangs upside down. So a frame is called tilted or upside down
only if no other explanation fits the points; `_is_doubtful` has the conditions, and if one fails, the kind is
``unknown``. They were tuned on simulated clouds: 16 to 128 rings, scattering lidars and depth cameras, in halls,
offices, corridors, warehouses, garages, streets, fields, woods, yards and on ramps, with and without floor and ceiling,
mounted at any roll and pitch from -90 to 180 degrees. For each, the result is right to within 3 degrees or unknown, and
no level one is called anything else (``tests/core/test_ground.py`` repeats a part).

Two cases cannot be distinguished by a cloud: a low ceiling of a hall whose floor is not visible is the mirror image of
open ground, and a lidar that hangs upside down just below a ceiling is that of a lidar just above the floor. Transforms
can distinguish them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .percentiles import median, percentiles
from .terrain import on_ground

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .points import Points
    from .rigid import Rigid

Kind = Literal["level", "tilted", "upside-down", "optical", "slanted", "unknown"]

_Points: TypeAlias = "NDArray[np.float64]"
_Direction: TypeAlias = tuple[float, float, float]

#: A plane whose normal is this far from the frame's z axis, radians, is as likely a wall as the ground.
_STEEPEST = math.radians(50.0)

#: Planes with this share of a cloud, and at most this share behind them, show how a room is turned. Those that are
#: slanted are this far from z (as cosines); two of them are at right angles within so many degrees.
_LARGE, _MOST_BEYOND = 0.08, 0.3
_SLANTED = (math.cos(math.radians(78.0)), math.cos(math.radians(12.0)))
_RIGHT_ANGLE = 3.0

#: body_from_optical: REP 103's optical frames have x to the right, y down and z forward.
_BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

#: The plastic number to the powers of -1, -2 and -3: the golden ratio's counterpart in three dimensions (Roberts,
#: 2018).
_PLASTIC = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)

#: The most planes of a cloud, the triplets tried for each, and the smallest share of the cloud that is a plane.
_PLANES, _TRIPLETS, _SMALLEST = 8, 250, 0.03

#: How many planes are compared with a cloud at a time.
_TOGETHER = 32

#: Points that are farther below the ground, metres, are not of it; those of a floor are less far below it.
_ROUGHEST, _SMOOTH = 0.3, 0.08

#: The lowest and the highest level plane: the fewest cells on it, the largest share behind it, and the share of its
#: places from where on it is a line on walls. What is overhead is so far above the sensor, metres, and no plane with a
#: larger share of a cloud, because all points of one ring are in one.
_FEWEST_CELLS, _FEW_BEHIND, _GOES_ON = 20, 0.02, 0.4
_OVERHEAD, _ONE_RING = 0.3, 0.9

#: A floor, or a ceiling, is seen from nearer than so many times its distance; another plane may be a ring on walls.
_FARTHEST = 12.0

#: Ground that rises does so by so much, metres a metre.
_LEAST_RISE, _STEEPEST_RISE = 0.03, 0.2
#: Grass is at most so high above the height that matters, metres, which few returns in squares of so many metres are
#: above. What is from so high above the lowest return in one up to so high, metres, stands there.
_GRASS, _SQUARE, _GRASSY, _STANDS, _HANGS = 0.2, 0.5, 0.125, 0.3, 2.0

#: A floor is farther from the sensor than so many times the tolerance: a ring that is tilted a little is none.
_CLEAR = 2.5

#: The floor is as far from a sensor as its transform says that it is high, but for this share. Only a level plane with
#: a larger share of a cloud contradicts that.
NEAR_MOUNT, _LARGE_FLOOR = 0.3, 0.1
#: Floors that differ by less are one, metres.
ONE_FLOOR = 0.05

#: How many clouds of a topic are judged if the first one has no level floor, how many points of each are sampled, and
#: with how many a cloud is not judged.
JUDGED_CLOUDS = 3
MOST_POINTS = 2_000
FEWEST_POINTS = 300

#: A message with fewer points is a part of a turn or of a pattern, and so many of them are one cloud.
WHOLE_POINTS, PARTS = 600, 40

#: A frame with at most this tilt counts as level, radians: roads and yards are not flatter, and robots pitch.
LEVEL = math.radians(5.0)

#: A transform is wrong if it tilts by more than this, radians, a floor that is level without it, up to this share of
#: the tilt. Floors of simulated lidars are off by 0.1 degrees (median), and by 0.4 (95 %). Another plane is the floor
#: if it is nearer to where a transform says, by the last factor, than the one below the sensor.
_LEAST_TILT = math.radians(0.9)
_LEVEL_BESIDE, _NEARER = 0.3, 0.1

#: Points with a larger median distance, metres, are in another unit: lidars do not see as far.
_FARTHEST_MEDIAN = 400.0

#: The golden ratio's inverse.
GOLDEN = 0.6180339887498949

#: A level plane of this share of the cells is the floor, whatever else there is; floors are so far below the sensor,
#: metres, with at most so much of a cloud below them, or such a part of their own share, as beside a road.
_LEAST_SHARE, _LEAST_HEIGHT, _MOST_BELOW, _BESIDE = 0.15, 0.03, 0.05, 0.2


@dataclass(eq=False)
class CloudSample:
    """Some points of a cloud, relative to the sensor along the axes of the frame in which it is judged.

    Attributes
    ----------
    frame_id, stamp_ns
        Of the cloud.
    judged_in
        The frame of its scan.
    points
        The result of `thin_points`, metres.
    transform
        The transform to that frame; None if it is the cloud's own.
    zeros
        How many points of the whole cloud are at the sensor itself.
    lossy
        See `pc2scan.core.points.Points`.
    """

    frame_id: str
    stamp_ns: int
    judged_in: str
    points: _Points
    transform: Rigid | None = None
    zeros: int = 0
    lossy: str = ""

    @classmethod
    def of(cls, cloud: Points) -> CloudSample:
        """Return a sample of a cloud, which is judged in its own frame."""
        x, y, z = cloud.xyz()
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            zeros = int(np.count_nonzero((x == 0) & (y == 0) & (z == 0)))
        return cls(cloud.frame_id, cloud.stamp_ns, cloud.frame_id, thin_points(x, y, z), zeros=zeros, lossy=cloud.lossy)

    @property
    def origin(self) -> tuple[float, float, float]:
        """The position of the sensor in the frame in which it is judged, metres."""
        x, y, z = [0.0, 0.0, 0.0] if self.transform is None else self.transform.translation.tolist()
        return x, y, z

    @property
    def placed(self) -> _Points:
        """The points in the frame in which it is judged."""
        return np.asarray(self.points + self.origin)

    @cached_property
    def ground(self) -> Ground:
        """How the frame in which it is judged is mounted, by this cloud alone."""
        ground = find_ground(self.points)
        return ground if self.transform is None else ground.believed(self.points, self.origin[2])

    @property
    def floor(self) -> Ground | None:
        """The ground, if it is level, and visible."""
        return self.ground if self.ground.kind == "level" and self.ground.height else None

    @cached_property
    def floor_elsewhere(self) -> Ground | None:
        """See `floor_elsewhere`; None without a transform."""
        moved = self.transform
        return None if moved is None else floor_elsewhere(self.points, moved.matrix, self.origin[2], self.ground)


def far_away(points: _Points) -> float:
    """Return the median distance of points so far away that they are in another unit than metres; otherwise 0."""
    distance = median(_distances(points)) if len(points) >= FEWEST_POINTS else 0.0
    return distance if distance > _FARTHEST_MEDIAN else 0.0


def _angle(cosine: float) -> float:
    return math.acos(max(-1.0, min(1.0, float(cosine))))


def gathered(samples: Sequence[CloudSample]) -> list[CloudSample]:
    """Return the first clouds, with messages that are a part of a turn or of a pattern together as one."""
    if not samples or len(samples[0].points) >= WHOLE_POINTS:
        return list(samples)
    points = np.concatenate([sample.points for sample in samples])
    return [replace(samples[0], points=points, zeros=sum(sample.zeros for sample in samples))]


def are_enough(samples: Sequence[CloudSample]) -> bool:
    """Return whether the first clouds show how a sensor is mounted: one with a smooth level floor, or several."""
    if not samples or len(samples[0].points) < WHOLE_POINTS:
        return len(samples) >= PARTS
    floor = samples[0].floor
    return len(samples) >= JUDGED_CLOUDS or (floor is not None and floor.rough <= _SMOOTH)


def thin_points(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> _Points:
    """Return a sample of a cloud's returns, (N, 3), spread over the cloud whatever its order.

    Parameters
    ----------
    x, y, z
        Coordinates, one a point, of any shape; points without a return are removed.
    """
    count = x.size
    # Multiples of the golden ratio never coincide with rings or columns.
    many = count > MOST_POINTS
    order = (np.arange(MOST_POINTS) * GOLDEN % 1.0 * count).astype(np.intp) if many else np.arange(count)
    with np.errstate(all="ignore"):
        # Without a copy of an organised cloud, whose rows may be padded.
        places = np.unravel_index(order, x.shape)
        points = np.stack([np.asarray(part[places], np.float64) for part in (x, y, z)], axis=1)
        # The nearest points are the robot itself, or no returns; the farthest may be in millimetres.
        good = (np.abs(points).max(axis=1, initial=0) < 1e7) & (_distances(points) > 0.05)
    return np.asarray(points[good])


def cells_of(points: _Points) -> _Points:
    """Return one point per cell, sorted by place: a spinning lidar measures near objects a hundred times as densely."""
    # Twenty-one bits for each coordinate: cells are at least 1 cm, and points in metres are within 10 km.
    keys = np.floor(points / min(0.3, max(0.01, 0.05 * median(_distances(points))))).astype(np.int64) + (1 << 20)
    _, first = np.unique(keys[:, 0] << 42 | keys[:, 1] << 21 | keys[:, 2], return_index=True)
    return points[first]


def tolerances(points: _Points) -> NDArray[np.float64]:
    """Return how far from a plane its points may be, metres: noise, roughness, and a part that grows with distance."""
    distances = _distances(points)
    return np.asarray(min(0.05, max(0.01, 0.02 * median(distances))) + 0.008 * distances)


def _distances(points: _Points) -> NDArray[np.float64]:
    """Return how far away points are; NumPy's norm of each takes five times as long."""
    x, y, z = points.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _is_surface(
    cells: _Points, at: NDArray[np.bool_], tolerance: NDArray[np.float64], height: float, side: int
) -> bool:
    """Whether the cells of a level plane are of a floor (``side`` -1) or a ceiling (1), not the edge of walls."""
    if height < _CLEAR * median(tolerance[at]):
        return False
    heights = side * cells[:, 2]
    level = side * median(cells[at, 2])
    inside = ~at & (heights > level - 0.8)
    squares = np.floor(cells[:, :2] / 0.3).astype(np.int64) @ np.array([1, 1 << 20])
    # Not `np.isin`, which imports NumPy's masked arrays, 10 MB.
    filled, count = np.unique(squares[inside], return_counts=True)
    places = np.searchsorted(filled, squares[at])
    if filled.size and (filled[places.clip(max=filled.size - 1)] == squares[at]).mean() > _GOES_ON:
        return False
    # Where few points are beside each other, also on walls, only an edge in their heights shows a surface.
    near = inside & (heights > level - 6 * median(tolerance))
    return bool(at.sum() > 2 * near.sum() or count[count > 1].sum() > 0.5 * inside.sum())


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
        Distance of its nearer cells (fifth percentile) from the sensor, metres.
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
        return _angle(self.up[2])


class Ground(NamedTuple):
    """How a frame is mounted, judged by its clouds.

    Attributes
    ----------
    kind
        ``level``; ``tilted``; ``upside-down``; ``optical`` (z is forward, as in a camera's optical frame); ``slanted``:
        z is not up, but which plane is the ground is not known; ``unknown``: there is not enough evidence.
    up
        The direction of up in the frame, a unit vector; None if so little ground is visible that it is not known.
    height
        Height of the frame's origin above the floor, metres; 0 if no ground is visible.
    ceiling
        From the origin up to the ceiling, metres; None if no ceiling is visible.
    rough
        How far its points are below a level ground, metres (95 %).
    clouds, sampled
        How many clouds agree, and how many were examined.
    """

    kind: Kind
    up: _Direction | None = None
    height: float = 0.0
    ceiling: float | None = None
    rough: float = 0.0
    clouds: int = 1
    sampled: int = 1

    @property
    def off(self) -> bool:
        """Whether z is not up in this frame, so that heights in it have no meaning."""
        return self.kind in {"tilted", "upside-down", "optical", "slanted"}

    @property
    def normal(self) -> _Direction:
        """The direction of up; z if it is not known."""
        return self.up or (0.0, 0.0, 1.0)

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
        pitch = math.pi / 2 - _angle(-up[0])
        return math.atan2(up[1], up[2]), pitch, math.atan2(left[0], ahead[0])

    @property
    def tilt(self) -> float:
        """Angle between up and the z axis, radians; for a frame that is upside down, between up and -z."""
        return _angle(self.normal[2] * (-1 if self.kind == "upside-down" else 1))

    def believed(self, points: _Points, height: float) -> Ground:
        """Return what the points show if the transforms say how high the sensor is, above 0: z points up by them.

        What is not about as far below it is another plane, such as the outer ring on walls, unless it is large and seen
        from near, and few points are as far below as the transforms say.
        """
        near = NEAR_MOUNT * height if self.off else ONE_FLOOR + 0.03 * height
        is_there = abs(self.height - height) < near
        if height <= 0 or is_there or (self.up is None and self.off) or not (self.off or self.height):
            return self
        if self.off:
            return Ground("unknown")
        points = cells_of(points)
        ranges, tolerance, few = _distances(points), tolerances(points), _LARGE_FLOOR * len(points)
        on = np.abs(points @ np.array(self.normal) + self.height) < tolerance
        at = np.abs(points[:, 2] + height) < tolerance
        # What is also seen where the transforms say is the floor that the robot stands on.
        is_floor = on.sum() > few >= at.sum() and percentiles(ranges[on], 10)[0] < _FARTHEST * self.height
        if self.height > height and on.sum() > _MOST_BELOW * len(points):
            # Nothing is seen through a floor, which is nearer than what is below it.
            is_seen = at.any() and (at.sum() > few or _is_surface(points, at, tolerance, height, -1))
            is_floor = not is_seen or percentiles(ranges[on], 10)[0] < percentiles(ranges[at], 10)[0]
        # A plane that is below that at the sensor, and visible only above it, or the other way round, is a slope.
        is_floor = is_floor and (median(points[on, 2]) + height) * (height - self.height) > 0
        return self if is_floor else self._replace(up=None, height=0.0, rough=0.0)


def common_ground(looks: Sequence[Ground]) -> Ground:
    """Return how a frame is mounted by several of its clouds: the result of most, if none contradicts it.

    The ground keeps its place while a robot drives; a wall that was mistaken for it does not.
    """
    kind: Kind = min({look.kind for look in looks} - {"unknown"}, default="unknown")
    same = [look for look in looks if look.kind == kind]
    ceilings = [look.ceiling for look in looks if look.ceiling is not None]
    ceiling = median(ceilings) if ceilings and 2 * len(ceilings) >= len(same) else None
    unknown = Ground("unknown", ceiling=ceiling, clouds=0, sampled=len(looks))
    contradict = any(look.kind not in {kind, "unknown"} for look in looks)
    if kind == "unknown" or contradict or 2 * len(same) < len(looks):
        return unknown
    seen = [look for look in same if look.height]
    if 2 * len(seen) < len(same):
        return Ground(kind, clouds=len(same), sampled=len(looks))
    middle = np.array([median(axis) for axis in zip(*(look.normal for look in seen), strict=True)])
    up = middle / np.linalg.norm(middle)
    height = median([look.height for look in seen])
    if kind != "level":
        apart = max(_angle(up @ np.array(look.normal)) for look in seen)
        moved = max(abs(look.height - height) for look in seen)
        if apart > math.radians(4.0) or moved > max(0.06, 0.2 * height):
            return Ground("optical", clouds=len(same), sampled=len(looks)) if kind == "optical" else unknown
    normal = (float(up[0]), float(up[1]), float(up[2]))
    return Ground(kind, normal, height, ceiling, min(look.rough for look in seen), len(same), len(looks))


def find_ground(points: _Points) -> Ground:
    """Return how the frame of a cloud is mounted, by this cloud alone.

    Parameters
    ----------
    points
        The result of `pc2scan.core.scene.thin_points`, metres.
    """
    if len(points) < FEWEST_POINTS:
        return Ground("unknown")
    # The points of an optical frame lie in a cone around the z axis, which is not so for a lidar that turns about it.
    directions = points / _distances(points)[:, None]
    middle = directions.mean(axis=0)
    ahead = float(middle[2] / max(float(np.linalg.norm(middle)), 1e-9))
    if (directions[:, 2] > 0.5).mean() <= 0.995 or ahead <= 0.85:
        cells = cells_of(points)
        low, ground = outermost(cells, -1), Ground("unknown")
        # Parts of a ramp and of the floor before it are a plane with much just below it.
        if low is None or low.share < _LEAST_SHARE or _roughness(cells, low.up, low.height) > _SMOOTH:
            ground = _choose_ground(points)
        if not ground.off:
            if not ground.height and low is not None:
                ground = Ground("level", low.up if low.share >= _LEAST_SHARE else None, low.height)
            high = outermost(cells, 1)
            ground = ground._replace(ceiling=None if high is None else high.height)
        if ground.height:
            ground = ground._replace(rough=_roughness(cells, ground.normal, ground.height))
        return ground
    turned = points @ _BODY_FROM_OPTICAL.T
    ground = _choose_ground(turned, level_needs_proof=True)
    if ground.up is None or ground.kind == "slanted":
        return Ground("optical")
    up = _BODY_FROM_OPTICAL.T @ np.array(ground.up)
    return Ground("optical", (float(up[0]), float(up[1]), float(up[2])), ground.height, ground.ceiling)


def _roughness(cells: _Points, up: _Direction, height: float) -> float:
    """Return how far the ground's points are below it, metres (95 %)."""
    off = cells @ np.array(up) + height
    below = -off[(off < 0) & (off > -_ROUGHEST)]
    return percentiles(below, 95)[0] if len(below) else 0.0


def outermost(cells: _Points, side: int) -> Plane | None:
    """Return the lowest level plane (``side`` -1), or the highest (1); None if nothing level is so far out.

    Nearly nothing is behind it, and it does not go on: the outer ring of a lidar makes a level line on the walls, too,
    but with the next ring beside it.
    """
    tolerance = tolerances(cells)
    heights = side * cells[:, 2]
    order = np.sort(heights)[::-1]
    width = 3 * median(tolerance)
    place = 0
    while place < _FEW_BEHIND * len(order) and order[place] > _LEAST_HEIGHT:
        near = np.abs(heights - order[place] + width / 2) <= width / 2
        place = int(np.searchsorted(-order, width / 2 - order[place], "right"))
        plane = _refine(cells, tolerance, near) if near.sum() >= _FEWEST_CELLS else None
        if plane is None or plane.beyond > _FEW_BEHIND or plane.height < (_LEAST_HEIGHT if side < 0 else _OVERHEAD):
            continue
        far = plane.nearest > _FARTHEST * plane.height
        if -side * plane.up[2] < math.cos(LEVEL) or (side > 0 and (far or plane.share > _ONE_RING)):
            continue
        at = np.abs(cells @ np.array(plane.up) + plane.height) < tolerance
        if _is_surface(cells, at, tolerance, plane.height, side):
            if plane.share >= _LEAST_SHARE:
                return plane
            # A small one says little of its tilt, so its height is that of its own place.
            return plane._replace(up=(0.0, 0.0, float(-side)), height=side * median(cells[at, 2]))
    return None


def are_ground(points: _Points, low: float, sensor: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points are on ground that rises above ``low``, or on grass, nearly all of which is below.

    Parameters
    ----------
    points
        Finite ones of a cloud, (N, 3), in a frame whose z axis points up.
    low
        The lower limit of scans.
    sensor
        The position of the sensor.
    """
    z, followed = points[:, 2], on_ground(*points.T)
    is_above = z > low
    places = np.unique(np.floor(points[:, :2] / _SQUARE).astype(np.int64) @ (1, 1 << 20), return_inverse=True)[1]
    is_grass = (np.bincount(places, is_above) <= _GRASSY * np.bincount(places))[places]
    is_grass &= z < min(low + _GRASS, (low + sensor[2]) / 2)
    # The foot of what stands is no ground; the filter may take it for that.
    lowest = np.full(places.max(initial=0) + 1, np.inf)
    np.minimum.at(lowest, places, z)
    over = z - lowest[places]
    stands = np.bincount(places, (over > _STANDS) & (over < _HANGS)) > 0
    ground = is_above & followed & ~stands[places]
    # Few rings see nothing of the floor before a slope, so none is followed: it rises from below the robot's frame.
    known = ground if followed.any() else is_above
    for plane in planes_of(cells_of(points[known])) if known.any() else ():
        off, near = points @ plane.up + plane.height, tolerances(points)
        if sensor[2] > low and plane.share > _ONE_RING and abs(sensor @ plane.up + plane.height) < near.min():
            # All points of one ring are in a plane through the sensor, wherever they are.
            return is_above & is_grass
        rises = plane.up[2] > 0 and _LEAST_RISE < math.tan(plane.tilt) < _STEEPEST_RISE
        # It goes on where it is not followed, if it hides what is below: beside a ramp, the floor is visible.
        if rises and ((off < -near) & (z - off > low)).sum() < _FEW_BEHIND * known.sum():
            ground |= is_above & (np.abs(off) < near)
    return np.asarray(ground | (is_above & is_grass))


def have_moved(ranges: NDArray[np.float64], off: float) -> bool:
    """Return whether most beams of the last of some scans, (scans, N), end elsewhere than those of the first ones.

    ``off`` is by how much another place is nearer or farther away, metres.
    """
    first, *_, last = (part.min(axis=0) for part in np.array_split(ranges, 3) if len(part))
    both = np.isfinite(first) & np.isfinite(last)
    return bool(both.any()) and median(np.abs(first[both] - last[both])) > off


def sectors_of(points: _Points, wide: float) -> NDArray[np.intp]:
    """Return the number of each point's direction, which is so many degrees wide."""
    turns = np.arctan2(points[:, 1], points[:, 0]) / math.tau + 0.5
    return (turns * math.ceil(360 / wide)).astype(np.intp) % math.ceil(360 / wide)


def planes_of(cells: _Points) -> list[Plane]:
    """Return the planes of a cloud, the largest first."""
    planes: list[Plane] = []
    tolerance = tolerances(cells)
    rest = np.ones(len(cells), bool)
    least = max(_SMALLEST * len(cells), 25)
    while len(planes) < _PLANES and rest.sum() > least:
        start = _largest(cells[rest], tolerance[rest])
        if start is None:
            break
        inliers = np.zeros(len(cells), bool)
        inliers[rest] = start
        plane = _refine(cells, tolerance, inliers, rest)
        if plane is None or plane.share * len(cells) < least:
            break
        planes.append(plane)
        rest &= ~(np.abs(cells @ np.array(plane.up) + plane.height) < tolerance)
    return planes


def _largest(points: _Points, tolerance: NDArray[np.float64]) -> NDArray[np.bool_] | None:
    """Return the points near the plane, of those through three points, that has most points; None if all are lines."""
    corners = points[_triplets(len(points))]
    normals = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    lengths = _distances(normals)
    good = lengths > 1e-3 * median(_distances(points)) ** 2
    if not good.any():
        return None
    normals = normals[good] / lengths[good, None]
    offsets = (normals * corners[0][good]).sum(axis=1).astype(np.float32)[:, None]
    normals, columns, close = normals.astype(np.float32), points.T.astype(np.float32), tolerance.astype(np.float32)

    def near(first: int, count: int) -> NDArray[np.bool_]:
        # One row for each plane, in place: with new arrays, and a column for each, it takes ten times as long.
        distances = normals[first : first + count] @ columns
        distances -= offsets[first : first + count]
        return np.asarray(np.abs(distances, out=distances) < close)

    # Some planes at a time: all of them take 20 MB.
    counts = [np.count_nonzero(near(first, _TOGETHER), axis=1) for first in range(0, len(normals), _TOGETHER)]
    return np.asarray(near(int(np.concatenate(counts).argmax()), 1)[0])


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
        percentiles(_distances(members), 5)[0],
    )


def _missing(points: _Points, up: _Direction, low: float, high: float) -> float:
    """Return the share of the directions between two elevations (as sines) without a return; NaN of too few.

    They are cells of about 10 by 5 degrees. The sensor sees those where it has a return at that azimuth, and at that
    elevation in some other.
    """
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    lowest, highest = percentiles(elevation, 0.5, 99.5)
    columns, rows = 36, int(min(18, max(1, round(math.degrees(highest - lowest) / 5))))
    row = np.floor((elevation - lowest) / max(highest - lowest, 1e-9) * rows).astype(np.intp)
    column = np.floor((azimuth + math.pi) / math.tau * columns).astype(np.intp) % columns
    inside = (row >= 0) & (row < rows)
    counts = np.bincount(row[inside] * columns + column[inside], minlength=rows * columns).reshape(rows, columns)
    seen = counts.any(axis=0)
    tilt = (lowest + (np.arange(rows) + 0.5) * (highest - lowest) / rows)[:, None]
    angle = (np.arange(columns)[seen] + 0.5) * (math.tau / columns) - math.pi
    sines = np.cos(tilt) * (np.cos(angle) * up[0] + np.sin(angle) * up[1]) + np.sin(tilt) * up[2]
    chosen = (sines > low) & (sines < high)
    weights = np.where(chosen, np.cos(tilt), 0.0)
    return float(weights[counts[:, seen] == 0].sum() / weights.sum()) if chosen.sum() >= 8 else math.nan


def _choose_ground(points: _Points, *, level_needs_proof: bool = False) -> Ground:
    """Return which of a cloud's planes is the ground."""
    cells = cells_of(points)
    planes = planes_of(cells)
    least = _CLEAR * float(tolerances(cells).min())
    level = [
        plane
        for plane in planes
        if plane.tilt <= LEVEL
        and plane.height > max(least, plane.nearest / _FARTHEST)
        and plane.beyond < (0.35 if plane.height > 0.3 else 0.05)
    ]
    if level:
        lowest = [plane for plane in level if plane.beyond < max(_MOST_BELOW, _BESIDE * plane.share)]
        floor = max(lowest or level, key=lambda plane: plane.share)
        if level_needs_proof and _is_doubtful(floor, planes, points, upside_down=False):
            return Ground("unknown")
        # Something level with much behind it shows how the frame is mounted, but is no floor.
        return _ground_of("level", floor, planes) if lowest else Ground("level")
    for plane in planes:
        over = plane.tilt >= math.pi - _STEEPEST
        if (over or plane.tilt <= _STEEPEST) and not _is_doubtful(plane, planes, points, upside_down=over):
            return _ground_of("upside-down" if over else "tilted", plane, planes)
    return _slanted(planes)


def floor_elsewhere(points: _Points, matrix: NDArray[np.float64], height: float, seen: Ground) -> Ground | None:
    """Return the ground if the transform of a sensor turns it wrongly; None if nothing says so.

    The floor is level in the sensor's own frame, and the transform tilts it. Or it is not as far away as the transform
    says, and another plane is: below the sensor or above it in its own frame, or anywhere, if it is large. Of several,
    the transform is least wrong by the floor. What is at the side may also be a wall beside a level sensor.

    Parameters
    ----------
    points, matrix
        In the axes of the frame to which the transform goes; and its rotation.
    height, seen
        How high it says that the sensor is, metres; and the ground in this frame.
    """
    turned, off = _angle(matrix[2, 2]), abs(seen.height - height)
    is_missed = height > ONE_FLOOR and (seen.off or off > ONE_FLOOR + 0.03 * height)
    near = max(0.01 + 0.03 * height, _NEARER * off if seen.height else 0.0)
    floors: list[Ground] = []
    ways = (matrix, matrix * (1.0, -1.0, -1.0)) if is_missed else (matrix,) if turned > _LEAST_TILT else ()
    for way in ways:
        own = find_ground(points @ way)
        if own.kind != "level" or not own.height:
            continue
        x, y, z = (way @ np.array(own.normal)).tolist()
        floor = Ground("tilted", (x, y, z), own.height)
        is_level = seen.up is not None and not seen.off and seen.tilt < _LEVEL_BESIDE * turned
        is_tilted = way is matrix and _LEAST_TILT < turned < math.pi - _LEAST_TILT and not is_level
        # What is also much nearer, or farther away, than the transform says is another plane.
        is_tilted &= height <= ONE_FLOOR or abs(own.height - height) < NEAR_MOUNT * max(1.0, own.height)
        is_tilted &= own.up is not None and max(own.tilt, abs(floor.tilt - turned)) < _LEVEL_BESIDE * turned
        if is_tilted or (is_missed and floor.tilt > LEVEL and abs(own.height - height) < near):
            floors.append(floor)
    if is_missed and len(points) >= FEWEST_POINTS:
        planes = planes_of(cells_of(points))
        for plane in planes:
            is_large = plane.tilt > LEVEL and plane.share > _LARGE and plane.beyond < _FEW_BEHIND
            if is_large and abs(plane.height - height) < near:
                is_steep = _STEEPEST < plane.tilt < math.pi - _STEEPEST
                if not (is_steep and _is_doubtful(plane, planes, points, upside_down=False)):
                    floors.append(Ground("tilted", plane.up, plane.height))
    if not floors:
        return None
    floor = min(floors, key=lambda floor: floor.tilt)
    on_it = np.abs(points @ np.array(floor.normal) + floor.height) < tolerances(points)
    there = np.abs(points[:, 2] + height) < tolerances(points)
    # What is seen where the transform says is the floor, and what is only seen from afar may be a ring on walls.
    is_near = on_it.any() and percentiles(_distances(points[on_it]), 10)[0] < _FARTHEST * floor.height
    return floor if is_near and there.sum() <= max(_LARGE_FLOOR * len(points), on_it.sum()) else None


def _slanted(planes: Sequence[Plane]) -> Ground:
    """Return the ground if no plane is level, and two, such as floor and wall, are at right angles and not upright.

    The one that is nearest to level is probably the floor.
    """
    large = [plane for plane in planes if plane.share >= _LARGE and plane.beyond < _MOST_BEYOND]
    leaning = [plane for plane in large if _SLANTED[0] < abs(plane.up[2]) < _SLANTED[1]]
    pairs = [pair for pair in combinations(leaning, 2) if abs(_angle_between(*pair) - 90) < _RIGHT_ANGLE]
    if not pairs or any(abs(plane.up[2]) > math.cos(2 * LEVEL) for plane in large):
        return Ground("unknown")
    floor = min((plane for pair in pairs for plane in pair), key=lambda plane: plane.tilt)
    is_likely = floor.tilt < _STEEPEST and floor.beyond < _MOST_BELOW
    return _ground_of("slanted", floor, planes) if is_likely else Ground("slanted")


def _ground_of(kind: Kind, floor: Plane, planes: Sequence[Plane]) -> Ground:
    ceiling = _opposite_plane(floor, planes)
    return Ground(kind, floor.up, floor.height, None if ceiling is None else ceiling.height)


def _angle_between(one: Plane, other: Plane) -> float:
    """Return the angle between two planes' normals, degrees."""
    return math.degrees(_angle(np.dot(one.up, other.up)))


def _opposite_plane(plane: Plane, planes: Sequence[Plane]) -> Plane | None:
    """Return the ceiling of a floor, or the opposite wall of a wall."""
    return next((other for other in planes if _angle_between(plane, other) > 172 and other.beyond < 0.05), None)


def _is_doubtful(plane: Plane, planes: Sequence[Plane], points: _Points, *, upside_down: bool) -> bool:
    """Return whether a plane may be something other than the ground: whether another explanation fits."""
    # It is small or narrow, or directions that would meet the ground have no return, as beside a wall.
    if plane.share < (0.15 if upside_down else 0.08) or plane.width < max(0.4, plane.height) or plane.beyond > 0.04:
        return True
    if not _missing(points, plane.up, -1.0, -0.2) <= 0.12:
        return True
    for other in planes:
        between = _angle_between(plane, other)
        nearer = other.nearest < plane.nearest or other.height < 0.9 * plane.height
        # There is ground of another slope nearer by; or a plane at right angles to it is as near, and it may be a wall.
        sloped = 4 <= between < 20 and nearer and other.share > _SMALLEST and other.beyond < 0.3
        if sloped or (70 < between < 110 and other.height < 1.1 * plane.height):
            return True
    # It may be the ceiling.
    if (ceiling := _opposite_plane(plane, planes)) is not None:
        return upside_down or ceiling.height < 1.75 * plane.height
    return not _missing(points, plane.up, -0.03, 0.1) > 0.3 and plane.height >= (0.7 if upside_down else 1.2)
