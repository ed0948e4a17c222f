"""What the consumers of laser scans do with a scan: accept it, ignore it, abort, or misplace its beams.

Each has a function with its rules, each beside its source: a function in C++ (floats of the message are float32,
literals float64 unless marked). Files of the sources:

- slam_toolbox: laser_utils.cpp, laser_utils.hpp, slam_toolbox_async.cpp, and Karto.h.
- Cartographer: msg_conversion.cc and sensor_bridge.cc of cartographer_ros, ``LocalTrajectoryBuilder2D``.
- gmapping: slam_gmapping.cpp; rangesensor.cpp and scanmatcher.cpp of openslam.
- AMCL: amcl_node.cpp of nav2_amcl.
- Nav2: scan.cpp of nav2_collision_monitor. Its costmap ignores infinite ranges: it accepts what laser_geometry accepts,
  ``range < range_max``.
- MRPT: laser_scan.cpp of two bridges: that of MRPT 2.5, in Debian and Ubuntu, and mrpt_ros_bridge 3.2.

The arithmetic is that of the consumers: float64 operations on float32 operands, rounded to float32 where the C++ result
is a float, which is the float32 result (see `pc2scan.core.layout.beam_count`).
A division of a float by a whole number is a float division, and MRPT divides floats. slam_toolbox and gmapping compute
the angles of their beams in doubles. Cartographer, Nav2 and AMCL add up floats, which is a rounding that matters only
from 8,000 beams on, and is not considered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from .layout import SYMMETRIC_BEAMS, float32, symmetric_sector
from .params import range_max_minus

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

Outcome = Literal["accepted", "shifted", "misplaced", "ignored", "aborts"]

#: From harmless to worst: accepted; accepted, but rotated by up to one beam; accepted, but with beams or ranges in
#: wrong places; dropped; the consumer's process ends.
OUTCOMES: tuple[Outcome, ...] = ("accepted", "shifted", "misplaced", "ignored", "aborts")

#: gmapping asserts ``beams < LASER_MAXBEAMS``.
_GMAPPING_BEAMS = 2048

#: gmapping does not start if the z axis of the scan's frame differs from the robot's by more than this.
_GMAPPING_TILT = 0.001

#: slam_toolbox's default of ``max_laser_range``, metres.
_KARTO_RANGE = 25.0

#: MRPT's bridges, and the types in which they multiply after divisions of floats.
_MRPT_BRIDGES: dict[str, type[np.floating[Any]]] = {"MRPT 2.5": np.float64, "mrpt_ros_bridge 3.2": np.float32}

#: Beams that are off by more than this share of an increment count as shifted. Smaller differences are roundings of a
#: driver's angles. The limit is pc2scan's own: the consumers have none.
_OFF = 0.1

#: A scan's frame that has turned or moved on the robot by more than this since the first scan is misplaced by consumers
#: that keep its first pose: radians, and metres. A joint that stands still trembles by less; at a range of 10 m, two
#: degrees are 0.35 m.
_TURNED = math.radians(2.0)
_MOVED = 0.1

#: Beams that are off by more than this many increments count as misplaced.
_SHIFTED = 1.0 + _OFF

#: If more than this share of a scan's ranges are `ConsumerScan.full`, these ranges are no returns.
_MISSES = 0.01

_TWO_PI = 2 * math.pi

#: ``std::numeric_limits<float>::epsilon() * 2.0f * M_PI``: the first product is a float, the second a double.
_KARTO_EPSILON = 2.0**-23 * 2 * math.pi

#: 350 degrees, as Karto's wrapper writes them.
_KARTO_NEARLY_FULL = 6.10865


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsumerScan:
    """The header of a scan, and the counts of its values.

    Attributes
    ----------
    angle_min, angle_max, angle_increment
        Radians; rounded to float32 when the object is created, like all numbers here.
    range_min, range_max
        Metres.
    scan_time, time_increment
        Seconds between scans, and between beams.
    beams
        Length of ``ranges``.
    intensities
        Length of ``intensities``.
    returns
        Ranges that are finite and within ``range_min`` and ``range_max``, inclusive.
    infinite
        Ranges that are +inf.
    nan
        Ranges that are NaN.
    zero
        Ranges that are 0, as some drivers write a beam without a return.
    short
        Ranges below ``range_min``, including zeros.
    long
        Finite ranges above ``range_max``.
    full
        Ranges that are ``range_max`` or 0.1 mm less (``no_return: range-max-minus``), which some drivers write for no
        return.
    """

    angle_min: float
    angle_max: float
    angle_increment: float
    range_min: float
    range_max: float
    beams: int
    scan_time: float = 0.0
    time_increment: float = 0.0
    intensities: int = 0
    returns: int = 0
    infinite: int = 0
    nan: int = 0
    zero: int = 0
    short: int = 0
    long: int = 0
    full: int = 0

    def __post_init__(self) -> None:
        floats = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max", "scan_time", "time_increment")
        for name in floats:
            object.__setattr__(self, name, float32(getattr(self, name)))

    @classmethod
    def of(cls, ranges: NDArray[np.float32], **header: Any) -> ConsumerScan:
        """Count the values of the ranges, float32, shape (beams,), metres; the other parameters as in the class."""
        low, high = float32(header["range_min"]), float32(header["range_max"])
        full = (ranges == high) | (ranges == range_max_minus(high))
        return cls(
            **header,
            beams=len(ranges),
            returns=int(are_returns(ranges, low, high).sum()),
            infinite=int((ranges == math.inf).sum()),
            nan=int(np.isnan(ranges).sum()),
            zero=int((ranges == 0).sum()),
            short=int((ranges < low).sum()),
            long=int(((ranges > high) & (ranges < math.inf)).sum()),
            full=int(full.sum()) if 0 < high < math.inf else 0,
        )


def are_returns(ranges: NDArray[np.float32], range_min: float, range_max: float) -> NDArray[np.bool_]:
    """Return which ranges are finite and within the limits, inclusive; the limits are float32 values."""
    returns: NDArray[np.bool_] = (ranges >= range_min) & (ranges <= range_max)
    if range_max == math.inf:
        # inf <= inf is true, but infinity is no return.
        returns &= ranges < math.inf
    return returns


class ScanTransforms(NamedTuple):
    """What the transforms at a scan's stamp say about its frame.

    Attributes
    ----------
    frame_id
        The frame in the scan's header.
    odometry, robot
        Whether there is a transform from the scan's frame to the odometry's frame, and to the robot's; None if unknown.
    up
        The z coordinate, in the scan's frame, of the point on the robot's z axis that is 1 m above the sensor: 1 for
        a level sensor, -1 for one that is upside down. None if unknown.
    turned, moved
        How far the scan's frame has turned around the robot's z axis (radians) and moved in its x-y plane (metres)
        since the first scan in this frame that had both transforms.
    missing
        Why a transform is missing.
    cure
        What to type if the frame's name is wrong; empty if that is not known.
    """

    frame_id: str = ""
    odometry: bool | None = None
    robot: bool | None = None
    up: float | None = None
    turned: float = 0.0
    moved: float = 0.0
    missing: str = ""
    cure: str = ""


class Verdict(NamedTuple):
    """What a consumer does with a scan.

    Attributes
    ----------
    consumer
        One of `pc2scan.core.consumers.CONSUMERS`.
    outcome
        One of `OUTCOMES`.
    rule
        The consumer's rule that decided; empty if the scan is accepted, like the following ones.
    observed, allowed
        What the scan has, and what the rule allows.
    cure
        How to change that.
    unplaced
        Whether the scan is ignored because of its transforms. The consumer then waits for the next one, and stores
        nothing of this one.
    """

    consumer: str
    outcome: Outcome = "accepted"
    rule: str = ""
    observed: str = ""
    allowed: str = ""
    cure: str = ""
    unplaced: bool = False

    @property
    def refused(self) -> bool:
        """Whether the consumer does not use the scan."""
        return self.outcome in ("ignored", "aborts")


class Case(NamedTuple):
    """What a rule judges.

    Attributes
    ----------
    scan
        The scan.
    first
        The first scan of the sensor that the consumer received; ``scan`` itself if that is the first.
    placed
        What the transforms say about the scan.
    started
        Whether the consumer received a scan before this one.
    """

    scan: ConsumerScan
    first: ConsumerScan
    placed: ScanTransforms
    started: bool


def judge(
    consumer: str, scan: ConsumerScan, first: ConsumerScan | None = None, placed: ScanTransforms | None = None
) -> Verdict:
    """Return what a consumer does with a scan: the verdict of its first rule that the scan breaks.

    Parameters
    ----------
    consumer
        One of `CONSUMERS`.
    scan
        The scan.
    first
        The first scan of the sensor that this consumer received: slam_toolbox and gmapping use its angles and its
        length for all others. None if this is the first.
    placed
        What the transforms say about the scan; None: they are not considered.

    Raises
    ------
    KeyError
        If there is no such consumer.
    """
    case = Case(scan, first or scan, placed or ScanTransforms(), first is not None)
    broken = next(CONSUMERS[consumer](case), Verdict(""))
    return broken._replace(consumer=consumer)


def last_beam(scan: ConsumerScan) -> float:
    """Return the angle of the last beam, radians, as float32: the correct ``angle_max``."""
    return float32(scan.angle_min + (scan.beams - 1) * scan.angle_increment)


def has_angles(scan: ConsumerScan) -> bool:
    """Whether the angles of a scan are numbers, and those of its beams differ."""
    angles = (scan.angle_min, scan.angle_max, scan.angle_increment)
    return all(map(math.isfinite, angles)) and (scan.angle_increment != 0 or scan.beams < 2)


def expected_by_karto(scan: ConsumerScan) -> int | None:
    """Return the length of ``ranges`` that slam_toolbox expects by a scan's angles, also for all scans after it.

    None if its arithmetic has no result: an increment of 0, or angles that are not finite.
    """
    span = abs(float32(scan.angle_max - scan.angle_min))
    if not math.isfinite(scan.angle_increment) or scan.angle_increment == 0:
        return None
    full = abs(span - _TWO_PI) < scan.angle_increment - _KARTO_EPSILON
    # If the message's length equals this float, the scan is a circle that repeats its first beam at its end.
    steps = float32(span / scan.angle_increment)
    if not math.isfinite(steps):
        return None
    if span > _KARTO_NEARLY_FULL and _rounded(steps) + 1 == scan.beams:
        full = False
    # Karto stores the angles as doubles.
    return _rounded((scan.angle_max - scan.angle_min) / scan.angle_increment) + (0 if full else 1)


def _rounded(value: float) -> int:
    """Round halves away from zero, as ``std::round`` and Karto's ``math::Round`` do."""
    return math.floor(value + 0.5) if value >= 0 else math.ceil(value - 0.5)


