"""What is known of a topic with clouds that a command depends on: its turns, its pattern, its motion and its mount.

A command that is proposed is tried on the clouds that were read: what is said of it, and what its scans see.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import pairwise, product
from operator import itemgetter, or_
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.advice.checks import judge, request_warnings
from pc2scan.advice.checks.first_clouds import CloudFacts, KnownTransforms
from pc2scan.advice.measurements import SHAPES, Measurements, regular_step, time_warnings, times_of
from pc2scan.advice.odometry import floor_tilt
from pc2scan.advice.survey import ABOVE_ROBOT, Fact
from pc2scan.conversion.deskew import Deskew
from pc2scan.conversion.report import StampCounts
from pc2scan.conversion.steps import CloudToScan, PlaceStep
from pc2scan.core.percentiles import median, median_low, percentiles
from pc2scan.core.points import TIME, Points
from pc2scan.core.rigid import Rigid
from pc2scan.core.scene import are_ground, have_moved, sectors_of, thin_points
from pc2scan.core.timing import median_interval_ns
from pc2scan.errors import DecodeError, Pc2ScanError, TransformError
from pc2scan.options.call import Options
from pc2scan.parsing import conversion_of
from pc2scan.request.filters import Frame
from pc2scan.request.point_time import DIRECTIONS, PointTime, directions_of
from pc2scan.transforms.frames import BODIES, WORLDS
from pc2scan.transforms.motion import sensor_motion
from pc2scan.transforms.placing import Placer, UpByFrame, UpByImu
from pc2scan.transforms.static import StaticTransform

from .topic_content import seconds_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.advice.clocks import Clock
    from pc2scan.advice.survey import TopicFacts
    from pc2scan.conversion.steps import PlacedCloud
    from pc2scan.core.rule import PointCounts
    from pc2scan.core.scene import CloudSample
    from pc2scan.model import Connection, RawMessage, Summary
    from pc2scan.request.spec import ScanSpec
    from pc2scan.transforms.attitude import UpEstimate
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.motion import SensorMotion
    from pc2scan.transforms.mounting import Mounting


#: All transforms of so much time at both edges of a recording are known, nanoseconds.
EDGE_NS = 1_000_000_000

#: How many clouds of a topic are looked at, how many at most of those in the recording's last second, how many for the
#: shape of their rings, and how many at most, and with so many points in all, of a pattern that is sparse.
HEADERS = 21
_LAST_HEADERS = 4_000
_SHAPES = 3
_MOST_CLOUDS = 100
_SPARSE = 60_000

#: How many clouds of a topic are tried, how many points of each are examined, what is just above the ground, metres,
#: and every how many points are counted there.
_CLOUDS = 3
POINTS = 30_000
_JUST_ABOVE, _SOME = 0.2, 10

#: Clouds are packets if one has less than this share of the directions that several have: so many at least.
_PART = 0.6
_SEVERAL = 3
#: The step between neighbouring directions of clouds, radians.
_STEP = math.tau / DIRECTIONS

#: No lidar takes longer for a turn, seconds.
_LONGEST_TURN = 1.5

#: Clouds are enough for a scan if this share of the beams that the next ones fill have a return, of so many at least;
#: at most those of so many seconds become one, and more than so many only if no wider beams do.
_ENOUGH, _FEWEST_BEAMS = 0.9, 20
_LONGEST, _USUAL = 1.0, 10
#: The widths of beams of a pattern, the first of which is the default, and of directions that it sees, degrees.
_WIDTHS, _SEEN = (1, 2, 3, 4, 5), 10
#: So many points show the rows, or the columns, of a camera, which have so many points.
_PIXELS, _A_ROW = 2_000, 4


def ask_facts(facts: TopicFacts, end_ns: int) -> None:
    """Ask for the facts about a topic that a command depends on, given the log time of the recording's last message."""
    for fact in (_DIRECTIONS, _PATTERN, _TIMES, _SHAPE):
        facts.ask(fact)
    facts.ask_last_headers(end_ns - EDGE_NS, _LAST_HEADERS)


