"""Clouds of a recording for pictures: some moments, their points, and where they go."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.errors import DecodeError, MessageError, RecordingError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.pipeline.measure import measure
from pc2scan.pipeline.plan import make_plan
from pc2scan.pipeline.scan_spec import ScanSpec
from pc2scan.pipeline.stages.select import Select
from pc2scan.tf.placing import Frames

from .moments import moment, spread

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.bags.reader import Reader
    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.points import Points
    from pc2scan.model import Connection, RawMessage
    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.placing import Placement

__all__ = ["Shot", "Shots", "take_shots"]

#: Fields that are taken besides x, y and z.
_MOST_FIELDS = 8

#: A field that no cloud has: the number of each point.
_NUMBER = "\0number"


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A cloud.

    Attributes
    ----------
    topic
        Where it was recorded.
    moment
        Its stamp, or its log time where it has none, for people.
    stamp_ns
        Of its header.
    frame
        The frame of its coordinates.
    place
        Where the scan is, and the transform to it.
    columns
        Copies of its fields by name, each (points,): ``x``, ``y``, ``z`` in metres as float32, others as recorded.
    filtered
        (points,) uint8: 1 for what the filters reject. None without filters.
    """

    topic: str
    moment: str
    stamp_ns: int
    frame: str
    place: Placement
    columns: Mapping[str, NDArray[Any]]
    filtered: NDArray[np.uint8] | None


class Shots(NamedTuple):
    """Clouds, the parameters with all that was measured, and what is worth saying."""

    shots: list[Shot]
    params: ProjectionParams
    notes: list[str]


def take_shots(
    reader: Reader,
    buffer: TransformBuffer | None,
    options: ConvertOptions,
    *,
    count: int,
    at_ns: Sequence[int],
) -> Shots:
    """Take clouds of each topic that a conversion converts.

    Parameters
    ----------
    reader
        The recording, open.
    buffer
        The transforms; None where there are none.
    options
        What to convert, as for a conversion.
    count
        Clouds of each topic, evenly spread over the recording.
    at_ns
        Log times: of each topic the first cloud at or after each is taken. Empty: ``count`` decides.

    Raises
    ------
    RecordingError
        If not a single cloud can be shown.
    """
    topics: dict[str, list[Connection]] = {}
    for route in make_plan(reader.connections, options).routes:
        if route.targets:
            topics.setdefault(route.connection.topic, []).append(route.connection)
    frames = _frames(buffer, options)
    params, notes = options.params, list[str]()
    if options.deskew or options.level:
        how = " and ".join(["deskews them"] * options.deskew + ["makes scans level"] * options.level)
        notes.append(f"Clouds are shown as recorded; only a conversion {how}.")
    if params.beams == "auto":
        params, note = _at_measured_resolution(reader, topics, options, frames)
        notes.append(note)
    shots: list[Shot] = []
    failed: list[str] = []
    for message in _messages(reader, topics, options, count, at_ns):
        try:
            shots.append(_shot(message, options, frames))
        except MessageError as err:
            failed.append(f"{message.connection.topic} at {moment(message.log_time_ns)}: {err.message}")
    if not shots:
        why = f"no cloud can be shown; {failed[0]}" if failed else f"no clouds on {', '.join(topics)}"
        raise RecordingError(why, path=reader.path)
    if failed:
        notes.append(f"{len(failed)} of {len(failed) + len(shots)} clouds are not shown; {failed[0]}.")
    return Shots(shots, params, notes)


def _frames(buffer: TransformBuffer | None, options: ConvertOptions) -> Frames:
    """Where clouds go."""
    params, asked = options.params, options.frames
    if buffer is None or not params.target_frame:
        return Frames(source_frame=asked.source_frame)
    return Frames(params.target_frame, asked.source_frame, buffer, round(params.transform_tolerance * 1e9))


def _at_measured_resolution(
    reader: Reader, topics: Mapping[str, Sequence[Connection]], options: ConvertOptions, frames: Frames
) -> tuple[ProjectionParams, str]:
    """The parameters with as many beams as the first topic's lidar has, and what is said about it."""
    first, connections = next(iter(topics.items()))
    only_beams = replace(options.params, scan_time=0.0, time_increment=0.0, intensity_field="")
    measured, _ = measure(reader, connections, ScanSpec(params=only_beams), frames)
    step = measured[first].azimuth_step
    params = options.params.at_resolution(step) if step else replace(options.params, beams=0)
    degrees = math.degrees(params.layout.angle_increment)
    return params, f"Beams, measured on {first}: {params.length}, by {degrees:.4g} deg."


def _messages(
    reader: Reader,
    topics: Mapping[str, Sequence[Connection]],
    options: ConvertOptions,
    count: int,
    at_ns: Sequence[int],
) -> Iterator[RawMessage]:
    if not at_ns:
        yield from spread(reader, topics, options, count)
        return
    seen: set[tuple[str, int]] = set()
    for time_ns in sorted(at_ns):
        for topic, connections in topics.items():
            message = next(iter(reader.messages(connections, time_ns)), None)
            if message is not None and (topic, message.log_time_ns) not in seen:
                seen.add((topic, message.log_time_ns))
                yield message


def _shot(message: RawMessage, options: ConvertOptions, frames: Frames) -> Shot:
    connection = message.connection
    points = CLOUDS[connection.ros_type](connection.serialization)(message.data)
    place = frames.place(points.frame_id, points.stamp_ns)
    return Shot(
        connection.topic,
        moment(points.stamp_ns or message.log_time_ns),
        points.stamp_ns,
        options.frames.source_frame or points.frame_id,
        place,
        _columns(points),
        _filtered(points, place, options, frames),
    )


def _filtered(points: Points, place: Placement, options: ConvertOptions, frames: Frames) -> NDArray[np.uint8] | None:
    """Which points the filters reject."""
    if not options.filters:
        return None
    shape = points.xyz()[0].shape
    numbers = np.arange(math.prod(shape)).reshape(shape)
    numbered = replace(points, fields={**points.fields, _NUMBER: numbers})
    kept = Select(options.filters, frames).apply(numbered, place).points.field(_NUMBER)
    filtered = np.ones(numbers.size, np.uint8)
    filtered[kept.reshape(-1)] = 0
    return filtered


def _columns(points: Points) -> dict[str, NDArray[Any]]:
    """The coordinates as float32, as the projection reads them, and other fields as they are recorded: copies."""
    with np.errstate(over="ignore", invalid="ignore"):
        columns = {name: axis.reshape(-1).astype("<f4") for name, axis in zip("xyz", points.xyz(), strict=True)}
    for name in islice((name for name in points.fields if name not in columns), _MOST_FIELDS):
        # A field that cannot be read is not shown; the projection does not need it.
        with suppress(DecodeError):
            values = points.field(name).reshape(-1)
            columns[name] = values.astype(values.dtype.newbyteorder("<"))
    return columns
