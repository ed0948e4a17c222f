"""What the consumers of laser scans do with a scan: accept it, ignore it, abort, or misplace its beams.

Sources of the rules, in C++ (floats of the message are float32, literals float64 unless marked):

- slam_toolbox: ``LaserAssistant::makeLaser`` (laser_utils.cpp), ``LaserRangeFinder::Update``, ``Validate``,
  ``LocalizedRangeScan::Update`` and ``OccupancyGrid::AddScan`` (Karto.h), ``laserCallback`` (slam_toolbox_async.cpp),
  ``scanToReadings`` (laser_utils.hpp).
- Cartographer: ``LaserScanToPointCloudWithIntensities`` (cartographer_ros, msg_conversion.cc), ``HandleLaserScan`` and
  ``HandleRangefinder`` (sensor_bridge.cc), ``LocalTrajectoryBuilder2D::AddRangeData`` (cartographer).
- gmapping: ``initMapper``, ``getOdomPose`` and ``addScan`` (slam_gmapping.cpp), ``RangeSensor`` (openslam,
  rangesensor.cpp), ``setLaserParameters``, ``computeActiveArea`` (scanmatcher.cpp).
- AMCL: ``AmclNode::updateFilter``, ``addNewScanner`` and its message filter (nav2_amcl, amcl_node.cpp).
- Nav2: ``Scan::getSourceData`` (nav2_collision_monitor, scan.cpp). Its costmap ignores infinite ranges: it accepts
  what laser_geometry accepts, ``range < range_max``.
- MRPT: ``fromROS`` of two bridges (laser_scan.cpp): that of MRPT 2.5, in Debian and Ubuntu, and mrpt_ros_bridge 3.2.

The arithmetic is that of the consumers: float64 operations on float32 operands, rounded to float32 where the C++ result
is a float, which is the float32 result (see `pc2scan.core.layout.beam_count`); NumPy's float32 for sums of all beams.
A division of a float by a whole number is a float division. Cartographer and Nav2 add up the angles of the beams in a
float, AMCL adds the first two angles in a float, and MRPT divides floats. slam_toolbox and gmapping compute the angles
of their beams in doubles.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .layout import SYMMETRIC_BEAMS, float32, symmetric_sector
from .verdicts import ConsumerScan, ScanTransforms, Verdict

if TYPE_CHECKING:
    from collections.abc import Callable

    from .verdicts import Outcome

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

#: Roundings of the consumer's own count only if they move a beam by more than this share of an increment: it is then
#: closer to a neighbour's direction than to its own.
_DRIFTED = 0.5

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


#: For scans without known transforms.
_ANYWHERE = ScanTransforms()


def judge(
    consumer: str, scan: ConsumerScan, first: ConsumerScan | None = None, placed: ScanTransforms | None = None
) -> Verdict:
    """Return what a consumer does with a scan.

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
    if placed is not None and (unplaced := _unplaced(consumer, placed, started=first is not None)):
        return unplaced
    facts = scan, first or scan, placed or _ANYWHERE
    rules = CONSUMERS[consumer]
    return (rules.refuse and rules.refuse(*facts)) or rules.place(*facts)


def refusal(consumer: str, scan: ConsumerScan) -> Verdict | None:
    """Return why a consumer would not use a scan that is the first of its sensor; None if it uses it.

    Where it places the scan's beams, which takes longer to find out, is not considered; see `judge`.
    """
    refuse = CONSUMERS[consumer].refuse
    return refuse and refuse(scan, scan, _ANYWHERE)


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


#: The transforms without which a consumer drops a scan: to the odometry's frame, and to the robot's.
_NEEDS: dict[str, tuple[str, ...]] = {
    "slam_toolbox": ("odometry", "robot"),
    "cartographer": ("robot",),
    "gmapping": ("odometry", "robot"),
    "amcl": ("odometry", "robot"),
    "nav2": ("robot",),
    "mrpt": ("robot",),
}


