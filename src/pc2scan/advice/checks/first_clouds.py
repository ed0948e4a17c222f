"""Checks of the first clouds of a topic: limits that reject every point, a floor within the heights, wrong units."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.params import ProjectionParams
from pc2scan.core.percentiles import percentiles
from pc2scan.core.rule import PointCounts
from pc2scan.core.scene import FEWEST_POINTS, MOST_POINTS, CloudSample, far_away, gathered, tolerances
from pc2scan.text import agreeing, counted, height_text
from pc2scan.transforms.frames import BODIES, WORLDS
from pc2scan.transforms.motion import body_in, find_body_motion
from pc2scan.transforms.mounting import is_upside_down, mounting, sensor_exclusion, unit_warning

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from pc2scan.request.spec import ScanSpec
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.mounting import Mounting

#: A scan with fewer points than this share of its beams counts as empty. The share of the cloud's points is no measure:
#: outdoors most points are ground, which scans reject.
_NEARLY_EMPTY = 0.02

#: Points that are farther than 5 cm from the sensor are at most this share of those that scans use: the unit is wrong.
_FEW_FAR = 0.1

#: If the default min_height rejects this share of the points, a warning suggests heights; where the ground is removed
#: before, the second one.
NOTABLE_SHARE = 0.25
_NOTABLE_ABOVE_GROUND = 0.05

#: From this share of beams that end on the floor, or on what is overhead, a warning gives other heights.
_MOST_FLOOR, _FEWEST_BEAMS = 0.3, 20

#: Things on the floor that are higher than this, metres, are obstacles that no scan should miss, and scans that begin
#: above this have none of them.
_OVERLOOKED, _NOTHING_LOW = 0.4, 1.5

#: A sensor that is at least this far below the frame of the scans may be above it, metres.
_BELOW = 0.1

#: Half of a floor this far below the lower limit of z, metres, is above it, because ranges are noisy.
_NOISE = 0.02

#: Filters that may remove the floor, and filters that may remove points at the sensor.
_FLOOR_FILTERS = {"ground", "min_height_slope", "where"}
_PLACE_FILTERS = {"exclude_box", "exclude_polygon", "where"}


@dataclass(slots=True)
class KnownTransforms:
    """The transforms that checks may use.

    Attributes
    ----------
    source_frame
        The frame that replaces the clouds' ``frame_id``; empty if none does.
    read
        Reads the recording's transforms between the robot's frames, in the few cases that need them.
    buffer
        The transforms to the target frame; None where there is no target frame.
    """

    source_frame: str
    read: Callable[[], TransformBuffer | None]
    buffer: TransformBuffer | None = None


@dataclass
class CloudFacts:
    """What checks read of the first clouds of one topic, for one output: one at least.

    Attributes
    ----------
    samples, counts
        A sample of each cloud in the frame of its scan, and its points, by what became of them; in the order of
        writing.
    """

    topic: str
    spec: ScanSpec
    transforms: KnownTransforms
    samples: list[CloudSample] = field(default_factory=list)
    counts: list[PointCounts] = field(default_factory=list)

    @property
    def gathered(self) -> CloudFacts:
        """The facts with parts of a turn or of a pattern together as one cloud."""
        samples = gathered(self.samples)
        is_one = len(samples) < len(self.samples)
        return replace(self, samples=samples, counts=[sum(self.counts, PointCounts())] if is_one else self.counts)

    @property
    def source(self) -> str:
        """The frame of the points."""
        return self.transforms.source_frame or self.samples[0].frame_id

    @cached_property
    def total(self) -> PointCounts:
        """The points of all clouds."""
        return sum(self.counts, PointCounts())

    @cached_property
    def is_level(self) -> bool:
        """Whether the first cloud has a level floor below it, which the transforms leave level."""
        first, floor, own = self.samples[0], self.samples[0].floor, self.source.removeprefix("/")
        if floor is None:
            return False
        # The floor of a cloud that stays in its own frame may be a ceiling.
        if (
            0 < percentiles(first.points[:, 2], 99)[0] < floor.height
            and first.judged_in.removeprefix("/") == own
            and self.robot is not None
            and is_upside_down(self.robot, own, first.stamp_ns)
        ):
            return False
        return self.spec.level or first.floor_elsewhere is None

    @property
    def are_fine(self) -> bool:
        """Whether the first cloud is level, or too small to be judged, and the heights need no advice."""
        total, height = self.total.total - self.no_returns, self.total.height - self.no_returns
        cut = height >= notable_share(self.spec) * max(total, 1) and self.spec.is_default("min_height")
        return (self.is_level or len(self.samples[0].points) < FEWEST_POINTS) and not cut

    @property
    def no_returns(self) -> int:
        """How many of the points outside the heights are at (0, 0, 0), as drivers write for no return."""
        params = self.spec.params
        if any(chosen.name in _PLACE_FILTERS for chosen in self.spec.filters):
            return 0  # these come first
        outside = (
            sample.zeros for sample in self.samples if not params.min_height <= sample.origin[2] <= params.max_height
        )
        return min(sum(outside), self.total.height)

    @cached_property
    def nearest(self) -> NDArray[np.bool_]:
        """Which points of the first cloud's sample are the closest of their beam, of one degree."""
        placed = self.samples[0].placed
        limited = _limited(placed, self.spec.params)
        used = np.logical_and.reduce([(values >= low) & (values <= high) for values, low, high in limited.values()])
        ranges, angles = (limited[limit][0] for limit in ("range", "angle"))
        order = np.flatnonzero(used)[np.argsort(ranges[used])]
        _, first = np.unique(np.degrees(angles[order]).astype(int), return_index=True)
        mask = np.zeros(len(placed), np.bool_)
        mask[order[first]] = True
        return mask

    def share_on(self, up: NDArray[np.float64], height: float) -> float:
        """Return the share of the first cloud's beams, of one degree, whose closest return is on a plane.

        0 if the plane is outside the heights, or if a filter may remove it.
        """
        if any(chosen.name in _FLOOR_FILTERS for chosen in self.spec.filters):
            return 0.0
        sample, params = self.samples[0], self.spec.params
        distances = sample.points @ up + height
        # The plane at the place of each point.
        at = sample.placed[:, 2] - distances / up[2]
        inside = (at > params.min_height - _NOISE) & (at < params.max_height + _NOISE)
        on_plane = (np.abs(distances) < tolerances(sample.points)) & inside
        return float(on_plane[self.nearest].mean()) if self.nearest.sum() >= _FEWEST_BEAMS else 0.0

    @property
    def robot(self) -> TransformBuffer | None:
        """The robot's transforms, which are read for it; None if there are none."""
        known = self.transforms
        return known.read() if known.buffer is None else known.buffer

    @cached_property
    def mounting(self) -> Mounting:
        """How the sensor is mounted, as `info` sees it: with the robot's transforms."""
        return mounting(self.topic, self.source, self.samples, self.robot)

    @cached_property
    def advice(self) -> str:
        """The options that suit the clouds; empty if there was no point.

        The option that excludes points at the sensor is among them, unless a warning has it.
        """
        mounting = self.mounting
        if mounting.heights is None or not mounting.heights.suit:
            return ""
        # The heights apply in the frame that these options make, which may differ from the frame of the scans.
        options = [
            mounting.options,
            f"`min_height={mounting.heights.low:g}`",
            f"`max_height={mounting.heights.high:g}`",
        ]
        if self.samples[0].zeros and self.keep_sensor and not any(map(self.shows_sensor, self.samples)):
            target = mounting.target_frame or self.samples[0].judged_in
            options.append(_without_sensor(mounting.frame, target))
        return " ".join(filter(None, options))

    def shows_sensor(self, sample: CloudSample) -> bool:
        """Return whether points at the sensor itself become returns of the scan."""
        params = self.spec.params
        return sample.zeros > 0 and params.min_height <= sample.origin[2] <= params.max_height and self.keep_sensor

    @property
    def keep_sensor(self) -> bool:
        """Whether nothing but heights removes points at the sensor itself."""
        params, (x, y, _) = self.spec.params, self.samples[0].origin
        return (
            params.range_min <= math.hypot(x, y) <= params.range_max
            and params.angle_min <= math.atan2(y, x) <= params.angle_max
            and not any(chosen.name in _PLACE_FILTERS for chosen in self.spec.filters)
        )


