"""Clouds of a recording as the page shows them: their points and fields, and the frames at their stamps."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.errors import DecodeError, MessageError, RecordingError, TransformError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.pipeline.measure import measure
from pc2scan.pipeline.options import ConvertOptions
from pc2scan.pipeline.parameters import PARAMETERS
from pc2scan.pipeline.plan import make_plan
from pc2scan.pipeline.stages.select import Select
from pc2scan.tf.placing import Frames

from .moments import moment, spread
from .packed import described, packed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.bags.reader import Reader
    from pc2scan.core.points import Points
    from pc2scan.core.rigid import Rigid
    from pc2scan.model import Connection, RawMessage
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.placing import Placement

__all__ = ["MOST_BYTES", "clouds_page"]

#: Compressed bytes of all clouds of a page. As text in the page they take a third more.
MOST_BYTES = 10_500_000

#: Fields that are shown besides x, y and z, and frames.
_MOST_FIELDS = 8
_MOST_FRAMES = 60

#: A field that no cloud has: the number of each point.
_NUMBER = "\0number"

#: Parameters that decide nothing about which points a beam reads.
_NOT_SHOWN = {"target_frame", "transform_tolerance", "scan_time", "queue_size", "time_increment"}
_SHOWN = tuple(spec.name for spec in fields(ProjectionParams) if spec.name not in _NOT_SHOWN)


@dataclass(frozen=True, slots=True)
class _Shot:
    """A cloud that was taken for the page: its fields, (points,) each, and what is said about it."""

    topic: str
    columns: Mapping[str, NDArray[Any]]
    #: (points,) uint8: 1 for what the filters reject; None without filters.
    filtered: NDArray[np.uint8] | None
    description: dict[str, Any]


def clouds_page(
    reader: Reader,
    buffer: TransformBuffer | None,
    options: ConvertOptions,
    *,
    count: int,
    at_ns: Sequence[int],
    preset: str,
    command: Sequence[str],
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Describe a page of clouds.

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
    preset
        The preset that the parameters come from; empty for none.
    command
        The words of the command line in front of the options for parameters.

    Returns
    -------
    description, blobs
        As `pc2scan.look.html.html` takes them.

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
    params = options.params
    notes: list[str] = []
    if params.beams == "auto":
        params, note = _at_measured_resolution(reader, topics, options, frames)
        notes.append(note)
    shots: list[_Shot] = []
    failed: list[str] = []
    for message in _messages(reader, topics, options, count, at_ns):
        try:
            shots.append(_shot(message, options, frames, buffer))
        except MessageError as err:
            failed.append(f"{message.connection.topic} at {moment(message.log_time_ns)}: {err.message}")
    if not shots:
        why = f"no cloud can be shown; {failed[0]}" if failed else f"no clouds on {', '.join(topics)}"
        raise RecordingError(why, path=reader.path)
    notes += [f"{len(failed)} of {len(failed) + len(shots)} clouds are not shown; {failed[0]}."] if failed else []
    step, blobs = _packed_to_fit(shots)
    if step > 1:
        notes.append(
            f"To keep this page small, 1 of {step} points is shown: counts and ranges are those of the thinned clouds. "
            "Fewer clouds are shown whole."
        )
    if options.filters:
        notes.append(
            "What filters reject was decided when this page was made: another mount or min_height does not change it."
        )
    entries: dict[str, list[dict[str, Any]]] = {}
    for number, shot in enumerate(shots):
        columns = {name: column[::step] for name, column in shot.columns.items()}
        entry = {**shot.description, "data": described(_name(number), columns), "filtered": None}
        if shot.filtered is not None:
            named = {"filtered": shot.filtered[::step]}
            entry["filtered"] = described(f"filtered-{number}", named)
            blobs[f"filtered-{number}"] = packed(named)
        entries.setdefault(shot.topic, []).append(entry)
    description = {
        "kind": "clouds",
        "notes": notes,
        "params": _shown(params),
        "base": _shown(ProjectionParams(**PRESETS[preset])) if preset else _shown(ProjectionParams()),  # type: ignore[arg-type]
        "defaults": _shown(ProjectionParams()),
        "presets": {name: {k: v for k, v in values.items() if k in _SHOWN} for name, values in PRESETS.items()},
        "preset": preset,
        "parameters": {name: {"help": PARAMETERS[name].help, "choices": PARAMETERS[name].words} for name in _SHOWN},
        "command": list(command),
        "targetFrame": options.params.target_frame,
        "topics": [{"topic": topic, "clouds": clouds} for topic, clouds in entries.items()],
    }
    return description, blobs


def _shown(params: ProjectionParams) -> dict[str, float | bool | str]:
    """The parameters that the page has; JSON has no infinity, so that is text."""
    values = {name: getattr(params, name) for name in _SHOWN}
    if params.beams == "auto":
        values["beams"] = 0
    return {name: str(v) if isinstance(v, float) and math.isinf(v) else v for name, v in values.items()}


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
    measured, _ = measure(reader, connections, ConvertOptions(params=only_beams), frames)
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


def _shot(message: RawMessage, options: ConvertOptions, frames: Frames, buffer: TransformBuffer | None) -> _Shot:
    connection = message.connection
    points = CLOUDS[connection.ros_type](connection.serialization)(message.data)
    place = frames.place(points.frame_id, points.stamp_ns)
    rigid = place.target_from_source
    columns = _columns(points)
    description = {
        "moment": moment(points.stamp_ns or message.log_time_ns),
        "frame": options.frames.source_frame or points.frame_id,
        "targetFrame": place.frame_id,
        "transform": None
        if rigid is None
        else {"quaternion": rigid.quaternion.tolist(), "translation": rigid.translation.tolist()},
        "mount": _mount(rigid),
        "frames": [] if buffer is None else list(_origins(buffer, place.frame_id, points.stamp_ns)),
        "total": len(columns["x"]),
    }
    return _Shot(connection.topic, columns, _filtered(points, place, options, frames), description)


def _filtered(points: Points, place: Placement, options: ConvertOptions, frames: Frames) -> NDArray[np.uint8] | None:
    """Which points the filters reject."""
    if not options.filters:
        return None
    shape = points.xyz()[0].shape
    numbers = np.arange(math.prod(shape)).reshape(shape)
    numbered = replace(points, fields={**points.fields, _NUMBER: numbers})
    kept = Select(options.filters, frames)(numbered, place).points.field(_NUMBER)
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


def _mount(rigid: Rigid | None) -> dict[str, float]:
    values = (0.0,) * 6 if rigid is None else (*rigid.translation.tolist(), *rigid.rpy)
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), values, strict=True))


def _origins(buffer: TransformBuffer, target: str, stamp_ns: int) -> Iterator[dict[str, Any]]:
    """Where other frames are, as seen from the scan's frame."""
    names = buffer.frames
    for name in names[:_MOST_FRAMES]:
        if name.removeprefix("/") == target.removeprefix("/"):
            continue
        try:
            x, y, z = buffer.lookup(target, name, stamp_ns).translation.tolist()
        except TransformError:
            continue
        if math.isfinite(x + y + z):
            yield {"name": name, "x": x, "y": y, "z": z}


def _packed_to_fit(shots: Sequence[_Shot]) -> tuple[int, dict[str, bytes]]:
    """Compress the clouds: every point, or every n-th where that is too much; return n and the bytes."""
    step = 1
    while True:
        blobs = {
            _name(number): packed({name: column[::step] for name, column in shot.columns.items()})
            for number, shot in enumerate(shots)
        }
        size = sum(map(len, blobs.values()))
        if size <= MOST_BYTES or all(len(shot.columns["x"]) <= step for shot in shots):
            return step, blobs
        step = math.ceil(step * size / MOST_BYTES)


def _name(number: int) -> str:
    return f"cloud-{number}"
