"""Recordings for pictures: opened as one, moments that are spread over them, and clouds of these with their frames."""

from __future__ import annotations

import heapq
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from pc2scan.advice.checks import first_clouds as checks
from pc2scan.advice.checks import found_by
from pc2scan.advice.measurements import Measurements
from pc2scan.advice.survey import placed_sample
from pc2scan.bags.damage import mention
from pc2scan.bags.observers import first_messages
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.topics import by_topic
from pc2scan.conversion.corrections import scaled
from pc2scan.conversion.plan import make_plan
from pc2scan.conversion.preparation import prepare, refuse_outside, span_of
from pc2scan.conversion.steps import CloudToScan, PlaceStep, SelectStep
from pc2scan.core.points import NUMBER
from pc2scan.core.rule import PointCounts
from pc2scan.core.scene import CloudSample, are_enough
from pc2scan.errors import DecodeError, MessageError, RecordingError, TopicError, UsageError, leading, stamp_text
from pc2scan.messages.clouds import CLOUDS
from pc2scan.result import Part, Result, tell_early
from pc2scan.text import counted, moment_text, size

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.points import Points
    from pc2scan.model import Connection, RawMessage
    from pc2scan.options.call import Options
    from pc2scan.options.moment import TimeBound
    from pc2scan.parsing import Warn
    from pc2scan.request.spec import Request
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import Placement, Placer

#: What is said of the first cloud that is shown, and of the first few. Heights are not: pages have sliders for them.
_OF_ONE = (checks.target_that_moves, checks.clouds_in_fixed_frame)
_OF_SEVERAL = (checks.frame_not_level, checks.clouds_in_another_unit)

#: Fields that a picture can show besides x, y and z.
_MOST_FIELDS = 8


@dataclass(frozen=True, slots=True, repr=False)
class Picture(Result):
    """What is known about a page or a figure.

    Attributes
    ----------
    path
        Its file; empty if it is not written.
    bytes
        The size of the file.
    notes
        Notes about the picture.
    warnings
        What differs from the request.
    damage
        The damage in the parts of the recording that were read.
    """

    json_names: ClassVar[tuple[str, ...]] = ("path", "bytes")

    path: str
    bytes: int
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    damage: tuple[Damage, ...] = ()

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the file and its size."""
        yield f"{leading(self.path) or 'a page'}: {size(self.bytes)}"


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
    damage
        The damage in the parts of the recordings that were read.
    """

    shots: list[Shot]
    params: ProjectionParams
    transforms: TransformBuffer | None
    notes: list[str]
    warnings: list[str]
    damage: tuple[Damage, ...]


class PictureSource(NamedTuple):
    """A recording that is open for pictures.

    Attributes
    ----------
    sources
        Its paths as they were given.
    reader
        The recording.
    request
        The conversion.
    options
        The options of the call: how many clouds, or at which moments.
    stack
        Closes the recording, and what is opened beside it.
    warn
        Called with each warning as soon as it is known; None: nobody waits for them.
    """

    sources: Sequence[Path]
    reader: Reader
    request: Request
    options: Options
    stack: ExitStack
    warn: Warn | None


@contextmanager
def opened(
    sources: Sequence[Path], request: Request, options: Options, warn: Warn | None, most: int = 0
) -> Iterator[PictureSource]:
    """Open recordings as one, for a picture of at most so many clouds; 0: it has none."""
    if most and not 1 <= options.clouds <= most:
        raise UsageError(f"`clouds` is {options.clouds:,}, it must be from 1 to {most:,}")
    with ExitStack() as stack:
        reader = scaled(as_one(open_recordings(sources, stack, strict=request.strict)), request.cloud_scale)
        try:
            yield PictureSource(sources, reader, request, options, stack, warn)
        except TopicError as err:
            mention(reader.damage, err)
            raise


def damage_of(*readers: Reader) -> tuple[Damage, ...]:
    """Return the damage in the parts of recordings that were read."""
    return tuple(damage for reader in readers for damage in reader.damage)


def title_of(sources: Sequence[Path]) -> str:
    """Return the title of a picture of recordings."""
    return ", ".join(source.name or str(source) for source in sources)


def chosen_messages(recording: PictureSource, topics: Mapping[str, Sequence[Connection]]) -> Iterator[RawMessage]:
    """Yield the first message of each topic at or after each moment of the call.

    Without any, the first message of each of so many equal parts of the recording, or of the cut. If a topic has no
    more messages, all of them are yielded.

    Raises
    ------
    UsageError
        If a moment is after the end, or the cut is empty, or outside of the recording.
    """
    reader, options = recording.reader, recording.options
    for time_ns in _moments(reader, options.at):
        for connections in topics.values():
            yield from islice(reader.messages(connections, time_ns), 1)
    if options.at:
        return
    span = span_of(reader, recording.request)
    refuse_outside(reader, span.start_ns, span.stop_ns)
    start_ns, stop_ns = span.first_ns, max(reader.summary.start_ns or 0, reader.summary.end_ns or 0) + 1
    if span.stop_ns is not None:
        stop_ns = min(stop_ns, span.stop_ns)
    if start_ns >= stop_ns:
        return

    each = (first_messages(reader, own, start_ns, stop_ns, options.clouds) for own in topics.values())
    yield from heapq.merge(*each, key=attrgetter("log_time_ns"))