#: What to do about a recording without any transforms.
NO_TRANSFORMS = (
    "keep /tf and /tf_static when recording or converting. For scans made from clouds, pc2scan convert `tf_from` reads "
    "them from another recording, `odom_topic` or `trajectory` adds odometry, `static_tf` with `write_static_tf` the "
    "mount; cartographer can do without odometry"
)


def _unplaced(consumer: str, placed: ScanTransforms, *, started: bool) -> Verdict | None:
    """Return the verdict on a scan that a consumer ignores because of its transforms; None if it uses the scan."""
    lacking = [role for role in _NEEDS[consumer] if getattr(placed, role) is False]
    if lacking:
        return Verdict(
            consumer,
            "ignored",
            f"a scan without a transform to the {' and the '.join(f'{role} frame' for role in lacking)} is dropped",
            placed.missing or f"no transform from {placed.frame_id!r}",
            "transforms at the scan's stamp",
            placed.cure or NO_TRANSFORMS,
            unplaced=True,
        )
    if consumer == "gmapping" and not started and placed.up is not None and _tilted(placed.up):
        return Verdict(
            consumer,
            "ignored",
            "it does not start unless the sensor is level: abs(abs(z) - 1) <= 0.001 for the point 1 m above it",
            f"z {placed.up:.6g} in the scan's frame {placed.frame_id!r}",
            "0.999 to 1.001, or -1.001 to -0.999",
            "make level scans: pc2scan convert `target_frame=base_link`",
            unplaced=True,
        )
    return None


def _tilted(up: float) -> bool:
    return not abs(abs(up) - 1) <= _GMAPPING_TILT


def _refused_by_slam_toolbox(scan: ConsumerScan, first: ConsumerScan, _placed: ScanTransforms) -> Verdict | None:
    expected = expected_by_karto(first)
    if expected != scan.beams:
        if scan.beams != first.beams and expected == first.beams:
            return Verdict(
                "slam_toolbox",
                "ignored",
                "every scan must be as long as the angles of the first one require",
                f"{scan.beams} ranges",
                f"{expected} ranges",
                "give all scans one number of beams: pc2scan convert `preset=slam_toolbox`",
            )
        return Verdict(
            "slam_toolbox",
            "ignored",
            "len(ranges) must be round((angle_max - angle_min) / angle_increment) + 1, or + 0 for a full circle",
            f"{scan.beams} ranges",
            f"{expected} ranges" if expected is not None and expected > 0 else "angles for a number of beams",
            f"{_advertise(first)}: pc2scan convert `preset=slam_toolbox`, or `geometry=centered`",
        )
    return None


def _placed_by_slam_toolbox(scan: ConsumerScan, first: ConsumerScan, placed: ScanTransforms) -> Verdict:
    if first.range_max <= _KARTO_RANGE and scan.full > _MISSES * scan.beams:
        return Verdict(
            "slam_toolbox",
            "misplaced",
            "a finite range up to range_max is a return if range_max is at most max_laser_range (default 25 m)",
            f"{scan.full} ranges of range_max {scan.range_max:.9g} or 0.1 mm less, taken for returns",
            "inf for no return, or a range_max above max_laser_range",
            "`no_return=inf`, or `range_max=100.0`: pc2scan convert `preset=slam_toolbox`",
        )
    kept = _kept_angles("slam_toolbox", scan, first)
    if kept.outcome == "accepted":
        kept = _kept_pose("slam_toolbox", placed, angle=True)
    if kept.outcome != "accepted" or placed.up is None or placed.up > 0 or not scan.beams:
        return kept
    # If the sensor is upside down, Karto reads beam i in the place of beam N - 1 - i.
    return _off(
        "slam_toolbox",
        scan.angle_increment,
        math.remainder(first.angle_min + last_beam(first), _TWO_PI),
        "ranges of a sensor that is upside down are taken in reverse order, at the same angles",
        f"angle_min {first.angle_min:.9g}, the last beam at {last_beam(first):.9g}",
        "a sector around 0",
        "pc2scan convert `target_frame=base_link`, or `geometry=symmetric`",
    )


