"""Checks before a conversion: options that have no effect or are probably a mistake, and cuts without any message.

One check goes on during the conversion: whether transforms connect the frames of any message with the target frame.
"""

from __future__ import annotations

import math
import os
from contextlib import closing
from typing import TYPE_CHECKING

from pc2scan.core.layout import FULL_TURN
from pc2scan.errors import MissingError, TopicError, UnconnectedError, UsageError, name_list
from pc2scan.text import did_you_mean, stamp

from .parameters import from_option

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.core.params import ProjectionParams
    from pc2scan.errors import MessageError
    from pc2scan.model import Connection
    from pc2scan.options.moment import TimeBound

    from .options import ConvertOptions
    from .scan_spec import ScanSpec

#: An angle_increment of this many radians (11 degrees) or more is nearly always meant in degrees.
_COARSE = 0.2

#: A tolerance of this many seconds or more, or a scan that takes so long, is nearly always meant in milliseconds.
_LONG = 5.0

#: How many of the first messages must fail before a user is warned.
_LOOKED_AT = 10


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


def option_warnings(options: ConvertOptions) -> list[str]:
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


def refuse_no_messages(
    reader: Reader, converted: Sequence[Connection], start_ns: int | None, stop_ns: int | None
) -> None:
    """Raise if the topics to convert have no messages, or none in the cut.

    The index is read first. If it lists no messages, the recording is read as well, because an index may be wrong.

    Raises
    ------
    UsageError
        If the cut lies outside of the recording.
    TopicError
        If there are no messages in it.
    """
    if not converted:
        return
    counts = reader.counts(converted, start_ns, stop_ns)
    outside = _outside(reader, start_ns, stop_ns)
    if outside is None and any(counts.get(connection.id) != 0 for connection in converted):
        return
    with closing(reader.messages(converted, start_ns, stop_ns)) as messages:
        if next(messages, None) is not None:
            return
    # If the recording is damaged, this is reported instead.
    if reader.damage:
        return
    if outside is not None:
        raise outside
    topics = name_list(sorted({connection.topic for connection in converted}))
    is_cut = start_ns is not None or stop_ns is not None
    raise TopicError(
        f"there is nothing to convert: no messages on {topics}{' in the cut' if is_cut else ''}",
        hint="check `start` and `end`" if is_cut else "pc2scan info lists the topics, and how many messages they have",
    )


def refuse_outside(reader: Reader, start_ns: int | None, stop_ns: int | None) -> None:
    """Raise if the cut lies outside of the recording, unless this is damaged, which is reported instead.

    Raises
    ------
    UsageError
        If it does.
    """
    if not reader.damage and (outside := _outside(reader, start_ns, stop_ns)) is not None:
        raise outside


def _outside(reader: Reader, start_ns: int | None, stop_ns: int | None) -> UsageError | None:
    """Return the error for a cut outside of the recording; None if the cut is inside, or the times are unknown."""
    first_ns, last_ns = reader.summary.start_ns, reader.summary.end_ns
    if first_ns is None or last_ns is None or not reader.summary.message_count:
        return None
    late = start_ns is not None and start_ns > last_ns
    early = stop_ns is not None and stop_ns <= first_ns
    if not late and not early:
        return None
    name, time_ns = ("start", start_ns) if late else ("end", stop_ns)
    seconds = (last_ns - first_ns) / 1e9
    meant = _meant(name, time_ns or 0, first_ns, last_ns)
    return UsageError(
        f"the cut is outside of the recording: `{name}` is {stamp(time_ns or 0)}, the recording is from "
        f"{stamp(first_ns)} to {stamp(last_ns)}",
        path=reader.path,
        hint=(f"{meant}; " if meant else "") + f"its {seconds:.3f} s are `start=0` to `end={seconds + 0.001:.3f}`",
    )


def cut_warnings(reader: Reader, start: TimeBound | None, end: TimeBound | None) -> list[str]:
    """Return a warning if times of day are given as a cut, and the whole recording is within it.

    Times that count from the beginning draw none: the same cut may be used for recordings of many lengths.
    """
    first_ns, last_ns = reader.summary.start_ns, reader.summary.end_ns
    if first_ns is None or last_ns is None or not reader.summary.message_count:
        return []
    bounds = {
        name: bound.resolve(first_ns)
        for name, bound in (("start", start), ("end", end))
        if bound is not None and (bound.absolute or bound.nanoseconds)
    }
    absolute = [name for name, bound in (("start", start), ("end", end)) if bound is not None and bound.absolute]
    if not absolute or bounds.get("start", first_ns) > first_ns or bounds.get("end", last_ns + 1) <= last_ns:
        return []
    # The first message may be at the start itself.
    if bounds.get("start") == first_ns or bounds.get("end") == last_ns + 1:
        return []
    shown = " and ".join(f"`{name}` is {stamp(bounds[name])}" for name in absolute)
    meant = next(filter(None, (_meant(name, bounds[name], first_ns, last_ns) for name in absolute)), "")
    return [
        f"the cut has no effect: {shown}, the recording is from {stamp(first_ns)} to {stamp(last_ns)}"
        + (f"; {meant}" if meant else "")
    ]


def _meant(name: str, time_ns: int, first_ns: int, last_ns: int) -> str:
    """Return which option a time in another unit would be; empty if none is inside of the recording."""
    for unit, factor in (("milliseconds", 1_000_000), ("microseconds", 1_000)):
        # Text and floats count seconds since 1970, large integers nanoseconds.
        for meant_ns in (time_ns * factor, time_ns * factor // 1_000_000_000):
            if first_ns <= meant_ns <= last_ns:
                seconds = f"{meant_ns // 1_000_000_000}.{meant_ns % 1_000_000_000:09d}".rstrip("0").rstrip(".")
                return f"if it was given in {unit}: `{name}=@{seconds}`"
    return ""


class TransformCheck:
    """Detects that no transforms connect the frames of any message to convert with the target frame.

    Frames may differ from message to message, so it is certain only after the last one. The first ones draw a warning.

    Parameters
    ----------
    warn
        Called with the warning; None: there is none.

    Attributes
    ----------
    is_possible
        Whether all messages so far have failed for this reason.
    """

    def __init__(self, warn: Callable[[str], None] | None = None) -> None:
        self.is_possible = True
        self._warn = warn
        self._failed = 0
        self._first: tuple[str, UnconnectedError] | None = None

    def note(self, topic: str, error: MessageError | None) -> None:
        """Count whether a message was converted."""
        if not isinstance(error, UnconnectedError):
            self.is_possible = False
            return
        self._failed += 1
        self._first = self._first or (topic, error)
        if self._failed == _LOOKED_AT and self.is_possible and self._warn is not None:
            topic, first = self._first
            advice = f"; {first.hint}" if first.hint else ""
            self._warn(f"none of the first {_LOOKED_AT} messages can be converted: {topic}: {first.message}{advice}")

    def finish(self) -> None:
        """Raise if there were messages, and all of them have failed.

        Raises
        ------
        TransformError
            The first error.
        """
        if self.is_possible and self._first is not None:
            topic, first = self._first
            raise UnconnectedError(f"nothing can be converted: {first.message}", topic=topic, hint=first.hint)


def ghost_warnings(params: ProjectionParams) -> list[str]:
    """Return a warning for each parameter that puts returns where there is no object."""
    if params.reduce != "mean":
        return []
    found = "reduce is mean, which puts returns where nothing is, between a near and a far object: "
    return [f"{found}8 % of the returns in a simulated hall. `reduce=surface` is as smooth, without them"]
