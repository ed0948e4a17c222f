"""What the programs that read laser scans do with one: take it, ignore it, die of it, or mis-place its beams.

Sources of the rules, in C++ (floats of the message are float32, literals float64 unless marked):

- slam_toolbox: ``LaserAssistant::makeLaser`` (laser_utils.cpp), ``LaserRangeFinder::Update``, ``Validate`` (Karto.h).
- Cartographer: ``LaserScanToPointCloudWithIntensities`` (cartographer_ros, msg_conversion.cc).
- gmapping: ``initMapper`` and ``addScan`` (slam_gmapping.cpp), ``setLaserParameters`` (openslam, scanmatcher.cpp).
- AMCL: ``AmclNode::updateFilter`` (nav2_amcl, amcl_node.cpp).
- Nav2: ``Scan::getSourceData`` (nav2_collision_monitor, scan.cpp). Its costmap leaves infinite ranges out: it takes
  what laser_geometry takes, ``range < range_max``.
- MRPT: ``fromROS`` (ros2bridge, laser_scan.cpp).

The arithmetic is theirs, in plain Python: float64 operations on float32 operands, rounded to float32 where the C++
result is a float, which is the float32 result (see `pc2scan.core.params.beam_count`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from .params import float32

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

__all__ = ["CONSUMERS", "OUTCOMES", "Outcome", "Scan", "Verdict", "expected_by_karto", "judge", "last_beam"]

Outcome = Literal["accepted", "misplaced", "ignored", "aborts"]

#: From the harmless to the worst: accepted; taken, but with beams or ranges where there is nothing; thrown away; a
#: failed check that ends the process.
OUTCOMES: tuple[Outcome, ...] = ("accepted", "misplaced", "ignored", "aborts")

#: gmapping asserts ``beams < LASER_MAXBEAMS``.
_GMAPPING_BEAMS = 2048

#: MRPT asserts ``ranges.size() > 2``.
_MRPT_BEAMS = 3

#: Beams that are off by more than this share of an increment are mis-placed. Smaller differences are roundings of a
#: driver's angles; none of the consumers draws the line itself.
_MISPLACED = 0.1

_TWO_PI = 2 * math.pi

#: ``std::numeric_limits<float>::epsilon() * 2.0f * M_PI``: the first product is a float, the second a double.
_KARTO_EPSILON = 2.0**-23 * 2 * math.pi

#: 350 degrees, as Karto's wrapper writes them.
_KARTO_NEARLY_FULL = 6.10865


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """What a scan advertises, and what is in its arrays.

    Attributes
    ----------
    angle_min, angle_max, angle_increment
        Radians; rounded to float32 when the scan is made, as all numbers here.
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
        Ranges below ``range_min``, the zeros among them included.
    long
        Finite ranges above ``range_max``.
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

    def __post_init__(self) -> None:
        for name in (
            "angle_min",
            "angle_max",
            "angle_increment",
            "range_min",
            "range_max",
            "scan_time",
            "time_increment",
        ):
            object.__setattr__(self, name, float32(getattr(self, name)))

    @classmethod
    def of(
        cls,
        ranges: NDArray[np.float32],
        *,
        angle_min: float,
        angle_max: float,
        angle_increment: float,
        range_min: float,
        range_max: float,
        scan_time: float = 0.0,
        time_increment: float = 0.0,
        intensities: int = 0,
    ) -> Scan:
        """Count what is in the ranges, float32, shape (beams,), metres; the others as in the class."""
        infinite = int((ranges == math.inf).sum())
        nan = int((ranges != ranges).sum())  # noqa: PLR0124  # NaN is what does not equal itself
        low, high = float32(range_min), float32(range_max)
        within = int(((ranges >= low) & (ranges <= high)).sum())
        return cls(
            angle_min=angle_min,
            angle_max=angle_max,
            angle_increment=angle_increment,
            range_min=range_min,
            range_max=range_max,
            scan_time=scan_time,
            time_increment=time_increment,
            beams=len(ranges),
            intensities=intensities,
            # inf <= inf, but it is nothing that was seen.
            returns=within - (infinite if high == math.inf else 0),
            infinite=infinite,
            nan=nan,
            zero=int((ranges == 0).sum()),
            short=int((ranges < low).sum()),
            long=int(((ranges > high) & (ranges < math.inf)).sum()),
        )


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a consumer does with a scan.

    Attributes
    ----------
    consumer
        One of `CONSUMERS`.
    outcome
        One of `OUTCOMES`.
    rule
        The consumer's rule that decided; empty if the scan is accepted, and the others then too.
    observed, allowed
        What the scan has, and what the rule wants.
    cure
        What to do about it.
    """

    consumer: str
    outcome: Outcome = "accepted"
    rule: str = ""
    observed: str = ""
    allowed: str = ""
    cure: str = ""

    @property
    def refused(self) -> bool:
        """Whether nothing comes of the scan."""
        return self.outcome in ("ignored", "aborts")


def judge(consumer: str, scan: Scan, first: Scan | None = None) -> Verdict:
    """What a consumer does with a scan.

    Parameters
    ----------
    consumer
        One of `CONSUMERS`.
    scan
        The scan.
    first
        The first scan that this consumer saw of the sensor: slam_toolbox and gmapping keep its angles and its
        length for all others. None if this is the first.

    Raises
    ------
    KeyError
        If there is no such consumer.
    """
    return CONSUMERS[consumer](scan, scan if first is None else first)


def last_beam(scan: Scan) -> float:
    """The angle of the last beam, radians, as float32: what ``angle_max`` should be."""
    return float32(scan.angle_min + (scan.beams - 1) * scan.angle_increment)


def expected_by_karto(scan: Scan) -> int | None:
    """The length of ``ranges`` that slam_toolbox expects of a scan's angles, and of all that follow it.

    None where its arithmetic has no result: an increment of 0, or angles that are not finite.
    """
    span = abs(float32(scan.angle_max - scan.angle_min))
    if not math.isfinite(scan.angle_increment) or scan.angle_increment == 0:
        return None
    full = abs(span - _TWO_PI) < scan.angle_increment - _KARTO_EPSILON
    # The message's length, compared as a float, tells a circle whose first beam is doubled at its end.
    steps = float32(span / scan.angle_increment)
    if not math.isfinite(steps):
        return None
    if span > _KARTO_NEARLY_FULL and _rounded(steps) + 1 == scan.beams:
        full = False
    # Karto keeps the angles as doubles.
    return _rounded((scan.angle_max - scan.angle_min) / scan.angle_increment) + (0 if full else 1)


def _rounded(value: float) -> int:
    """``std::round`` and Karto's ``math::Round``: halves away from zero."""
    return math.floor(value + 0.5) if value >= 0 else math.ceil(value - 0.5)


