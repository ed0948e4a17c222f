"""What the first clouds of a topic show: limits that reject every point, a floor within the heights, wrong units.

Everything is computed from samples of the clouds. `pipeline.first_clouds` decides which clouds are sampled, and when.
"""

from __future__ import annotations

import math
import shlex
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.counts import PointCounts
from pc2scan.core.level import cells_of, level_floor, thin_points, tolerances
from pc2scan.core.params import ProjectionParams
from pc2scan.text import agreeing, counted

from .parameters import from_preset

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pc2scan.core.level import Floor
    from pc2scan.core.points import Points
    from pc2scan.tf.mounting import Mounting
    from pc2scan.tf.placing import Placement
    from pc2scan.tf.static import StaticTransform

    from .scan_spec import ScanSpec

#: How many points of a cloud are sampled.
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


def sample_of(points: Points, place: Placement) -> Sample:
    """Return a sample of a cloud's points."""
    x, y, z = points.xyz()
    taken, moved = thin_points(x, y, z, _POINTS), place.target_from_source
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        zeros = int(np.count_nonzero((x == 0) & (y == 0) & (z == 0)))
    origin = (0.0, 0.0, 0.0)
    if moved is not None:
        taken, origin = moved.rotation.apply(taken), tuple(moved.translation.tolist())
    return Sample(points.frame_id, place.frame_id, points.stamp_ns, taken, origin, zeros)