#: What to do about a recording without any transforms.
_NO_TRANSFORMS = (
    "keep /tf and /tf_static when recording or converting. For scans made from clouds, pc2scan convert `tf_from` reads "
    "them from another recording, `odom_topic` or `trajectory` adds odometry, `static_tf` with `write_static_tf` the "
    "mount; cartographer can do without odometry"
)


def _needs(placed: ScanTransforms, *roles: str) -> Iterator[Verdict]:
    """Yield the verdict on a scan without a transform to the odometry's frame, to the robot's, or both."""
    lacking = [role for role in roles if getattr(placed, role) is False]
    if lacking:
        rule = f"a scan without a transform to the {' and the '.join(f'{role} frame' for role in lacking)} is dropped"
        observed = placed.missing or f"no transform from {placed.frame_id!r}"
        cure = placed.cure or _NO_TRANSFORMS
        yield Verdict("", "ignored", rule, observed, "transforms at the scan's stamp", cure, unplaced=True)


def _infinite_hits(scan: ConsumerScan, consumer: str) -> Iterator[Verdict]:
    if scan.infinite and not scan.range_max < math.inf:
        rule = "a range within range_max is a return, and inf <= inf"
        observed = f"{scan.infinite} infinite ranges, range_max {scan.range_max:.9g}"
        cure = f"give a finite `range_max`: pc2scan convert `preset={consumer}`"
        yield Verdict("", "misplaced", rule, observed, "a finite range_max", cure)


