"""Judges how the frame of clouds is mounted, which options make it level, and which heights suit its scans.

It uses the ground in a few clouds (`pc2scan.core.scene`), and the recording's transforms, if it has any.
"""

from __future__ import annotations

import math
import re
import shlex
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.percentiles import percentiles
from pc2scan.core.rigid import Rigid
from pc2scan.core.scene import (
    LEVEL,
    ONE_FLOOR,
    Ground,
    cells_of,
    common_ground,
    far_away,
    find_ground,
    floor_elsewhere,
    gathered,
    sectors_of,
    tolerances,
)

from .buffer import mount_text
from .frames import BODIES, WORLDS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pc2scan.core.scene import CloudSample

    from .buffer import TransformBuffer

    _Samples = Sequence[NDArray[np.float64]]

#: Transforms that tilt a sensor by more than this, radians, are reported even if no ground is visible.
_NOTABLE_TILT = math.radians(10.0)

#: Scans are from the first height above the floor, or from up to the second one where the ground is rough, to the third
#: one, and so far below what is overhead; between them is at least so much, metres.
_LOW, _ROUGHEST, _HIGH, _BELOW_CEILING, _THINNEST = 0.1, 0.3, 1.5, 0.2, 0.3

#: Without a floor: so far from the sensor's height, metres.
_AROUND = 0.4

#: The least share of the points that heights are judged by, the largest below a floor that they do not show, and below
#: one that is visible. No ceiling is lower than so much above the floor, metres.
_FEWEST_SHARE, _MOST_BELOW, _FEW_BELOW, _LOWEST_CEILING = 0.001, 0.05, 0.02, 1.8

#: What is nearer than this share of the farthest in a direction, so many degrees wide, is before a wall. So many cells
#: of it may be noise. Lidars of robots are at most so high, metres.
_BEFORE, _WIDE, _STRAY, _HIGHEST = 0.8, 5.0, 5, 2.2

#: Names that `static_tf` can have: without blanks and commas, which separate its parts.
_WORD = re.compile(r"[^\s,]+")


class Heights(NamedTuple):
    """Limits of z that suit scans, metres.

    Attributes
    ----------
    low, high
        The limits; equal if none suit.
    floor, ceiling
        The heights of floor and ceiling; None: not known.
    question
        What the recording says of the floor, and the clouds show otherwise; empty if they agree.
    doubt
        What is not known, so that the limits may be wrong; empty if nothing is.
    """

    low: float
    high: float
    floor: float | None = None
    ceiling: float | None = None
    question: str = ""
    doubt: str = ""

    @property
    def suit(self) -> bool:
        """Whether there are limits that suit."""
        return self.low < self.high


class Mounting(NamedTuple):
    """How the clouds of a topic are mounted.

    Attributes
    ----------
    topic, frame
        The topic of the clouds, and their ``frame_id``.
    judged_in
        The frame in which they were judged: their own, or a target frame.
    ground
        The ground in this frame.
    fault
        What is wrong with this frame, as text; empty if nothing is, or if there is not enough evidence.
    target_frame, static_tf
        The options that make the clouds level; empty if none are needed (``target_frame`` may be the robot's frame
        even if nothing is wrong).
    heights
        Heights that suit scans in the frame of these options; None if there was no point.
    samples
        The points that were judged.
    """

    topic: str
    frame: str
    judged_in: str
    ground: Ground
    samples: Sequence[NDArray[np.float64]]
    fault: str = ""
    target_frame: str = ""
    static_tf: str = ""
    heights: Heights | None = None

    @property
    def options(self) -> str:
        """The options that make the clouds level, as written in messages; empty if unknown."""
        static = f"`static_tf={shlex.quote(self.static_tf)}` " if self.static_tf else ""
        return f"{static}`target_frame={shlex.quote(self.target_frame)}`" if self.target_frame else ""

    @property
    def cure(self) -> str:
        """How to make the clouds level, as a sentence; empty if unknown."""
        if not self.target_frame:
            return mount_text(self.frame.removeprefix("/"), ()) if self.ground.kind == "slanted" else ""
        floor = None if self.heights is None or not self.static_tf else self.heights.floor
        at = "" if floor is None else f", with the floor at z = {_short(floor, 2)} m"
        return f"{self.options} makes it level{at}"

    @property
    def warning(self) -> str:
        """The observed and the expected mounting, and the options that correct it; empty if nothing is wrong."""
        if not self.fault:
            return ""
        return f"{self.topic}: frame {self.judged_in!r} is {self.fault}" + (f". {self.cure}" if self.cure else "")