def _slam_toolbox(scan: Scan, first: Scan) -> Verdict:
    expected = expected_by_karto(first)
    if expected == scan.beams:
        return _kept_angles("slam_toolbox", scan, first)
    if scan.beams != first.beams and expected == first.beams:
        return Verdict(
            "slam_toolbox",
            "ignored",
            "every scan must be as long as the first one's angles say",
            f"{scan.beams} ranges",
            f"{expected} ranges",
            "give all scans one number of beams (pc2scan convert does, to scans made from clouds)",
        )
    return Verdict(
        "slam_toolbox",
        "ignored",
        "len(ranges) must be round((angle_max - angle_min) / angle_increment) + 1, or + 0 for a full circle",
        f"{scan.beams} ranges",
        f"{expected} ranges" if expected is not None and expected > 0 else "angles that make a number of beams",
        f"{_advertise(first)}: pc2scan convert --preset slam_toolbox, or --geometry centered",
    )


def _cartographer(scan: Scan, _first: Scan) -> Verdict:
    def aborts(rule: str, observed: str, allowed: str, cure: str) -> Verdict:
        return Verdict("cartographer", "aborts", rule, observed, allowed, cure)

    # Written with `not`, since a check fails on NaN.
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
            "advertise angles in the order of the beams: pc2scan convert --preset cartographer",
        )
    hits = scan.returns + (scan.infinite if scan.range_max == math.inf else 0)
    # The check stands where a range within the limits is taken over.
    if scan.intensities and scan.intensities != scan.beams and hits:
        return aborts(
            "CHECK len(intensities) == len(ranges), if there are intensities",
            f"{scan.intensities} intensities",
            f"0 or {scan.beams}",
            "leave the intensities out, or give every beam one",
        )
    return _infinite_hits("cartographer", scan)