def _refused_by_cartographer(scan: ConsumerScan, _first: ConsumerScan, placed: ScanTransforms) -> Verdict | None:
    def aborts(rule: str, observed: str, allowed: str, cure: str) -> Verdict:
        return Verdict("cartographer", "aborts", rule, observed, allowed, cure)

    # Written with `not`, because a check fails on NaN.
    if not scan.range_min >= 0:
        return aborts("CHECK range_min >= 0", f"range_min {scan.range_min:.9g}", ">= 0", "`range_min=0.0`")
    if not scan.range_max >= scan.range_min:
        return aborts(
            "CHECK range_max >= range_min",
            f"range_max {scan.range_max:.9g}",
            f">= range_min {scan.range_min:.9g}",
            "give a `range_max` beyond `range_min`",
        )
    forward = scan.angle_increment > 0
    low, high = (scan.angle_min, scan.angle_max) if forward else (scan.angle_max, scan.angle_min)
    if not high > low:
        return aborts(
            f"CHECK {'angle_max > angle_min' if forward else 'angle_min > angle_max'} "
            f"for angle_increment {scan.angle_increment:.9g}",
            f"angle_min {scan.angle_min:.9g}, angle_max {scan.angle_max:.9g}",
            "angle_max > angle_min" if forward else "angle_min > angle_max",
            "advertise angles in the order of the beams: pc2scan convert `preset=cartographer`",
        )
    hits = _hits(scan)
    # Cartographer checks this when it copies a range within the limits.
    if scan.intensities and scan.intensities != scan.beams and hits:
        return aborts(
            "CHECK len(intensities) == len(ranges), if there are intensities",
            f"{scan.intensities} intensities",
            f"0 or {scan.beams}",
            "write no intensities, or one for every beam",
        )
    # A scan without points is dropped before its frame is checked.
    if hits and placed.frame_id.startswith("/"):
        return aborts(
            "CHECK that the frame_id has no leading slash",
            f"frame_id {placed.frame_id!r}",
            repr(placed.frame_id.removeprefix("/")),
            "for scans made from clouds: pc2scan convert `source_frame`",
        )
    return None


def _placed_by_cartographer(scan: ConsumerScan, _first: ConsumerScan, _placed: ScanTransforms) -> Verdict:
    if _hits(scan) > 1 and scan.time_increment < 0:
        return Verdict(
            "cartographer",
            "misplaced",
            "points are taken in the order of time: those that are earlier than the first are placed at its pose",
            f"time_increment {scan.time_increment:.6g} s",
            ">= 0",
            "`time_increment=0.0`: pc2scan convert `preset=cartographer`",
        )
    if scan.infinite and scan.range_max == math.inf:
        return _infinite_hits("cartographer", scan)
    return _summed("cartographer", scan)


def _hits(scan: ConsumerScan) -> int:
    """Return how many ranges Cartographer takes for returns."""
    return scan.returns + (scan.infinite if scan.range_max == math.inf else 0)


def _refused_by_gmapping(scan: ConsumerScan, first: ConsumerScan, _placed: ScanTransforms) -> Verdict | None:
    if first.beams >= _GMAPPING_BEAMS:
        return Verdict(
            "gmapping",
            "aborts",
            "assert(beams < LASER_MAXBEAMS)",
            f"{first.beams} ranges",
            f"at most {_GMAPPING_BEAMS - 1}",
            "fewer beams: give `beams`, or a larger `angle_increment`",
        )
    if scan.beams != first.beams:
        return Verdict(
            "gmapping",
            "ignored",
            "every scan must be as long as the first",
            f"{scan.beams} ranges",
            f"{first.beams} ranges",
            "give all scans one number of beams: pc2scan convert `preset=gmapping`",
        )
    # gmapping skips ranges above the first scan's range_max, and replaces ranges below range_min by range_max.
    infinite = scan.infinite + (scan.short if scan.range_max == math.inf else 0)
    if infinite and not math.inf > first.range_max:
        return Verdict(
            "gmapping",
            "aborts",
            "the map grows until it contains every range up to range_max; ranges below range_min become range_max",
            f"{scan.infinite} infinite ranges, {scan.short} below range_min, range_max {first.range_max:.9g}",
            "a finite range_max",
            "give a finite `range_max`: pc2scan convert `preset=gmapping`",
        )
    return None


