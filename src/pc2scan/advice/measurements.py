"""Measures the first clouds of topics: the times of scans, beams and points, the lidar's resolution, and the fields.

Only the first clouds are read, so that a conversion needs a single pass over the recording.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.layout import TURN
from pc2scan.core.percentiles import median, median_low
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
    from collections.abc import Iterable, Iterator, Sequence

    from pc2scan.core.layout import BeamLayout
    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.points import Points
    from pc2scan.core.timing import Sweep
    from pc2scan.model import RawMessage
    from pc2scan.request.point_time import Turn
    from pc2scan.request.spec import ScanSpec
    from pc2scan.transforms.placing import Placer

    from .survey import TopicFacts

#: How many clouds are read to measure the scan time, and how many to measure the time and the width of a beam.
STAMPS = 51
SHAPES = 11

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
        The azimuth step, radians; None if the points are in no regular rings, or it is not measured.
    sweep
        The motion of a turning lidar; None if the times are not of one, or it is not measured.
    time_field
        The field with the times; empty if it has none, or they are not wanted.
    """

    frame_id: str
    stamp_ns: int
    step: float | None = None
    sweep: Sweep | None = None
    time_field: str = ""


@np.errstate(all="ignore")  # coordinates and times may be any numbers: signalling NaN, the largest numbers
def _shape(cloud: Points, _: RawMessage, needs_step: bool, needs_sweep: bool) -> CloudShape:
    x, y, z = cloud.xyz()
    step = sweep = None
    if needs_step:
        name = next((name for name in RING_FIELDS if name in cloud.fields), None)
        rings = None if name is None else np.ravel(cloud.field(name))
        if rings is not None and rings.dtype.kind not in "iu":
            rings = np.unique(rings, return_inverse=True)[1]
        step = azimuth_step(x, y, z, rings)
    times = time_field(cloud.fields) if needs_sweep else ""
    if times:
        ahead, left, up = (np.ravel(part).astype(np.float64) for part in (x, y, z))
        angles = np.arctan2(left, ahead)
        angles[~np.isfinite(ahead + left + up) | ((ahead == 0) & (left == 0) & (up == 0))] = np.nan
        with suppress(MessageError):
            sweep = fit_sweep(angles, np.ravel(PointTime().read(cloud).at()))
    return CloudShape(cloud.frame_id, cloud.stamp_ns, step, sweep, times or "")


def shapes_of(*, step: bool, sweep: bool, most: int = SHAPES) -> Fact[CloudShape]:
    """Return the fact: what the points of the first clouds show of the lidar."""
    return Fact(_shape, most, (step, sweep))


def _wanted_shapes(spec: ScanSpec) -> Fact[CloudShape] | None:
    step, sweep = spec.params.beams == "auto", spec.params.time_increment == "auto"
    return shapes_of(step=step, sweep=sweep) if step or sweep else None


def ask_measurements(facts: TopicFacts, spec: ScanSpec) -> None:
    """Ask for what `measure` reads of a topic."""
    shapes = _wanted_shapes(spec)
    if shapes is not None:
        facts.ask(shapes)
    facts.ask_headers(STAMPS if spec.params.scan_time == "auto" else SHAPES if shapes is not None else 1)


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


def measure(topics: Iterable[TopicFacts], spec: ScanSpec, placer: Placer) -> tuple[dict[str, Measurements], list[str]]:
    """Measure the first clouds of each topic.

    Parameters
    ----------
    topics
        What was observed: see `ask_measurements`.
    spec
        The request: requested fields must exist.
    placer
        The recording's transforms: beams are measured in the frame of the scans.

    Returns
    -------
    dict, list of str
        The timing of each topic, and notes for the user.

    Raises
    ------
    ParameterError
        If none of the first clouds of a topic has the ``intensity_field``, or a field that a filter or deskewing
        needs; or if ``beams`` is auto, and the points are not in regular rings.
    """
    measurements: dict[str, Measurements] = {}
    notes: list[str] = []
    for facts in topics:
        _require_fields(facts, spec)
        measurements[facts.topic] = _timing(facts, spec, placer, notes)
    return measurements, notes


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


def unknown_step(why: str) -> ParameterError:
    """Return the error that the number of beams cannot be measured."""
    hint = "give a number of `beams`, or an `angle_increment`"
    return ParameterError(f"beams is auto, but {why}", name="beams", hint=hint)


def _require_fields(facts: TopicFacts, spec: ScanSpec) -> None:
    """Raise if no cloud has a requested field."""
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


def _timing(facts: TopicFacts, spec: ScanSpec, placer: Placer, notes: list[str]) -> Measurements:
    """Return the times to write into the scans, and add notes about them."""
    params, topic = spec.params, facts.topic
    wanted = _wanted_shapes(spec)
    shapes = [] if wanted is None else facts.values(wanted)
    step = _resolution(topic, shapes, params, notes) if params.beams == "auto" and facts.headers else 0.0
    layout = (params.at_resolution(step) if step else params).layout
    scan_time, time_increment, first_beam_ns = params.scan_time, params.time_increment, 0
    if scan_time == "auto":
        stamps = [header.stamp_ns for header in facts.headers[:STAMPS]]
        interval = median_interval_ns(stamps)
        scan_time = (interval or 0) / 1e9
        notes.append(
            f"{topic}: scan_time is 0, because there are no two different stamps to measure it between"
            if interval is None
            else f"{topic}: scan_time is {scan_time:.6g} s, the median interval of "
            f"{'its' if len(stamps) < STAMPS else 'the first'} {len(stamps)} stamps"
        )
    if time_increment == "auto":
        times = [header.stamp_ns for header in facts.headers]
        time_increment, first_beam_ns, note = _beams(shapes, layout, times, placer)
        notes.append(f"{topic}: {note}")
    return Measurements(scan_time, time_increment, first_beam_ns, step)