def unit_warning(topic: str, distance: float = 0.0) -> str:
    """Return the warning that a cloud is in another unit than metres, by the median distance of its points.

    0: nearly all of them are so near that they are in no sample.
    """
    if not distance:
        return (
            f"{topic}: nearly all points are within 5 cm of the sensor, so they are in another unit than metres; "
            "`cloud_scale` is the factor that makes metres of them"
        )
    return (
        f"{topic}: the points are {distance:,.0f} m away (median), so they are in another unit: in millimetres "
        f"that is {distance / 1000:.3g} m (`cloud_scale=0.001` corrects it), in centimetres "
        f"{distance / 100:.3g} m (`cloud_scale=0.01`)"
    )


def mounting(
    topic: str,
    frame: str,
    clouds: Sequence[CloudSample],
    buffer: TransformBuffer | None = None,
    up: float = 0.0,
) -> Mounting:
    """Judge how clouds are mounted.

    Parameters
    ----------
    topic, frame
        The topic of the clouds, and the frame of their points.
    clouds
        The first clouds, in the frame of the scans: one at least.
    buffer
        The recording's transforms; None if there are none.
    up
        1 if an IMU, or how the lidar turns, says that z points up: in the robot's frame by the recorded mount, without
        one in the frame of the points; -1 if it points down; 0: not known.
    """
    clouds = gathered(clouds)
    judged_in, origin_z, stamp_ns = clouds[0].judged_in, clouds[0].origin[2], clouds[0].stamp_ns
    samples, transform = [cloud.points for cloud in clouds], clouds[0].transform
    recorded = 0.0 if transform is None else _recorded_floor(buffer, judged_in, stamp_ns)
    looks = _looks(samples, origin_z - recorded) if recorded else [cloud.ground for cloud in clouds]
    ground = common_ground(looks) if transform is None else _believed(looks, samples, origin_z - recorded, up)
    # In a world's frame, z points up.
    ground = Ground("unknown") if ground.off and frame.removeprefix("/") in WORLDS else ground
    seen = Mounting(topic, frame, judged_in, ground, samples)
    if transform is not None:
        if wrong := _wrong(seen, ground, judged_in, transform, recorded, up):
            return wrong
        heights = suitable_heights(ground, samples, frame=judged_in, origin_z=origin_z, recorded=recorded)
        return seen._replace(fault=_fault(ground) if ground.off else "", heights=heights)
    if buffer is not None and (by_transforms := _by_transforms(seen, buffer, stamp_ns, up)):
        return by_transforms
    own = _by_clouds(seen)
    is_seen = bool(own.ground.height or own.ground.ceiling)
    if own.static_tf or not (up < 0 or (not up and is_seen and _may_be_ceiling(own.ground, samples))):
        return own
    over = _by_clouds(seen._replace(ground=_ground_above(samples)))
    if over.ground.height and (up or (over.ground.height <= _HIGHEST and not 0 < own.ground.height <= _HIGHEST)):
        own, over = over, own
    return own if up else own._replace(heights=_doubted(own, over))


def _by_clouds(seen: Mounting) -> Mounting:
    """Return how clouds are mounted by what they show alone."""
    ground = seen.ground
    if not ground.off or (ground.kind == "slanted" and ground.up is None):
        return seen._replace(fault=_fault(ground), heights=suitable_heights(ground, seen.samples))
    level = Rigid.from_rpy(*ground.level_from_frame, (0.0, 0.0, ground.height))
    name = f"{seen.frame.removeprefix('/')}_level"
    return _mounted_on(seen, name, level, suitable_heights(ground, seen.samples, level))


def _ground_above(samples: _Samples) -> Ground:
    """Return the ground if the sensor is upside down."""
    over = common_ground([find_ground(points * (1.0, -1.0, -1.0)) for points in samples])
    x, y, z = over.normal
    return over._replace(kind="upside-down", up=(x, -y, -z)) if over.kind == "level" else Ground("unknown")