def _placed_by_gmapping(scan: ConsumerScan, first: ConsumerScan, placed: ScanTransforms) -> Verdict:
    kept = _kept_angles("gmapping", scan, first)
    if kept.outcome != "accepted" or not scan.beams:
        return kept
    down = placed.up is not None and placed.up <= 0
    return _half_open(scan.angle_min, scan.angle_max, scan.angle_increment, scan.beams, down=down)


@lru_cache(maxsize=64)
def _half_open(angle_min: float, angle_max: float, angle_increment: float, beams: int, *, down: bool) -> Verdict:
    """Return the verdict of gmapping on the places of a scan's beams; ``down`` if the sensor is upside down.

    It orders beams by growing angle, and places beam ``i`` at ``(i - N / 2) * angle_increment`` from the middle between
    ``angle_min`` and ``angle_max``; for a sensor that is upside down, as seen from below.
    """
    step = abs(angle_increment)
    middle = float32(float32(angle_min + angle_max) / 2)
    reverse = angle_min < angle_max if down else angle_min > angle_max
    off = max(
        (
            middle
            + (-1 if down else 1) * ((beams - 1 - beam if reverse else beam) - beams / 2) * step
            - (angle_min + beam * angle_increment)
            for beam in (0, beams - 1)
        ),
        key=abs,
    )
    steps = beams - 2 if reverse else beams
    wanted = float32(angle_min + steps * angle_increment)
    return _off(
        "gmapping",
        angle_increment,
        off,
        "beam i is placed at (i - len(ranges) / 2) * angle_increment from the middle between angle_min and angle_max",
        f"angle_max {angle_max:.9g}",
        f"angle_max {wanted:.9g}",
        f"advertise angle_max = angle_min + {steps} * angle_increment: pc2scan convert `preset=gmapping`",
    )


def _refused_by_amcl(scan: ConsumerScan, _first: ConsumerScan, _placed: ScanTransforms) -> Verdict | None:
    if scan.range_max <= 0:
        return Verdict(
            "amcl",
            "ignored",
            "range_max must be above 0",
            f"range_max {scan.range_max:.9g}",
            "> 0",
            "give a positive `range_max`: pc2scan convert `preset=amcl`",
        )
    return None


def _placed_by_amcl(scan: ConsumerScan, _first: ConsumerScan, placed: ScanTransforms) -> Verdict:
    # AMCL looks up the directions of the beams anew for each scan, but not the place of the sensor.
    kept = _kept_pose("amcl", placed, angle=False)
    if kept.outcome != "accepted" or not has_angles(scan) or not scan.beams:
        return kept
    # AMCL's increment is the difference of two angles, of which one is a sum of floats.
    increment = float32(scan.angle_min + scan.angle_increment) - scan.angle_min
    rounding = math.remainder(increment - scan.angle_increment, _TWO_PI) if math.isfinite(increment) else math.inf
    return _off(
        "amcl",
        scan.angle_increment,
        (scan.beams - 1) * rounding if scan.beams > 1 else 0.0,
        "the increment is the float32 sum angle_min + angle_increment, less angle_min",
        f"angle_increment {scan.angle_increment:.9g}, read as {increment:.9g} for {scan.beams} ranges",
        "a rounding that adds up to less than half an increment",
        "fewer beams: give `beams`, or a larger `angle_increment`",
        least=_DRIFTED,
    )