def _kept_angles(case: Case) -> Iterator[Verdict]:
    scan, first = case.scan, case.first
    begin = scan.angle_min - first.angle_min
    end = begin + (scan.beams - 1) * (scan.angle_increment - first.angle_increment)
    off = max(abs(begin), abs(end))
    if scan.beams and not off <= _OFF * abs(first.angle_increment):
        observed, kept = (
            f"angle_min {x.angle_min:.9g}, angle_increment {x.angle_increment:.9g}" for x in (scan, first)
        )
        yield Verdict(
            "",
            "misplaced",
            "the first scan's angles are kept for all",
            f"{observed}, a beam off by {math.degrees(off):.3g} deg",
            kept,
            "give all scans the same angles (pc2scan convert does, to scans made from clouds)",
        )


def _kept_pose(placed: ScanTransforms, *, angle: bool) -> Iterator[Verdict]:
    """Yield the verdict on a scan whose frame is no longer where it was on the robot at first."""
    if placed.moved > _MOVED or (angle and abs(placed.turned) > _TURNED):
        turned = f"turned by {math.degrees(placed.turned):.3g} deg, and " if angle else ""
        yield Verdict(
            "",
            "misplaced",
            f"the {'pose' if angle else 'place'} of the scan's frame on the robot at the first scan is kept for all",
            f"since then the frame {placed.frame_id!r} has {turned}moved by {placed.moved:.2f} m",
            f"up to {f'{math.degrees(_TURNED):g} deg and ' if angle else ''}{_MOVED:g} m",
            "a frame that is fixed on the robot: for scans made from clouds, pc2scan convert `target_frame=base_link`",
        )