def _doubted(likely: Mounting, other: Mounting) -> Heights | None:
    """Return the heights of a mounting, with the question whether the sensor is mounted the other way."""
    if likely.heights is None or not (other.heights and other.heights.suit):
        return likely.heights
    way, options = ("upright", "without `static_tf`,") if likely.static_tf else ("upside down", other.options)
    limits = f"`min_height={other.heights.low:g}` `max_height={other.heights.high:g}`"
    text = "no transform and no IMU says that z points up, and what seems the floor may be the ceiling"
    return likely.heights._replace(doubt=f"{text}: is the sensor {way}? if so, {options} {limits}")


def _may_be_ceiling(ground: Ground, samples: _Samples) -> bool:
    """Return whether what seems the floor may be the ceiling: more hangs than stands, or it is far away."""
    cells = cells_of(np.concatenate(samples))
    ranges, height = np.hypot(cells[:, 0], cells[:, 1]), cells @ np.array(ground.normal)
    low, top = percentiles(height, 1, 99)
    low = -ground.height or low
    top = (top if ground.ceiling is None else ground.ceiling) - low
    height -= low
    between = np.minimum(height, top - height) > 3 * tolerances(cells)
    # Walls are what is farthest away in a direction.
    direction, wall = sectors_of(cells, _WIDE), np.zeros(math.ceil(360 / _WIDE))
    np.maximum.at(wall, direction[between], ranges[between])
    before = between & (ranges < _BEFORE * wall[direction])
    stands, hangs = (int(np.count_nonzero(before & part)) for part in (height < top / 2, height >= top / 2))
    return bool(hangs > 2 * stands + _STRAY or (ground.height > _HIGHEST and stands <= max(_STRAY, hangs)))


def _mounted_on(seen: Mounting, parent: str, parent_from_frame: Rigid, heights: Heights | None) -> Mounting:
    """Return the mounting with another transform of the frame."""
    static = static_tf_of(parent, seen.frame, parent_from_frame)
    return seen._replace(fault=_fault(seen.ground), target_frame=static and parent, static_tf=static, heights=heights)


def _corrected(seen: Mounting, target: str, target_from_frame: Rigid, ground: Ground, recorded: float) -> Mounting:
    """Return the mounting with the recorded transform turned over if that is all, or rotated until the ground is level.

    ``ground`` is the ground by the recorded transform; the samples are in its axes; for ``recorded``, see
    `suitable_heights`.
    """
    matrix, z = target_from_frame.matrix, float(target_from_frame.translation[2])
    # It looks where it does by its transform: along its x axis, or along z if y is upright, as that of a camera.
    is_optical = ground.kind == "optical"
    is_camera = is_optical or abs(matrix[2, 1]) > 0.7
    x, y = (1.0, 0.0) if is_optical else matrix[:2, 2 * is_camera]
    up = (np.array(ground.normal) @ matrix).tolist()
    own = Ground("optical" if is_camera else "tilted", ground.up and (up[0], up[1], up[2]))
    roll, pitch, yaw = own.level_from_frame
    right = Rigid.from_rpy(roll, pitch, yaw + math.atan2(y, x), target_from_frame.translation)
    # The tilt that is left is that of the robot, or of the ground. A camera that is turned over looks ahead.
    over = Rigid.from_rpy(0.0, 0.0, math.pi) if is_camera and x > 0 else Rigid.from_rpy(math.pi, 0.0, 0.0)
    over = target_from_frame.compose(over)
    right = over if over.matrix[2] @ up > math.cos(LEVEL) else right
    moved = [right.rotation.apply(points @ matrix) for points in seen.samples]
    corrected = _believed(_looks(moved, z - recorded), moved, z - recorded, 1.0)
    heights = suitable_heights(corrected, moved, frame=target, origin_z=z, recorded=recorded)
    return _mounted_on(seen, target, right, heights)


def _looks(samples: _Samples, height: float) -> list[Ground]:
    """Return the ground in each cloud by a transform that says how high the sensor is; see `Ground.believed`."""
    return [find_ground(points).believed(points, height) for points in samples]


def _believed(looks: Sequence[Ground], samples: _Samples, height: float, up: float) -> Ground:
    """Return the ground of which a transform says how far below the sensor it is, by what is seen in each cloud."""
    ground = common_ground(looks)
    return Ground("unknown") if ground.off and _is_ceiling(ground, samples, height, up) else ground


