"""Measures the first clouds of topics: the times of scans, beams and points, the lidar's resolution, and the fields.

Only the first clouds are read, so that a conversion needs a single pass over the recording.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.layout import TURN
from pc2scan.core.percentiles import median, median_low
from pc2scan.core.points import Points
from pc2scan.core.resolution import RING_FIELDS, azimuth_step
from pc2scan.core.timing import (
    IN_SECONDS,
    TIME_FIELDS,
    TIME_UNITS,
    beam_times,
    fit_sweep,
    increment_doubt,
    is_brief,
    median_interval_ns,
    time_field,
)
from pc2scan.errors import MessageError, ParameterError, TransformError, stamp_text
from pc2scan.request.point_time import BY_AZIMUTH, TURN_CLOUDS, PointTime, measure_turn, turn_sample
from pc2scan.text import did_you_mean

from .survey import Fact

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pc2scan.core.layout import BeamLayout
    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.timing import Sweep
    from pc2scan.model import RawMessage
    from pc2scan.request.point_time import FieldTimes
    from pc2scan.request.spec import ScanSpec
    from pc2scan.transforms.placing import Placer

    from .survey import TopicFacts

#: How many clouds are read to measure the scan time, and how many to measure the time and the width of a beam.
STAMPS, _SHAPES = 51, 11

#: A lidar turns about the z axis of the scans' frame if the cosine between its own and this one is larger.
_UPRIGHT = 0.9

#: In how many clouds times of points are read, and how many stamps are needed to know the period.
_CLOUDS = 4
_FEWEST = 3

#: A cloud takes about the time from one stamp to the next. If it takes this many times as long, or this small a share
#: of it, and with another unit about as long, the unit is probably wrong.
_OFF = 50.0
_ABOUT = (0.2, 2.0)

#: Clocks probably differ if the points are measured this many periods, and this many seconds, from their stamp.
_PERIODS, _SECONDS = 2.0, 0.2


class Measurements(NamedTuple):
    """What was measured in the first clouds of a topic before the conversion.

    Attributes
    ----------
    scan_time, time_increment
        Seconds, as in the message.
    first_beam_ns
        Nanoseconds from the cloud's stamp to the scan's.
    azimuth_step
        How finely the lidar samples azimuth, radians; 0 if it was not measured.
    """

    scan_time: float
    time_increment: float = 0.0
    first_beam_ns: int = 0
    azimuth_step: float = 0.0

    @classmethod
    def given(cls, params: ProjectionParams) -> Measurements:
        """Return what the parameters say, 0 for what is to be measured."""
        scan_time, increment = (0.0 if time == "auto" else time for time in (params.scan_time, params.time_increment))
        return cls(scan_time, increment)

    def resolve(self, params: ProjectionParams) -> ProjectionParams:
        """Return parameters whose ``beams`` is not auto: as measured, or without clouds as ``angle_increment`` says."""
        if params.beams != "auto":
            return params
        return params.at_resolution(self.azimuth_step) if self.azimuth_step else replace(params, beams=0)


class CloudShape(NamedTuple):
    """What the points of a cloud show of the lidar, in its own frame.

    Attributes
    ----------
    frame_id, stamp_ns
        The cloud's.
    step
        The azimuth step, radians; None if the points are in no regular rings.
    sweep
        The motion of a turning lidar; None if the times are not of one.
    time_field
        The field with the times; empty if it has none.
    """

    frame_id: str
    stamp_ns: int
    step: float | None
    sweep: Sweep | None
    time_field: str


@np.errstate(all="ignore")  # coordinates and times may be any numbers: signalling NaN, the largest numbers
def _shape(cloud: Points, _: RawMessage) -> CloudShape:
    x, y, z = cloud.xyz()
    name = next((name for name in RING_FIELDS if name in cloud.fields), None)
    rings = None if name is None else np.ravel(cloud.field(name))
    if rings is not None and rings.dtype.kind not in "iu":
        rings = np.unique(rings, return_inverse=True)[1]
    step, sweep, times = azimuth_step(x, y, z, rings), None, time_field(cloud.fields)
    if times:
        ahead, left, up = (np.ravel(part).astype(np.float64) for part in (x, y, z))
        angles = np.arctan2(left, ahead)
        angles[~np.isfinite(ahead + left + up) | ((ahead == 0) & (left == 0) & (up == 0))] = np.nan
        with suppress(MessageError):
            sweep = fit_sweep(angles, np.ravel(PointTime().read(cloud).at()))
    return CloudShape(cloud.frame_id, cloud.stamp_ns, step, sweep, times)


#: What the points of the first clouds show of the lidar.
SHAPES = Fact(_shape, _SHAPES)


def _needs_shapes(params: ProjectionParams) -> bool:
    return "auto" in (params.beams, params.time_increment)


def ask_measurements(facts: TopicFacts, spec: ScanSpec) -> None:
    """Ask for what `measure` reads of a topic."""
    most = 1
    if _needs_shapes(spec.params):
        facts.ask(SHAPES)
        most = _SHAPES
    facts.ask_headers(STAMPS if spec.params.scan_time == "auto" else most)


def _turned(shape: CloudShape, placer: Placer) -> Sweep | None:
    """Return the motion of a lidar around the z axis of the scans' frame."""
    if shape.sweep is None:
        return None
    with suppress(TransformError):
        transform = placer.place(shape.frame_id, shape.stamp_ns).target_from_source
        if transform is None:
            return shape.sweep
        matrix = transform.matrix
        yaw, way = math.atan2(matrix[1, 0], matrix[0, 0]), math.copysign(1.0, matrix[2, 2])
        if abs(matrix[2, 2]) > _UPRIGHT:
            return shape.sweep._replace(angle=yaw + way * shape.sweep.angle, rate=way * shape.sweep.rate)
    return None