def regular_step(shapes: Sequence[CloudShape]) -> float | None:
    """Return how finely the lidar samples azimuth, radians; None if most of its clouds have no regular rings."""
    known = [shape.step for shape in shapes if shape.step is not None]
    return median_low(known) if 2 * len(known) > len(shapes) else None


def _resolution(topic: str, shapes: Sequence[CloudShape], params: ProjectionParams, notes: list[str]) -> float:
    """Return how finely the lidar samples azimuth, radians."""
    known = sum(shape.step is not None for shape in shapes)
    step = regular_step(shapes)
    if step is None:
        raise unknown_step(
            f"the azimuth resolution of the clouds on {topic} cannot be measured: the points of "
            f"{len(shapes) - known} of the first {len(shapes)} are in no regular rings"
        )
    layout = params.at_resolution(step).layout
    notes.append(
        f"{topic}: beams is {layout.count:,}, angle_increment {layout.angle_increment:.6g} rad: the lidar measures "
        f"every {math.degrees(step):.4g} deg (median of {known} clouds)"
    )
    return step


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


class PointTimes(NamedTuple):
    """The times of a cloud's points.

    Attributes
    ----------
    stamp_ns
        The cloud's stamp.
    field
        The field with the times.
    low, high
        The times of the first and the last point, seconds after the stamp.
    unit
        Of the values, seconds.
    """

    stamp_ns: int
    field: str
    low: float
    high: float
    unit: float


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
    if any(header.turn for header in facts.headers):
        yield from filter(None, [increment_warning(facts)])
    topic, clouds = facts.topic, [] if point_time.turn is not None else facts.values(times_of(point_time))
    period = (median_interval_ns(cloud.stamp_ns for cloud in clouds) or 0) / 1e9
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


def _unit_warning(topic: str, times: PointTimes, whole: float, period: float) -> str:
    """Return the warning that clouds take far too long or too short by their times; empty if packets may be brief."""
    name, unit = times.field, times.unit
    takes = f"a cloud takes {whole:.3g} s, but clouds come every {period:.3g} s"
    likely = [other for other, size in TIME_UNITS.items() if _ABOUT[0] < whole / unit * size / period < _ABOUT[1]]
    used = next(other for other, size in TIME_UNITS.items() if size == unit)
    if likely:
        return (
            f"{topic}: the times of the points, field {name}, are taken for {used}: {takes}; "
            f"`point_time={name}:{likely[0]}`, if they are {likely[0]}"
        )
    if is_brief(whole, period):
        return (
            f"{topic}: the times of the points, field {name}, are in no unit that fits, as {used} {takes}: deskewing "
            f"hardly moves a point; `point_time=FIELD` names another field, and {BY_AZIMUTH}"
        )
    return ""


def increment_warning(facts: TopicFacts) -> str:
    """Return the warning that scans take far too long or too short by their time_increment; empty if not."""
    turn = median([header.turn for header in facts.headers]) if facts.headers else 0.0
    period = (median_interval_ns(header.stamp_ns for header in facts.headers) or 0) / 1e9
    doubt = increment_doubt(turn, period) if turn else ""
    return f"{facts.topic}: {doubt}: {IN_SECONDS}" if doubt else ""


def times_of(point_time: PointTime) -> Fact[PointTimes]:
    """Return the fact: the times of points in a field."""
    return Fact(_times, _CLOUDS, (point_time,))


#: What clouds show of how a lidar turns.
TURNS = Fact(lambda points, message: turn_sample(points, message.log_time_ns), TURN_CLOUDS)


def _times(points: Points, _: RawMessage, point_time: PointTime) -> PointTimes | None:
    """Return the times of a cloud's points; None if it has none."""
    known = point_time.read(points)
    if known.measured - known.unknown < 2:
        return None
    return PointTimes(points.stamp_ns, known.field, known.low, known.high, known.unit)


def measure_turns(topics: Iterable[TopicFacts], point_time: PointTime) -> tuple[dict[str, Turn], list[str]]:
    """Measure the rotation of the lidars, if the times of points come from azimuths and that of a turn is not given.

    Parameters
    ----------
    topics
        What was observed.
    point_time
        The source of the times.

    Returns
    -------
    dict, list of str
        The turn of each topic that has clouds, and notes for the user.

    Raises
    ------
    ParameterError
        If a turn cannot be measured in the first clouds of a topic.
    """
    turns: dict[str, Turn] = {}
    notes: list[str] = []
    if point_time.turn is not None and not point_time.turn.period:
        for facts in topics:
            if samples := facts.values(TURNS):
                turns[facts.topic], note = measure_turn(facts.topic, point_time.turn, samples)
                notes.append(note)
    return turns, notes
