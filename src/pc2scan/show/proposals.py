"""The command that `info` proposes: every option that a recording needs, with its reason, from the survey's facts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import or_
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.advice.clocks import are_doubtful
from pc2scan.advice.measurements import ShapeRequest, regular_step, shapes_of
from pc2scan.advice.odometry import odometry_of
from pc2scan.advice.point_times import time_warnings, times_of
from pc2scan.advice.survey import Fact
from pc2scan.conversion.report import StampCounts
from pc2scan.core.params import ProjectionParams
from pc2scan.core.percentiles import median, median_low
from pc2scan.core.timing import median_interval_ns
from pc2scan.errors import TransformError
from pc2scan.request.point_time import PointTime
from pc2scan.request.turn import DIRECTIONS, directions_of
from pc2scan.result import Call
from pc2scan.text import height_text
from pc2scan.transforms.motion import sensor_motion, spread_of_up
from pc2scan.transforms.mounting import sensor_exclusion
from pc2scan.transforms.static import StaticTransform
from pc2scan.transforms.summary import BODIES, WORLDS

from .edges import EDGE_NS, EdgeClouds, edge_cuts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.advice.clocks import ClockFinding
    from pc2scan.advice.survey import TopicFacts
    from pc2scan.core.points import Points
    from pc2scan.model import RawMessage
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.imu import UpEstimate
    from pc2scan.transforms.motion import SensorMotion
    from pc2scan.transforms.mounting import Mounting

#: The preset whose scans all consumers accept.
_PRESET = "slam_toolbox"

#: How many clouds of a topic are looked at, how many at most of those in the recording's last second, how many for the
#: shape of their rings, and the largest of a pattern that is sparse, points.
HEADERS = 21
_LAST_HEADERS = 400
_SHAPES = 3
_SPARSE = 60_000

#: Lidars with at most this step fill beams of half a degree, radians.
_FINE = math.radians(0.41)

#: Rings are level if the cosine between the z axes of lidar and scans is larger: half a degree.
_UPRIGHT = math.cos(math.radians(0.5))

#: A sensor that moves by more than this within a cloud distorts it: the noise of lidars, metres.
_METRES = 0.02

#: A robot whose roll and pitch vary by more than this tilts, radians.
_TILTS = math.radians(1.0)

#: Clouds are packets if one has less than this share of the directions that several have: so many at least.
_PART = 0.6
_SEVERAL = 3
#: The step between neighbouring directions of clouds, radians.
_STEP = math.tau / DIRECTIONS

#: A pattern is sparse if a quarter of its clouds fill less than this share of the beams that all fill. Clouds are
#: enough for a scan if they fill this share; at most so many become one.
_FILLED = 0.6
_ENOUGH = 0.9
_MOST_CLOUDS = 10

#: Floors of several lidars that differ by less are one, metres.
_ONE_FLOOR = 0.05

#: Cells of the robot's own body, metres; how far from its frame they are at most; in how many clouds, and what share of
#: them, the same cells have returns.
_CELL = 0.1
_REACH = 3.0
_FEWEST_CLOUDS = 5
_PERSIST = 0.9
#: The robot moves if at most this share of larger cells beyond, up to this distance, have returns in as many clouds,
#: in this time at least, seconds.
_STAYS = 0.05
_LARGE = 0.5
_BEYOND = 15.0
#: How many cells, small or large, are between the origin and the farthest one.
_CELLS = 30
_LONG = 5.0


def ask_facts(facts: TopicFacts, end_ns: int | None) -> None:
    """Ask for the facts about a topic with clouds that a command depends on.

    Parameters
    ----------
    facts
        The topic.
    end_ns
        The log time of the recording's last message; None without messages.
    """
    for fact in (_DIRECTIONS, _PATTERN, _TIMES, _SHAPE.fact):
        facts.ask(fact)
    if end_ns is not None:
        facts.ask_last_headers(end_ns - EDGE_NS, _LAST_HEADERS)


def stamp_faults(facts: TopicFacts) -> list[str]:
    """Return what is wrong with the stamps of the first messages of a topic, and what to do."""
    stamps = StampCounts()
    for header in facts.headers:
        stamps.add(header.stamp_ns, header.log_time_ns)
    return stamps.faults(facts.topic)


def _sparse_points(points: Points, _: RawMessage) -> NDArray[np.float32] | None:
    """Return copies of the coordinates of a small cloud, (3, N)."""
    xyz = points.xyz()
    if xyz[0].size > _SPARSE:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack([np.ravel(axis).astype(np.float32) for axis in xyz])


def _directions(points: Points, _: RawMessage) -> int:
    return directions_of(points)


def _are_whole(found: Sequence[int]) -> bool:
    """Whether the first clouds are no packets, whatever directions further ones have."""
    return len(found) >= _SEVERAL and all(each.bit_count() >= _PART * DIRECTIONS for each in found[:_SEVERAL])


_DIRECTIONS = Fact(_directions, HEADERS, are_enough=_are_whole)
_PATTERN = Fact(_sparse_points, HEADERS)
_TIMES = times_of(PointTime())
_SHAPE = ShapeRequest(step=True, sweep=True, most=_SHAPES)


class Directions(NamedTuple):
    """Which directions clouds have: whole turns, or parts of one.

    Attributes
    ----------
    is_part
        Whether a cloud has a part of the directions that several have.
    turn
        The time of a turn, seconds; 0 if the clouds are no parts, or it is not regular.
    """

    is_part: bool = False
    turn: float = 0.0


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
        Points of clouds that are spread over the recording, each (3, N), in the frame in which they were judged.
    has_zeros
        Whether points at (0, 0, 0) stand for no return.
    seconds
        How long it measured.
    span_ns
        The log times of the recording's first and last message; the last one is None if not all transforms there are
        known.
    """

    facts: TopicFacts
    mounting: Mounting
    buffer: TransformBuffer | None
    clouds: Sequence[NDArray[np.floating[Any]]]
    has_zeros: bool
    seconds: float
    span_ns: tuple[int, int | None]

    @property
    def topic(self) -> str:
        """Its topic."""
        return self.facts.topic

    @property
    def target(self) -> str:
        """The frame of its scans; empty for its own."""
        own = self.mounting
        return own.target_frame or (own.judged_in if own.judged_in != own.frame else "")

    @cached_property
    def period(self) -> float:
        """The time from cloud to cloud, seconds; 0 if it is not known."""
        return (median_interval_ns(each.stamp_ns for each in self.facts.headers) or 0) / 1e9

    @cached_property
    def duration(self) -> float:
        """The time that the points of a cloud take by their own times, seconds; 0 without plausible ones."""
        times = self.facts.found(_TIMES)
        if not times or any(time_warnings(self.facts, PointTime())):
            return 0.0
        return median([each.high - each.low for each in times])

    @property
    def edges(self) -> EdgeClouds:
        """Its clouds at the edges of the recording."""
        clouds = EdgeClouds(self.mounting.frame, self.facts.headers, self.facts.last_headers)
        if not self.duration:
            return clouds
        times = self.facts.found(_TIMES)
        return clouds._replace(before=min(each.low for each in times), after=max(each.high for each in times))

    @cached_property
    def time_field(self) -> str:
        """The field with the times of points."""
        return self.facts.found(_TIMES)[0].field

    @cached_property
    def step(self) -> float | None:
        """How finely a turning lidar samples azimuth, radians; None for others."""
        shapes = shapes_of(self.facts, _SHAPE)
        turns = any(each.sweep is not None for each in shapes) or self.covered > 0.5
        return regular_step(shapes) if turns else None

    @property
    def is_upright(self) -> bool:
        """Whether the z axes of its frame and of the scans are the same, so that its rings are level there."""
        if self.mounting.static_tf or not self.target:
            return not self.mounting.static_tf
        try:
            turned = None if self.buffer is None else self.buffer.lookup(self.target, self.mounting.frame, 0)
        except TransformError:
            return False
        return turned is not None and float(turned.matrix[2, 2]) > _UPRIGHT

    @cached_property
    def covered(self) -> float:
        """The share of all directions that a cloud has."""
        found = self.facts.found(_DIRECTIONS)
        return median([each.bit_count() / DIRECTIONS for each in found]) if found else 0.0

    @cached_property
    def directions(self) -> Directions:
        """Whether a cloud is a part of a turn."""
        found = self.facts.found(_DIRECTIONS)
        union = reduce(or_, found, 0)
        if len(found) < _SEVERAL or self.covered >= _PART * union.bit_count() / DIRECTIONS:
            return Directions()
        middles = [_middle(each) for each in found]
        steps = np.remainder(np.diff(middles) + math.pi, math.tau) - math.pi
        step = median(steps)
        # Packets follow each other; a pattern jumps.
        if not abs(step) > _STEP / 4 or (np.abs(steps - step) < max(0.5 * abs(step), _STEP)).mean() < _ENOUGH:
            return Directions(is_part=True)
        return Directions(is_part=True, turn=round(math.tau / abs(step)) * self.period)

    def motion(self, seconds: float) -> SensorMotion | None:
        """Return how it moves within some time; None if it stands still, or no transforms say how it moves."""
        return None if self.buffer is None else sensor_motion(self.buffer, self.mounting.frame, seconds)

    def clouds_of_a_scan(self) -> int:
        """Return how many clouds fill a scan, if their pattern is sparse; else 0."""
        heights = self.mounting.heights
        if self.step is not None or self.directions.turn or heights is None:
            return 0
        clouds = [
            filled
            for each in self.facts.found(_PATTERN)
            if (filled := _filled_beams(self._in_target(each, self.mounting.frame), heights.low, heights.high))
            is not None
        ]
        if len(clouds) < _MOST_CLOUDS:
            return 0
        every = np.logical_or.reduce(clouds)
        if every.sum() < 20 or _lower_quartile(each.sum() for each in clouds) >= _FILLED * every.sum():
            return 0
        for count in range(2, _MOST_CLOUDS + 1):
            groups = [
                np.logical_or.reduce(clouds[n : n + count]).sum() for n in range(0, len(clouds) - count + 1, count)
            ]
            if median(groups) >= _ENOUGH * every.sum():
                return count
        return _MOST_CLOUDS

    @property
    def placed(self) -> Iterator[NDArray[np.float64]]:
        """The spread clouds in the frame of the scans, each (N, 3)."""
        return (self._in_target(each, self.mounting.judged_in) for each in self.clouds)

    def _in_target(self, points: NDArray[np.floating[Any]], frame: str) -> NDArray[np.float64]:
        """Return points of a frame, (3, N), in the frame of the scans, (N, 3)."""
        found = points.T.astype(np.float64)
        target, static = self.target, self.mounting.static_tf
        if static and frame == self.mounting.frame:
            return np.asarray(StaticTransform.parse(static).parent_from_child.apply(found))
        if not target or target == frame or self.buffer is None:
            return found
        try:
            return np.asarray(self.buffer.lookup(target, frame, 0).apply(found))
        except TransformError:
            return found