def _off(
    angle_increment: float, off: float, rule: str, observed: str, allowed: str, cure: str, which: str = "beams"
) -> Iterator[Verdict]:
    """Yield the verdict on a scan of which beams are off by up to ``off``, radians."""
    share = abs(off) / abs(angle_increment) if angle_increment else math.inf if off else 0.0
    if share <= _OFF:
        return
    turned = f"{which} off by up to {abs(math.degrees(off)):.3g} deg ({share:.3g} of an increment)"
    if off == math.inf:
        turned = "it reads beyond the end of the ranges"
    yield Verdict("", "shifted" if share <= _SHIFTED else "misplaced", rule, f"{observed}: {turned}", allowed, cure)


def _slam_toolbox(case: Case) -> Iterator[Verdict]:
    scan, first, placed = case.scan, case.first, case.placed
    # laserCallback, LaserAssistant::toLaserMetadata
    yield from _needs(placed, "odometry", "robot")
    # LaserAssistant::makeLaser, LaserRangeFinder::Update and Validate
    expected = expected_by_karto(first)
    if expected != scan.beams:
        rule = "len(ranges) must be round((angle_max - angle_min) / angle_increment) + 1, or + 0 for a full circle"
        advertised = "advertise the angles of the beams, angle_min + i * angle_increment"
        if has_angles(first):
            advertised = f"advertise angle_max {last_beam(first):.9g}, the last beam's angle"
        cure = f"{advertised}: pc2scan convert `preset=slam_toolbox`, or `geometry=centered`"
        if scan.beams != first.beams and expected == first.beams:
            rule = "every scan must be as long as the angles of the first one require"
            cure = "give all scans one number of beams: pc2scan convert `preset=slam_toolbox`"
        allowed = f"{expected} ranges" if expected is not None and expected > 0 else "angles for a number of beams"
        yield Verdict("", "ignored", rule, f"{scan.beams} ranges", allowed, cure)
    # LocalizedRangeScan::Update, OccupancyGrid::AddScan
    if not (first.range_max > _KARTO_RANGE or scan.full <= _MISSES * scan.beams):
        yield Verdict(
            "",
            "misplaced",
            "a finite range up to range_max is a return if range_max is at most max_laser_range (default 25 m)",
            f"{scan.full} ranges of range_max {scan.range_max:.9g} or 0.1 mm less, taken for returns",
            "inf for no return, or a range_max above max_laser_range",
            "`no_return=inf`, or `range_max=100.0`: pc2scan convert `preset=slam_toolbox`",
        )
    # LaserAssistant::makeLaser, once a sensor
    if case.started:
        yield from _kept_angles(case)
    yield from _kept_pose(placed, angle=True)
    # scanToReadings: of a sensor that is upside down, Karto reads beam i in the place of beam N - 1 - i.
    if placed.up is not None and not placed.up > 0 and scan.beams:
        yield from _off(
            scan.angle_increment,
            math.remainder(first.angle_min + last_beam(first), _TWO_PI),
            "ranges of a sensor that is upside down are taken in reverse order, at the same angles",
            f"angle_min {first.angle_min:.9g}, the last beam at {last_beam(first):.9g}",
            "a sector around 0",
            "pc2scan convert `target_frame=base_link`, or `geometry=symmetric`",
        )