def measure(facts: TopicFacts, spec: ScanSpec, placer: Placer) -> tuple[Measurements, list[str]]:
    """Measure the first messages of a topic.

    Parameters
    ----------
    facts
        What was observed: see `ask_measurements`.
    spec
        The request.
    placer
        The recording's transforms: beams are measured in the frame of the scans.

    Returns
    -------
    Measurements, list of str
        The timing, and notes for the user.

    Raises
    ------
    ParameterError
        If ``beams`` is auto, and the points are not in regular rings.
    """
    params, topic, notes = spec.params, facts.topic, list[str]()
    shapes = facts.values(SHAPES) if _needs_shapes(params) else []
    stamps = [header.stamp_ns for header in facts.headers]
    step = _resolution(facts, shapes) if params.beams == "auto" and stamps else 0.0
    layout = (params.at_resolution(step) if step else params).layout
    if step:
        notes.append(
            f"{topic}: beams is {layout.count:,}, angle_increment {layout.angle_increment:.6g} rad: the lidar measures "
            f"every {math.degrees(step):.4g} deg"
        )
    scan_time, time_increment, first_beam_ns = params.scan_time, params.time_increment, 0
    if scan_time == "auto":
        interval = median_interval_ns(stamps[:STAMPS])
        scan_time = (interval or 0) / 1e9
        notes.append(
            f"{topic}: scan_time is 0, because there are no two different stamps to measure it between"
            if interval is None
            else f"{topic}: scan_time is {scan_time:.6g} s, the median interval of "
            f"{'its' if len(stamps) < STAMPS else 'the first'} {len(stamps[:STAMPS])} stamps"
        )
    if time_increment == "auto":
        time_increment, first_beam_ns, note = _beams(shapes, layout, stamps, placer)
        notes.append(f"{topic}: {note}")
    return Measurements(scan_time, time_increment, first_beam_ns, step), notes


def require_fields(spec: ScanSpec, fields: Sequence[str], what: str, hint: str, point_time: str = "") -> None:
    """Raise if a field that an output needs is missing.

    Parameters
    ----------
    spec
        The output.
    fields
        Those that there are.
    what
        What has them, in the plural.
    hint
        What to do.
    point_time
        The field with the times of points; empty: none is requested by its name.
    """
    name = spec.params.intensity_field
    requests = [("intensity_field", f"intensity_field is {name!r}", name)] if name else []
    requests += [(f.name, f"`{f.name}` needs the field {field!r}", field) for f in spec.filters for field in f.fields]
    if point_time:
        requests.append(("point_time", f"`point_time` is {point_time!r}", point_time))
    for option, request, field in requests:
        if field not in fields:
            text = f"{request}, which {what} do not have"
            raise ParameterError(text, name=option, hint=f"{did_you_mean(field, fields)} {hint}".strip())