def _lower_quartile(counts: Iterable[int]) -> int:
    ordered = sorted(counts)
    return ordered[len(ordered) // 4]


def _middle(directions: int) -> float:
    """Return the middle of directions, radians."""
    angles = np.array([place for place in range(DIRECTIONS) if directions >> place & 1]) * _STEP
    return float(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean())) if angles.size else 0.0


def _filled_beams(points: NDArray[np.float64], low: float, high: float) -> NDArray[np.bool_] | None:
    """Return which beams of half a degree have points between two heights; None if there are hardly any points."""
    x, y, z = points.T
    good = (z >= low) & (z <= high) & ((x != 0) | (y != 0)) & np.isfinite(x) & np.isfinite(y)
    if good.sum() < 20:
        return None
    places = ((np.arctan2(y[good], x[good]) / math.tau + 0.5) * 720).astype(np.intp) % 720
    return np.bincount(places, minlength=720) > 0


class Box(NamedTuple):
    """The place of the robot's own body: the limits of x, y and z, metres."""

    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]

    def text(self, frame: str) -> str:
        """Return it as `exclude_box` has it."""
        return " ".join((frame, *(f"{value:g}" for limits in self for value in limits)))


def body_of(clouds: Iterable[NDArray[np.float64]], low: float, high: float) -> Box | None:
    """Return the box around returns of the robot's own body; None if there are none, or if nothing tells them apart.

    Parameters
    ----------
    clouds
        Points of some clouds, spread over a recording, each (N, 3), in the frame of the scans.
    low, high
        The heights of the scans.

    Notes
    -----
    The body has returns at the same places in all clouds, while the surroundings change. If the surroundings stay, too,
    the robot stands still.
    """
    # In how many clouds each cell has returns.
    small, large = (np.zeros((2 * _CELLS + 1, 2 * _CELLS + 1), np.intp) for _ in range(2))
    count = 0
    for points in clouds:
        count += 1
        good = points[(points[:, 2] >= low) & (points[:, 2] <= high), :2]
        ranges = np.hypot(good[:, 0], good[:, 1])
        small += _filled_cells(good[(ranges > _CELL) & (ranges < _REACH)], _CELL)
        large += _filled_cells(good[(ranges >= _REACH) & (ranges < _BEYOND)], _LARGE)
        # Not held while the next one is transformed.
        del points
    if count < _FEWEST_CLOUDS:
        return None
    body, beyond = (np.argwhere(counts >= _PERSIST * count) - _CELLS for counts in (small, large))
    cells = np.count_nonzero(large)
    if len(body) < 3 or cells < 20 or len(beyond) > _STAYS * cells:
        return None
    (x0, y0), (x1, y1) = body.min(axis=0) * _CELL - 0.05, (body.max(axis=0) + 1) * _CELL + 0.05
    limits = ((x0, x1), (y0, y1), (low - 0.1, high + 0.1))
    return Box(*((round(float(one), 2), round(float(other), 2)) for one, other in limits))


