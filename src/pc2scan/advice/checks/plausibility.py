"""Checks of a request alone: options that have no effect, and values that are probably a mistake.

Only parameters that are given as options are checked, because a parameter file usually lists all parameters.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.advice.clocks import moving
from pc2scan.errors import name_list
from pc2scan.request.precedence import is_given
from pc2scan.text import stamp

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pc2scan.model import Connection, Summary
    from pc2scan.request.spec import Request, ScanSpec

#: A warning is worth it if this share of the beams is out of reach.
_NOTABLE_SHARE = 0.01

#: From so much on, a value is nearly always meant in a smaller unit than its own; and why.
_LARGE = {
    "transform_tolerance": (5.0, "s", "ms", "a transform of that age is used as if it were current"),
    "scan_time": (5.0, "s", "ms", "a lidar takes less than a second for a scan"),
    "time_increment": (0.01, "s", "us", "a lidar takes less than a millisecond from beam to beam"),
    "angle_increment": (0.2, "rad", "deg", "a turn of a lidar has more than 31 beams"),
}

#: Messages of less time, nanoseconds, are the packets of a turn: together they are a cloud like any other.
_TURN_NS = 200_000_000

#: No recording takes so long.
_CENTURY_NS = 100 * 365 * 86_400 * 1_000_000_000


class OutputRequest(NamedTuple):
    """The request of one output: all options, and its own; and the recording's connections."""

    options: Request
    spec: ScanSpec
    connections: Sequence[Connection]

    @property
    def given(self) -> set[str]:
        """The parameters that are given as options."""
        return {name for name, origin in self.spec.origins.items() if is_given(origin)}


def unused_transforms(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if there are options about transforms, and nothing is transformed."""
    frames = request.options.frames
    if request.spec.needs_transforms:
        return
    options = {
        "static_tf": frames.static and not frames.write_static,
        "urdf": frames.model is not None and not frames.write_static,
        "tf_from": frames.tf_from,
        "tf_topics": frames.tf_topics,
        "transform_tolerance": "transform_tolerance" in request.given,
    }
    if idle := [f"`{name}`" for name, is_given in options.items() if is_given]:
        yield (
            f"{name_list(idle)} {'have' if idle[1:] else 'has'} no effect without `target_frame`: "
            "every message stays in its own frame"
        )


def accumulated_without_motion(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if clouds are accumulated without regard to the robot's motion, which is recorded."""
    combining = request.spec.combining
    if (
        combining.accumulates
        and combining.count != 1
        and not request.spec.fixed_frame
        and not 0 < combining.every_ns < _TURN_NS
        and moving(request.connections, request.options.frames.tf_topics)
    ):
        yield (
            "`accumulate` and `every` without `fixed_frame` combine messages as if the robot had not moved; "
            "with odometry: `fixed_frame=odom`"
        )


def returns_without_object(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if a parameter puts returns where there is no object."""
    if request.spec.params.reduce == "mean" and not request.spec.reverse:
        yield (
            "reduce is mean, which puts returns where nothing is, between a near and a far object: "
            "8 % of the returns in a simulated hall. `reduce=surface` is as smooth, without them"
        )


def values_in_another_unit(request: OutputRequest) -> Iterator[str]:
    """Yield a warning for each value that is so large that a smaller unit was probably meant."""
    for name, (largest, unit, smaller, why) in _LARGE.items():
        value = getattr(request.spec.params, name)
        if not request.spec.is_default(name) and not isinstance(value, str) and value >= largest:
            yield f"{name} is {value:g} {unit}, and {why}; for {value:g} {smaller} write `{name}={value:g}{smaller}`"


def beams_beyond_half_turn(request: OutputRequest) -> Iterator[str]:
    """Yield a warning if some beams have angles that no point has: those of points are from -pi to pi."""
    params = request.spec.params
    # Beams of a full circle go round it, wherever it begins.
    if request.spec.reverse or params.layout.full_circle:
        return
    first, last = params.angle_min, params.angle_max
    share = 1 - max(0.0, min(last, math.pi) - max(first, -math.pi)) / (last - first)
    if share >= _NOTABLE_SHARE:
        yield (
            f"angle_min is {math.degrees(first):.4g} degrees and angle_max {math.degrees(last):.4g}, but the angles of "
            f"points are from -180 to 180: {share:.0%} of the beams never have a return; a full turn is "
            "`angle_min=-180deg` `angle_max=180deg`"
        )


def log_times_of_centuries(recorded: Summary) -> Iterator[str]:
    """Yield a warning if log times are so far apart that some of them are wrong."""
    first_ns, last_ns = recorded.start_ns, recorded.end_ns
    if first_ns is not None and last_ns is not None and last_ns - first_ns > _CENTURY_NS:
        yield (
            f"its log times are from {stamp(first_ns)} to {stamp(last_ns)}, {(last_ns - first_ns) / _CENTURY_NS:.1f} "
            "centuries: some are wrong, such as one that rolled over; `start` and `end` cut messages off"
        )


def cut_in_another_unit(request: Request, recorded: Summary) -> Iterator[str]:
    """Yield a warning if a cut is outside of the recording, and inside of it in another unit of time."""
    first_ns, last_ns = recorded.start_ns, recorded.end_ns
    for name, bound in (("start", request.start), ("end", request.end)):
        if bound is None or not bound.absolute or first_ns is None or last_ns is None:
            continue
        if meant := in_another_unit(name, bound.resolve(first_ns), first_ns, last_ns):
            extent = f"from {stamp(first_ns)} to {stamp(last_ns)}"
            yield f"`{name}` is {stamp(bound.resolve(first_ns))}, the recording is {extent}; {meant}"


def in_another_unit(name: str, time_ns: int, first_ns: int, last_ns: int) -> str:
    """Return which option a time in another unit would be; empty if none is inside of the recording."""
    for unit, factor in (("milliseconds", 1_000_000), ("microseconds", 1_000)):
        # Text and floats count seconds since 1970, large integers nanoseconds.
        for meant_ns in (time_ns * factor, time_ns * factor // 1_000_000_000):
            if first_ns <= meant_ns <= last_ns:
                seconds = f"{meant_ns // 1_000_000_000}.{meant_ns % 1_000_000_000:09d}".rstrip("0").rstrip(".")
                return f"if it was given in {unit}: `{name}=@{seconds}`"
    return ""
