"""Measures the first clouds of topics: the times of scans and beams, the resolution of the lidar, and the fields.

Only the first clouds are read, so that a conversion needs a single pass over the recording.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.bags.observers import Observer
from pc2scan.bags.topics import by_topic
from pc2scan.bags.units import FirstTimes
from pc2scan.core.layout import TURN
from pc2scan.core.percentiles import median_low
from pc2scan.core.points import Points
from pc2scan.core.resolution import RING_FIELDS, azimuth_step
from pc2scan.core.timing import TIME_FIELDS, beam_times, fit_sweep, median_interval_ns, point_times
from pc2scan.errors import MessageError, ParameterError, stamp_text
from pc2scan.messages.clouds import CLOUDS
from pc2scan.text import did_you_mean

from .conversion import Measurements

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.layout import BeamLayout
    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.timing import Sweep
    from pc2scan.model import Connection, RawMessage
    from pc2scan.tf.placing import Placer

    from .options import ScanSpec

#: How many clouds are read to measure the scan time, and how many to measure the time and the width of a beam.
FIRST_CLOUDS = 51
SWEEPS = 11


class CloudShape(NamedTuple):
    """What the points of a cloud show of the lidar.

    Attributes
    ----------
    step
        The azimuth step, radians; None if the points are in no regular rings, or it is not measured.
    sweep
        The motion of a turning lidar; None if the times are not of one, or it is not measured.
    is_readable
        Whether the coordinates can be read and transformed.
    """

    step: float | None = None
    sweep: Sweep | None = None
    is_readable: bool = True


class FirstCloud(NamedTuple):
    """What is kept of a cloud.

    Attributes
    ----------
    stamp_ns
        Its stamp.
    fields
        The names of its fields.
    shape
        What its points show; None if that is not wanted, or needs transforms that are not known yet.
    points
        The columns that show it, once the transforms are known; None if it is known or not wanted.
    """

    stamp_ns: int
    fields: tuple[str, ...]
    shape: CloudShape | None = None
    points: Points | None = None


def cloud_observers(
    connections: Iterable[Connection],
    spec: ScanSpec,
    placer: Placer | None,
    start_ns: int | None = None,
    stop_ns: int | None = None,
) -> dict[str, Observer[FirstCloud]]:
    """Return the observers of the first clouds of each topic.

    Parameters
    ----------
    connections
        The connections to convert.
    spec
        The request: ``scan_time``, ``time_increment`` and ``beams`` are measured if they are ``auto``.
    placer
        The frame of the scans; None if that needs transforms that are not known yet.
    start_ns, stop_ns
        The cut, by log time; None: no limit.
    """
    params = spec.params
    swept = "auto" in {params.time_increment, params.beams}
    wanted = FIRST_CLOUDS if params.scan_time == "auto" else SWEEPS if swept else 1

    def observer(sources: Sequence[Connection]) -> Observer[FirstCloud]:
        decoders = {each.id: CLOUDS[each.ros_type](each.serialization) for each in sources}
        first = FirstTimes(SWEEPS)

        def take(message: RawMessage) -> FirstCloud:
            cloud = decoders[message.connection.id](message.data)
            stamp_ns, fields = cloud.stamp_ns, tuple(cloud.fields)
            if not swept or not first.may_have(message.log_time_ns):
                return FirstCloud(stamp_ns, fields)
            if placer is None:
                return FirstCloud(stamp_ns, fields, points=_columns(cloud, params))
            return FirstCloud(stamp_ns, fields, _shape(cloud, params, placer))

        return Observer(sources, take, wanted, start_ns, stop_ns)

    return {topic: observer(sources) for topic, sources in by_topic(connections).items()}


def measure(
    observers: Mapping[str, Observer[FirstCloud]], spec: ScanSpec, placer: Placer
) -> tuple[dict[str, Measurements], list[str]]:
    """Measure the first clouds of each topic.

    Parameters
    ----------
    observers
        What was observed: see `cloud_observers`.
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
    found: dict[str, Measurements] = {}
    notes: list[str] = []
    for topic, observer in observers.items():
        first = _TopicMeasurements(spec.params)
        for cloud in observer.found:
            first.add(cloud, placer)
        first.require_fields(topic, spec)
        if spec.point_time.partition(":")[0] == "azimuth":
            from .stages.turn import Turn  # noqa: PLC0415  # only with deskewing

            # A time that is not given is measured later, with a note of its own.
            turn = Turn.parse(spec.point_time)
            if turn.period:
                notes.append(f"{topic}: the times of points are computed from their azimuth: {turn}")
        found[topic] = first.timing(topic, notes)
    return found, notes