def _filled_cells(points: NDArray[np.float64], size: float) -> NDArray[np.bool_]:
    """Return which cells of a grid around the origin have points, (N, 2)."""
    filled = np.zeros((2 * _CELLS + 1, 2 * _CELLS + 1), np.bool_)
    filled[tuple((np.floor(points / size).astype(np.intp) + _CELLS).T)] = True
    return filled


class Choice(NamedTuple):
    """An option with its value and its reason."""

    name: str
    value: Any
    reason: str


def proposals(
    lidars: Sequence[Lidar],
    sources: Sequence[str],
    given: Mapping[str, Any],
    ups: Mapping[str, UpEstimate],
    clocks: Mapping[str, ClockFinding],
    destination: Callable[[str], str],
    *,
    names_topics: bool,
    has_scans: bool,
) -> Iterator[Call]:
    """Yield the commands that suit a recording: one for all lidars that make one scan, one for each other.

    Parameters
    ----------
    lidars
        The topics with clouds.
    sources
        The recordings.
    given
        Options about frames that were given; the conversion needs them, too.
    ups
        The direction of up by each IMU that shows it.
    clocks
        What is wrong with the clocks of topics.
    destination
        Names the destination of a topic, if there are several commands.
    names_topics
        Whether a command must say which topic it converts.
    has_scans
        Whether the recording has a topic /scan.
    """
    groups = list(_groups([_with_common_heights(each, lidars) for each in lidars if each.mounting.heights is not None]))
    for group in groups:
        choices = list(_choices(group, given, ups, clocks, names_topics=names_topics, has_scans=has_scans))
        options: dict[str, Any] = {}
        if len(groups) > 1:
            options["destination"] = destination(group[0].topic)
        options |= {each.name: each.value for each in choices}
        yield Call("convert", tuple(sources), options, {each.name: each.reason for each in choices if each.reason})