def _placed_by_nav2(scan: ConsumerScan, _first: ConsumerScan, _placed: ScanTransforms) -> Verdict:
    if scan.infinite and scan.range_max == math.inf:
        return _infinite_hits("nav2", scan)
    return _summed("nav2", scan)


def _summed(consumer: str, scan: ConsumerScan) -> Verdict:
    """Return the verdict of a consumer that adds the increment to a float, from beam to beam."""
    if not has_angles(scan) or not scan.beams:
        return Verdict(consumer)
    return _added_up(consumer, scan.angle_min, scan.angle_increment, scan.beams)


@lru_cache(maxsize=64)
def _added_up(consumer: str, angle_min: float, angle_increment: float, beams: int) -> Verdict:
    steps = np.full(beams, angle_increment, np.float32)
    steps[0] = angle_min
    with np.errstate(over="ignore"):
        off = np.add.accumulate(steps).astype(np.float64)
    off -= angle_min + np.arange(beams) * angle_increment
    return _off(
        consumer,
        angle_increment,
        float(np.abs(off).max()),
        "the angles are a float32 sum: angle += angle_increment from beam to beam",
        f"{beams} ranges by {angle_increment:.9g}",
        "roundings that add up to less than half an increment",
        "fewer beams: give `beams`, or a larger `angle_increment`",
        least=_DRIFTED,
    )


def _refused_by_mrpt(scan: ConsumerScan, _first: ConsumerScan, _placed: ScanTransforms) -> Verdict | None:
    if scan.beams < SYMMETRIC_BEAMS[0]:
        return Verdict(
            "mrpt",
            "aborts",
            "ASSERT(ranges.size() > 2)",
            f"{scan.beams} ranges",
            f"at least {SYMMETRIC_BEAMS[0]}",
            "more beams",
        )
    return None


def _placed_by_mrpt(scan: ConsumerScan, _first: ConsumerScan, _placed: ScanTransforms) -> Verdict:
    return _mrpt_sector(scan.angle_min, scan.angle_max, scan.angle_increment, scan.beams)


@lru_cache(maxsize=64)
def _mrpt_sector(angle_min: float, angle_max: float, angle_increment: float, beams: int) -> Verdict:
    """Return the verdict of MRPT on the places of a scan's beams."""
    found = {name: _mrpt_off(angle_min, angle_max, angle_increment, beams, name) for name in _MRPT_BRIDGES}
    number, off = (max(values) for values in zip(*found.values(), strict=True))
    misread = [name for name, (count, _) in found.items() if count]
    allowed = "angles of the beams"
    half = (beams - 1) * abs(angle_increment) / 2
    if 0 < half <= math.pi:
        low, high = symmetric_sector(half)
        allowed = f"angle_min {low:.9g}, angle_max {high:.9g}"
    return _off(
        "mrpt",
        angle_increment,
        off,
        "angles run from -(angle_max - angle_min) / 2 to + that in equal steps; angle_increment is not read",
        f"angle_min {angle_min:.9g}, angle_max {angle_max:.9g}" + (f", in {misread[0]}" if len(misread) == 1 else ""),
        allowed,
        "pc2scan convert `preset=mrpt`, or `geometry=symmetric`",
        which=f"{number:,} of {beams:,} beams",
    )


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


def _off(
    consumer: str,
    angle_increment: float,
    off: float,
    rule: str,
    observed: str,
    allowed: str,
    cure: str,
    *,
    which: str = "beams",
    least: float = _OFF,
) -> Verdict:
    """Return the verdict on a scan of which beams are off by up to ``off``, radians.

    It is accepted up to ``least``, a share of the increment.
    """
    share = abs(off) / abs(angle_increment) if angle_increment else math.inf if off else 0.0
    if share <= least:
        return Verdict(consumer)
    turned = f"{which} off by up to {abs(math.degrees(off)):.3g} deg ({share:.3g} of an increment)"
    if off == math.inf:
        turned = "it reads beyond the end of the ranges"
    outcome: Outcome = "shifted" if share <= _SHIFTED else "misplaced"
    return Verdict(consumer, outcome, rule, f"{observed}: {turned}", allowed, cure)


