"""Checks of the first clouds of a conversion: wrong frames, limits that reject every point, wrong units.

The threads that convert take a sample of each cloud that may be among the first, until enough samples have been judged.
Samples are judged in the order of writing, so the warnings do not depend on the number of threads. A level floor in the
first cloud ends the check within a millisecond.
"""

from __future__ import annotations

import math
import shlex
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.counts import PointCounts
from pc2scan.core.level import cells_of, level_floor, thinned, tolerances
from pc2scan.core.params import ProjectionParams
from pc2scan.shown import agreeing, counted

from .parameters import from_preset

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.level import Floor
    from pc2scan.core.points import Points
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.mounting import Mounting
    from pc2scan.tf.options import StaticTransform
    from pc2scan.tf.placing import Placement

    from .report import Report
    from .scan_spec import ScanSpec
    from .topic_report import TopicReport

__all__ = ["Candidate", "FirstClouds", "Sample", "TopicClouds"]

#: How many clouds are judged together if the first one is not enough, and how many points of each.
_CLOUDS = 3
_POINTS = 2_000

#: With fewer points than this, a cloud is not judged.
_FEWEST_POINTS = 300

#: A scan with fewer points than this share of its beams counts as empty. The share of the cloud's points is no measure:
#: outdoors most points are ground, which scans reject.
_NEARLY_EMPTY = 0.02

#: If the default min_height rejects this share of the points, a warning suggests heights.
_NOTABLE_SHARE = 0.25

#: From this share of beams that end on the floor, a warning gives heights above it.
_MOST_FLOOR = 0.3
_FEWEST_BEAMS = 20

#: A transform is taken for swapped if the sensor is at least this far below the robot's frame, metres, and as far as it
#: is above the floor, but for this share.
_BELOW = 0.1
_NEAR_FLOOR = 0.3

#: Half of a floor this far below the lower limit of z, metres, is above it, because ranges are noisy.
_NOISE = 0.02

#: Filters that may remove the floor, and filters that may remove points at the sensor.
_FLOOR_FILTERS = {"ground", "min_height_slope", "where"}
_PLACE_FILTERS = {"exclude_box", "exclude_polygon", "where"}

#: A height limit from here on, metres, is taken for millimetres if the clouds are ten times lower.
_TALL = 50.0


class Sample(NamedTuple):
    """Some points of a cloud, relative to the sensor along the axes of the scan's frame, and the sensor's position."""

    clouds: TopicClouds
    frame_id: str
    scan_frame: str
    stamp_ns: int
    points: NDArray[np.float64]
    origin: tuple[float, float, float]
    zeros: int

    @property
    def placed(self) -> NDArray[np.float64]:
        """The points in the scan's frame."""
        return np.asarray(self.points + self.origin)


class Candidate(NamedTuple):
    """A cloud that may be among the first ones, as long as its message is in memory."""

    clouds: TopicClouds
    points: Points
    place: Placement

    def sample(self, log_time_ns: int) -> Sample | None:
        """Return a sample of the cloud's points; None if it is not among the first. On any thread."""
        clouds = self.clouds
        return clouds.sample(self.points, self.place) if clouds.may_be_first(log_time_ns) else None


class FirstClouds:
    """The first clouds of every topic that is converted.

    Parameters
    ----------
    report
        Receives warnings and notes.
    warn
        Also called with each warning immediately, so that a user can stop a conversion that makes empty scans.
    transforms
        Reads the recording's transforms between the robot's frames, in the few cases that need them.

    Attributes
    ----------
    buffer
        The transforms to the target frame; None where there is no target frame.
    static
        The transforms that options add.
    """

    def __init__(
        self,
        report: Report,
        warn: Callable[[str], None] | None,
        transforms: Callable[[], TransformBuffer | None],
    ) -> None:
        self.report = report
        self.transforms = transforms
        self.buffer: TransformBuffer | None = None
        self.static: Sequence[StaticTransform] = ()
        self._warn = warn
        self._topics: dict[tuple[str, ScanSpec], TopicClouds] = {}

    def of(self, spec: ScanSpec, topic: str) -> TopicClouds:
        """Return the checks of one topic for one output; the publishers of a topic share them."""
        return self._topics.setdefault((topic, spec), TopicClouds(topic, spec, self))

    def warn(self, text: str) -> None:
        """Warn immediately, but only once of what concerns several outputs."""
        if text in self.report.warnings:
            return
        self.report.warnings.append(text)
        if self._warn is not None:
            self._warn(text)

    def finish(self) -> None:
        """Judge topics that have fewer clouds than usual."""
        for clouds in self._topics.values():
            clouds.finish()