def _cartographer(case: Case) -> Iterator[Verdict]:
    scan, placed = case.scan, case.placed
    # SensorBridge::HandleRangefinder
    yield from _needs(placed, "robot")
    # LaserScanToPointCloudWithIntensities
    low, high = f"range_min {scan.range_min:.9g}", f"range_max {scan.range_max:.9g}"
    if not scan.range_min >= 0:
        yield Verdict("", "aborts", "CHECK range_min >= 0", low, ">= 0", "`range_min=0.0`")
    if not scan.range_max >= scan.range_min:
        cure = "give a `range_max` beyond `range_min`"
        yield Verdict("", "aborts", "CHECK range_max >= range_min", high, f">= {low}", cure)
    begin, end = scan.angle_min, scan.angle_max
    if not (end > begin if scan.angle_increment > 0 else begin > end):
        yield Verdict(
            "",
            "aborts",
            "CHECK angle_max > angle_min, or < for a negative angle_increment",
            f"angle_min {begin:.9g}, angle_max {end:.9g}, angle_increment {scan.angle_increment:.9g}",
            "angles in the order of the beams",
            "advertise angles in the order of the beams: pc2scan convert `preset=cartographer`",
        )
    # For ranges within the limits.
    hits = scan.returns + (scan.infinite if scan.range_max == math.inf else 0)
    if hits and scan.intensities not in (0, scan.beams):
        rule = "CHECK len(intensities) == len(ranges), if there are intensities"
        cure = "write none, or one for every beam"
        yield Verdict("", "aborts", rule, f"{scan.intensities} intensities", f"0 or {scan.beams}", cure)
    # CheckNoLeadingSlash, for a scan with points
    if hits and placed.frame_id.startswith("/"):
        rule = "CHECK that the frame_id has no leading slash"
        cure = "for scans made from clouds: pc2scan convert `source_frame`"
        yield Verdict("", "aborts", rule, f"frame_id {placed.frame_id!r}", "the name without the slash", cure)
    # LocalTrajectoryBuilder2D::AddRangeData
    if hits > 1 and scan.time_increment < 0:
        rule = "points are taken in the order of time: those that are earlier than the first are placed at its pose"
        cure = "`time_increment=0.0`: pc2scan convert `preset=cartographer`"
        yield Verdict("", "misplaced", rule, f"time_increment {scan.time_increment:.6g} s", ">= 0", cure)
    # LaserScanToPointCloudWithIntensities
    yield from _infinite_hits(scan, "cartographer")