def _by_transforms(seen: Mounting, buffer: TransformBuffer, stamp_ns: int, up: float) -> Mounting | None:
    """Return what the transforms say about the frame; None if they neither help nor contradict."""
    ground, body = seen.ground, _body(buffer, seen.frame, stamp_ns)
    if body is None:
        # No frame is known to be level, so a new frame that makes the clouds level is used.
        for name in buffer.above(seen.frame) if ground.off else ():
            if name in WORLDS or (moved := _lookup(buffer, name, seen.frame, stamp_ns)) is None:
                return None
            if ground.up is not None and float((moved.matrix @ np.array(ground.up))[2]) > math.cos(LEVEL):
                heights = suitable_heights(ground, seen.samples, moved)
                return seen._replace(fault=_fault(ground), target_frame=name, heights=heights)
        return None
    name, body_from_frame = body
    recorded = _recorded_floor(buffer, name, stamp_ns)
    height = float(body_from_frame.translation[2]) - recorded
    samples = [body_from_frame.rotation.apply(points) for points in seen.samples]
    body_ground = _believed(_looks(samples, height), samples, height, up)
    ground = ground.believed(seen.samples[0], height) if ground.off and body_ground.kind != "level" else ground
    placed = seen._replace(ground=ground if ground.off else body_ground, samples=samples)
    tilt = body_from_frame.tilt
    # A transform that tilts the frame says why it is slanted.
    is_slanted = body_ground.kind == "unknown" and ground.kind == "slanted" and tilt <= LEVEL
    if (wrong := _wrong(placed, body_ground, name, body_from_frame, recorded, up)) or body_ground.off or is_slanted:
        return wrong
    heights = suitable_heights(body_ground, samples, frame=name, origin_z=height + recorded, recorded=recorded)
    # The transform says which of the slanted planes is the floor.
    fault = "" if ground.kind == "slanted" and tilt > LEVEL else _fault(ground)
    if not fault and tilt > _NOTABLE_TILT:
        how = "upside down" if tilt > math.pi - _NOTABLE_TILT else f"tilted by {math.degrees(tilt):.1f} deg"
        fault = f"{how} according to its transform to {name!r}; expected z up"
    # The floor may be another one than that of the frame itself, which is not where the transform says.
    ground = seen.ground._replace(height=body_ground.height)
    return seen._replace(ground=ground, fault=fault, target_frame=name, heights=heights)


def _wrong(seen: Mounting, ground: Ground, target: str, moved: Rigid, recorded: float, up: float) -> Mounting | None:
    """Return the mounting of a sensor that its transform turns wrongly; None if it does not, or it is not known how.

    ``ground`` is the ground by the transform, in whose axes the samples are; for ``recorded``, see `suitable_heights`.
    """
    if up < 0:
        x, y, z = (moved.matrix * (1.0, -1.0, -1.0) @ moved.matrix[2]).tolist()
        over = _corrected(seen, target, moved, Ground("upside-down", (x, y, z)), recorded)
        return over._replace(fault=f"upside down against its transform to {target!r}, by how it turns, or by an IMU")
    height, samples = float(moved.translation[2]) - recorded, seen.samples
    floors = [floor for points in samples if (floor := floor_elsewhere(points, moved.matrix, height, ground))]
    # A level floor elsewhere contradicts the transform, too.
    is_ceiling = bool(floors and (up or not ground.height)) and _is_ceiling(floors[0], samples, height, up)
    if not floors or 2 * len(floors) < len(samples) or is_ceiling:
        is_known = ground.off and "slanted" not in {seen.ground.kind, ground.kind}
        return _corrected(seen, target, moved, ground, recorded) if is_known else None
    floor = floors[0]
    how = f"tilted by {math.degrees(floor.tilt):.1f} deg by it, with {_direction(floor.normal)} up"
    fault = f"placed by a wrong transform: {target} is {how}, if the floor is the plane {floor.height:.2f} m away"
    return _corrected(seen, target, moved, floor, recorded)._replace(fault=fault)


def _is_ceiling(floor: Ground, samples: _Samples, height: float, up: float) -> bool:
    """Return whether a floor overhead is a ceiling: it is known which way is up, or nothing contradicts the transform.

    Points below the floor by the transform do, and a height at which there is no ceiling.
    """
    below = samples[0][:, 2] < -height - ONE_FLOOR - LEVEL * np.linalg.norm(samples[0], axis=1)
    return floor.normal[2] < -0.5 and (bool(up) or (2 * height > _LOWEST_CEILING and below.mean() < _FEW_BELOW))