def _time_field(fields: Container[str]) -> str | None:
    return next((name for name in TIME_FIELDS if name in fields), None)


def _columns(cloud: Points, params: ProjectionParams) -> Points:
    """Return copies of the columns that show the shape of a cloud; without coordinates that cannot be read."""
    rings = [name for name in RING_FIELDS if name in cloud.fields][: params.beams == "auto"]
    time = _time_field(cloud.fields) if params.time_increment == "auto" else None
    columns: dict[str, NDArray[Any]] = {}
    with suppress(MessageError):
        columns |= {name: cloud.field(name).copy() for name in (*rings, "x", "y", "z")}
    if time is not None:
        with suppress(MessageError):
            columns[time] = cloud.field(time).copy()
    return Points(cloud.sequence, cloud.stamp_ns, cloud.frame_id, columns)


@np.errstate(all="ignore")  # coordinates and times may be any numbers: signalling NaN, the largest numbers
def _shape(cloud: Points, params: ProjectionParams, placer: Placer) -> CloudShape:
    """Return what a cloud's points show, as far as it is to be measured."""
    step = None
    if params.beams == "auto":
        try:
            step = _step(cloud, placer)
        except MessageError:
            # An error of decoding or transforming is reported when this message is converted.
            return CloudShape(is_readable=False)
    name = _time_field(cloud.fields) if params.time_increment == "auto" else None
    sweep = None
    if name is not None:
        with suppress(MessageError):
            sweep = fit_sweep(_angles(cloud, placer), point_times(cloud.field(name), cloud.stamp_ns))
    return CloudShape(step, sweep)


def _step(cloud: Points, placer: Placer) -> float | None:
    """Return the azimuth step of a cloud around the sensor, with the axes of the scan's frame."""
    x, y, z = cloud.xyz()
    transform = placer.place(cloud.frame_id, cloud.stamp_ns).target_from_source
    if transform is not None:
        shape = x.shape
        points = np.stack([np.ravel(part).astype(np.float64) for part in (x, y, z)])
        x, y, z = (part.reshape(shape) for part in transform.matrix @ points)
    name = next((name for name in RING_FIELDS if name in cloud.fields), None)
    if name is None:
        return azimuth_step(x, y, z)
    rings = np.ravel(cloud.field(name))
    if rings.dtype.kind not in "iu":
        rings = np.unique(rings, return_inverse=True)[1]
    return azimuth_step(x, y, z, rings)


def _angles(cloud: Points, placer: Placer) -> NDArray[np.float64]:
    """Return the azimuth of each point in the scan's frame; NaN for points without a direction."""
    points = np.stack([np.ravel(part).astype(np.float64) for part in cloud.xyz()], axis=1)
    nowhere = ~points.any(axis=1) | ~np.isfinite(points).all(axis=1)
    transform = placer.place(cloud.frame_id, cloud.stamp_ns).target_from_source
    if transform is not None:
        points = transform.apply(points)
    angles: NDArray[np.float64] = np.arctan2(points[:, 1], points[:, 0])
    angles[nowhere] = np.nan
    return angles