def _advertise(scan: ConsumerScan) -> str:
    """Return what the header should advertise."""
    if not has_angles(scan):
        return "advertise the angles of the beams, angle_min + i * angle_increment"
    return f"advertise angle_max {last_beam(scan):.9g}, the last beam's angle" if scan.beams else "advertise beams"


def _infinite_hits(consumer: str, scan: ConsumerScan) -> Verdict:
    """Return the verdict of a consumer for which range_min <= range <= range_max is a return, even if infinite."""
    return Verdict(
        consumer,
        "misplaced",
        "a range within range_max is a return, and inf <= inf",
        f"{scan.infinite} infinite ranges, range_max {scan.range_max:.9g}",
        "a finite range_max",
        f"give a finite `range_max`: pc2scan convert `preset={consumer}`",
    )


def _kept_angles(consumer: str, scan: ConsumerScan, first: ConsumerScan) -> Verdict:
    """Return the verdict of a consumer that uses the first scan's angles for all scans."""
    begin = scan.angle_min - first.angle_min
    end = begin + (scan.beams - 1) * (scan.angle_increment - first.angle_increment)
    off = max(abs(begin), abs(end))
    if not scan.beams or off <= _OFF * abs(first.angle_increment):
        return Verdict(consumer)
    return Verdict(
        consumer,
        "misplaced",
        "the first scan's angles are kept for all",
        f"angle_min {scan.angle_min:.9g}, angle_increment {scan.angle_increment:.9g}, "
        f"a beam off by {math.degrees(off):.3g} deg",
        f"angle_min {first.angle_min:.9g}, angle_increment {first.angle_increment:.9g}",
        "give all scans the same angles (pc2scan convert does, to scans made from clouds)",
    )


def _kept_pose(consumer: str, placed: ScanTransforms, *, angle: bool) -> Verdict:
    """Return the verdict of a consumer that keeps where the scan's frame was on the robot at first."""
    if placed.moved <= _MOVED and not (angle and abs(placed.turned) > _TURNED):
        return Verdict(consumer)
    turned = f"turned by {math.degrees(placed.turned):.3g} deg, and " if angle else ""
    return Verdict(
        consumer,
        "misplaced",
        f"the {'pose' if angle else 'place'} of the scan's frame on the robot at the first scan is kept for all",
        f"since then the frame {placed.frame_id!r} has {turned}moved by {placed.moved:.2f} m",
        f"up to {f'{math.degrees(_TURNED):g} deg and ' if angle else ''}{_MOVED:g} m",
        "a frame that is fixed on the robot: for scans made from clouds, pc2scan convert `target_frame=base_link`",
    )


class Rules(NamedTuple):
    """The rules of a consumer: functions of a scan, the first scan of its sensor, and what the transforms say about it.

    Attributes
    ----------
    refuse
        Returns why it does not use the scan, or aborts; None if it uses the scan. None: it uses every scan.
    place
        Returns whether it places the beams of a scan that it uses where they were measured.
    """

    refuse: Callable[[ConsumerScan, ConsumerScan, ScanTransforms], Verdict | None] | None
    place: Callable[[ConsumerScan, ConsumerScan, ScanTransforms], Verdict]


#: The consumers by name, in the order in which they are shown.
CONSUMERS: dict[str, Rules] = {
    "slam_toolbox": Rules(_refused_by_slam_toolbox, _placed_by_slam_toolbox),
    "cartographer": Rules(_refused_by_cartographer, _placed_by_cartographer),
    "gmapping": Rules(_refused_by_gmapping, _placed_by_gmapping),
    "amcl": Rules(_refused_by_amcl, _placed_by_amcl),
    "nav2": Rules(None, _placed_by_nav2),
    "mrpt": Rules(_refused_by_mrpt, _placed_by_mrpt),
}