def static_tf_of(parent: str, child: str, rigid: Rigid) -> str:
    """Return the text of `static_tf`; empty if it cannot have such a name."""
    if not (_WORD.fullmatch(parent) and _WORD.fullmatch(child)):
        return ""
    numbers = [*(_short(x, 3) for x in rigid.translation.tolist()), *(_short(x, 4) for x in rigid.rpy)]
    return " ".join((parent, child, *numbers))


def _short(number: float, digits: int) -> str:
    """Return a rounded number without trailing zeros."""
    return f"{round(number, digits) + 0.0:.10g}"


def is_upside_down(buffer: TransformBuffer, frame: str, stamp_ns: int) -> bool:
    """Return whether a frame is upside down by its transform to the robot's frame."""
    body = _body(buffer, frame, stamp_ns)
    return body is not None and body[1].tilt > math.pi - _NOTABLE_TILT


def _body(buffer: TransformBuffer, frame: str, stamp_ns: int) -> tuple[str, Rigid] | None:
    """Return the robot's frame, and the transform of another one to it; None if they are the same, or not connected."""
    names = (name for name in BODIES if name in buffer.frames and name != frame.removeprefix("/"))
    return next(((name, moved) for name in names if (moved := _lookup(buffer, name, frame, stamp_ns))), None)


def _recorded_floor(buffer: TransformBuffer | None, frame: str, stamp_ns: int) -> float:
    """Return how high base_footprint, which is on the floor, is in a frame of the robot; 0 if it is not known."""
    if buffer is None or "base_footprint" not in buffer.frames:
        return 0.0
    moved = _lookup(buffer, frame, "base_footprint", stamp_ns)
    return 0.0 if moved is None else float(moved.translation[2])


def _lookup(buffer: TransformBuffer, target: str, source: str, stamp_ns: int) -> Rigid | None:
    """Return a transform at a stamp, or the latest one: the mounting of a sensor does not change."""
    return buffer.known(target, source, stamp_ns) or buffer.known(target, source, 0)


def _fault(ground: Ground) -> str:
    """Return what is wrong with a frame, by the ground in it: observed, and expected."""
    seen = f"in {ground.clouds} of {ground.sampled} checked clouds" if ground.sampled > 1 else "in one cloud"
    if ground.kind == "optical":
        at = "" if ground.up is None else f", and up is {_direction(ground.up)}"
        return f"an optical frame: z points forward{at} {seen}; expected z up"
    if ground.kind == "slanted":
        floor = "not known" if ground.up is None else f"perhaps the one at {math.degrees(ground.tilt):.1f} deg"
        return f"slanted: floor and walls are neither level nor upright {seen}, the floor is {floor}; expected z up"
    if not ground.off or ground.up is None:
        return ""
    how = f"tilted by {math.degrees(ground.tilt):.1f} deg"
    if ground.kind == "upside-down":
        how = f"upside down, and {how}" if ground.tilt > LEVEL else "upside down"
    normal = ", ".join(_short(part, 2) for part in ground.up)
    return f"{how}: the ground is {ground.height:.2f} m away, its normal is ({normal}) {seen}; expected (0, 0, 1)"


def _direction(up: tuple[float, float, float]) -> str:
    """Return a direction as text: as an axis if it is near one."""
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) > math.cos(LEVEL):
        return ("-" if up[axis] < 0 else "+") + "xyz"[axis]
    return "(" + ", ".join(_short(part, 2) for part in up) + ")"