def _with_common_heights(lidar: Lidar, lidars: Sequence[Lidar]) -> Lidar:
    """Return a lidar with the heights of all that see the same floor in the same frame."""
    own = lidar.mounting.heights
    if own is None or own.floor is None or not lidar.target:
        return lidar
    heights = [each.mounting.heights for each in lidars if each.target == lidar.target and each.mounting.heights]
    same = [each for each in heights if each.floor is not None and abs(each.floor - own.floor) < _ONE_FLOOR]
    common = own._replace(low=max(each.low for each in same), high=max(each.high for each in same))
    return replace(lidar, mounting=lidar.mounting._replace(heights=common))


def _groups(lidars: Sequence[Lidar]) -> Iterator[list[Lidar]]:
    """Yield the lidars whose clouds become one scan: they measure at the same time, and transforms connect them."""
    rest = list(lidars)
    while rest:
        first = rest.pop(0)
        group = [first]
        for other in list(rest):
            frames = {each.mounting.frame.removeprefix("/") for each in group}
            if (
                first.target
                and other.target == first.target
                and other.mounting.frame.removeprefix("/") not in frames
                and _overlap(first.facts, other.facts)
                and _has_one_clock(first.facts, other.facts)
            ):
                group.append(other)
                rest.remove(other)
        yield group


