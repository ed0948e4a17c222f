"""Checks for options that have no effect, and for values that are probably a mistake."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING

from pc2scan.core.layout import FULL_TURN
from pc2scan.errors import MissingError, UsageError
from pc2scan.text import did_you_mean

from .parameters import from_option

if TYPE_CHECKING:
    from .options import ConvertOptions
    from .scan_spec import ScanSpec

#: An angle_increment of this many radians (11 degrees) or more is nearly always meant in degrees.
_COARSE = 0.2

#: A tolerance of this many seconds or more, or a scan that takes so long, is nearly always meant in milliseconds.
_LONG = 5.0


def refuse_unusable(options: ConvertOptions) -> None:
    """Raise if an option cannot be used, even if this conversion would not need it.

    Raises
    ------
    MissingError
        If a recording of ``tf_from`` does not exist.
    UsageError
        If ``ros_distro`` is not a known distribution.
    """
    for path in options.frames.tf_from:
        if not os.path.lexists(path):
            from pc2scan.files.similar_paths import missing_hint  # noqa: PLC0415  # only for errors

            raise MissingError("does not exist (from `tf_from`)", path=path, hint=missing_hint(path))
    if options.ros_distro:
        from pc2scan.messages.transcode import DISTROS  # noqa: PLC0415  # few conversions name one

        if options.ros_distro not in DISTROS:
            near = did_you_mean(options.ros_distro, DISTROS)
            raise UsageError(
                f"`ros_distro` is {options.ros_distro!r}, which is not known",
                hint=f"{near} the distributions are {', '.join(DISTROS)}".strip(),
            )


def doubts(options: ConvertOptions) -> list[str]:
    """Return a warning for each option without an effect, and each value that looks like degrees.

    Only parameters that are given as options are checked, because a parameter file usually lists all parameters.
    """
    found: list[str] = []
    for spec in options.scans:
        given = {name for name, origin in spec.origins.items() if from_option(origin)}
        doubtful = (
            *_frame_doubts(options, spec, given),
            *_combining_doubts(spec),
            *_return_doubts(spec, given),
            *_time_doubts(spec, given),
            *_angle_doubts(spec),
        )
        found += (spec.label + each for each in doubtful)
    return found


def _frame_doubts(options: ConvertOptions, spec: ScanSpec, given: set[str]) -> list[str]:
    params, frames = spec.params, options.frames
    found = []
    if spec.level and spec.imu and spec.fixed_frame and not (spec.deskew or spec.may_combine):
        found.append("`fixed_frame` has no effect: roll and pitch come from `imu`")
    if spec.needs_transforms:
        source = frames.source_frame.removeprefix("/")
        if source and source == params.target_frame.removeprefix("/"):
            found.append(f"`source_frame` and `target_frame` are both {source}: nothing is transformed")
        return found
    idle = [
        name
        for name, is_given in (
            ("static_tf", frames.static and not frames.write_static),
            ("tf_from", frames.tf_from),
            ("tf_topics", frames.tf_topics),
            ("transform_tolerance", "transform_tolerance" in given),
        )
        if is_given
    ]
    if idle:
        names = ", ".join(f"`{name}`" for name in idle)
        found.append(
            f"{names} {'have' if idle[1:] else 'has'} no effect without `target_frame`: "
            "every message stays in its own frame"
        )
    return found


def _combining_doubts(spec: ScanSpec) -> list[str]:
    asked = spec.combining
    found = []
    if asked.count == 1:
        found.append("`accumulate=1clouds` has no effect: every scan is made of one cloud")
    elif asked.accumulates and not spec.fixed_frame:
        found.append(
            "`accumulate` and `every` without `fixed_frame` combine messages as if the robot had not moved; "
            "with odometry: `fixed_frame=odom`"
        )
    if spec.fixed_frame and asked.rebin and not (spec.deskew or spec.level or asked.accumulates or spec.may_share):
        found.append("`fixed_frame` has no effect: each scan becomes one; `deskew` places each beam at its own time")
    return found


def _return_doubts(spec: ScanSpec, given: set[str]) -> list[str]:
    params = spec.params
    if spec.reverse:
        return []
    found = []
    if params.no_return == "zero" and params.range_min <= 0:
        found.append(
            "beams without a return are 0, and range_min is 0 m, so that SLAM and navigation take them for obstacles "
            "at the sensor; with them beyond the limits: `range_min=0.1`"
        )
    is_sum = (params.no_return or ("inf" if params.use_inf else "range-max-plus")) == "range-max-plus"
    if "inf_epsilon" in given and not is_sum:
        found.append("`inf_epsilon` has no effect: it is used only with `no_return=range-max-plus`, or use_inf off")
    elif is_sum and {"use_inf", "inf_epsilon"} & given and math.isinf(params.empty_range):
        found.append("beams without a return are inf anyway: range_max is infinite; give a `range_max`")
    return found


def _time_doubts(spec: ScanSpec, given: set[str]) -> list[str]:
    """Return a warning for each time that is so long that milliseconds were probably meant."""
    params = spec.params
    turn = params.time_increment * params.length if isinstance(params.time_increment, float) else 0.0
    times = (
        ("transform_tolerance", params.transform_tolerance, "a transform of that age is used as if it were current"),
        ("scan_time", params.scan_time, "a lidar takes less than a second for a scan"),
        ("time_increment", params.time_increment, f"{params.length} beams take {abs(turn):,.0f} s"),
    )
    return [
        f"{name} is {value:g} s, and {why}; milliseconds are written `{name}={value:g}ms`"
        for name, value, why in times
        if name in given
        and not isinstance(value, str)
        and abs(turn if name == "time_increment" else value) >= _LONG
        and not (spec.reverse and name != "transform_tolerance")
    ]


def _angle_doubts(spec: ScanSpec) -> list[str]:
    params, origins = spec.params, spec.origins
    if spec.reverse:
        return []
    found = []
    increment = params.angle_increment
    if increment >= _COARSE and origins.get("angle_increment", "default") != "default" and not params.beams:
        found.append(
            f"angle_increment is {increment:g} rad, which is {math.degrees(increment):.3g} degrees a beam: "
            f"{params.length} beams; for {increment:g} deg write `angle_increment={increment:g}deg`"
        )
    span = params.angle_max - params.angle_min
    if span > FULL_TURN:
        found.append(
            f"angle_min {params.angle_min:g} to angle_max {params.angle_max:g} rad is a sector of "
            f"{math.degrees(span):.0f} degrees: beams beyond pi stay empty; degrees are written `angle_max=90deg`"
        )
    return found
