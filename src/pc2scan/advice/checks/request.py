"""Checks of a request alone: options that have no effect, and values that are probably a mistake.

Only parameters that are given as options are checked, because a parameter file usually lists all parameters.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.core.layout import FULL_TURN
from pc2scan.core.timing import is_brief
from pc2scan.request.parameters import is_given
from pc2scan.text import stamp

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.model import Summary
    from pc2scan.options.moment import TimeBound
    from pc2scan.request.options import ConvertOptions, ScanSpec

#: An angle_increment of this many radians (11 degrees) or more is nearly always meant in degrees.
_COARSE = 0.2

#: A warning is worth it if this share of the beams is out of reach.
_NOTABLE_SHARE = 0.01

#: A range_max from here on, metres, is taken for millimetres.
_FARTHEST = 1500.0

#: A tolerance of this many seconds or more, or a scan that takes so long, is nearly always meant in milliseconds.
_LONG = 5.0


#: Messages of less time, nanoseconds, are the packets of a turn: together they are a cloud like any other.
_TURN_NS = 200_000_000

#: No recording takes so long.
_CENTURY_NS = 100 * 365 * 86_400 * 1_000_000_000


class OutputRequest(NamedTuple):
    """The request of one output: all options, and its own."""

    options: ConvertOptions
    spec: ScanSpec

    @property
    def given(self) -> set[str]:
        """The parameters that are given as options."""
        return {name for name, origin in self.spec.origins.items() if is_given(origin)}


class Cut(NamedTuple):
    """The cut of a conversion, and the extent of the recording."""

    start: TimeBound | None
    end: TimeBound | None
    recorded: Summary


def fixed_frame_beside_imu(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if scans are made level by an IMU and by a frame."""
    spec = request.spec
    if spec.level and spec.imu and spec.fixed_frame and not (spec.deskew or spec.may_combine):
        yield "`fixed_frame` has no effect: roll and pitch come from `imu`"