def notable_share(spec: ScanSpec) -> float:
    """Return the share of the points from which on a warning suggests heights, if the default ones reject it."""
    return _NOTABLE_ABOVE_GROUND if any(chosen.name == "ground" for chosen in spec.filters) else NOTABLE_SHARE


def target_that_moves(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning if the robot moves in the target frame: scans are then measured from where the robot is not."""
    target, buffer = clouds.spec.params.target_frame, clouds.transforms.buffer
    if target and buffer is not None and (moving := find_body_motion(buffer, target, clouds.source)) is not None:
        yield moving.of_target(target)


def clouds_in_fixed_frame(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning if clouds are, or claim to be, in a frame that the robot moves in, and stay in it.

    There is none if the recording's transforms say that nothing moves in it.
    """
    frame, own = clouds.source.removeprefix("/"), clouds.samples[0].frame_id.removeprefix("/")
    if clouds.transforms.source_frame and own and (buffer := clouds.robot) is not None:
        # If the transforms do not have the clouds' own frame, another one had to be given.
        moving = find_body_motion(buffer, frame, own)
        if moving is not None:
            yield f"{clouds.topic}: {moving.of_source(frame, own)}"
            return
    if clouds.spec.params.target_frame or frame not in WORLDS:
        return
    body = "" if (buffer := clouds.robot) is None else body_in(buffer, frame)
    if buffer is not None and body and buffer.is_rigid(frame, body):
        return
    cure = (
        f"`target_frame={body}` moves them to the robot"
        if body
        else "convert the topic with the lidar's own clouds, or move them to the robot by `tf_from` and `target_frame`"
    )
    yield (
        f"{clouds.topic}: the clouds are in {frame!r}, a frame that does not move with the robot: the scans are "
        f"measured from its origin instead of from the robot, as SLAM and navigation expect; {cure}"
    )


def returns_at_sensor(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning if points at (0, 0, 0), which many drivers write for no return, become returns of the scan.

    Only the first cloud with such points draws one.
    """
    for sample, counts in zip(clouds.samples, clouds.counts, strict=True):
        if clouds.shows_sensor(sample):
            x, y, _ = sample.origin
            yield (
                f"{clouds.topic}: {sample.zeros:,} of {counted(counts.total, 'point')} of a cloud "
                f"{agreeing(sample.zeros, 'are')} at (0, 0, 0), as drivers write for no return, and become returns at "
                f"the sensor itself, at a range of {math.hypot(x, y):.2f} m in {sample.judged_in!r}; "
                f"{_without_sensor(clouds.source, sample.judged_in)} excludes them"
            )
            return


def frame_not_level(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning if the frame of the scans is tilted, upside down or optical, whatever the output is."""
    # In a frame that is made level, ground that seems tilted by the transform may rise.
    if clouds.mounting.warning and (clouds.mounting.ground.off or not clouds.spec.level):
        yield clouds.mounting.warning


def lossy_clouds(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning if the points are not those that the lidar measured."""
    if text := clouds.samples[0].lossy:
        yield f"{clouds.topic}: {text}"


def clouds_in_another_unit(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning if the points are so far away, or so near, that they are in another unit."""
    sample, counts = clouds.samples[0], clouds.counts[0]
    if distance := far_away(sample.points):
        yield unit_warning(clouds.topic, distance)
    # Points within 5 cm are in no sample.
    elif len(sample.points) * counts.total < _FEW_FAR * counts.used * min(counts.total, MOST_POINTS):
        yield unit_warning(clouds.topic)


def nearly_empty_scans(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning of the limits that reject all points, with the clouds' own values."""
    params, counts = clouds.spec.params, clouds.total
    if not counts.total or counts.used >= _NEARLY_EMPTY * len(clouds.samples) * params.length:
        return
    placed = np.concatenate([sample.placed for sample in clouds.samples])
    descriptions, alone = {}, []
    for reason, (values, low, high) in _limited(placed, params).items() if len(placed) else ():
        names = ("min_height", "max_height") if reason == "height" else (f"{reason}_min", f"{reason}_max")
        what = f"z in {clouds.samples[0].judged_in!r}" if reason == "height" else f"the {reason}"
        unit = "rad" if reason == "angle" else "m"
        first, middle, last = percentiles(values, 5, 50, 95)
        descriptions[reason] = (
            f"{names[0]} is {_limit(low, unit)} and {names[1]} {_limit(high, unit)}, but {what} is "
            f"{first:.2f} to {last:.2f} {unit} (5 and 95 %; median {middle:.2f})"
        )
        if not ((values >= low) & (values <= high)).any():
            alone.append(reason)
    # A limit that alone rejects every point is the cause, whatever is rejected before it.
    reasons = alone or [reason for reason in descriptions if counts.rejected[reason] >= NOTABLE_SHARE * counts.total]
    parts = [descriptions[reason] for reason in reasons]
    if reasons[:1] == ["height"] and clouds.advice:
        parts[0] += f": {clouds.advice}"
    # Without any, the reason is a filter, or NaN: the report has it at the end.
    if parts:
        which = f"the first {counted(len(clouds.samples), 'cloud')}" if clouds.samples[1:] else "the first cloud"
        share = f"{counts.used:,} of the {counts.total:,} points of {which} are used"
        yield f"{clouds.topic}: {share}; {'; '.join(parts)}"


def floor_within_heights(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning if many beams end on the floor, with its own height."""
    sample, params = clouds.samples[0], clouds.spec.params
    floor = sample.floor
    # The floor of a level frame is level: that of a robot that tilts turns within a cloud.
    up = (0.0, 0.0, 1.0) if floor is None or clouds.spec.level else floor.normal
    share = 0.0 if floor is None else clouds.share_on(np.array(up), floor.height)
    if floor is None or share < _MOST_FLOOR or any(nearly_empty_scans(clouds)):
        return
    below = f"min_height is {_limit(params.min_height, 'm')}"
    at = height_text(sample.origin[2] - floor.height)
    yield (
        f"{clouds.topic}: the floor is within the heights: it is at z = {at} m in {sample.judged_in!r}, and {below}; "
        f"{share:.0%} of the beams with a return end on it"
        + (f"; without it: {clouds.advice}" if clouds.advice else "")
    )


def heights_above_floor(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning if the lowest height is far above the floor: of a sensor that is mounted, or by another unit."""
    sample, spec, low = clouds.samples[0], clouds.spec, clouds.spec.params.min_height
    target, floor = spec.params.target_frame, sample.floor
    # If the sensor is below the frame, and the heights are above it, z may have the wrong sign.
    is_below = sample.origin[2] < -_BELOW and low > 0
    if floor is None or (spec.is_default("min_height") and not is_below):
        return
    above = low - sample.origin[2] + floor.height
    is_robot = target.removeprefix("/") in BODIES
    if target and (is_robot or is_below) and above > (_OVERLOOKED if is_below else _NOTHING_LOW):
        cure = "is another `cloud_scale` right, or another transform (the parent comes first)?"
    elif not target and low > 0 and above > _OVERLOOKED and clouds.mounting.target_frame in BODIES:
        cure = f"heights above the floor: {clouds.advice}"
    else:
        return
    yield (
        f"{clouds.topic}: min_height is {round(low, 3):g} m above {target or clouds.source!r}, and {above:.2f} m above "
        f"the floor; {cure}"
    )


def ceiling_within_heights(clouds: CloudFacts) -> Iterator[str]:
    """Yield a warning if many beams end on what is overhead, with the height that ends it."""
    sample, params = clouds.samples[0], clouds.spec.params
    ground, height = sample.ground, sample.ground.ceiling
    # A ceiling is parallel to the floor.
    share = 0.0 if height is None else clouds.share_on(-np.array(ground.normal), height)
    if height is None or share < _MOST_FLOOR or any(nearly_empty_scans(clouds)) or any(clouds_in_another_unit(clouds)):
        return
    at = sample.origin[2] + height
    yield (
        f"{clouds.topic}: the ceiling is within the heights: it is at z = {height_text(at)} m in {sample.judged_in!r}, "
        f"and max_height is {_limit(params.max_height, 'm')}; {share:.0%} of the beams with a return end on it; "
        f"`max_height={math.floor(100 * at - 20) / 100:g}` ends below it"
    )


def _limited(
    placed: NDArray[np.float64], params: ProjectionParams
) -> dict[str, tuple[NDArray[np.float64], float, float]]:
    """Return the limited quantities of points, (N,), with their limits."""
    x, y, z = placed.T
    return {
        "height": (z, params.min_height, params.max_height),
        "range": (np.hypot(x, y), params.range_min, params.range_max),
        "angle": (np.arctan2(y, x), params.angle_min, params.angle_max),
    }


def _without_sensor(frame: str, target: str) -> str:
    option, value = sensor_exclusion(frame, target)
    return f"`{option}={shlex.quote(value)}`"


def _limit(value: float, unit: str) -> str:
    """Return a limit as text: upstream's defaults mean no limit."""
    if value == ProjectionParams().min_height:
        return f"above 0 {unit}"
    return "without limit" if abs(value) > 1e300 else f"{value:g} {unit}"
