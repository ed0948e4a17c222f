"""Takes clouds of a recording for pictures, at some moments, with the transforms to the scans' frame."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.bags.observers import observe
from pc2scan.errors import DecodeError, MessageError, RecordingError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.pipeline.levelling import UpSources
from pc2scan.pipeline.measurements import cloud_observers, measure
from pc2scan.pipeline.options import ScanSpec
from pc2scan.pipeline.plan import make_plan
from pc2scan.pipeline.point_times import measure_turns, turn_observers
from pc2scan.pipeline.stages.deskew import Deskew, PointTime
from pc2scan.pipeline.stages.selection import SelectStage
from pc2scan.text import counted
from pc2scan.tf.imu import read_up
from pc2scan.tf.placing import Placer

from .recording import moment_text, spread_messages

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.bags.observers import Observer
    from pc2scan.bags.reader import Reader
    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.points import Points
    from pc2scan.model import Connection, RawMessage
    from pc2scan.pipeline.measurements import FirstCloud
    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.pipeline.stages.turn import TurnSample
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.placing import Placement

#: Fields that a picture can show besides x, y and z.
_MOST_FIELDS = 8

#: A field that no cloud has: the number of each point.
_NUMBER = "\0number"


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A cloud for a picture.

    Attributes
    ----------
    topic
        Its topic.
    moment
        Its stamp as text for users; its log time if it has no stamp.
    stamp_ns
        The stamp of its header.
    frame
        The frame of its coordinates.
    place
        The scan's frame, and the transform into it.
    columns
        Copies of its fields by name, each (points,): ``x``, ``y``, ``z`` in metres as float32, others as recorded.
    filtered
        (points,) uint8: 1 for points that the filters reject. None without filters.
    """

    topic: str
    moment: str
    stamp_ns: int
    frame: str
    place: Placement
    columns: Mapping[str, NDArray[Any]]
    filtered: NDArray[np.uint8] | None


class Shots(NamedTuple):
    """Clouds, the parameters with all measured values, and notes and warnings for the user."""

    shots: list[Shot]
    params: ProjectionParams
    notes: list[str]
    warnings: list[str]


def take_shots(
    reader: Reader,
    buffer: TransformBuffer | None,
    options: ConvertOptions,
    *,
    count: int,
    at_ns: Sequence[int],
    others: Sequence[Reader] | None = None,
) -> Shots:
    """Take some clouds of each topic that a conversion converts.

    Parameters
    ----------
    reader
        The recording, open.
    buffer
        The transforms; None where there are none.
    options
        The options of the conversion.
    count
        The number of clouds of each topic, evenly spread over the recording.
    at_ns
        Log times: the first cloud of each topic at or after each of them is taken. Empty: ``count`` decides.
    others
        Recordings that the transforms were read from, which level scans need.

    Raises
    ------
    RecordingError
        If no cloud can be shown.
    """
    topics: dict[str, list[Connection]] = {}
    for route in make_plan(reader.connections, options).routes:
        if route.targets:
            topics.setdefault(route.connection.topic, []).append(route.connection)
    frames = _frames(buffer, options, None if others is None else [reader, *others])
    spec = options.scan
    params, notes = spec.params, list[str]()
    spec.refuse_combining("pages and figures make")
    if spec.deskew:
        notes.append("Clouds are deskewed, as if all points had been measured at the scan's time.")
    if spec.level and frames.up is None:
        notes.append("Clouds are shown as recorded; only a conversion makes scans level.")
    first = next(iter(topics))
    clouds = cloud_observers(topics[first], _only_beams(spec), frames) if params.beams == "auto" else {}
    connections = [each for found in topics.values() for each in found]
    turning = turn_observers(connections, spec.point_time) if spec.deskew else {}
    observe(reader, [*turning.values(), *clouds.values()])
    deskew = _deskew(turning, options, frames._replace(target_frame="", up=None))
    if clouds:
        params, note = _at_measured_resolution(first, clouds, options, frames)
        notes.append(note)
    shots: list[Shot] = []
    failed: list[str] = []
    for message in _messages(reader, topics, options, count, at_ns):
        try:
            shots.append(_shot(message, options, frames, deskew))
        except MessageError as err:
            failed.append(f"{message.connection.topic} at {moment_text(message.log_time_ns)}: {err.message}")
    if not shots:
        why = f"no cloud can be shown; {failed[0]}" if failed else f"no clouds on {', '.join(topics)}"
        raise RecordingError(why, path=reader.path)
    number = counted(len(failed) + len(shots), "cloud")
    warnings = [f"Not shown: {len(failed)} of {number}; {failed[0]}."] if failed else []
    return Shots(shots, params, notes, warnings)