def require_cloud_fields(facts: TopicFacts, spec: ScanSpec) -> None:
    """Raise if none of the first clouds of a topic has a field that the request needs."""
    if not facts.headers:
        return
    topic = facts.topic
    fields = list(dict.fromkeys(name for header in facts.headers for name in header.fields))
    listed = f"their fields are: {', '.join(fields) or 'none'}"
    require_fields(spec, fields, f"the clouds on {topic}", listed, spec.point_time.field if spec.point_time else "")
    if spec.deskew and not spec.point_time and not time_field(fields):
        raise ParameterError(
            f"the clouds on {topic} have no times of their points: no field {', '.join(TIME_FIELDS)}",
            name="point_time",
            hint="name the field that has them: `point_time=FIELD`; of a lidar that turns once in 0.1 s: "
            f"`point_time=azimuth:0.1`, or `point_time=azimuth` to measure it; {listed}",
        )


def regular_step(shapes: Sequence[CloudShape]) -> float | None:
    """Return how finely the lidar samples azimuth, radians; None if most of its clouds have no regular rings."""
    known = [shape.step for shape in shapes if shape.step is not None]
    return median_low(known) if 2 * len(known) > len(shapes) else None


def _resolution(facts: TopicFacts, shapes: Sequence[CloudShape]) -> float:
    """Return how finely the lidar samples azimuth, radians: by the rings of its clouds, or as its scans say."""
    increments = [header.increment for header in facts.headers if header.increment is not None]
    known = [increment for increment in increments if 0 < increment < math.inf]
    if (step := median_low(known) if known else regular_step(shapes)) is not None:
        return step
    irregular = sum(shape.step is None for shape in shapes)
    why = (
        f"no scan on {facts.topic} has an angle_increment"
        if increments
        else f"the azimuth resolution of the clouds on {facts.topic} cannot be measured: the points of "
        f"{irregular} of the first {len(shapes)} are in no regular rings"
    )
    hint = "give a number of `beams`, or an `angle_increment`"
    raise ParameterError(f"beams is auto, but {why}", name="beams", hint=hint)


def _beams(
    shapes: Sequence[CloudShape], layout: BeamLayout, stamps_ns: Sequence[int], placer: Placer
) -> tuple[float, int, str]:
    """Return the time between beams in seconds, from the stamp to the first beam in nanoseconds, and a note."""
    field = ", ".join(dict.fromkeys(shape.time_field for shape in shapes if shape.time_field))
    sweeps = [sweep for shape in shapes if (sweep := _turned(shape, placer)) is not None]
    takes = median([sweep.end - sweep.begin for sweep in sweeps]) if sweeps else 0.0
    period = (median_interval_ns(stamps_ns) or 0) / 1e9
    timings = [times for sweep in sweeps if (times := beam_times(sweep, layout)) is not None]
    why = ""
    if not field:
        why = f"the clouds have no field {', '.join(TIME_FIELDS)}"
    elif not sweeps:
        why = f"the times of points ({field}) are not of a turning lidar"
    elif is_brief(takes, period):
        wrong = f"by the times of points ({field}) a cloud takes {takes:.3g} s, but clouds come every {period:.3g} s"
        why = f"{wrong}: their unit is probably another one"
    elif len(timings) < len(sweeps):
        lowest = median_low(sweep.lowest for sweep in sweeps)
        advice = f"`angle_min={lowest:.4f}` `angle_max={lowest + TURN:.4f}`"
        why = f"the clouds begin inside the scan's sector; let the scan begin there: {advice}"
    if why:
        return 0.0, 0, f"time_increment is 0, because {why}"
    first_beam_ns = round(median_low(first for first, _ in timings) * 1e9)
    increment = median_low(step for _, step in timings)
    way = "clockwise, so the first beam is the last in time" if increment < 0 else "counter-clockwise"
    note = f"time_increment is {increment:.4g} s, from {field}: the lidar turns {way}"
    return increment, first_beam_ns, f"{note}; stamps are shifted by {stamp_text(first_beam_ns)} s, to the first beam"