def _gmapping(scan: Scan, first: Scan) -> Verdict:
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
            "give all scans one number of beams (pc2scan convert does, to scans made from clouds)",
        )
    verdict = _infinite_hits("gmapping", scan)
    if verdict.outcome != "accepted":
        return verdict
    # Ranges below range_min are replaced by range_max.
    if math.isinf(scan.range_max) and scan.short:
        return Verdict(
            "gmapping",
            "misplaced",
            "a range below range_min becomes range_max, and goes into the map",
            f"{scan.short} ranges below range_min, range_max {scan.range_max:.9g}",
            "a finite range_max",
            "give a finite `range_max`: pc2scan convert --preset gmapping",
        )
    return _kept_angles("gmapping", scan, first)


def _amcl(scan: Scan, _first: Scan) -> Verdict:
    if scan.range_max <= 0:
        return Verdict(
            "amcl",
            "ignored",
            "range_max must be above 0",
            f"range_max {scan.range_max:.9g}",
            "> 0",
            "give a positive `range_max`: pc2scan convert --preset amcl",
        )
    return Verdict("amcl")


def _nav2(scan: Scan, _first: Scan) -> Verdict:
    return _infinite_hits("nav2", scan)


def _mrpt(scan: Scan, _first: Scan) -> Verdict:
    if scan.beams < _MRPT_BEAMS:
        return Verdict(
            "mrpt",
            "aborts",
            "ASSERT(ranges.size() > 2)",
            f"{scan.beams} ranges",
            f"at least {_MRPT_BEAMS}",
            "more beams",
        )
    # angle_increment is not read: the step is the aperture over the number of steps.
    step = float32(scan.angle_max - scan.angle_min) / (scan.beams - 1)
    off = (scan.beams - 1) * (step - scan.angle_increment)
    if abs(off) <= _MISPLACED * abs(scan.angle_increment):
        return Verdict("mrpt")
    return Verdict(
        "mrpt",
        "misplaced",
        "angle_increment is ignored, the step is (angle_max - angle_min) / (len(ranges) - 1)",
        f"a step of {step:.9g}, the last beam off by {abs(math.degrees(off)):.3g} deg",
        f"angle_increment {scan.angle_increment:.9g}",
        f"{_advertise(scan)}: pc2scan convert --geometry centered",
    )


def _advertise(scan: Scan) -> str:
    """What would be right to advertise."""
    return f"advertise angle_max {last_beam(scan):.9g}, the last beam's angle" if scan.beams else "advertise beams"


def _infinite_hits(consumer: str, scan: Scan) -> Verdict:
    """The verdict of a consumer that takes range_min <= range <= range_max for a return.

    gmapping leaves out what is above range_max instead, which is something else if that is NaN.
    """
    passes = not math.inf > scan.range_max if consumer == "gmapping" else math.inf <= scan.range_max
    if not (passes and scan.infinite):
        return Verdict(consumer)
    return Verdict(
        consumer,
        "misplaced",
        "a range within range_max is a return, and inf <= inf",
        f"{scan.infinite} infinite ranges, range_max {scan.range_max:.9g}",
        "a finite range_max",
        f"give a finite `range_max`: pc2scan convert --preset {consumer}",
    )


def _kept_angles(consumer: str, scan: Scan, first: Scan) -> Verdict:
    """The verdict of a consumer that keeps the first scan's angles."""
    begin = scan.angle_min - first.angle_min
    end = begin + (scan.beams - 1) * (scan.angle_increment - first.angle_increment)
    off = max(abs(begin), abs(end))
    if not scan.beams or off <= _MISPLACED * abs(first.angle_increment):
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


#: The consumers by name, in the order in which they are shown.
CONSUMERS: dict[str, Callable[[Scan, Scan], Verdict]] = {
    "slam_toolbox": _slam_toolbox,
    "cartographer": _cartographer,
    "gmapping": _gmapping,
    "amcl": _amcl,
    "nav2": _nav2,
    "mrpt": _mrpt,
}