def _frames(buffer: TransformBuffer | None, options: ConvertOptions, levelled: Sequence[Reader] | None) -> Placer:
    """Return the frames of the scans; level ones only if ``levelled`` has recordings to take roll and pitch from."""
    spec, asked = options.scan, options.frames
    params = spec.params
    if buffer is None or not spec.needs_transforms:
        return Placer(source_frame=asked.source_frame)
    tolerance_ns = params.tolerance_ns
    up = None
    if spec.level and levelled is not None:
        up, _ = UpSources(buffer, partial(read_up, levelled)).of(spec)
    return Placer(params.target_frame, asked.source_frame, buffer, tolerance_ns, up)


def _at_measured_resolution(
    topic: str, observers: Mapping[str, Observer[FirstCloud]], options: ConvertOptions, frames: Placer
) -> tuple[ProjectionParams, str]:
    """Return the parameters with the number of beams of a topic's lidar, and a note about it."""
    measured, _ = measure(observers, _only_beams(options.scan), frames)
    step = measured[topic].azimuth_step
    params = options.scan.params.at_resolution(step) if step else replace(options.scan.params, beams=0)
    degrees = math.degrees(params.layout.angle_increment)
    return params, f"Beams, measured on {topic}: {params.length}, by {degrees:.4g} deg."


def _only_beams(spec: ScanSpec) -> ScanSpec:
    """Return an output of which nothing but the number of beams is measured."""
    return ScanSpec(params=replace(spec.params, scan_time=0.0, time_increment=0.0, intensity_field=""))


def _messages(
    reader: Reader,
    topics: Mapping[str, Sequence[Connection]],
    options: ConvertOptions,
    count: int,
    at_ns: Sequence[int],
) -> Iterator[RawMessage]:
    if not at_ns:
        yield from spread_messages(reader, topics, options, count)
        return
    seen: set[tuple[str, int]] = set()
    for time_ns in sorted(at_ns):
        for topic, connections in topics.items():
            message = next(iter(reader.messages(connections, time_ns)), None)
            if message is not None and (topic, message.log_time_ns) not in seen:
                seen.add((topic, message.log_time_ns))
                yield message


def _deskew(observers: Mapping[str, Observer[TurnSample]], options: ConvertOptions, frames: Placer) -> Deskew | None:
    """Return the stage that deskews clouds into the target frame or, without one, into their own frame."""
    if not options.scan.deskew:
        return None
    asked = options.scan
    where = PointTime.parse(asked.point_time)
    turns, _ = measure_turns(observers, asked.point_time)
    return Deskew(frames, asked.fixed_frame, where, asked.stamp, turns)


def _shot(message: RawMessage, options: ConvertOptions, frames: Placer, deskew: Deskew | None) -> Shot:
    connection = message.connection
    points = CLOUDS[connection.ros_type](connection.serialization)(message.data)
    deskew = None if deskew is None else deskew.of(connection.topic)
    moving = None if deskew is None else deskew(points)
    stamp_ns, xyz = points.stamp_ns, points.xyz()
    if moving is not None:
        stamp_ns, xyz = moving.stamp_ns, moving.place(moving.points)[0].xyz()
    place = frames.place(points.frame_id, stamp_ns)
    return Shot(
        connection.topic,
        moment_text(stamp_ns or message.log_time_ns),
        stamp_ns,
        options.frames.source_frame or points.frame_id,
        place,
        _columns(points, xyz),
        _filter_mask(points, place, options, frames, None if deskew is None else deskew.within(frames)),
    )


def _filter_mask(
    points: Points, place: Placement, options: ConvertOptions, frames: Placer, deskew: Deskew | None
) -> NDArray[np.uint8] | None:
    """Return a mask of the points that the filters reject, and of those that cannot be deskewed."""
    if not options.scan.filters:
        return None
    moving = None if deskew is None else deskew(points)
    points = points if moving is None else moving.points
    shape = points.xyz()[0].shape
    numbers = np.arange(math.prod(shape)).reshape(shape)
    numbered = replace(points, fields={**points.fields, _NUMBER: numbers})
    kept = SelectStage(options.scan.filters, frames).apply(numbered, place, moving).points.field(_NUMBER)
    filtered = np.ones(numbers.size, np.uint8)
    filtered[kept.reshape(-1)] = 0
    return filtered


def _columns(points: Points, xyz: Sequence[NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return copies of the coordinates as float32, like the projection reads them, and of other fields as recorded."""
    with np.errstate(over="ignore", invalid="ignore"):
        columns = {name: axis.reshape(-1).astype("<f4") for name, axis in zip("xyz", xyz, strict=True)}
    for name in islice((name for name in points.fields if name not in columns), _MOST_FIELDS):
        # Skip fields that cannot be read; the projection does not need them.
        with suppress(DecodeError):
            values = points.field(name).reshape(-1)
            columns[name] = values.astype(values.dtype.newbyteorder("<"))
    return columns
