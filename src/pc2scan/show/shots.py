"""Takes clouds of a recording for pictures, at some moments, with the transforms to the scans' frame."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.advice.checks import clouds as checks
from pc2scan.advice.checks import found_by
from pc2scan.advice.measurements import Measurements
from pc2scan.bags.topics import by_topic
from pc2scan.conversion.cloud_to_scan import CloudToScan
from pc2scan.conversion.corrections import corrected_for
from pc2scan.conversion.plan import make_plan
from pc2scan.conversion.stages import PlaceStage, SelectStage
from pc2scan.core.points import NUMBER
from pc2scan.core.rule import PointCounts
from pc2scan.core.scene import CloudSample, are_enough
from pc2scan.errors import DecodeError, MessageError, RecordingError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.text import counted

from .recording import chosen_messages, moment_text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.points import Points
    from pc2scan.model import RawMessage
    from pc2scan.request.options import ConvertOptions
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import Placement, Placer

    from .recording import ShownRecording

#: What is said of the first cloud that is shown, and of the first few. Heights are not: pages have sliders for them.
_OF_ONE = (checks.target_that_moves, checks.clouds_in_fixed_frame)
_OF_SEVERAL = (checks.frame_not_level, checks.swapped_transform, checks.clouds_in_another_unit)

#: Fields that a picture can show besides x, y and z.
_MOST_FIELDS = 8


class Shot(NamedTuple):
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
    page
        What a page knows of its points.
    """

    topic: str
    moment: str
    stamp_ns: int
    frame: str
    place: Placement
    columns: Mapping[str, NDArray[Any]]
    filtered: NDArray[np.uint8] | None
    page: Mapping[str, Any] = {}


class Shots(NamedTuple):
    """Clouds for pictures.

    Attributes
    ----------
    shots
        The clouds.
    params
        The parameters, with all measured values.
    transforms
        The transforms; None if there are none.
    notes, warnings
        Texts for the user.
    """

    shots: list[Shot]
    params: ProjectionParams
    transforms: TransformBuffer | None
    notes: list[str]
    warnings: list[str]


def take_shots(
    recording: ShownRecording,
    options: ConvertOptions,
    count: int,
    *,
    level: bool,
    keep: Callable[[Shot], Shot] = lambda shot: shot,
) -> Shots:
    """Take some clouds of each topic that a conversion converts.

    Parameters
    ----------
    recording
        The recording, and the moments.
    options
        The options of the conversion.
    count
        As for `chosen_messages`.
    level
        Whether clouds are placed in the frames of level scans; otherwise they are shown as recorded.
    keep
        Called with each cloud as soon as it is taken, and returns what is kept of it.

    Raises
    ------
    RecordingError
        If no cloud can be shown.
    """
    options.scan.refuse_combining("pages and figures make")
    # Pictures have neither times nor intensities.
    params = replace(options.scan.params, scan_time=0.0, time_increment=0.0, intensity_field="")
    options = options.with_scan(params=params)
    plan = make_plan(recording.reader.connections, options)
    reader, notes = corrected_for(recording.reader, plan, options)
    recording.reader = reader
    prepared = recording.prepare(plan, options)
    conversion = prepared.conversions[options.scan, ""]
    assert isinstance(conversion, CloudToScan)
    topics = by_topic(plan.converted)
    placer = conversion.placer if level else conversion.placer._replace(up=None)
    shots: list[Shot] = []
    samples: dict[str, list[CloudSample]] = {topic: [] for topic in topics}
    failed: list[str] = []
    for message in chosen_messages(recording, topics, options, count):
        topic = message.connection.topic
        try:
            # No name refers to the whole cloud, which would stay in memory while the next one is read.
            shots.append(keep(_shot(message, conversion, placer, samples[topic])))
        except MessageError as err:
            failed.append(f"{topic} at {moment_text(message.log_time_ns)}: {err.message}")
        del message
    if not shots:
        why = f"no cloud can be shown; {failed[0]}" if failed else f"no clouds on {', '.join(topics)}"
        raise RecordingError(why, path=reader.path)
    warnings = recording.warnings
    with np.errstate(all="ignore"):
        for topic, own in samples.items():
            for group, clouds in ((_OF_ONE, own[:1]), (_OF_SEVERAL, own)):
                facts = checks.CloudFacts(topic, options.scan, prepared.known, clouds, [PointCounts()])
                warnings += found_by(group, facts)
    if failed:
        warnings.append(f"Not shown: {len(failed)} of {counted(len(failed) + len(shots), 'cloud')}; {failed[0]}.")
    measured = next((each for topic in topics if (each := conversion.measurements.get(topic))), Measurements(0.0))
    notes += prepared.notes
    return Shots(shots, measured.resolve(conversion.spec.params), prepared.transforms, notes, warnings)


def _shot(message: RawMessage, conversion: CloudToScan, placer: Placer, samples: list[CloudSample]) -> Shot:
    """Return a cloud as it is shown; the first ones of a topic are added to ``samples``."""
    connection = message.connection
    points = CLOUDS[connection.ros_type](connection.serialization)(message.data)
    deskew, filters = conversion.deskews.get(connection.topic), conversion.spec.filters
    # Points at their own times, in the frame of the cloud; and, for filters, in that of the scans.
    place_own, place = (
        PlaceStage(each, None if deskew is None else replace(deskew, placer=each, sample=None))
        for each in (placer._replace(target_frame="", up=None), placer)
    )
    recorded = place_own(points)
    moving, stamp_ns = recorded.moving, recorded.stamp_ns
    placement = placer.place(points.frame_id, stamp_ns)
    if not are_enough(samples):
        samples.append(CloudSample.of(points).placed_in(placement.frame_id, placement.target_from_source))
    columns = _columns(points, (points if moving is None else moving.place(moving.points)[0]).xyz())
    filtered = None
    if filters:
        # Those that cannot be deskewed are rejected, too.
        filtered = np.ones(columns["x"].size, np.uint8)
        filtered[SelectStage(filters, placer, numbered=True)(place(points)).points.field(NUMBER).reshape(-1)] = 0
    moment, frame = moment_text(stamp_ns or message.log_time_ns), placer.source_frame or points.frame_id
    return Shot(connection.topic, moment, stamp_ns, frame, placement, columns, filtered)


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