def equal_frames(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if clouds are transformed to the frame that they are in."""
    spec = request.spec
    source = request.options.frames.source_frame.removeprefix("/")
    if spec.needs_transforms and source and source == spec.params.target_frame.removeprefix("/"):
        yield f"`source_frame` and `target_frame` are both {source}: nothing is transformed"


def unused_transforms(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if there are options about transforms, and nothing is transformed."""
    frames = request.options.frames
    if request.spec.needs_transforms:
        return
    idle = [
        name
        for name, is_given in (
            ("static_tf", frames.static and not frames.write_static),
            ("urdf", frames.model is not None and not frames.write_static),
            ("tf_from", frames.tf_from),
            ("tf_topics", frames.tf_topics),
            ("transform_tolerance", "transform_tolerance" in request.given),
        )
        if is_given
    ]
    if idle:
        names = ", ".join(f"`{name}`" for name in idle)
        yield (
            f"{names} {'have' if idle[1:] else 'has'} no effect without `target_frame`: "
            "every message stays in its own frame"
        )


def accumulated_without_effect(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if clouds are accumulated one by one, or without regard to the robot's motion."""
    spec, combining = request.spec, request.spec.combining
    if combining.count == 1:
        yield "`accumulate=1clouds` has no effect: every scan is made of one cloud"
    elif combining.accumulates and not spec.fixed_frame and not 0 < combining.every_ns < _TURN_NS:
        yield (
            "`accumulate` and `every` without `fixed_frame` combine messages as if the robot had not moved; "
            "with odometry: `fixed_frame=odom`"
        )


def fixed_frame_of_rebinned(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if each scan becomes one, and nothing needs the robot's motion."""
    spec, combining = request.spec, request.spec.combining
    needed = spec.deskew or spec.level or combining.accumulates or spec.may_share
    if spec.fixed_frame and combining.rebin and not needed:
        yield "`fixed_frame` has no effect: each scan becomes one; `deskew` places each beam at its own time"


def zeros_as_obstacles(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if beams without a return look like obstacles at the sensor."""
    params = request.spec.params
    if not request.spec.reverse and params.no_return == "zero" and params.range_min <= 0:
        yield (
            "beams without a return are 0, and range_min is 0 m, so that SLAM and navigation take them for obstacles "
            "at the sensor; with them beyond the limits: `range_min=0.1`"
        )


def unused_no_return(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if the value of beams without a return does not depend on the options about it."""
    params, given = request.spec.params, request.given
    is_sum = (params.no_return or ("inf" if params.use_inf else "range-max-plus")) == "range-max-plus"
    if request.spec.reverse:
        return
    if "inf_epsilon" in given and not is_sum:
        yield "`inf_epsilon` has no effect: it is used only with `no_return=range-max-plus`, or use_inf off"
    elif is_sum and {"use_inf", "inf_epsilon"} & given and math.isinf(params.empty_range):
        yield "beams without a return are inf anyway: range_max is infinite; give a `range_max`"


def returns_without_object(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if a parameter puts returns where there is no object."""
    if request.spec.params.reduce == "mean" and not request.spec.reverse:
        yield (
            "reduce is mean, which puts returns where nothing is, between a near and a far object: "
            "8 % of the returns in a simulated hall. `reduce=surface` is as smooth, without them"
        )


def times_in_another_unit(request: OutputRequest) -> Iterator[str]:
    """Yield a warning for each time that is so long or so short that another unit was probably meant."""
    spec, params = request.spec, request.spec.params
    turn = params.time_increment * params.length if isinstance(params.time_increment, float) else 0.0
    times = (
        ("transform_tolerance", params.transform_tolerance, "a transform of that age is used as if it were current"),
        ("scan_time", params.scan_time, "a lidar takes less than a second for a scan"),
        ("time_increment", params.time_increment, f"{params.length} beams take {abs(turn):,.0f} s"),
    )
    for name, value, why in times:
        if name not in request.given or isinstance(value, str) or (spec.reverse and name != "transform_tolerance"):
            continue
        if abs(turn if name == "time_increment" else value) >= _LONG:
            yield f"{name} is {value:g} s, and {why}; milliseconds are written `{name}={value:g}ms`"
        elif name != "transform_tolerance" and not isinstance(params.beams, str):
            # Of a sector, however narrow it is.
            circle = abs(value) * (FULL_TURN / params.layout.angle_increment if name == "time_increment" else 1)
            if is_brief(circle, math.inf):
                took = f"a whole turn takes {circle:.3g} s" if name == "time_increment" else "no lidar is so fast"
                yield f"{name} is {value:g} s, and {took}: it is in seconds; `{name}=auto` measures it"


def range_in_millimetres(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if range_max is so large that millimetres were probably meant."""
    value = request.spec.params.range_max
    if "range_max" in request.given and _FARTHEST <= value < 1e6 and not says_unlimited(value):
        yield f"range_max is {value:g} m, and no lidar measures as far; millimetres are written `range_max={value:g}mm`"


def says_unlimited(value: float) -> bool:
    """Return whether a limit is a way to say that there is none: 100, 1000, 999.

    >>> [value for value in (150.0, 999.0, 1000.0, 30000.0) if says_unlimited(value)]
    [999.0, 1000.0]
    """
    return math.log10(value).is_integer() or set(f"{value:g}") == {"9"}


def increment_in_degrees(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if beams are so wide that degrees were probably meant."""
    params, origins = request.spec.params, request.spec.origins
    increment = params.angle_increment
    if request.spec.reverse or params.beams or origins.get("angle_increment", "default") == "default":
        return
    if increment >= _COARSE:
        yield (
            f"angle_increment is {increment:g} rad, which is {math.degrees(increment):.3g} degrees a beam: "
            f"{params.length} beams; for {increment:g} deg write `angle_increment={increment:g}deg`"
        )


def sector_in_degrees(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if scans have more than a full turn, so that degrees were probably meant."""
    params = request.spec.params
    span = params.angle_max - params.angle_min
    if not request.spec.reverse and span > FULL_TURN:
        yield (
            f"angle_min {params.angle_min:g} to angle_max {params.angle_max:g} rad is a sector of "
            f"{math.degrees(span):.0f} degrees: beams beyond pi stay empty; degrees are written `angle_max=90deg`"
        )


def beams_beyond_half_turn(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if some beams have angles that no point has: those of points are from -pi to pi."""
    params = request.spec.params
    # Beams of a full circle go round it, wherever it begins.
    if request.spec.reverse or params.angle_max - params.angle_min > FULL_TURN or params.layout.full_circle:
        return
    low, high = max(params.angle_min, -math.pi), min(params.angle_max, math.pi)
    share = 1 - max(0.0, high - low) / (params.angle_max - params.angle_min)
    if share >= _NOTABLE_SHARE:
        first, last = math.degrees(params.angle_min), math.degrees(params.angle_max)
        yield (
            f"angle_min is {first:.4g} degrees and angle_max {last:.4g}, but the angles of points are from -180 to "
            f"180: {share:.0%} of the beams never have a return; a full turn is `angle_min=-180deg` `angle_max=180deg`"
        )


def log_times_of_centuries(cut: Cut) -> Iterator[str]:
    """Yield a warning if log times are so far apart that some of them are wrong."""
    first_ns, last_ns = cut.recorded.start_ns, cut.recorded.end_ns
    if first_ns is not None and last_ns is not None and last_ns - first_ns > _CENTURY_NS:
        yield (
            f"its log times are from {stamp(first_ns)} to {stamp(last_ns)}, {(last_ns - first_ns) / _CENTURY_NS:.1f} "
            "centuries: some are wrong, such as one that rolled over; `start` and `end` cut messages off"
        )


def cut_without_effect(cut: Cut) -> Iterator[str]:
    """Yield a warning if times of day are given as a cut, and the whole recording is within it.

    Times that count from the beginning draw none: the same cut may be used for recordings of many lengths.
    """
    first_ns, last_ns = cut.recorded.start_ns, cut.recorded.end_ns
    if first_ns is None or last_ns is None or not cut.recorded.message_count:
        return
    bounds = {
        name: bound.resolve(first_ns)
        for name, bound in (("start", cut.start), ("end", cut.end))
        if bound is not None and (bound.absolute or bound.nanoseconds)
    }
    absolute = [
        name for name, bound in (("start", cut.start), ("end", cut.end)) if bound is not None and bound.absolute
    ]
    if not absolute or bounds.get("start", first_ns) > first_ns or bounds.get("end", last_ns + 1) <= last_ns:
        return
    # The first message may be at the start itself.
    if bounds.get("start") == first_ns or bounds.get("end") == last_ns + 1:
        return
    shown = " and ".join(f"`{name}` is {stamp(bounds[name])}" for name in absolute)
    meant = next(filter(None, (in_another_unit(name, bounds[name], first_ns, last_ns) for name in absolute)), "")
    yield (
        f"the cut has no effect: {shown}, the recording is from {stamp(first_ns)} to {stamp(last_ns)}"
        + (f"; {meant}" if meant else "")
    )


def in_another_unit(name: str, time_ns: int, first_ns: int, last_ns: int) -> str:
    """Return which option a time in another unit would be; empty if none is inside of the recording."""
    for unit, factor in (("milliseconds", 1_000_000), ("microseconds", 1_000)):
        # Text and floats count seconds since 1970, large integers nanoseconds.
        for meant_ns in (time_ns * factor, time_ns * factor // 1_000_000_000):
            if first_ns <= meant_ns <= last_ns:
                seconds = f"{meant_ns // 1_000_000_000}.{meant_ns % 1_000_000_000:09d}".rstrip("0").rstrip(".")
                return f"if it was given in {unit}: `{name}=@{seconds}`"
    return ""