def _moments(reader: Reader, at: Sequence[TimeBound]) -> list[int]:
    """Return the log times of given moments.

    Raises
    ------
    UsageError
        If one is after the end.
    """
    first_ns, last_ns = reader.summary.start_ns or 0, reader.summary.end_ns
    at_ns = sorted(bound.resolve(first_ns) for bound in at)
    if last_ns is not None and at_ns and at_ns[-1] > last_ns:
        text = f"`at` is {stamp_text(at_ns[-1])}, the recording is from {stamp_text(first_ns)} to"
        hint = f"`at=0` to `at={(last_ns - first_ns) / 1e9:.3f}` are in it"
        raise UsageError(f"{text} {stamp_text(last_ns)}", path=reader.path, hint=hint)
    return at_ns


def take_shots(recording: PictureSource, *, level: bool, keep: Callable[[Shot], Shot] = lambda shot: shot) -> Shots:
    """Take some clouds of each topic that a conversion converts.

    Parameters
    ----------
    recording
        The recording.
    level
        Whether clouds are placed in the frames of level scans; otherwise they are shown as recorded.
    keep
        Called with each cloud as soon as it is taken, and returns what is kept of it.

    Raises
    ------
    RecordingError
        If no cloud can be shown.
    """
    request = recording.request
    request.scan.refuse_combining("pages and figures make")
    # Pictures have neither times nor intensities.
    params = replace(request.scan.params, scan_time=0.0, time_increment=0.0, intensity_field="")
    request = request.with_scan(params=params)
    reader = recording.reader
    plan, span = make_plan(reader.connections, request), span_of(reader, request)
    warnings: list[str] = []
    tell = partial(tell_early, warnings, recording.warn)
    prepared = prepare(reader, plan, request, span, recording.stack, tell, transform_frames=())
    reader = prepared.reader
    conversion = prepared.conversions[request.scan, ""]
    assert isinstance(conversion, CloudToScan)
    topics = by_topic(plan.converted)
    placer = conversion.placer if level else conversion.placer._replace(up=None)
    shots: list[Shot] = []
    samples: dict[str, list[CloudSample]] = {topic: [] for topic in topics}
    failed: list[str] = []
    for message in chosen_messages(recording._replace(reader=reader), topics):
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
    with np.errstate(all="ignore"):
        for topic, own in samples.items():
            for group, clouds in ((_OF_ONE, own[:1]), (_OF_SEVERAL, own)):
                facts = checks.CloudFacts(topic, request.scan, prepared.known, clouds, [PointCounts()])
                warnings += found_by(group, facts)
    if failed:
        warnings.append(f"Not shown: {len(failed)} of {counted(len(failed) + len(shots), 'cloud')}; {failed[0]}.")
    measured = next(filter(None, map(conversion.measurements.get, topics)), Measurements(0.0))
    resolved, damage = measured.resolve(conversion.spec.params), damage_of(reader, *prepared.others)
    return Shots(shots, resolved, prepared.recorded and prepared.recorded.buffer, prepared.notes, warnings, damage)


def _shot(message: RawMessage, conversion: CloudToScan, placer: Placer, samples: list[CloudSample]) -> Shot:
    """Return a cloud as it is shown; the first ones of a topic are added to ``samples``."""
    connection = message.connection
    points = CLOUDS[connection.ros_type](connection.serialization)(message.data)
    deskew, filters = conversion.deskews.get(connection.topic), conversion.spec.filters
    # Points at their own times, in the frame of the cloud; and, for filters, in that of the scans.
    place_own, place = (
        PlaceStep(frames, None if deskew is None else replace(deskew, placer=frames, sample=None))
        for frames in (placer._replace(target_frame="", up=None), placer)
    )
    recorded = place_own(points)
    moving, stamp_ns = recorded.moving, recorded.stamp_ns
    placement = placer.place(points.frame_id, stamp_ns)
    if not are_enough(samples):
        samples.append(placed_sample(CloudSample.of(points), placement))
    columns = _columns(points, (points if moving is None else moving.place(moving.points)[0]).xyz())
    filtered = None
    if filters:
        # Those that cannot be deskewed are rejected, too.
        filtered = np.ones(columns["x"].size, np.uint8)
        filtered[SelectStep(filters, placer, numbered=True)(place(points)).points.field(NUMBER).reshape(-1)] = 0
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