class TopicClouds:
    """The first clouds of one topic, for one output.

    Attributes
    ----------
    full
        Whether enough clouds have been judged; all threads read it.
    """

    def __init__(self, topic: str, spec: ScanSpec, every: FirstClouds) -> None:
        self.full = False
        self._topic = topic
        self._spec = spec
        self._every = every
        self._samples: list[Sample] = []
        self._earliest: list[int] = []
        self._counts = PointCounts()
        self._zeros_reported = False

    def may_be_first(self, log_time_ns: int) -> bool:
        """Return whether fewer clouds than are judged were converted from earlier log times; on any thread.

        Threads convert hundreds of small clouds before the first one is written. All clouds that are judged pass,
        whatever the order in which threads convert them: only earlier ones are written before them. If two threads
        change the list at once, it lacks one log time, and more clouds pass.
        """
        earliest = self._earliest
        if len(earliest) == _CLOUDS and earliest[-1] < log_time_ns:
            return False
        self._earliest = sorted([*earliest, log_time_ns])[:_CLOUDS]
        return True

    def sample(self, points: Points, place: Placement) -> Sample:
        """Return a sample of a cloud's points; on any thread."""
        x, y, z = points.xyz()
        taken, moved = thinned(x, y, z, _POINTS), place.target_from_source
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            zeros = int(np.count_nonzero((x == 0) & (y == 0) & (z == 0)))
        origin = (0.0, 0.0, 0.0)
        if moved is not None:
            taken, origin = moved.rotation.apply(taken), tuple(moved.translation.tolist())
        return Sample(self, points.frame_id, place.frame_id, points.stamp_ns, taken, origin, zeros)

    def add(self, sample: Sample, counts: PointCounts) -> None:
        """Add the next cloud, in the order of writing."""
        if self.full:
            return
        self._samples.append(sample)
        self._counts += counts
        if len(self._samples) == 1:
            self._check_target(sample)
        if sample.zeros and not self._zeros_reported:
            self._check_zeros(sample, counts)
        if len(self._samples) == 1 and self._is_fine():
            self.full = True
        elif len(self._samples) == _CLOUDS:
            self.finish()

    def _check_target(self, sample: Sample) -> None:
        """Warn if the robot moves in the target frame: the scans are then measured from where the robot is not."""
        target, buffer = self._spec.params.target_frame, self._every.buffer
        source = self._every.report.source_frame or sample.frame_id
        if not target or buffer is None or buffer.is_rigid(target, source):
            return
        from pc2scan.tf.worlds import moving_below  # noqa: PLC0415  # a lidar is usually rigid on its robot

        moving = moving_below(buffer, target, source)
        if moving is not None:
            self._every.warn(
                f"{self._spec.label}`target_frame` is {target}, in which {moving.body} moves (by {moving.metres:.2f} "
                f"m): the scans are measured from the origin of {target} instead of from the robot, as SLAM and "
                f"navigation expect; `target_frame={shlex.quote(moving.body)}`"
            )

    def _check_zeros(self, sample: Sample, counts: PointCounts) -> None:
        """Warn if points at (0, 0, 0), which many drivers write for no return, become returns of the scan."""
        params, (x, y, z) = self._spec.params, sample.origin
        if not (params.min_height <= z <= params.max_height and self._keeps_sensor):
            return
        self._zeros_reported = True
        source = self._every.report.source_frame or sample.frame_id
        self._every.warn(
            f"{self._spec.label}{self._topic}: {sample.zeros:,} of {counted(counts.total, 'point')} of a cloud "
            f"{agreeing(sample.zeros, 'are')} at (0, 0, 0), as drivers write for no return, and become returns at the "
            f"sensor itself, at a range of {math.hypot(x, y):.2f} m in {sample.scan_frame!r}; "
            f"{_without_sensor(source, sample.scan_frame)} excludes them"
        )

    def finish(self) -> None:
        """Judge the clouds added so far."""
        if self.full or not self._samples:
            return
        self.full = True
        with np.errstate(all="ignore"):
            if not self._is_fine():
                self._judge()

    def _is_fine(self) -> bool:
        """Whether scans have points, heights need no advice, and the first cloud is level or too small to be judged."""
        if self._is_nearly_empty() or self._needs_heights() or self._mistaken_units():
            return False
        if len(self._samples[0].points) < _FEWEST_POINTS:
            return True
        return self._level_floor is not None and self._floor_share < _MOST_FLOOR and not self._swapped

    @cached_property
    def _level_floor(self) -> Floor | None:
        """The level floor in the first cloud; None if there is none."""
        points = self._samples[0].points
        return level_floor(cells_of(points)) if len(points) >= _FEWEST_POINTS else None

    @property
    def _swapped(self) -> str:
        """A warning if an added transform to the target frame would put the floor at z = 0 the other way round."""
        floor, sample = self._level_floor, self._samples[0]
        below = -sample.origin[2]
        target = sample.scan_frame.removeprefix("/")
        static = next((each for each in self._every.static if each.child.removeprefix("/") == target), None)
        if floor is None or static is None or below < _BELOW or abs(below - floor.height) > _NEAR_FLOOR * floor.height:
            return ""
        from pc2scan.tf.options import static_text  # noqa: PLC0415  # loaded by now

        swapped = static_text(static.child, static.parent, static)
        return (
            f"`static_tf` from {static.parent} to {static.child} puts the sensor {below:.2f} m below {static.child}, "
            f"and the floor at z = {-below - floor.height:.2f} m; the parent comes first: `static_tf='{swapped}'` puts "
            f"the floor at z = {below - floor.height + 0.0:.2f} m"
        )

    @cached_property
    def _floor_share(self) -> float:
        """The share of beams, of those with a return of the first cloud, whose closest return is the floor.

        0 if the floor is outside the heights, or if a filter may remove it.
        """
        floor, params = self._level_floor, self._spec.params
        if floor is None or any(each.name in _FLOOR_FILTERS for each in self._spec.filters):
            return 0.0
        sample = self._samples[0]
        distances = sample.points @ np.array(floor.up) + floor.height
        placed = sample.placed
        ranges, angles = np.hypot(placed[:, 0], placed[:, 1]), np.arctan2(placed[:, 1], placed[:, 0])
        used = (
            (placed[:, 2] >= params.min_height)
            & (placed[:, 2] <= params.max_height)
            & (ranges >= params.range_min)
            & (ranges <= params.range_max)
            & (angles >= params.angle_min)
            & (angles <= params.angle_max)
        )
        # The floor at the place of each point.
        height = placed[:, 2] - distances / floor.up[2]
        on_floor = (
            (np.abs(distances) < tolerances(sample.points))
            & (height > params.min_height - _NOISE)
            & (height < params.max_height + _NOISE)
        )
        nearest = np.flatnonzero(used)[np.argsort(ranges[used])]
        _, first = np.unique(np.degrees(angles[nearest]).astype(int), return_index=True)
        return float(on_floor[nearest[first]].mean()) if len(first) >= _FEWEST_BEAMS else 0.0

    def _judge(self) -> None:
        from pc2scan.tf.mounting import mounting  # noqa: PLC0415  # only where there may be a warning

        every, first = self._every, self._samples[0]
        # A level first cloud is enough for the mounting and for the heights.
        points = [sample.points for sample in self._samples[: 1 if self._level_floor else None]]
        source = every.report.source_frame or first.frame_id
        judged_in = first.scan_frame if first.scan_frame != source else ""

        def judged(buffer: TransformBuffer | None) -> Mounting:
            height = first.origin[2]
            return mounting(
                self._topic, source, points, buffer, judged_in=judged_in, origin_z=height, stamp_ns=first.stamp_ns
            )

        found = judged(every.buffer)
        if found.fault and every.buffer is None:
            found = judged(every.transforms())
        if found.warning:
            every.warn(found.warning)
        if swapped := self._swapped:
            every.warn(self._spec.label + swapped)
        if units := self._mistaken_units():
            every.warn(self._spec.label + units)
        advice = self._advice(found)
        if self._is_nearly_empty() and (emptiness := self._emptiness(advice)):
            every.warn(self._spec.label + emptiness)
        elif not units and self._floor_share >= _MOST_FLOOR:
            every.warn(self._spec.label + self._floor_text(advice))
        for entry in self._entries():
            entry.advice = advice
        if self._without_heights() and any(map(from_preset, self._spec.origins.values())) and advice:
            every.report.notes.append(
                f"{self._spec.label}{self._topic}: no heights are given, presets leave them to you, and the default "
                f"min_height drops everything at z <= 0; these suit the clouds: {advice}"
            )

    def _entries(self) -> list[TopicReport]:
        topics = self._every.report.topics
        return [entry for entry in topics if entry.topic == self._topic and entry.spec is self._spec]

    def _is_nearly_empty(self) -> bool:
        beams = len(self._samples) * self._spec.params.length
        return self._counts.total > 0 and self._counts.used < _NEARLY_EMPTY * beams

    def _is_default(self, name: str) -> bool:
        spec = self._spec
        return spec.origins.get(name, "default") == "default" and (
            getattr(spec.params, name) == getattr(ProjectionParams(), name)
        )

    def _without_heights(self) -> bool:
        return self._is_default("min_height") and self._is_default("max_height")

    def _needs_heights(self) -> bool:
        """Whether the default min_height rejects many points, or a preset leaves the heights to the user."""
        cut = self._counts.height >= _NOTABLE_SHARE * max(self._counts.total, 1)
        presets = any(map(from_preset, self._spec.origins.values()))
        return (self._is_default("min_height") and cut) or (self._without_heights() and presets)

    def _advice(self, found: Mounting) -> str:
        """Return the options that suit the clouds; empty if there was no point."""
        if found.heights is None:
            return ""
        # The heights apply in the frame that these options make, which may differ from the frame of the scans.
        options = [found.options, f"`min_height={found.heights.low:g}`", f"`max_height={found.heights.high:g}`"]
        if self._samples[0].zeros and not self._zeros_reported and self._keeps_sensor:
            target = found.target_frame or self._samples[0].scan_frame
            options.append(_without_sensor(found.frame, target))
        return " ".join(filter(None, options))

    @property
    def _keeps_sensor(self) -> bool:
        """Whether nothing but heights removes points at the sensor itself."""
        params, (x, y, _) = self._spec.params, self._samples[0].origin
        return (
            params.range_min <= math.hypot(x, y) <= params.range_max
            and params.angle_min <= math.atan2(y, x) <= params.angle_max
            and not any(each.name in _PLACE_FILTERS for each in self._spec.filters)
        )

    def _emptiness(self, advice: str) -> str:
        """Return which limits reject all points, with the clouds' own values; empty if no limit does."""
        params, counts = self._spec.params, self._counts
        placed = np.concatenate([sample.placed for sample in self._samples])
        share = f"{counts.used:,} of the {counts.total:,} points of the first {_clouds(len(self._samples))} are used"
        frame = self._samples[0].scan_frame
        ranges, angles = np.hypot(placed[:, 0], placed[:, 1]), np.arctan2(placed[:, 1], placed[:, 0])
        observed = (
            ("height", placed[:, 2], f"z in {frame!r}", "m", "min_height", "max_height"),
            ("range", ranges, "the range", "m", "range_min", "range_max"),
            ("angle", angles, "the angle", "rad", "angle_min", "angle_max"),
        )
        parts = [
            f"{low} is {_limit(getattr(params, low), unit)} and {high} {_limit(getattr(params, high), unit)}, "
            f"but {name} is {_percentiles(values, unit)}"
            for reason, values, name, unit, low, high in observed
            if len(values) and counts.rejected[reason] >= _NOTABLE_SHARE * counts.total
        ]
        if parts and advice and counts.height >= _NOTABLE_SHARE * counts.total:
            parts[0] += f": {advice}"
        if not parts:
            # The reason is a filter, or NaN: the report has it at the end.
            return ""
        return f"{self._topic}: {share}; {'; '.join(parts)}"

    def _floor_text(self, advice: str) -> str:
        """Return the warning about a floor between the heights, with its own height."""
        sample, floor, params = self._samples[0], self._level_floor, self._spec.params
        assert floor is not None  # it has a share
        below = f"min_height is {_limit(params.min_height, 'm')}"
        return (
            f"{self._topic}: the floor is within the heights: it is at z = {sample.origin[2] - floor.height:.2f} m in "
            f"{sample.scan_frame!r}, and {below}; {self._floor_share:.0%} of the beams with a return end on it"
            + (f"; without it: {advice}" if advice else "")
        )

    def _mistaken_units(self) -> str:
        """Return a warning if heights seem to be millimetres, with the clouds' own heights; empty otherwise."""
        params = self._spec.params
        wrong = [name for name in ("min_height", "max_height") if self._is_tall(name)]
        if not wrong:
            return ""
        z = np.concatenate([sample.placed[:, 2] for sample in self._samples])
        given = " and ".join(f"{name} is {_limit(getattr(params, name), 'm')}" for name in wrong)
        metres = " ".join(f"`{name}={getattr(params, name) / 1000:g}`" for name in wrong)
        return (
            f"{given}, but z on {self._topic} is {_percentiles(z, 'm')}: heights are metres; if these are millimetres, "
            f"{metres}"
        )

    def _is_tall(self, name: str) -> bool:
        value = abs(float(getattr(self._spec.params, name)))
        if self._is_default(name) or not _TALL <= value < 1e5:
            return False
        # 100, 1000 and 999 are ways to say "no limit".
        if math.log10(value).is_integer() or set(f"{value:g}") == {"9"}:
            return False
        from pc2scan.core.percentiles import percentiles  # noqa: PLC0415  # few heights are doubtful

        z = np.concatenate([sample.placed[:, 2] for sample in self._samples])
        return len(z) > 0 and 10 * max(map(abs, percentiles(z, 1, 99))) < value


def _clouds(count: int) -> str:
    return "cloud" if count == 1 else counted(count, "cloud")


def _without_sensor(frame: str, target: str) -> str:
    from pc2scan.tf.mounting import without_sensor  # noqa: PLC0415  # only where there is a warning

    option, value = without_sensor(frame, target)
    return f"`{option}={shlex.quote(value)}`"


def _limit(value: float, unit: str) -> str:
    """Return a limit as text: upstream's defaults mean no limit."""
    if value == ProjectionParams().min_height:
        return f"above 0 {unit}"
    return "without limit" if abs(value) > 1e300 else f"{value:g} {unit}"


def _percentiles(values: NDArray[np.float64], unit: str) -> str:
    from pc2scan.core.percentiles import percentiles  # noqa: PLC0415  # only for warnings

    low, middle, high = percentiles(values, 5, 50, 95)
    return f"{low:.2f} to {high:.2f} {unit} (5 and 95 %; median {middle:.2f})"
