"""The command that `info` proposes: every option that a recording needs, with its reason, from the survey's facts."""

from __future__ import annotations

import math
import re
from itertools import product
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.advice.clocks import measure_together
from pc2scan.advice.odometry import odometry_of, tilts
from pc2scan.bags.destinations import default_destination
from pc2scan.core.params import ProjectionParams
from pc2scan.core.scene import ONE_FLOOR, sectors_of
from pc2scan.messages.clouds import CLOUDS
from pc2scan.result import Call
from pc2scan.text import height_text
from pc2scan.transforms.attitude import GRAVITY
from pc2scan.transforms.frames import BODIES, WORLDS
from pc2scan.transforms.motion import spread_of_up
from pc2scan.transforms.mounting import sensor_exclusion

from .lidar import Lidar, Trial, stamp_faults, tried

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.bags.reader import Reader
    from pc2scan.core.rigid import Rigid
    from pc2scan.transforms.motion import SensorMotion


#: The preset whose scans all consumers accept.
_PRESET = "slam_toolbox"

#: Lidars with at most this step fill beams of half a degree, radians.
_FINE = math.radians(0.41)

#: A sensor that moves by more than this within a cloud distorts it: the noise of lidars, metres.
_METRES = 0.02
#: ... and by more than this, worth a warning if nothing corrects it.
_FAR = 0.1

#: From the first share of returns that may be on the ground on, it is said, and from the second one on, options that
#: end half of them are tried. Limits pass by at most the last share of what stands.
_TOLD, _LYING, _MISSED = 0.1, 0.05, 0.1
_ON_GROUND = "may be on rising ground, or on grass"
#: Lower limits that are so much higher are tried, metres, if so much is left above them.
_HIGHER, _THIN = (0.05, 0.1, 0.15, 0.2), 0.3
#: No robot drives on steeper ground, metres a metre.
_STEEPEST = 0.17
#: If nothing lower does, scans above rising ground reach so far, metres, and end so far below what is overhead.
_REACHES, _BELOW = 20.0, 0.2

#: Cells of the robot's own body, metres; in how many clouds, and what share of them, the same cells have returns.
_CELL, _FEWEST_CLOUDS, _PERSIST = 0.1, 5, 0.9
#: Robots stand if more than this share of larger cells, metres, have returns in as many clouds. How many cells are
#: between the origin and the farthest one. What is closer to a sensor, metres, is probably its robot.
_STANDS, _LARGE, _CELLS, _CLOSE = 0.5, 0.5, 20, 0.5
#: What does not move is left behind if its place is so many cells from all that stay, and what is seen in its direction
#: is so far away from it, metres. How many directions there are.
_AWAY, _LEFT, _DIRECTIONS = 3, 0.3, 360

#: Cuts at an edge are hundredths of a second if there is one between the clouds, nanoseconds.
_CUT_NS = 10_000_000