def ask_times(facts: TopicFacts, point_time: PointTime) -> None:
    """Ask for the times of points: those of a field, or the turns of a lidar whose period is to be measured."""
    facts.ask_headers(_CLOUDS)
    if point_time.turn is None:
        facts.ask(times_of(point_time))
    elif not point_time.turn.period:
        facts.ask(TURNS)


def time_warnings(facts: TopicFacts, point_time: PointTime) -> Iterator[str]:
    """Yield warnings about times of points, or of beams, that are probably wrong, and would deskew a cloud wrongly.

    Times that are impossible are not among them: those are errors when their cloud is converted.
    """
    yield from filter(None, [increment_warning(facts)])
    topic, clouds = facts.topic, [] if point_time.turn is not None else facts.values(times_of(point_time))
    period = (median_interval_ns(cloud.points.stamp_ns for cloud in clouds) or 0) / 1e9
    if len(clouds) < _FEWEST or not period:
        return
    low, high = median([cloud.low for cloud in clouds]), median([cloud.high for cloud in clouds])
    whole = median([cloud.high - cloud.low for cloud in clouds])
    is_off = whole > 0 and not 1 / _OFF < whole / period < _OFF
    if is_off and (doubt := _unit_warning(topic, clouds[0], whole, period)):
        yield doubt
    elif max(low, -high) > max(_PERIODS * period, _SECONDS):
        first, last = sorted((abs(low), abs(high)))
        yield (
            f"{topic}: the points are measured {first:.3g} to {last:.3g} s {'after' if low > 0 else 'before'} the "
            f"stamp of their cloud, by field {clouds[0].field}, but clouds come every {period:.3g} s: if their clocks "
            f"differ, deskewing moves the points wrongly; {BY_AZIMUTH}"
        )


def _unit_warning(topic: str, times: FieldTimes, whole: float, period: float) -> str:
    """Return the warning that clouds take far too long or too short by their times; empty if packets may be brief."""
    name, unit = times.field, times.unit
    likely = [other for other, size in TIME_UNITS.items() if _ABOUT[0] < whole / unit * size / period < _ABOUT[1]]
    if not likely and not is_brief(whole, period):
        return ""
    used = next(other for other, size in TIME_UNITS.items() if size == unit)
    cure = f"`point_time=FIELD` names another field, and {BY_AZIMUTH}"
    if likely:
        cure = f"`point_time={name}:{likely[0]}`, if they are {likely[0]}"
    return (
        f"{topic}: the times of the points, field {name}, are taken for {used}: a cloud takes {whole:.3g} s, but "
        f"clouds come every {period:.3g} s; {cure}"
    )


def increment_warning(facts: TopicFacts) -> str:
    """Return the warning that scans take far too long or too short by their time_increment; empty if not."""
    turn = median([header.turn for header in facts.headers]) if facts.headers else 0.0
    period = (median_interval_ns(header.stamp_ns for header in facts.headers) or 0) / 1e9
    doubt = increment_doubt(turn, period) if turn else ""
    return f"{facts.topic}: {doubt}: {IN_SECONDS}" if doubt else ""


@cache
def times_of(point_time: PointTime) -> Fact[FieldTimes]:
    """Return the fact: the times of points in a field, without the points."""
    return Fact(partial(_times, point_time), _CLOUDS)


#: What clouds show of how a lidar turns.
TURNS = Fact(lambda points, message: turn_sample(points, message.log_time_ns), TURN_CLOUDS)


def _times(point_time: PointTime, points: Points, _: RawMessage) -> FieldTimes | None:
    """Return the times of a cloud's points; None if it has none."""
    known = point_time.read(points)
    nothing = Points(points.sequence, points.stamp_ns, points.frame_id, {})
    return known._replace(points=nothing) if known.measured - known.unknown >= 2 else None


def measured_times(facts: TopicFacts, point_time: PointTime) -> tuple[PointTime, list[str]]:
    """Return the source of the times of a topic's points, with its lidar's turn measured if it is not given; and notes.

    Raises
    ------
    ParameterError
        If a turn cannot be measured in the first clouds.
    """
    if point_time.turn is None or point_time.turn.period or not (clouds := facts.values(TURNS)):
        return point_time, []
    turn, note = measure_turn(facts.topic, point_time.turn, clouds)
    return PointTime(turn=turn), [note]
