"""Maps of recordings: scans where the recorded transforms place them. A preview; scans are not matched."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from pc2scan.bags.topics import find_topics, matches
from pc2scan.core.occupancy import OccupancyGrid
from pc2scan.core.params import ProjectionParams
from pc2scan.errors import UsageError, name_list
from pc2scan.files.ownership import OutputPath, inputs_of, refuse_overlap
from pc2scan.files.text_output import files_output
from pc2scan.messages.clouds import CLOUDS, usual_topics
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.progress import Meter
from pc2scan.request.options import TopicRequest
from pc2scan.requests import conversion_of, first_output, with_notes
from pc2scan.result import tell_early
from pc2scan.streams.scans import Scans
from pc2scan.streams.stream import Selection

from .map_drawing import Drawing, MapOptions
from .map_files import map_paths
from .map_result import contents_of
from .recording import open_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.reader import Reader
    from pc2scan.options.call import Options
    from pc2scan.progress import Progress
    from pc2scan.request.options import ConvertOptions
    from pc2scan.requests import Warn

    from .map_result import Map


#: Cells of a map: 410 m by 410 m at 5 cm. Two bytes each while scans are drawn.
_MAX_CELLS = 64 << 20


def draw_map(
    sources: Sequence[Path],
    destination: Path | None,
    options: Options,
    *,
    write: bool = True,
    warn: Warn | None = None,
    progress: Progress | None = None,
) -> Map:
    """Draw scans into a map, which is written unless ``write`` is false; see `pc2scan.map`."""
    conversion = first_output(conversion_of(options, warn), "drawn", warn)
    asked = MapOptions.of(options)
    if not write:
        return with_notes(map_of(sources, conversion.options, asked, progress=progress, warn=warn), conversion)
    drawn = write_map(
        sources,
        destination,
        conversion.options,
        asked,
        overwrite=options.overwrite,
        also_read=conversion.files,
        progress=progress,
        warn=warn,
    )
    return with_notes(drawn, conversion)


def write_map(
    sources: Sequence[Path],
    destination: Path | None,
    options: ConvertOptions,
    asked: MapOptions,
    *,
    overwrite: bool = False,
    also_read: Mapping[str, Path] | None = None,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> Map:
    """Make a map of a recording, and write it; see `map_of`.

    Parameters
    ----------
    destination
        ``NAME.yaml``: its image and its picture are written beside it. ``NAME.png``: only the picture is written.
    overwrite
        Whether files of these names may be replaced.
    also_read
        Files that were read for the options, by option. They are never replaced.

    Raises
    ------
    DestinationError, OutputError
        If a file exists, or one cannot be written. Then none is written.
    """
    if destination is None:
        raise UsageError(
            "no file to write is given", hint="`destination=map.yaml`; or `destination=map.png`, the picture"
        )
    paths = map_paths(destination)
    refuse_overlap(
        inputs_of(sources, options.frames.tf_from, also_read),
        [OutputPath(path) for path in paths],
    )
    with files_output(paths, overwrite=overwrite) as deliver:
        made = map_of(sources, options, asked, progress=progress, warn=warn)
        deliver(contents_of(made, destination))
    return made


def map_of(
    sources: Sequence[Path],
    options: ConvertOptions,
    asked: MapOptions,
    *,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> Map:
    """Draw the scans of a recording, or scans made of its clouds, where its transforms place them.

    Parameters
    ----------
    sources
        Recordings; several are read as one, in time order.
    options
        The options of a conversion. Its topics decide whether scans or clouds are drawn. Without topics, clouds are
        drawn if there are no scans, or if any option is about the conversion of clouds.
    asked
        The options of the map.
    progress
        Called regularly; see `pc2scan.progress.Progress`.
    warn
        Called with each warning as soon as it is known, also if an error follows; the result has all of them.

    Raises
    ------
    UsageError
        If the options contradict each other or the recording, a frame does not exist, or the map would be too large.
    RecordingError
        If a source cannot be read.
    ResultError
        If no scan can be placed, or none has a return.
    """
    if options.scan.reverse:
        raise UsageError("`reverse` makes clouds, but a map is made of scans")
    notes: list[str] = []
    tell = partial(tell_early, notes, warn)
    with open_recording(sources, options) as recording:
        topics, converted = _topics(recording.reader, options)
        meter = None if progress is None else Meter(progress)
        frames = (asked.odom_frame, asked.base_frame)
        stream = _stream(sources, options, topics, frames, meter, converted=converted)
        buffer = stream.transforms
        if buffer is None:
            # Recorded scans are read as they are.
            found = recording.transforms(frames, meter)
            buffer = found.buffer
            tell(*found.warnings, *found.notes)
        further = recording.damage
    if not converted and _converts(options):
        tell("recorded scans are drawn: options about clouds have no effect")
    drawn = Drawing(OccupancyGrid(asked.resolution, _MAX_CELLS), buffer, asked, options)
    stream.listener = tell
    with stream, closing(stream.results()) as results:
        for result in results:
            for error in result.errors:
                error.topic = result.topic
                drawn.skip(result.topic, error)
            for scan, level in result.items:
                drawn.add(scan, level)
    return drawn.result(
        list(dict.fromkeys((*stream.notes, *notes))),
        tuple(dict.fromkeys((*further, *stream.damage))),
        converted=converted,
    )


def _converts(options: ConvertOptions) -> bool:
    """Whether any option is about the conversion of clouds."""
    scan = options.scan
    # Recorded scans are placed with the tolerance, too.
    params = replace(scan.params, transform_tolerance=ProjectionParams().transform_tolerance)
    chooses = bool(scan.filters or scan.remove or options.frames.source_frame)
    return params != ProjectionParams() or chooses or scan.deskew or scan.level or scan.may_combine


def _topics(reader: Reader, options: ConvertOptions) -> tuple[tuple[TopicRequest, ...], bool]:
    """Return the topics to draw, and whether they are clouds."""
    types: dict[str, set[str]] = {}
    for connection in reader.connections:
        types.setdefault(connection.topic, set()).add(connection.ros_type)
    scans = [topic for topic, kinds in types.items() if LASERSCAN in kinds]
    clouds = [topic for topic, kinds in types.items() if not kinds.isdisjoint(CLOUDS)]
    names = [request.source for request in options.scan.topics]
    if options.scan.may_share:
        return options.scan.topics, True
    if options.scan.combining.rebin:
        return options.scan.topics or tuple(map(TopicRequest, sorted(scans))), True
    if names:
        converted = any(matches(topic, names) for topic in clouds)
        if converted and any(matches(topic, names) for topic in scans):
            raise UsageError(f"`topics` has scans and clouds: {name_list(names)}", hint="a map is drawn of either")
    else:
        converted = bool(clouds) and (_converts(options) or not scans)
    if converted:
        return options.scan.topics or tuple(map(TopicRequest, sorted(usual_topics(types, CLOUDS)))), True
    # Without scans the stream raises an error that lists the topics.
    found = [topic for name in names for topic in find_topics(name, types, scans, LASERSCAN)] or sorted(scans)
    return tuple(map(TopicRequest, dict.fromkeys(found))), False


def _stream(
    sources: Sequence[Path],
    options: ConvertOptions,
    topics: tuple[TopicRequest, ...],
    frames: tuple[str, ...],
    meter: Meter | None,
    *,
    converted: bool,
) -> Scans:
    selection = Selection(
        paths=tuple(sources),
        topics=tuple(topic.source for topic in topics),
        start=options.start,
        end=options.end,
        strict=options.strict,
        clock=options.clock,
        cloud_scale=options.cloud_scale,
    )
    if not converted:
        return Scans(selection, meter=meter)
    scans_alone = replace(options, only_scans=True, keep=(), keep_clouds=False)
    return Scans(selection, scans_alone.with_scan(topics=topics), transform_frames=frames, meter=meter)