def _overlap(one: TopicFacts, other: TopicFacts) -> bool:
    """Whether the first clouds of two topics were recorded at about the same time."""
    if not (one.headers and other.headers):
        return False
    (begin, end), (other_begin, other_end) = (
        (each.headers[0].log_time_ns, each.headers[-1].log_time_ns) for each in (one, other)
    )
    return begin <= other_end and other_begin <= end


def _has_one_clock(one: TopicFacts, other: TopicFacts) -> bool:
    delays = [median_low([each.delay_ns for each in facts.headers]) for facts in (one, other)]
    return not are_doubtful(*delays)


def _choices(
    group: Sequence[Lidar],
    given: Mapping[str, Any],
    ups: Mapping[str, UpEstimate],
    clocks: Mapping[str, ClockFinding],
    *,
    names_topics: bool,
    has_scans: bool,
) -> Iterator[Choice]:
    lidar = group[0]
    if len(group) > 1:
        name = "/scan_all" if has_scans else "/scan"
        topics = tuple(f"{each.topic}:={name}" for each in group)
        yield Choice("topics", topics, f"{len(group)} lidars measure at the same time, so they make one scan")
    elif has_scans:
        yield Choice("topics", f"{lidar.topic}:={lidar.topic.rstrip('/')}/scan", "the recording has a topic /scan")
    elif names_topics:
        yield Choice("topics", lidar.topic, "each topic has a command of its own")
    yield Choice("preset", _PRESET, "beams, limits and times that SLAM and navigation accept")
    given = dict(given)
    static = [each.mounting.static_tf for each in group if each.mounting.static_tf]
    if static:
        given["static_tf"] = (*given.get("static_tf", ()), *static)
    for option, value in given.items():
        reason = "makes the clouds level" if option == "static_tf" and static else "as given"
        yield Choice(option, value[0] if isinstance(value, tuple) and len(value) == 1 else value, reason)
    if lidar.target:
        yield Choice("target_frame", lidar.target, "the robot's frame" if lidar.target in BODIES else "its z points up")
    if (clock := clocks.get(lidar.topic)) is not None:
        yield Choice("time_offset", clock.time_offset, clock.reason)
    elif any(stamp_faults(each.facts) for each in group):
        yield Choice("stamps", "log", "its stamps go back, or are 0")
    yield from _heights(group)
    times = list(_times(group, ups))
    yield from times
    if clock is None:
        yield from _edges(group, next((each.value for each in times if each.name == "fixed_frame"), ""))
    yield from _exclusions(group)
    yield from _beams(group)