def body_of(
    clouds: Iterable[tuple[Rigid | None, NDArray[np.float64]]], sensor: NDArray[np.float64], low: float, high: float
) -> tuple[Sequence[float], bool]:
    """Return the limits of x, y and z of returns of the robot's own body; empty if nothing tells these apart.

    The body has returns at the same places in all clouds. Where it was in the world, other clouds see what is farther
    away; what they see there again is a wall that the robot drives along.

    Parameters
    ----------
    clouds
        The transforms to a frame that does not move, if they are known, and the points, (N, 3), of `Lidar.placed`.
    sensor, low, high
        The position of the sensor, and the heights of the scans.

    Returns
    -------
    The limits, and whether it is certain: without evidence, what stays close to the sensor is probably the body.
    """
    # In how many clouds each cell has returns.
    small, large = np.zeros((2, 2 * _CELLS + 1, 2 * _CELLS + 1), np.intp)
    views: list[tuple[Rigid | None, NDArray[np.float64]]] = []
    for place, points in clouds:
        # What is lower may be grass.
        good = points[(points[:, 2] >= low + _CELL) & (points[:, 2] <= high)]
        for counts, size in (small, _CELL), (large, _LARGE):
            cells = np.floor(good[np.maximum(*np.abs(good.T[:2])) < _CELLS * size, :2] / size).astype(np.intp)
            places = (cells + _CELLS) @ (len(counts), 1)
            counts[:] += np.reshape(np.bincount(places, minlength=counts.size) > 0, counts.shape)
        ranges, direction = _polar(good - sensor)
        view = np.full(_DIRECTIONS, np.inf)
        np.minimum.at(view, direction, ranges)
        views.append((place, np.minimum.reduce([np.roll(view, step) for step in (-1, 0, 1)])))
        # Not held while the next one is transformed.
        del points, good
    if len(views) < _FEWEST_CLOUDS:
        return (), False
    stays, large_stays = (counts >= _PERSIST * len(views) for counts in (small, large))
    cells = np.argwhere(stays) - _CELLS
    body = np.insert((cells + 0.5) * _CELL, 2, low, axis=1)
    own_ranges, _ = _polar(body - sensor)
    near = np.logical_or.reduce([np.roll(stays, step, (0, 1)) for step in product(range(-_AWAY, _AWAY + 1), repeat=2)])
    free, again = np.zeros((2, len(cells)), np.intp)
    for (now, _), (then, view) in product(views, views):
        if now is not None and then is not None:
            moved = then.inverse().apply(now.apply(body))
            is_off = ~near[tuple((np.floor(moved[:, :2] / _CELL).astype(np.intp) + _CELLS).clip(0, 2 * _CELLS).T)]
            ranges, direction = _polar(moved - sensor)
            behind = view[direction] - ranges
            # What is nearer may be too high or too low for the sensor.
            free += is_off & (behind > _LEFT) & (ranges >= own_ranges)
            again += is_off & (np.abs(behind) <= _LEFT)
    is_left = free * (1 - _PERSIST) > again * _PERSIST
    sure = bool(is_left.any() and large_stays.sum() <= _STANDS * np.count_nonzero(large))
    cells = cells[is_left if sure else (own_ranges < _CLOSE) & (again <= free)]
    if not cells.size:
        return (), False
    (x0, y0), (x1, y1) = cells.min(axis=0) * _CELL - 0.05, (cells.max(axis=0) + 1) * _CELL + 0.05
    return [round(float(limit), 2) for limit in (x0, x1, y0, y1, low - 0.1, high + 0.1)], sure