class CloudChecks:
    """What the first clouds of one topic show about the parameters of one output.

    Attributes
    ----------
    samples
        The clouds so far, in the order of writing. Unless stated otherwise, there must be one.
    counts
        The points of these clouds, by what became of them.
    """

    def __init__(self, topic: str, spec: ScanSpec) -> None:
        self.samples: list[Sample] = []
        self.counts = PointCounts()
        self._topic = topic
        self._spec = spec

    def add(self, sample: Sample, counts: PointCounts) -> None:
        """Add the next cloud."""
        self.samples.append(sample)
        self.counts += counts

    def is_fine(self, static: Sequence[StaticTransform]) -> bool:
        """Whether scans have points, heights need no advice, and the first cloud is level or too small to be judged."""
        if self.is_nearly_empty() or self._needs_heights() or self.mistaken_units():
            return False
        if len(self.samples[0].points) < _FEWEST_POINTS:
            return True
        return self.level_floor is not None and self._floor_share < _MOST_FLOOR and not self.swapped(static)

    @cached_property
    def level_floor(self) -> Floor | None:
        """The level floor in the first cloud; None if there is none."""
        points = self.samples[0].points
        return level_floor(cells_of(points)) if len(points) >= _FEWEST_POINTS else None

    def swapped(self, added: Sequence[StaticTransform]) -> str:
        """Return a warning if an added transform would put the floor at z = 0 the other way round; empty otherwise."""
        floor, sample = self.level_floor, self.samples[0]
        below = -sample.origin[2]
        target = sample.scan_frame.removeprefix("/")
        static = next((each for each in added if each.child.removeprefix("/") == target), None)
        if floor is None or static is None or below < _BELOW or abs(below - floor.height) > _NEAR_FLOOR * floor.height:
            return ""
        from pc2scan.tf.static import static_text  # noqa: PLC0415  # loaded by now

        inverse = static_text(static.child, static.parent, static)
        return (
            f"`static_tf` from {static.parent} to {static.child} puts the sensor {below:.2f} m below {static.child}, "
            f"and the floor at z = {-below - floor.height:.2f} m; the parent comes first: `static_tf='{inverse}'` puts "
            f"the floor at z = {below - floor.height + 0.0:.2f} m"
        )

    @cached_property
    def _floor_share(self) -> float:
        """The share of beams, of those with a return of the first cloud, whose closest return is the floor.

        0 if the floor is outside the heights, or if a filter may remove it.
        """
        floor, params = self.level_floor, self._spec.params
        if floor is None or any(each.name in _FLOOR_FILTERS for each in self._spec.filters):
            return 0.0
        sample = self.samples[0]
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

    def is_nearly_empty(self) -> bool:
        """Whether the scans have nearly no points."""
        beams = len(self.samples) * self._spec.params.length
        return self.counts.total > 0 and self.counts.used < _NEARLY_EMPTY * beams

    def _is_default(self, name: str) -> bool:
        spec = self._spec
        return spec.origins.get(name, "default") == "default" and (
            getattr(spec.params, name) == getattr(ProjectionParams(), name)
        )

    def lacks_heights(self) -> bool:
        """Whether a preset leaves the heights to the user, who gives none."""
        presets = any(map(from_preset, self._spec.origins.values()))
        return presets and self._is_default("min_height") and self._is_default("max_height")

    def _needs_heights(self) -> bool:
        """Whether the default min_height rejects many points, or a preset leaves the heights to the user."""
        cut = self.counts.height >= _NOTABLE_SHARE * max(self.counts.total, 1)
        return (self._is_default("min_height") and cut) or self.lacks_heights()

    def advice(self, found: Mounting, *, zeros_reported: bool) -> str:
        """Return the options that suit the clouds; empty if there was no point.

        Parameters
        ----------
        zeros_reported
            Whether a warning already has the option that excludes points at the sensor.
        """
        if found.heights is None:
            return ""
        # The heights apply in the frame that these options make, which may differ from the frame of the scans.
        options = [found.options, f"`min_height={found.heights.low:g}`", f"`max_height={found.heights.high:g}`"]
        if self.samples[0].zeros and not zeros_reported and self._keeps_sensor:
            target = found.target_frame or self.samples[0].scan_frame
            options.append(_without_sensor(found.frame, target))
        return " ".join(filter(None, options))

    def points_at_sensor(self, sample: Sample, counts: PointCounts, source: str) -> str:
        """Return a warning if points at (0, 0, 0), which many drivers write for no return, become returns of the scan.

        Parameters
        ----------
        sample, counts
            The cloud.
        source
            The frame of its points.
        """
        params, (x, y, z) = self._spec.params, sample.origin
        if not (sample.zeros and params.min_height <= z <= params.max_height and self._keeps_sensor):
            return ""
        return (
            f"{self._topic}: {sample.zeros:,} of {counted(counts.total, 'point')} of a cloud "
            f"{agreeing(sample.zeros, 'are')} at (0, 0, 0), as drivers write for no return, and become returns at the "
            f"sensor itself, at a range of {math.hypot(x, y):.2f} m in {sample.scan_frame!r}; "
            f"{_without_sensor(source, sample.scan_frame)} excludes them"
        )

    @property
    def _keeps_sensor(self) -> bool:
        """Whether nothing but heights removes points at the sensor itself."""
        params, (x, y, _) = self._spec.params, self.samples[0].origin
        return (
            params.range_min <= math.hypot(x, y) <= params.range_max
            and params.angle_min <= math.atan2(y, x) <= params.angle_max
            and not any(each.name in _PLACE_FILTERS for each in self._spec.filters)
        )

    def emptiness(self, advice: str) -> str:
        """Return which limits reject all points, with the clouds' own values; empty if no limit does."""
        params, counts = self._spec.params, self.counts
        placed = np.concatenate([sample.placed for sample in self.samples])
        share = f"{counts.used:,} of the {counts.total:,} points of the first {_clouds(len(self.samples))} are used"
        frame = self.samples[0].scan_frame
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

    def floor_within_heights(self, advice: str) -> str:
        """Return a warning if many beams end on the floor, with its own height; empty otherwise."""
        sample, floor, params = self.samples[0], self.level_floor, self._spec.params
        if floor is None or self._floor_share < _MOST_FLOOR:
            return ""
        below = f"min_height is {_limit(params.min_height, 'm')}"
        return (
            f"{self._topic}: the floor is within the heights: it is at z = {sample.origin[2] - floor.height:.2f} m in "
            f"{sample.scan_frame!r}, and {below}; {self._floor_share:.0%} of the beams with a return end on it"
            + (f"; without it: {advice}" if advice else "")
        )

    def mistaken_units(self) -> str:
        """Return a warning if heights seem to be millimetres, with the clouds' own heights; empty otherwise."""
        params = self._spec.params
        wrong = [name for name in ("min_height", "max_height") if self._is_tall(name)]
        if not wrong:
            return ""
        z = np.concatenate([sample.placed[:, 2] for sample in self.samples])
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

        z = np.concatenate([sample.placed[:, 2] for sample in self.samples])
        return len(z) > 0 and 10 * max(map(abs, percentiles(z, 1, 99))) < value


def _clouds(count: int) -> str:
    return "cloud" if count == 1 else counted(count, "cloud")


def _without_sensor(frame: str, target: str) -> str:
    from pc2scan.tf.mounting import sensor_exclusion  # noqa: PLC0415  # only where there is a warning

    option, value = sensor_exclusion(frame, target)
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