def suitable_heights(
    ground: Ground,
    samples: Sequence[NDArray[np.float64]],
    target_from_frame: Rigid | None = None,
    *,
    frame: str = "",
    origin_z: float = 0.0,
    recorded: float = 0.0,
) -> Heights | None:
    """Return heights that suit scans: above the floor, below the ceiling, and at obstacles of a robot.

    Parameters
    ----------
    ground, samples
        The ground in the samples' frame, and points of some clouds, metres, relative to the sensor.
    target_from_frame
        The transform to the frame of the heights; None for the samples' frame, in which the sensor is at ``origin_z``.
    frame, recorded
        The robot's frame, if the recording says where the sensor is in it, and the floor in it by the recording.

    Notes
    -----
    0.1 to 1.5 m above the floor, or more where the ground is rough, and 0.2 m below what is overhead. Without a floor,
    around the sensor: what is visible there is no floor.
    """
    points = [points for points in samples if len(points)]
    if not points or far_away(points[0]):
        return None
    moved = target_from_frame or Rigid.from_pose((0.0, 0.0, origin_z, 0.0, 0.0, 0.0, 1.0))
    z = moved.apply(np.concatenate(points))[:, 2]
    sensor = float(moved.translation[2])
    floor, question, least = None, "", _LOW
    ceiling = None if ground.ceiling is None else sensor + ground.ceiling
    if ground.height:
        floor = float(moved.apply(np.array([ground.normal]) * -ground.height)[0, 2])
        least = min(_ROUGHEST, max(_LOW, 1.5 * ground.rough))
    if frame and sensor > recorded + ONE_FLOOR:
        off = 0.0 if floor is None else recorded - floor
        # A plane that is fitted over a floor and a ramp is as rough as it is off.
        if abs(off) > max(ONE_FLOOR + 0.03 * (sensor - recorded), ground.rough):
            side = "above" if off > 0 else "below"
            name, at = (frame, "its z = 0") if not recorded else ("base_footprint", "it")
            question = f"{name} is {abs(off):.2f} m {side} the floor that the clouds show: is {at} the floor?"
        else:
            below = 0.0 if ground.height else float((z < recorded - _LOW - tolerances(np.concatenate(points))).mean())
            if below > _MOST_BELOW:
                question = f"{below:.0%} of the points are below it: does the sensor tilt as its transform says?"
            floor = recorded
    top = math.inf if ceiling is None else ceiling - _BELOW_CEILING
    if floor is None:
        heights = _around(z, sensor, top)
        text = f"the sensor is {recorded - sensor:.2f} m below base_footprint by its transform: how high is it?"
        return heights._replace(doubt=text) if recorded and sensor < recorded else heights
    low, high, doubt = floor + least, min(floor + _HIGH, top), ""
    shown = "no scan is proposed; `pc2scan view` shows them"
    if high - low < _THINNEST:
        overhead = top + _BELOW_CEILING - floor
        high, doubt = low, f"only {overhead:.2f} m are between the floor and what is overhead: {shown}"
    elif ((z >= low) & (z <= high)).mean() < _FEWEST_SHARE:
        # There is no object on the ground, or the sensor is above all of them.
        doubt = f"no point is between {low:.2f} and {high:.2f} m, above the floor at z = {floor:.2f} m: {shown}"
        high = low
    return Heights(_round_down(low + 0.005), _round_down(high + 0.005), floor, ceiling, question, doubt)


def _around(z: NDArray[np.float64], sensor: float, top: float) -> Heights:
    """Return heights around a sensor that sees no floor."""
    fifth, last = percentiles(z, 5, 95)
    if last - fifth < _THINNEST:
        # A planar lidar has one height, so its scans need some margin around it.
        middle = (fifth + last) / 2
        return Heights(_round_down(middle - _THINNEST / 2), _round_down(middle + _THINNEST / 2))
    low, high = max(fifth, sensor - _AROUND), min(last, sensor + _AROUND, top)
    if high - low < _THINNEST or ((z >= low) & (z <= high)).mean() < _FEWEST_SHARE:
        low, high = fifth, max(min(last, top), fifth + _THINNEST)
    doubt = "no floor is visible, and no transform says how high the sensor is; the heights are those around the sensor"
    return Heights(_round_down(low), -_round_down(-high), doubt=doubt)


def sensor_exclusion(frame: str, target: str) -> tuple[str, str]:
    """Return the option that excludes points at the sensor itself, and its value.

    `range_min` is measured from the origin of the scans' frame, ``target``.
    """
    if target.removeprefix("/") in {"", frame.removeprefix("/")}:
        return "range_min", "0.1"
    return "exclude_box", f"{frame} -0.05 0.05 -0.05 0.05 -0.05 0.05"


def _round_down(value: float) -> float:
    """Round down to a centimetre."""
    return round(math.floor(value * 100) / 100, 2) + 0.0