def _polar(places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return how far away places are, and in which direction."""
    return np.hypot(places[:, 0], places[:, 1]), sectors_of(places, 360 / _DIRECTIONS)


class Choice(NamedTuple):
    """An option with its value and its reason."""

    name: str
    value: Any
    reason: str


def proposals(
    lidars: Sequence[Lidar],
    sources: Sequence[Reader],
    types: Mapping[str, Sequence[str]],
    given: Mapping[str, Any],
    warnings: list[str],
) -> Iterator[Call]:
    """Yield the commands that suit a recording: one for all lidars that make one scan, one for each other.

    Parameters
    ----------
    lidars
        The topics with clouds.
    sources
        The recordings.
    types
        The types of each topic with messages.
    given
        Options about frames that were given; the conversion needs them, too.
    warnings
        What the commands would be told is added.
    """
    lidars = [lidar for lidar in lidars if lidar.mounting.heights is not None and lidar.mounting.heights.suit]
    warnings += _motion_that_stays(lidars)
    groups = list(_groups(lidars))
    for group in groups:
        choices, findings = _tried([*_topics(group, sources, types), *_choices(group, lidars, given)], group)
        warnings += (f"the proposed command: {text}" for text in findings if text not in warnings)
        options: dict[str, Any] = {}
        if len(groups) > 1:
            mark = "_" + re.sub(r"\W+", "_", group[0].topic.strip("/")) + "_scan"
            options["destination"] = str(default_destination(sources[0].path, sources[0].summary.container, mark))
        options |= {choice.name: choice.value for choice in choices}
        reasons = {choice.name: choice.reason for choice in choices if choice.reason}
        yield Call("convert", tuple(str(reader.path) for reader in sources), options, reasons)


def _tried(choices: list[Choice], group: Sequence[Lidar]) -> tuple[list[Choice], Sequence[str]]:
    """Return the options of a command, changed where a trial of it shows it, and what it would be told with them."""
    options = {choice.name: choice.value for choice in choices}
    trials = [tried(options, lidar) for lidar in group]
    worst = max(trial.lying for trial in trials)
    slopes = [slope for lidar in group if lidar.scene for slope in lidar.scene.slopes]
    why = f"{worst:.0%} of a cloud's returns {_ON_GROUND}"
    outcomes = [(worst, worst, list[Choice](), trials)]
    for way in _ways(options, group, slopes, why) if worst > _LYING else ():
        added = {choice.name: choice.value for choice in way}
        # The filter is tried with a limit only if it has found ground without one.
        if "ground" in added and way[1:] and way[:1] not in (done for _, _, done, _ in outcomes):
            continue
        after = [tried({**options, **added}, lidar) for lidar in group]
        # Where nothing is left, nothing lies.
        if not any(np.isfinite(trial.ranges).any() for trial in after):
            continue
        lying, missed = max(trial.lying for trial in after), max(map(Trial.missed_in, trials, after))
        if lying <= worst / 2 and ("ground" in added or missed <= _MISSED):
            # What is missed may be ground that is on no plane.
            outcomes.append((lying + missed / 2, lying, way, after))
        # Limits may be above what stands, so they are for much that lies.
        if lying + missed <= _LYING or worst <= _TOLD:
            break
    _, lying, way, after = min(outcomes, key=itemgetter(0))
    said = f"{lying:.0%} of a cloud's returns {_ON_GROUND}; `pc2scan view` shows them"
    findings = dict.fromkeys(text for trial in after for text in trial.findings)
    return [*choices, *way], (*findings, *([said] if lying > _TOLD else ()))


def _ways(options: Mapping[str, Any], group: Sequence[Lidar], slopes: list[float], why: str) -> Iterator[list[Choice]]:
    """Yield options of which one may end the returns on the ground, which rises so much, or on grass."""
    low, high = options["min_height"], options["max_height"]
    ground = Choice("ground", "remove", why)
    limits = [Choice("min_height", float(f"{low + by:.2f}"), why) for by in _HIGHER if low + by + _THIN <= high]
    # Both are for grass on ground that the filter finds.
    yield from ([ground], *([limit] for limit in limits), *([ground, limit] for limit in limits[:1]))
    if max(slopes) < _STEEPEST:
        slope = math.ceil(100 * max(slopes) + 0.5) / 100
        rises = Choice("min_height_slope", slope, why)
        yield [rises]
        ceilings = (lidar.mounting.heights.ceiling for lidar in group if lidar.mounting.heights is not None)
        most = min((ceiling - _BELOW for ceiling in ceilings if ceiling is not None), default=math.inf)
        top = max(high, min(high + slope * _REACHES, most))
        yield [rises, Choice("max_height", float(f"{top:.2f}"), f"of what stands on it, up to {_REACHES:.0f} m away")]


def _groups(lidars: Sequence[Lidar]) -> Iterator[list[Lidar]]:
    """Yield the lidars whose clouds become one scan: they measure at the same time, and transforms connect them."""
    rest = list(lidars)
    while rest:
        group = [rest.pop(0)]
        for other in list(rest):
            frames = {lidar.mounting.frame.removeprefix("/") for lidar in group}
            is_beside = other.target == group[0].target and other.mounting.frame.removeprefix("/") not in frames
            offsets = {lidar.clock and lidar.clock.time_offset for lidar in (group[0], other)}
            if other.target and is_beside and len(offsets) == 1 and measure_together(group[0].facts, other.facts):
                group.append(other)
                rest.remove(other)
        yield group


def _topics(group: Sequence[Lidar], sources: Sequence[Reader], types: Mapping[str, Sequence[str]]) -> Iterator[Choice]:
    """Yield what a command converts, and the name of its scans, if they are not those of the only topic with clouds."""
    topic = group[0].topic
    has_scans = any(connection.topic == "/scan" for reader in sources for connection in reader.connections)
    if len(group) > 1:
        named = tuple(f"{lidar.topic}:={'/scan_all' if has_scans else '/scan'}" for lidar in group)
        yield Choice("topics", named, f"{len(group)} lidars measure at the same time, so they make one scan")
    elif has_scans:
        yield Choice("topics", f"{topic}:={topic.rstrip('/')}/scan", "the recording has a topic /scan")
    elif sum(not CLOUDS.keys().isdisjoint(kinds) for kinds in types.values()) > 1:
        yield Choice("topics", topic, "each topic has a command of its own")


def _choices(group: Sequence[Lidar], lidars: Sequence[Lidar], given: Mapping[str, Any]) -> Iterator[Choice]:
    lidar = group[0]
    yield Choice("preset", _PRESET, "beams, limits and times that SLAM and navigation accept")
    given, times = dict(given), list(_times(group))
    static = {lidar.mounting.static_tf: "makes the clouds level" for lidar in group}
    if any(choice.name == "fixed_frame" for choice in times):
        static |= {lidar.assumed: "a guess that it looks ahead, by which only motion is corrected" for lidar in group}
    static.pop("", None)
    if static:
        given["static_tf"] = (*given.get("static_tf", ()), *static)
    reasons = {"odom_topic": "says how the robot moves", "cloud_scale": "makes metres of the clouds' unit"}
    reasons["static_tf"] = "; ".join(dict.fromkeys(static.values())) or "as given"
    for option, value in given.items():
        alone = value[0] if isinstance(value, tuple) and len(value) == 1 else value
        yield Choice(option, alone, reasons.get(option, "as given"))
    if lidar.target:
        is_robot = lidar.target in BODIES or lidar.is_registered
        yield Choice("target_frame", lidar.target, "the robot's frame" if is_robot else "its z points up")
    if (clock := lidar.clock) is not None:
        yield Choice("time_offset", clock.time_offset, clock.text)
    elif any(stamp_faults(lidar.facts) for lidar in group):
        yield Choice("stamps", "log", "its stamps go back, or are 0")
    yield from _heights(group, lidars)
    yield from times
    own = lidar.mounting.frame if lidar.is_registered else ""
    yield from _edge_cuts(group, next((choice.value for choice in times if choice.name == "fixed_frame"), own))
    yield from _exclusions(group)
    yield from _beams(group)


def _beams(group: Sequence[Lidar]) -> Iterator[Choice]:
    """Yield the width of the beams, if the lidars turn and the default one suits none of them, or for a pattern."""
    if len(group) == 1 and (degrees := group[0].pattern[1]) > 1:
        yield Choice("angle_increment", f"{degrees}deg", "the pattern is too sparse for the default beams")
    if not all(lidar.step for lidar in group):
        return
    step = max(lidar.step for lidar in group)
    measured = f"the lidar measures every {math.degrees(step):.3g} deg"
    if step <= _FINE:
        yield Choice("angle_increment", "0.5deg", f"{measured}, finer than the default beams")
    elif step > 1.2 * ProjectionParams().angle_increment:
        wide = math.ceil(2 * math.degrees(step) - 0.1) / 2
        yield Choice("angle_increment", f"{wide:g}deg", f"{measured}, coarser than the default beams")


def _heights(group: Sequence[Lidar], lidars: Sequence[Lidar]) -> Iterator[Choice]:
    """Yield the limits of z, which are those of all lidars that see the same floor in the same frame."""
    lidar, own = group[0], group[0].mounting.heights
    floor = None if own is None else own.floor
    heights = [
        limits
        for other in (lidars if lidar.target else group)
        if (limits := other.mounting.heights) is not None and other.target == lidar.target
        if floor is None or limits.floor is None or abs(limits.floor - floor) < ONE_FLOOR
    ]
    above, below = "no floor is visible: the heights of most points", ""
    if floor is not None:
        above, below = f"above the floor at z = {height_text(floor)} m", "of objects that stand on it"
    yield Choice("min_height", float(f"{max(limits.low for limits in heights):g}"), above)
    yield Choice("max_height", float(f"{max(limits.high for limits in heights):g}"), below)


def _times(group: Sequence[Lidar]) -> Iterator[Choice]:
    """Yield the options about motion, packets and patterns."""
    lidar = group[0]
    turn, clouds = max(lidar.turn for lidar in group), 0 if group[1:] or lidar.pattern[0] == 1 else lidar.pattern[0]
    within_cloud = lidar.motion(lidar.duration or lidar.period or 0.1)
    gathered = turn or clouds * lidar.period or (lidar.period if group[1:] else 0.0)
    within_scan = lidar.motion(gathered) if gathered else within_cloud
    is_level = within_scan is None or not tilts(within_scan.tilt, lambda: lidar.floor_tilt)
    deskews = (not is_level or _moves(within_cloud) or _moves(within_scan)) and all(lidar.duration for lidar in group)
    if turn:
        yield Choice("every", float(f"{turn:.4g}"), f"a cloud is a part of a turn, which takes {turn:.3g} s")
    if clouds:
        seconds = float(f"{clouds * lidar.period:.3g}")
        stands = "" if lidar.world else ", if the robot stands: nothing says how it moves"
        yield Choice("accumulate", f"{seconds:g}s", f"the pattern is sparse: {clouds} clouds fill a scan{stands}")
        yield Choice("reduce", "surface", "the nearest of so many returns would be too near by the noise")
    if deskews and within_scan is not None:
        within = f"{math.degrees(within_scan.radians):.1f} deg within a {'scan' if gathered else 'cloud'}"
        moved = f"the lidar moves by {within_scan.metres:.2f} m and {within}"
        yield Choice("deskew", True, f"points have times ({lidar.time_field}), and {moved}")
    if within_scan is not None and not is_level:
        yield Choice("level", True, f"roll and pitch vary by {math.degrees(within_scan.tilt):.1f} deg")
    fixed = within_scan.fixed if within_scan is not None else lidar.world
    if (deskews or not is_level or turn or clouds or (gathered and _moves(within_scan))) and fixed:
        yield Choice("fixed_frame", fixed, "the frame that does not move with the robot")
    if is_level:
        yield from _level_by_imu(lidar)


def _edge_cuts(lidars: Sequence[Lidar], fixed: str) -> Iterator[Choice]:
    """Yield ``start`` or ``end``, seconds, and why, so that the first and last clouds have transforms; or nothing.

    A cloud is skipped if there is no transform to the fixed frame at its stamp, and loses what it measured without one:
    it is left out if that is most of it. Clouds that lack transforms for longer than all are known are left as they
    are: they may have some.
    """
    buffer, start_ns, (first_ns, last_ns) = lidars[0].buffer, lidars[0].recorded.start_ns or 0, lidars[0].known_ns
    if not fixed or buffer is None:
        return
    # Whether a cloud is lost, its log time after the begin, and how long it lacks transforms.
    first, last = list[tuple[bool, int, int]](), list[tuple[bool, int, int]]()
    for lidar in lidars:
        links = buffer.moving_links(fixed, lidar.moving_frame)
        if not links:
            return
        begin_ns, stop_ns = max(link.first_ns for link in links), min(link.last_ns for link in links)
        middle_ns, tolerance_ns = lidar.middle_ns, ProjectionParams().tolerance_ns
        for header in lidar.facts.headers:
            is_lost = header.stamp_ns + min(middle_ns, tolerance_ns) < begin_ns
            first.append((is_lost, header.log_time_ns - start_ns, begin_ns - header.stamp_ns - min(middle_ns, 0)))
        for header in lidar.facts.last_headers:
            is_lost = header.stamp_ns + max(middle_ns, -tolerance_ns) > stop_ns
            last.append((is_lost, header.log_time_ns - start_ns, header.stamp_ns + max(middle_ns, 0) - stop_ns))
    if lost := [entry for entry in first if entry[0]]:
        (_, after_ns, lacks_ns), by_ns = max(lost), max(entry[2] for entry in lost)
        later = [time_ns for is_lost, time_ns, _ in first if not is_lost and time_ns > after_ns]
        # If all of these packets came too early, later ones are known by their own times.
        after_ns += 0 if later else lacks_ns
        if after_ns + start_ns < first_ns:
            seconds = min([(after_ns // _CUT_NS + 1) * _CUT_NS, *later]) / 1e9
            yield Choice("start", seconds, f"transforms to {fixed} begin {by_ns / 1e9:.2g} s after the first cloud")
    if lost := [entry for entry in last if entry[0]]:
        until_ns, by_ns = min(entry[1] for entry in lost), max(entry[2] for entry in lost)
        earlier = [time_ns for is_lost, time_ns, _ in last if not is_lost and time_ns < until_ns]
        if earlier and until_ns + start_ns > last_ns:
            seconds = min((max(earlier) // _CUT_NS + 1) * _CUT_NS, until_ns) / 1e9
            yield Choice("end", seconds, f"transforms to {fixed} end {by_ns / 1e9:.2g} s before the last cloud")


def _moves(motion: SensorMotion | None, metres: float = _METRES) -> bool:
    """Whether a sensor moves by more than the resolution of its scans, or by more than some metres."""
    return motion is not None and (motion.metres > metres or motion.radians > ProjectionParams().angle_increment)


def _level_by_imu(lidar: Lidar) -> Iterator[Choice]:
    motion = lidar.motion(0.1)
    curves = 0.0 if motion is None else 100 * motion.metres * motion.radians / GRAVITY
    for topic, up in lidar.ups.items():
        # A mount that is assumed says nothing of how the lidar tilts with the IMU.
        buffer = None if lidar.assumed else lidar.buffer
        angle, z = spread_of_up(up.directions), up.z_of(lidar.target or lidar.mounting.frame, buffer)
        if z and tilts(angle, lambda: lidar.floor_tilt, curves * up.is_felt):
            yield Choice("level", True, f"roll and pitch vary by {math.degrees(angle):.1f} deg, by the IMU")
            yield Choice("imu", topic, "no transforms say how the robot tilts")
            return


def _exclusions(group: Sequence[Lidar]) -> Iterator[Choice]:
    """Yield the boxes around the robot's own body, and around the origins of lidars that write zeros for no return."""
    lidar = group[0]
    # The preset rejects points at the origin of the scans' own frame.
    origins = (sensor_exclusion(member.mounting.frame, lidar.target) for member in group if member.has_zeros)
    boxes = {value: "(0, 0, 0) is no return" for option, value in origins if option == "exclude_box"}
    limits = lidar.mounting.heights
    for member in group:
        body, sure = body_of(member.placed, member.sensor, limits.low, limits.high) if limits else ((), False)
        if body:
            box = " ".join((lidar.target or lidar.mounting.frame, *map("{:g}".format, body)))
            close = f"what stays within {_CLOSE:g} m of the lidar: is it the robot's own body?"
            boxes[box] = "returns of the robot's own body" if sure else close
    if boxes:
        value = tuple(boxes)
        yield Choice("exclude_box", value if value[1:] else value[0], ", ".join(dict.fromkeys(boxes.values())))


def odometry_doubts(lidars: Iterable[Lidar]) -> Iterator[str]:
    """Yield what is wrong with the transforms that move the robot, by the frame that a conversion would deskew in."""
    for lidar in lidars:
        if (buffer := lidar.buffer) is None:
            continue
        motion = lidar.motion(0.1)
        # Frames that are the wrong way round move nothing.
        fixed = motion.fixed if motion is not None else next((name for name in WORLDS if name in buffer.frames), "")
        yield odometry_of(buffer, fixed, lidar.mounting.frame).doubt


def _motion_that_stays(lidars: Iterable[Lidar]) -> Iterator[str]:
    """Yield a warning for each lidar that moves much within a cloud whose points have no times."""
    for lidar in lidars:
        motion, turns = lidar.motion(lidar.period or 0.1), lidar.turn or lidar.step
        if motion and turns and _moves(motion, _FAR) and not (lidar.time_field or lidar.is_registered):
            yield (
                f"{lidar.topic}: its points have no times, so scans are distorted by the motion within a cloud, "
                f"{motion.metres:.2f} m and {math.degrees(motion.radians):.1f} deg; "
                "`point_time=azimuth` computes them for `deskew`"
            )