def _beams(group: Sequence[Lidar]) -> Iterator[Choice]:
    """Yield the width of the beams, if the lidars turn and the default one suits none of them."""
    steps = [each.step for each in group]
    if None in steps:
        return
    step = max(each for each in steps if each is not None)
    measured = f"every {math.degrees(step):.3g} deg"
    if step > 1.2 * ProjectionParams().angle_increment and len(group) == 1 and group[0].is_upright:
        yield Choice("beams", "auto", f"the lidar measures {measured}, coarser than the default beams")
    elif step <= _FINE:
        yield Choice("angle_increment", "0.5deg", f"the lidar measures {measured}, finer than the default beams")


def _heights(group: Sequence[Lidar]) -> Iterator[Choice]:
    heights = [each.mounting.heights for each in group if each.mounting.heights is not None]
    low, high = max(each.low for each in heights), max(each.high for each in heights)
    floors = [each.floor for each in heights if each.floor is not None]
    if floors:
        yield Choice("min_height", float(f"{low:g}"), f"above the floor at z = {height_text(max(floors))} m")
        ceilings = [each.ceiling for each in heights if each.ceiling is not None]
        under = (
            f"below the ceiling at z = {height_text(min(ceilings))} m" if ceilings else "of objects that stand on it"
        )
        yield Choice("max_height", float(f"{high:g}"), under)
    else:
        yield Choice("min_height", float(f"{low:g}"), "no floor is visible: the heights of most points")
        yield Choice("max_height", float(f"{high:g}"), "")


def _times(group: Sequence[Lidar], ups: Mapping[str, UpEstimate]) -> Iterator[Choice]:
    """Yield the options about motion, packets and patterns."""
    lidar = group[0]
    is_alone = len(group) == 1
    turn = lidar.directions.turn if is_alone else 0.0
    clouds = lidar.clouds_of_a_scan() if is_alone and not turn else 0
    within_cloud = lidar.motion(lidar.duration or lidar.period or 0.1)
    gathered = turn or clouds * lidar.period or (0.0 if is_alone else lidar.period)
    within_scan = lidar.motion(gathered) if gathered else within_cloud
    deskews = (_moves(within_cloud) or (gathered > 0 and _moves(within_scan))) and all(each.duration for each in group)
    tilts = within_scan is not None and within_scan.tilt > _TILTS
    if turn:
        yield Choice("every", float(f"{turn:.4g}"), f"a cloud is a part of a turn, which takes {turn:.3g} s")
    if clouds:
        seconds = float(f"{clouds * lidar.period:.3g}")
        yield Choice("accumulate", f"{seconds:g}s", f"the pattern is sparse: {clouds} clouds fill a scan")
        yield Choice("reduce", "surface", "the nearest of so many returns would be too near by the noise")
    moving = within_scan if gathered else within_cloud
    if deskews and moving is not None:
        yield Choice(
            "deskew",
            True,
            f"points have times ({lidar.time_field}), and the lidar moves by {moving.metres:.2f} m and "
            f"{math.degrees(moving.radians):.1f} deg within a {'scan' if gathered else 'cloud'}",
        )
    if tilts and within_scan is not None:
        yield Choice("level", True, f"roll and pitch vary by {math.degrees(within_scan.tilt):.1f} deg")
    if within_scan is not None and (deskews or tilts or (gathered and _moves(within_scan))):
        yield Choice("fixed_frame", within_scan.fixed, "the frame that does not move with the robot")
    if not tilts:
        yield from _level_by_imu(lidar, ups)