def stamp_faults(facts: TopicFacts) -> list[str]:
    """Return what is wrong with the stamps of the first messages of a topic, and what to do."""
    stamps = StampCounts()
    for header in facts.headers:
        stamps.add(header.stamp_ns, header.log_time_ns)
    return stamps.texts(facts.topic)


def _sparse_points(points: Points, _: RawMessage) -> NDArray[np.float32]:
    """Return copies of the returns of a small cloud, (4, N), with their times; none of a large one, or of a camera."""
    xyz = points.xyz()
    if xyz[0].size > POINTS or xyz[0].ndim > 1:
        return np.empty((4, 0), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        columns = np.stack([np.ravel(axis).astype(np.float32) for axis in (*xyz, seconds_of(points))])
    return _returns(columns)


def _returns(xyz: NDArray[Any]) -> NDArray[Any]:
    """Return those of a cloud's points, (3, N) or with times, that are finite, and not at the sensor."""
    return xyz[:, np.isfinite(xyz[:3]).all(axis=0) & xyz[:3].any(axis=0)]


def _are_many(clouds: Sequence[NDArray[np.float32]]) -> bool:
    """Whether no more clouds are needed: those of sparse patterns have few points."""
    return len(clouds) >= HEADERS and not 0 < sum(map(np.size, clouds)) <= 3 * _SPARSE


def _are_whole(masks: Sequence[int]) -> bool:
    """Whether the first clouds are no packets, whatever directions further ones have."""
    return len(masks) >= _SEVERAL and all(mask.bit_count() >= _PART * DIRECTIONS for mask in masks[:_SEVERAL])


_DIRECTIONS = Fact(lambda points, _: directions_of(points), HEADERS, are_enough=_are_whole)
_PATTERN = Fact(_sparse_points, _MOST_CLOUDS, are_enough=_are_many)
_TIMES = times_of(PointTime())
_SHAPE = replace(SHAPES, most=_SHAPES)


@dataclass(eq=False)
class Lidar:
    """What is known of a topic with clouds.

    Attributes
    ----------
    facts
        The facts that the survey has found.
    mounting
        How it is mounted, and which heights suit it.
    buffer
        The transforms; None if there are none.
    clouds
        Stamps and points, each (4, N) with their times, or (3, N), of clouds that are spread over the recording, in the
        frame in which they were judged; registered ones in their own.
    has_zeros
        Whether points at (0, 0, 0) stand for no return.
    recorded, connections
        The recording's extent, and its connections.
    known_ns
        All transforms are known up to the first of these log times, and from the second one on.
    clock
        What is wrong with its clock; None if nothing is.
    ups
        The direction of up by each IMU that shows it.
    assumed
        The `static_tf` that connects it with the robot, if no transform does: above the robot's frame, looking ahead.
    scene
        What commands are tried on, once one is.
    """

    facts: TopicFacts
    mounting: Mounting
    buffer: TransformBuffer | None
    clouds: Sequence[tuple[int, NDArray[np.floating[Any]]]]
    has_zeros: bool
    recorded: Summary
    connections: Sequence[Connection]
    known_ns: tuple[int, int]
    clock: Clock | None
    ups: Mapping[str, UpEstimate]
    assumed: str = ""
    scene: Scene | None = None

    @property
    def topic(self) -> str:
        """Its topic."""
        return self.facts.topic

    @property
    def target(self) -> str:
        """The frame of its scans; empty for its own."""
        own = self.mounting
        return own.target_frame or (own.judged_in if own.judged_in != own.frame else "")

    @property
    def is_registered(self) -> bool:
        """Whether its clouds are in a frame that does not move with the robot: their points are placed already."""
        return bool(self.target) and self.mounting.frame.removeprefix("/") in WORLDS

    @property
    def moving_frame(self) -> str:
        """A frame that moves with the sensor."""
        return self.target if self.is_registered else self.mounting.frame

    @cached_property
    def period(self) -> float:
        """The time from cloud to cloud, seconds; 0 if it is not known."""
        return (median_interval_ns(header.stamp_ns for header in self.facts.headers) or 0) / 1e9

    @cached_property
    def duration(self) -> float:
        """The time that the points of a cloud take by their own times, seconds; 0 without plausible ones."""
        times = self.facts.values(_TIMES)
        is_unknown = not times or self.is_registered or any(time_warnings(self.facts, PointTime()))
        return 0.0 if is_unknown else median([timing.high - timing.low for timing in times])

    @property
    def middle_ns(self) -> int:
        """The middle of the times of a cloud's points after its stamp, nanoseconds; 0 without plausible times."""
        times = self.facts.values(_TIMES) if self.duration else []
        return round(median([(timing.low + timing.high) / 2 for timing in times]) * 1e9) if times else 0

    @property
    def time_field(self) -> str:
        """The field with the times of points, plausible or not; empty without any."""
        return next((timing.field for timing in self.facts.values(_TIMES)), "")

    @cached_property
    def step(self) -> float:
        """How finely a turning lidar samples azimuth, radians; 0 for others."""
        shapes = self.facts.values(_SHAPE)
        turns = any(shape.sweep is not None for shape in shapes) or self.covered > 0.5
        return (regular_step(shapes) if turns else None) or 0.0

    @cached_property
    def covered(self) -> float:
        """The share of all directions that a cloud has."""
        masks = self.facts.values(_DIRECTIONS)
        return median([mask.bit_count() / DIRECTIONS for mask in masks]) if masks else 0.0

    @cached_property
    def turn(self) -> float:
        """The time of a turn, seconds, of clouds that are parts of one; 0 if they are not, or it is not regular."""
        masks = self.facts.values(_DIRECTIONS)
        if len(masks) < _SEVERAL or self.covered >= _PART * reduce(or_, masks).bit_count() / DIRECTIONS:
            return 0.0
        packets = zip(masks, (header.stamp_ns for header in self.facts.headers), strict=False)
        # Packets without returns may be missing between two; few directions do not show the middle of one.
        whole = [(_middle(mask), at_ns) for mask, at_ns in packets if 2 * mask.bit_count() >= self.covered * DIRECTIONS]
        steps, waits_ns = np.diff(whole, axis=0).T
        steps = np.remainder(steps[waits_ns <= 1.5 * median(waits_ns)] + math.pi, math.tau) - math.pi
        # Directions are known by sectors, so single steps are off by one.
        step = float(steps[np.abs(steps - median_low(steps)) < 1.5 * _STEP].mean())
        # Packets follow each other; a pattern jumps.
        if not abs(step) > _STEP / 4 or (np.abs(steps - step) < max(0.5 * abs(step), _STEP)).mean() < _ENOUGH:
            return 0.0
        turn = round(math.tau / abs(step)) * self.period
        # Directions that go round more slowly are those of a robot that turns.
        return turn if turn < _LONGEST_TURN else 0.0

    @property
    def world(self) -> str:
        """The frame that does not move with the robot; empty if there is none."""
        return next((name for name in WORLDS if self.transform(name, self.mounting.frame) is not None), "")

    def transform(self, target: str, source: str, stamp_ns: int = 0) -> Rigid | None:
        """Return a recorded transform, by default the latest; None if there is none."""
        return None if self.buffer is None else self.buffer.known(target, source, stamp_ns)

    def motion(self, seconds: float) -> SensorMotion | None:
        """Return how it moves within some time; None if it stands still, or no transforms say how it moves."""
        return None if self.buffer is None else sensor_motion(self.buffer, self.moving_frame, seconds)

    @cached_property
    def parts(self) -> Sequence[NDArray[np.float32]]:
        """The first clouds, each (4, N) in its own frame, if they are parts of a turn or of a pattern; else empty."""
        recorded = [] if self.step and not self.turn else self.facts.values(_PATTERN)
        return recorded if self.turn or (recorded and not _are_of_camera(recorded[:_SEVERAL])) else []

    @cached_property
    def pattern(self) -> tuple[int, int]:
        """How many clouds of a sparse pattern fill a scan, and how many degrees wide its beams are; 1: as usual.

        Most beams that as many further clouds fill have a return.
        """
        heights, own, back = self.mounting.heights, self.mounting.frame, Rigid.identity()
        if self.turn or not self.period or heights is None:
            return 1, 1
        views: list[NDArray[np.bool_]] = []
        for number, xyz in enumerate(self.parts):
            stamp_ns = self.facts.headers[0].stamp_ns + round(number * self.period * 1e9)
            place = self.transform(self.world, self.target or own, stamp_ns) if self.world else back
            if place is not None:
                # All are seen from the place of the first one.
                back = back if views else place.inverse()
                points = self.in_target(xyz, own, stamp_ns)
                inside = (points[:, 2] >= heights.low) & (points[:, 2] <= heights.high)
                views.append(_view(back.compose(place).apply(points), inside))
        best, most = (0.0, (1, 1)), min(len(views) // 2, round(_LONGEST / self.period))
        sizes, usual = product(_WIDTHS, range(1, most + 1)), _USUAL if self.world else 0
        # If it is not known how the robot moves, wider beams are better than more clouds.
        for width, count in sorted(sizes, key=lambda size: size[1] if size[1] > usual else 0):
            best = max(best, (_refilled(views, count, width), (count, width)), key=itemgetter(0))
            if best[0] >= _ENOUGH:
                break
        return best[1]

    @cached_property
    def floor_tilt(self) -> float | None:
        """How far the floor that clouds show tilts in the frame of the scans, radians; None if too few show it."""
        few = (self.in_target(thin_points(*xyz[:3]).T, stamp_ns=at_ns) - self.sensor for at_ns, xyz in self.clouds[::2])
        return None if self.turn else floor_tilt(few)

    @property
    def placed(self) -> Iterator[tuple[Rigid | None, NDArray[np.float64]]]:
        """The transform from the frame of the scans to one that does not move, and the points of the spread clouds."""
        for stamp_ns, points in self.clouds:
            place = self.transform(self.world, self.target or self.mounting.frame, stamp_ns)
            yield place, self.in_target(points, stamp_ns=stamp_ns)

    @property
    def sensor(self) -> NDArray[np.float64]:
        """The position of the sensor in the frame of the scans, or of the robot if clouds are registered."""
        return np.asarray(self.in_target(np.zeros((3, 1)), self.moving_frame)[0])

    @property
    def merges(self) -> bool:
        """Whether several clouds become one scan."""
        return bool(self.turn or self.pattern[0] > 1)

    @cached_property
    def telling(self) -> Sequence[tuple[int, NDArray[np.floating[Any]]]]:
        """Those of `clouds` with most points that stand, and just above the ground, which a robot that pitches sees."""
        if self.mounting.heights is None or len(self.clouds) <= _CLOUDS:
            return self.clouds
        low, high = self.mounting.heights.low, self.mounting.heights.high
        limits = (low, min(low + _JUST_ABOVE, high), high)
        few = (self.in_target(xyz[:, ::_SOME], stamp_ns=at_ns)[:, 2] for at_ns, xyz in self.clouds)
        lowest, highest = np.argsort([-np.histogram(z, limits)[0] for z in few], axis=0, kind="stable").T.tolist()
        return [self.clouds[number] for number in dict.fromkeys((highest[0], *lowest))][:_CLOUDS]

    def tried_clouds(self, *, is_placed: bool, is_levelled: bool) -> list[Points]:
        """Return clouds to try a command on, with stamps of their middles: the first ones if they are parts.

        They are in the frame of the scans if they are to be placed, and otherwise in their own. If they are made level
        then, their heights do not tell yet where the ground is.
        """
        stamped, most, own = self.clouds if is_levelled else self.telling, _CLOUDS, self.mounting
        frame = own.frame if self.parts or self.is_registered else own.judged_in
        if self.parts:
            stamped = list(zip((header.stamp_ns for header in self.facts.headers), self.parts, strict=False))
            most = len(stamped) if self.merges else max(_CLOUDS, _CLOUDS * POINTS // (self.parts[0].shape[1] + 1))
        clouds, motion = [], self.motion(self.duration) if self.duration else None
        for stamp_ns, recorded in stamped[:: -(-len(stamped) // most) or 1]:
            at_ns, xyz = self._at_once(stamp_ns, _returns(recorded), motion)
            axes = self.in_target(xyz, frame, at_ns).T if is_placed else xyz
            clouds.append(Points(0, at_ns, self.target if is_placed else frame, dict(zip("xyz", axes, strict=True))))
        return [cloud for cloud in clouds if cloud.fields["x"].size]

    def _at_once(self, stamp_ns: int, points: NDArray[Any], motion: SensorMotion | None) -> tuple[int, NDArray[Any]]:
        """Return the middle of a cloud's times, and its points, (3, N), as they are seen from where it is then."""
        if motion is not None and len(points) > 3:
            cloud = Points(0, stamp_ns, self.mounting.frame, dict(zip((*"xyz", TIME), points, strict=True)))
            deskew = Deskew(Placer("", "", self.buffer, 0), motion.fixed, PointTime(), "middle")
            with suppress(DecodeError, TransformError):
                if moving := deskew(cloud):
                    return moving.stamp_ns, _returns(np.stack(moving.place(cloud)[0].xyz()))
        return stamp_ns + self.middle_ns, points[:3]

    def clouds_in(self, fixed: str) -> list[tuple[Rigid, NDArray[np.floating[Any]]]]:
        """Return the transforms of the spread clouds to a frame that does not move, and their returns, (N, 3)."""
        places = [(self.transform(fixed, self.mounting.frame, stamp_ns), points) for stamp_ns, points in self.clouds]
        return [(place, _returns(points[:3]).T) for place, points in places if place is not None]

    def in_target(self, points: NDArray[np.floating[Any]], frame: str = "", stamp_ns: int = 0) -> NDArray[np.float64]:
        """Return points of a frame, (3, N), in the frame of the scans, (N, 3): of `clouds`, if none is given."""
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            xyz = points[:3].T.astype(np.float64)
        frame = frame or (self.mounting.frame if self.is_registered else self.mounting.judged_in)
        target, static = self.target, self.mounting.static_tf
        if static and frame == self.mounting.frame:
            return np.asarray(StaticTransform.parse(static).parent_from_child.apply(xyz))
        if not target or target == frame or self.buffer is None:
            return xyz
        if (placed := self.transform(target, frame, stamp_ns)) is None:
            return xyz[:0] if self.is_registered else xyz
        return np.asarray(placed.apply(xyz))


def _middle(directions: int) -> float:
    """Return the middle of directions, radians."""
    angles = np.array([place for place in range(DIRECTIONS) if directions >> place & 1]) * _STEP
    return float(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean())) if angles.size else 0.0


def _are_of_camera(clouds: Sequence[NDArray[np.float32]]) -> bool:
    """Whether clouds, each (4, N), are of a camera, whose pixels are in few rows and columns; also without points."""
    x, y, z, _ = np.concatenate(clouds, axis=1)[:, :_PIXELS]
    with np.errstate(all="ignore"):
        of_axes = ((np.round(part / ahead, 4) for part in others) for ahead, others in ((z, (x, y)), (x, (y, z))))
        # Not `np.unique`, which imports NumPy's masked arrays.
        return any(all(_A_ROW * (np.diff(np.sort(part)) > 0).sum() <= part.size for part in parts) for parts in of_axes)


def _view(points: NDArray[np.float64], inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which directions, a degree wide, have points inside, and are near ones that have any, (2, 360)."""
    beams = np.bincount(sectors_of(points[inside], 1), minlength=360)
    looks = np.bincount(sectors_of(points, _SEEN), minlength=360 // _SEEN)
    return np.array([beams, np.repeat(looks, _SEEN)]) > 0


def _refilled(views: Sequence[NDArray[np.bool_]], count: int, width: int) -> float:
    """Return which share of the beams that so many clouds fill as many before them, which look there, have filled.

    0: few are known. Beams are so many degrees wide.
    """
    again = wanted = 0
    groups = [np.logical_or.reduce(views[first : first + count]) for first in range(0, len(views), count)]
    for (before, looks), (after, _) in pairwise(groups[: len(views) // count]):
        had, has = (beams.reshape(-1, width).any(axis=1) for beams in (before, after & looks))
        again, wanted = again + int((had & has).sum()), wanted + int(has.sum())
    return again / wanted if wanted >= _FEWEST_BEAMS else 0.0


# --- Trial ---

#: A beam that ends on the ground, or misses what stands on it, is off by more than this, metres.
_OFF = 0.2

#: Slopes are measured from this distance on, metres; nearly all rising ground rises less, percent. Of scans with a
#: return in less than this share of their beams, what lies is a share of so many beams.
_NEAR, _NEARLY, _FEWEST = 2.0, 99.0, 0.2

_BLURRED = "the robot moves, and nothing says how, so its scans are blurred: `odom_topic` or `trajectory` says it"

#: The field of points that stand.
_STANDS = "<stands>"


class Trial(NamedTuple):
    """What a command makes of the clouds of a topic.

    Attributes
    ----------
    ranges
        The ranges of the beams of each scan, (scans, 2, N), infinite without a return: by all points, and by those that
        stand.
    findings
        What a conversion would say.
    """

    ranges: NDArray[np.float64] = np.empty((1, 2, 0))
    findings: tuple[str, ...] = ()

    @property
    def lying(self) -> float:
        """The share of the returns that are on rising ground, or on what is low, of the scan with most.

        A robot that pitches sees the ground only now and then.
        """
        every, stands = self.ranges[:, 0], self.ranges[:, 1]
        returns = np.isfinite(every)
        lies = returns & ~(every > stands - _OFF)
        return float((lies.sum(axis=1) / np.maximum(returns.sum(axis=1), 1 + _FEWEST * returns.shape[1])).max())

    def missed_in(self, other: Trial) -> float:
        """Return which share of the returns is on what stands, and ends behind it, or before it, in other scans."""
        # What one scan of sparse parts sees first is chance.
        before, after, several = self.ranges[:, 1], other.ranges[:, 1], len(self.ranges) > 1
        is_off = np.isfinite(before) & ((after > before + _OFF) | ((after < before - _OFF) & several))
        return float(is_off.sum() / max(np.isfinite(self.ranges[:, 0]).sum(), 1))


class Scene(NamedTuple):
    """What commands for a topic are tried on, which differ only in what they remove of the ground, and up to where.

    Attributes
    ----------
    clouds
        They have a field of what stands.
    placer
        Places them in the frame of the scans.
    samples
        The first clouds, for their checks; empty if clouds are placed by other means than in a conversion.
    slopes
        How steeply nearly all rising ground rises above the lower limit in each of them, metres a metre.
    """

    clouds: Sequence[PlacedCloud]
    placer: Placer
    samples: list[CloudSample]
    slopes: Sequence[float]


def tried(options: Mapping[str, Any], lidar: Lidar) -> Trial:
    """Return what the options of a proposed command make of a topic's clouds; see `Scene`."""
    try:
        request = conversion_of(Options("convert", options))
        spec, findings = request.scan, request_warnings(request, lidar.recorded, lidar.connections)
        scene = lidar.scene = lidar.scene or _scene(spec, lidar)
        if not scene.clouds:
            return Trial(findings=tuple(findings))
        trial, counts = _scans(spec, lidar, scene)
    except Pc2ScanError as err:
        return Trial(findings=(str(err),))
    if scene.samples:
        known = KnownTransforms("", lambda: lidar.buffer, lidar.buffer if spec.needs_transforms else None)
        facts = CloudFacts(lidar.topic, spec, known, scene.samples[: len(counts)], counts[: len(scene.samples)])
        findings += judge(facts).warnings
    return trial._replace(findings=(*findings, *trial.findings))


def _scene(spec: ScanSpec, lidar: Lidar) -> Scene:
    """Return what commands like this one are tried on."""
    is_placed = bool(lidar.mounting.static_tf) or lidar.is_registered
    placer = _placer(spec, lidar, "" if is_placed else spec.params.target_frame)
    # One part shows too little of the ground, so they are judged together, if it is known how the robot moves.
    fixed = spec.fixed_frame if spec.level else lidar.world if lidar.parts and not is_placed else ""
    clouds: list[PlacedCloud] = []
    ways: list[Rigid] = []
    for points in lidar.tried_clouds(is_placed=is_placed, is_levelled=spec.level):
        # A cut leaves out those that cannot be placed.
        with suppress(TransformError):
            cloud = PlaceStep(placer)(points)
            if fixed:
                ways.append(placer.from_fixed(fixed, cloud.points.frame_id, cloud.stamp_ns)[1])
            clouds.append(cloud)
    if not clouds:
        return Scene((), placer, [], ())
    samples = [] if is_placed or spec.level else lidar.facts.samples(placer)
    placed = [_coordinates(cloud) for cloud in clouds]
    if ways:
        # What a robot that moves sees of a place, from all of them.
        placed = [ways[0].compose(way.inverse()).apply(xyz) for way, xyz in zip(ways, placed, strict=True)]
    params, heights = spec.params, lidar.mounting.heights
    seen = [np.concatenate(placed)] if lidar.merges or ways else placed
    # From a floor that is not known, nothing rises.
    floor = None if heights is None else heights.floor
    low = math.inf if floor is None else params.min_height
    # From where clouds in the robot's frame were seen is not known.
    is_of_robot = lidar.moving_frame.removeprefix("/") in BODIES
    sensor = np.array([0.0, 0.0, ABOVE_ROBOT]) if is_of_robot else lidar.sensor
    lies = [are_ground(xyz, low, sensor) for xyz in seen]
    slopes = [_slope(xyz[up], low) for xyz, up in zip(seen, lies, strict=True)]
    parts = np.split(~np.concatenate(lies), np.cumsum([len(xyz) for xyz in placed])[:-1])
    marked = []
    for cloud, stands in list(zip(clouds, parts, strict=True))[:: 1 if lidar.merges else -(-len(clouds) // _CLOUDS)]:
        marked.append(replace(cloud, points=cloud.points.replace({_STANDS: stands}, cloud.points.frame_id)))
    return Scene(marked, placer, samples, slopes)


def _placer(spec: ScanSpec, lidar: Lidar, target: str) -> Placer:
    """Return what places clouds in the frame of the scans, which is level if the robot tilts."""
    buffer, imu, up, tolerance_ns = lidar.buffer, spec.imu, None, spec.params.tolerance_ns
    if spec.level and buffer is not None:
        by_frame = UpByFrame(spec.fixed_frame, buffer, tolerance_ns)
        up = by_frame if imu is None else UpByImu(lidar.ups[imu.topic], buffer, tolerance_ns)
    return Placer(target, "", buffer, tolerance_ns, up)


def _coordinates(cloud: PlacedCloud) -> NDArray[np.float64]:
    """Return the points of a cloud in the frame of the scans, (N, 3)."""
    points, transform = np.stack(cloud.points.xyz(), axis=1).astype(np.float64), cloud.place.target_from_source
    return points if transform is None else np.asarray(transform.apply(points))


def _slope(ground: NDArray[np.float64], low: float) -> float:
    """Return how steeply nearly all of these points rise above the lower limit."""
    ranges = np.hypot(ground[:, 0], ground[:, 1])
    far = ranges > _NEAR
    return percentiles((ground[far, 2] - low) / ranges[far], _NEARLY)[0] if far.any() else 0.0


def _scans(spec: ScanSpec, lidar: Lidar, scene: Scene) -> tuple[Trial, list[PointCounts]]:
    """Return what a command makes of the clouds, and what became of the points of each."""
    params, placer = spec.params, scene.placer
    # Placed clouds have no other frame.
    is_placed = placer.target_frame != params.target_frame
    filters = [point_filter for point_filter in spec.filters if not is_placed or point_filter.frame is Frame.TARGET]
    measured = {lidar.topic: Measurements(0.0, azimuth_step=lidar.step)}
    steps = CloudToScan(replace(spec, filters=tuple(filters)), placer, measured).steps(lidar.topic)
    ranges: list[list[NDArray[np.float32]]] = []
    counts: list[PointCounts] = []
    for cloud in scene.clouds:
        chosen = steps.select(cloud)
        stands = chosen.points.select(chosen.points.field(_STANDS))
        scans = [steps.project(replace(chosen, points=points)) for points in (chosen.points, stands)]
        ranges.append([scan.message.ranges for scan in scans])
        counts.append(scans[0].counts)
    read = np.array(ranges, np.float64)
    read[~((read >= params.range_min) & (read <= params.range_max))] = np.inf
    merged = read.min(axis=0, keepdims=True) if lidar.merges else read
    is_blurred = lidar.pattern[0] > 1 and not lidar.world and have_moved(read[:, 0], _OFF)
    return Trial(merged, (_BLURRED,) if is_blurred else ()), counts