def _gmapping(case: Case) -> Iterator[Verdict]:
    scan, first, placed = case.scan, case.first, case.placed
    # getOdomPose
    yield from _needs(placed, "odometry", "robot")
    # initMapper
    if not (case.started or placed.up is None or abs(abs(placed.up) - 1) <= _GMAPPING_TILT):
        yield Verdict(
            "",
            "ignored",
            "it does not start unless the sensor is level: abs(abs(z) - 1) <= 0.001 for the point 1 m above it",
            f"z {placed.up:.6g} in the scan's frame {placed.frame_id!r}",
            "0.999 to 1.001, or -1.001 to -0.999",
            "make level scans: pc2scan convert `target_frame=base_link`",
            unplaced=True,
        )
    # ScanMatcher::setLaserParameters
    if first.beams >= _GMAPPING_BEAMS:
        rule, cure = "assert(beams < LASER_MAXBEAMS)", "fewer beams: give `beams`, or a larger `angle_increment`"
        yield Verdict("", "aborts", rule, f"{first.beams} ranges", f"at most {_GMAPPING_BEAMS - 1}", cure)
    # addScan
    if scan.beams != first.beams:
        rule = "every scan must be as long as the first"
        cure = "give all scans one number of beams: pc2scan convert `preset=gmapping`"
        yield Verdict("", "ignored", rule, f"{scan.beams} ranges", f"{first.beams} ranges", cure)
    # addScan, ScanMatcher::computeActiveArea: it skips ranges above the first scan's range_max, and replaces ranges
    # below range_min by range_max.
    if not first.range_max < math.inf and (scan.infinite or (scan.short and scan.range_max == math.inf)):
        yield Verdict(
            "",
            "aborts",
            "the map grows until it contains every range up to range_max; ranges below range_min become range_max",
            f"{scan.infinite} infinite ranges, {scan.short} below range_min, range_max {first.range_max:.9g}",
            "a finite range_max",
            "give a finite `range_max`: pc2scan convert `preset=gmapping`",
        )
    # initMapper, once
    if case.started:
        yield from _kept_angles(case)
    # initMapper, RangeSensor
    if scan.beams:
        yield from _off_from_middle(scan, -1 if placed.up is not None and placed.up <= 0 else 1)


def _off_from_middle(scan: ConsumerScan, way: int) -> Iterator[Verdict]:
    """Yield the verdict of gmapping on the places of a scan's beams; ``way`` is -1 if the sensor is upside down.

    It orders beams by growing angle, and places beam ``i`` at ``(i - N / 2) * angle_increment`` from the middle between
    ``angle_min`` and ``angle_max``; for a sensor that is upside down, as seen from below.
    """
    beams, begin, end, increment = scan.beams, scan.angle_min, scan.angle_max, scan.angle_increment
    middle = float32(float32(begin + end) / 2)
    reverse = begin * way > end * way
    places = {beam: (beams - 1 - beam if reverse else beam) - beams / 2 for beam in (0, beams - 1)}
    offs = [middle + way * place * abs(increment) - (begin + beam * increment) for beam, place in places.items()]
    steps = beams - 2 if reverse else beams
    yield from _off(
        increment,
        max(offs, key=abs),
        "beam i is placed at (i - len(ranges) / 2) * angle_increment from the middle between angle_min and angle_max",
        f"angle_max {end:.9g}",
        f"angle_max {float32(begin + steps * increment):.9g}",
        f"advertise angle_max = angle_min + {steps} * angle_increment: pc2scan convert `preset=gmapping`",
    )


def _amcl(case: Case) -> Iterator[Verdict]:
    # The message filter, AmclNode::addNewScanner
    yield from _needs(case.placed, "odometry", "robot")
    # AmclNode::updateFilter
    if case.scan.range_max <= 0:
        observed = f"range_max {case.scan.range_max:.9g}"
        cure = "give a positive `range_max`: pc2scan convert `preset=amcl`"
        yield Verdict("", "ignored", "range_max must be above 0", observed, "> 0", cure)
    # AmclNode::addNewScanner, once a frame: it looks up the directions of the beams anew for each scan, but not the
    # place of the sensor.
    yield from _kept_pose(case.placed, angle=False)