def _edges(group: Sequence[Lidar], fixed: str) -> Iterator[Choice]:
    """Yield the cut that leaves out clouds which no transform places in the fixed frame, if there is such a frame."""
    buffer = group[0].buffer
    if not fixed or buffer is None:
        return
    for cut in edge_cuts([each.edges for each in group], buffer, fixed, *group[0].span_ns):
        yield Choice(cut.option, cut.seconds, cut.reason)


def _moves(motion: SensorMotion | None) -> bool:
    """Whether a sensor moves by more than the resolution of its scans."""
    return motion is not None and (motion.metres > _METRES or motion.radians > ProjectionParams().angle_increment)


def _level_by_imu(lidar: Lidar, ups: Mapping[str, UpEstimate]) -> Iterator[Choice]:
    for topic, up in ups.items():
        angle = spread_of_up(up.directions)
        if angle > _TILTS and _is_connected(lidar, up.frame):
            yield Choice("level", True, f"roll and pitch vary by {math.degrees(angle):.1f} deg, by the IMU")
            yield Choice("imu", topic, "no transforms say how the robot tilts")
            return


def _is_connected(lidar: Lidar, frame: str) -> bool:
    """Whether a frame is the lidar's, or transforms connect the two."""
    own = lidar.target or lidar.mounting.frame
    if own.removeprefix("/") == frame.removeprefix("/"):
        return True
    return lidar.buffer is not None and lidar.buffer.is_rigid(own, frame)


def _exclusions(group: Sequence[Lidar]) -> Iterator[Choice]:
    lidar = group[0]
    boxes: list[str] = []
    reasons: list[str] = []
    heights = lidar.mounting.heights
    for each in group:
        body = None
        if heights is not None and each.seconds >= _LONG:
            body = body_of(each.placed, heights.low, heights.high)
        if body is not None:
            boxes.append(body.text(lidar.target or lidar.mounting.frame))
            reasons = ["returns of the robot's own body"]
    for each in group:
        # The preset rejects points at the origin of the scans' own frame.
        option, value = sensor_exclusion(each.mounting.frame, lidar.target)
        if each.has_zeros and option == "exclude_box":
            boxes.append(value)
            reasons.append("(0, 0, 0) is no return")
    if boxes:
        yield Choice("exclude_box", boxes[0] if len(boxes) == 1 else tuple(boxes), ", ".join(dict.fromkeys(reasons)))


def odometry_doubts(lidars: Iterable[Lidar]) -> Iterator[str]:
    """Yield what is wrong with the transforms that move the robot, by the frame that a conversion would deskew in."""
    found: set[str] = set()
    for lidar in lidars:
        if (buffer := lidar.buffer) is None:
            continue
        motion = lidar.motion(0.1)
        # Frames that are the wrong way round move nothing.
        fixed = motion.fixed if motion is not None else next((name for name in WORLDS if name in buffer.frames), "")
        doubt = odometry_of(buffer, fixed, lidar.mounting.frame).doubt
        if doubt and doubt not in found:
            found.add(doubt)
            yield doubt


def missing_mounts(lidars: Iterable[Lidar]) -> Iterator[str]:
    """Yield a note for each lidar that no transform connects with the robot, with the line to complete."""
    for lidar in lidars:
        frame, buffer = lidar.mounting.frame.removeprefix("/"), lidar.buffer
        if lidar.mounting.judged_in.removeprefix("/") != frame:
            continue
        body = next((name for name in BODIES if buffer is not None and name in buffer.frames), "")
        if not frame or frame == body or buffer is None or not body:
            continue
        try:
            buffer.lookup(body, frame, 0)
        except TransformError:
            yield (
                f"{lidar.topic}: no transform connects {frame!r} with {body}: complete "
                f"`static_tf='{body} {frame} X Y Z ROLL PITCH YAW'` (metres and radians), or give the robot's model, "
                f"`urdf=robot.urdf`; with `target_frame={body}`"
            )