class _TopicMeasurements:
    """The measurements in the first clouds of a topic."""

    def __init__(self, params: ProjectionParams) -> None:
        self._params = params
        self._stamps: list[int] = []
        self._fields: dict[str, None] = {}
        self._timed: dict[str, None] = {}
        self._sweeps: list[Sweep] = []
        self._steps: list[float | None] = []

    def add(self, cloud: FirstCloud, placer: Placer) -> None:
        """Add the next cloud."""
        params = self._params
        self._stamps.append(cloud.stamp_ns)
        self._fields.update(dict.fromkeys(cloud.fields))
        if len(self._stamps) > SWEEPS:
            return
        shape = cloud.shape
        if shape is None and cloud.points is not None:
            shape = _shape(cloud.points, params, placer)
        if shape is None or not shape.is_readable:
            return
        if params.beams == "auto":
            self._steps.append(shape.step)
        name = _time_field(self._fields) if params.time_increment == "auto" else None
        if name is not None:
            self._timed[name] = None
            if name in cloud.fields and shape.sweep is not None:
                self._sweeps.append(shape.sweep)

    def require_fields(self, topic: str, spec: ScanSpec) -> None:
        """Raise if no cloud has a requested field."""
        if not self._stamps:
            return
        there = f"their fields are: {', '.join(self._fields) or 'none'}"
        name = spec.params.intensity_field
        asked = [("intensity_field", f"intensity_field is {name!r}", name)] if name else []
        asked += [(f.name, f"`{f.name}` needs the field {field!r}", field) for f in spec.filters for field in f.fields]
        if spec.point_time.partition(":")[0] == "azimuth":
            pass
        elif spec.point_time:
            asked.append(("point_time", f"`point_time` is {spec.point_time!r}", spec.point_time.partition(":")[0]))
        for option, request, field in asked:
            if field not in self._fields:
                near = did_you_mean(field, self._fields)
                raise ParameterError(
                    f"{request}, which the clouds on {topic} do not have", name=option, hint=f"{near} {there}".strip()
                )
        if spec.deskew and not spec.point_time and not any(name in self._fields for name in TIME_FIELDS):
            raise ParameterError(
                f"the clouds on {topic} have no times of their points: no field {', '.join(TIME_FIELDS)}",
                name="point_time",
                hint="name the field that has them: `point_time=FIELD`; of a lidar that turns once in 0.1 s: "
                f"`point_time=azimuth:0.1`, or `point_time=azimuth` to measure it; {there}",
            )

    def timing(self, topic: str, notes: list[str]) -> Measurements:
        """Return the times to write into the scans."""
        step = self._resolution(topic, notes) if self._params.beams == "auto" and self._stamps else 0.0
        layout = (self._params.at_resolution(step) if step else self._params).layout
        scan_time, time_increment, first_beam_ns = self._params.scan_time, self._params.time_increment, 0
        if scan_time == "auto":
            interval = median_interval_ns(self._stamps)
            scan_time = (interval or 0) / 1e9
            notes.append(
                f"{topic}: scan_time is 0, because there are no two different stamps to measure it between"
                if interval is None
                else f"{topic}: scan_time is {scan_time:.6g} s, the median interval of "
                f"{'its' if len(self._stamps) < FIRST_CLOUDS else 'the first'} {len(self._stamps)} stamps"
            )
        if time_increment == "auto":
            time_increment, first_beam_ns, found = self._beams(layout)
            notes.append(f"{topic}: {found}")
        return Measurements(scan_time, time_increment, first_beam_ns, step)

    def _resolution(self, topic: str, notes: list[str]) -> float:
        """Return how finely the lidar samples azimuth, radians."""
        known = [step for step in self._steps if step is not None]
        if 2 * len(known) <= len(self._steps):
            raise ParameterError(
                f"beams is auto, but the azimuth resolution of the clouds on {topic} cannot be measured: the points of "
                f"{len(self._steps) - len(known)} of the first {len(self._steps)} are in no regular rings",
                name="beams",
                hint="give a number of `beams`, or an `angle_increment`",
            )
        step = median_low(known)
        layout = self._params.at_resolution(step).layout
        notes.append(
            f"{topic}: beams is {layout.count:,}, angle_increment {layout.angle_increment:.6g} rad: the lidar measures "
            f"every {math.degrees(step):.4g} deg (median of {len(known)} clouds)"
        )
        return step

    def _beams(self, layout: BeamLayout) -> tuple[float, int, str]:
        """Return the time between beams in seconds, from the stamp to the first beam in nanoseconds, and a note."""
        if not self._timed:
            return 0.0, 0, f"time_increment is 0, because the clouds have no field {', '.join(TIME_FIELDS)}"
        field = ", ".join(self._timed)
        if not self._sweeps:
            return 0.0, 0, f"time_increment is 0, because the times of points ({field}) are not of a turning lidar"
        found = [times for sweep in self._sweeps if (times := beam_times(sweep, layout)) is not None]
        if len(found) < len(self._sweeps):
            lowest = median_low(sweep.lowest for sweep in self._sweeps)
            advice = f"`angle_min={lowest:.4f}` `angle_max={lowest + TURN:.4f}`"
            note = "time_increment is 0, because the clouds begin inside the scan's sector; let the scan begin there"
            return 0.0, 0, f"{note}: {advice}"
        first_beam_ns = round(median_low(first for first, _ in found) * 1e9)
        increment = median_low(step for _, step in found)
        way = "clockwise, so the first beam is the last in time" if increment < 0 else "counter-clockwise"
        note = f"time_increment is {increment:.4g} s, from {field}: the lidar turns {way}"
        return (
            increment,
            first_beam_ns,
            f"{note}; stamps are shifted by {stamp_text(first_beam_ns)} s, to the first beam",
        )