def _nav2(case: Case) -> Iterator[Verdict]:
    # Source::getTransform
    yield from _needs(case.placed, "robot")
    # Scan::getSourceData
    yield from _infinite_hits(case.scan, "nav2")


def _mrpt(case: Case) -> Iterator[Verdict]:
    scan, fewest = case.scan, SYMMETRIC_BEAMS[0]
    # The bridges' sensor pose
    yield from _needs(case.placed, "robot")
    # fromROS
    if scan.beams < fewest:
        rule = "ASSERT(ranges.size() > 2)"
        yield Verdict("", "aborts", rule, f"{scan.beams} ranges", f"at least {fewest}", "more beams")
    begin, end, increment, beams = scan.angle_min, scan.angle_max, scan.angle_increment, scan.beams
    misread = {name: _mrpt_off(begin, end, increment, beams, name) for name in _MRPT_BRIDGES}
    number, off = (max(values) for values in zip(*misread.values(), strict=True))
    bridges = [name for name, (count, _) in misread.items() if count]
    allowed = "angles of the beams"
    half = (beams - 1) * abs(increment) / 2
    if 0 < half <= math.pi:
        low, high = symmetric_sector(half)
        allowed = f"angle_min {low:.9g}, angle_max {high:.9g}"
    yield from _off(
        increment,
        off,
        "angles run from -(angle_max - angle_min) / 2 to + that in equal steps; angle_increment is not read",
        f"angle_min {begin:.9g}, angle_max {end:.9g}" + (f", in {bridges[0]}" if len(bridges) == 1 else ""),
        allowed,
        "pc2scan convert `preset=mrpt`, or `geometry=symmetric`",
        f"{number:,} of {beams:,} beams",
    )


@lru_cache(maxsize=64)
def _mrpt_off(angle_min: float, angle_max: float, angle_increment: float, beams: int, bridge: str) -> tuple[int, float]:
    """Return how many beams of MRPT have the range of another direction, and the largest angle between the two.

    In radians; inf if the bridge reads outside of the ranges. The index of the range that each beam takes is computed
    in MRPT's order of operations: the truncated value is often a whole number except for roundings.
    """
    aperture = float32(angle_max - angle_min)
    if not (math.isfinite(aperture) and math.isfinite(angle_increment)) or aperture == 0:
        return beams, math.inf
    kind = _MRPT_BRIDGES[bridge]
    last, number = np.float32(beams - 1), np.arange(beams)
    with np.errstate(all="ignore"):
        step, inverse = kind(np.float32(aperture) / last), kind(last / np.float32(aperture))
        first = -(kind(0.5) * kind(aperture)) - kind(angle_min)
        taken = np.trunc(inverse * (first + step * number.astype(kind))).astype(np.float64)
    taken += np.where(taken < 0, beams, np.where(taken >= beams, -beams, 0))
    # False for NaN, too.
    if not (taken.min() >= 0 and taken.max() < beams):
        return beams, math.inf
    seen = aperture * (number / (beams - 1) - 0.5)
    off = seen - (angle_min + taken * angle_increment)
    off = np.abs(off - _TWO_PI * np.rint(off / _TWO_PI))
    return int((off > _OFF * abs(angle_increment)).sum()), float(off.max())


#: The consumers by name, in the order in which they are shown: functions that yield what they do with a scan, by the
#: first rule that it breaks. Rules by which a scan is not used come before those by which its beams are misplaced.
#: Conditions are written so that NaN fails them as in C++.
CONSUMERS: dict[str, Callable[[Case], Iterator[Verdict]]] = {
    "slam_toolbox": _slam_toolbox,
    "cartographer": _cartographer,
    "gmapping": _gmapping,
    "amcl": _amcl,
    "nav2": _nav2,
    "mrpt": _mrpt,
}
