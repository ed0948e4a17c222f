"""Draws maps of recordings: scans where the recorded transforms place them. A preview; scans are not matched.

A scan is placed at its own stamp, by the transform from its frame to the odometry's. If it has a ``time_increment``,
and there are transforms up to its last beam, each beam is placed at its own time.
"""

from __future__ import annotations

import math
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.arguments import path_of
from pc2scan.bags.topics import find_topics, matches
from pc2scan.core.occupancy import FREE, LONGEST, OCCUPIED, Occupancy, OccupancyGrid, observing_beams, placed_beams
from pc2scan.core.params import ProjectionParams
from pc2scan.core.rigid import Rigid
from pc2scan.core.unproject import beam_angles, last_beam_ns
from pc2scan.errors import MessageError, ResultError, TransformError, UsageError, name_list
from pc2scan.files.limits import MAX_MAP_CELLS
from pc2scan.files.overlap import InputPath, OutputPath, refuse_overlap
from pc2scan.files.text_output import files_output
from pc2scan.inspect.scan_frames import BASE_FRAMES
from pc2scan.json_types import json_value
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.names import did_you_mean
from pc2scan.pipeline.scan_spec import TopicRequest
from pc2scan.shown import Shown, counted, duration, listed
from pc2scan.streams.scans import Scans
from pc2scan.streams.stream import Selection
from pc2scan.tf.reading import read_transforms

from .map_files import image_of, map_paths, yaml_of
from .map_picture import picture_of
from .opened import opened

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.pipeline.run import Progress
    from pc2scan.shown import Table
    from pc2scan.streams.scans import Scan
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.placing import LevelTransform

__all__ = ["Map", "MapOptions", "NotDrawn", "map_of", "write_map"]

#: Limits of the side of a cell, metres: smaller cells are finer than any lidar measures, larger ones show nothing.
_FINEST, _COARSEST = 0.001, 1.0

#: A scan is tilted if the cosine between its z axis and the map's is below this: 5 degrees.
_LEVEL = math.cos(math.radians(5))

#: How many reasons for skipping are distinguished.
_MOST_REASONS = 100

#: How many reasons for skipping, and damaged places, are shown as text.
_MAX_SHOWN = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class MapOptions:
    """The options of a map.

    Attributes
    ----------
    odom_frame
        The frame in which the robot moves, and of the map.
    base_frame
        The robot's frame, whose path is shown; empty for ``base_link``, or ``base_footprint`` if the former does not
        exist.
    resolution
        The side of a cell, metres.
    max_range
        Returns beyond this range mark no cell as occupied; the cells up to it are cleared. Metres.
    clear_to
        The range up to which beams without a return clear cells, metres; 0: they are ignored.

    Raises
    ------
    UsageError
        If a number is not allowed.
    """

    odom_frame: str = "odom"
    base_frame: str = ""
    resolution: float = 0.05
    max_range: float = math.inf
    clear_to: float = 0.0

    def __post_init__(self) -> None:
        if not _FINEST <= self.resolution <= _COARSEST:
            # A resolution of 5 nearly always means centimetres.
            meant = self.resolution / 100
            raise UsageError(
                f"`resolution` is {self.resolution:g} m, it must be from {_FINEST:g} to {_COARSEST:g}",
                hint=f"for {self.resolution:g} cm write `resolution={meant:g}`"
                if _FINEST <= meant <= _COARSEST
                else None,
            )
        if not self.max_range > 0:
            raise UsageError(f"`max_range` is {self.max_range:g} m, it must be greater than 0")
        if not 0 <= self.clear_to < math.inf:
            raise UsageError(f"`clear_to` is {self.clear_to:g} m, it must be 0 or more, and finite")
        if not self.odom_frame.removeprefix("/"):
            raise UsageError("`odom_frame` is empty", hint="pc2scan tf shows the frames of a recording")


@dataclass(frozen=True, slots=True)
class NotDrawn:
    """Messages of a topic that are not in the map, for one reason."""

    topic: str
    reason: str
    count: int

    def __str__(self) -> str:
        return f"{self.count:,} of {self.topic}: {self.reason}"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Map(Shown):
    """A map of a recording by its recorded odometry. Notebooks show its picture.

    Attributes
    ----------
    cells
        (H, W) int8 as in nav_msgs/OccupancyGrid: -1 unknown, 0 free, 100 occupied; the first row has the smallest y.
    resolution
        The side of a cell, metres.
    origin
        x, y (metres) and yaw of the corner of the first cell; yaw is always 0.
    frame
        The frame of the map.
    robot_frame
        The frame whose path is `trajectory`.
    trajectory
        (N, 2) float64, metres: the position of the robot at each scan.
    scans
        How many scans of each topic are in the map.
    converted
        Whether the scans were made of clouds.
    skipped
        The scans that are not in the map, and why.
    notes
        Warnings about the map.
    damage
        The damage in the parts of the recording that were read.
    """

    cells: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]
    frame: str
    robot_frame: str
    trajectory: NDArray[np.float64]
    duration: float
    scans: dict[str, int]
    converted: bool
    skipped: tuple[NotDrawn, ...]
    notes: tuple[str, ...]
    damage: tuple[Damage, ...]

    @property
    def exit_status(self) -> int:
        """The exit status of the command: 0, or 3 if scans were skipped or the recording is damaged."""
        return 3 if self.skipped or self.damage else 0

    @property
    def distance(self) -> float:
        """The length of the robot's path, metres."""
        steps = np.diff(self.trajectory, axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    @property
    def png(self) -> bytes:
        """The picture: the map, the robot's path, a scale, and the axes of the map's frame."""
        occupancy = Occupancy(self.cells, self.resolution, *self.origin[:2])
        return picture_of(occupancy, self.trajectory)

    def _repr_png_(self) -> bytes:
        return self.png

    def save(self, destination: str | Path, *, overwrite: bool = False) -> Path:
        """Write the map, as map_server reads it: ``NAME.yaml``, ``NAME.pgm``, and the picture ``NAME.png``.

        Raises
        ------
        DestinationError, UsageError
            If there is such a file, or the name does not end in ``.yaml``.
        OutputError
            If one cannot be written.
        """
        path = path_of("destination", destination)
        with files_output(map_paths(path), overwrite=overwrite) as deliver:
            deliver(self._files(path))
        return path

    def _files(self, path: Path) -> list[bytes]:
        """The contents of `map_paths`."""
        image = image_of(self.cells, self.resolution)
        return [image, self.png, yaml_of(map_paths(path)[0].name, self.resolution, self.origin)]

    def as_dict(self) -> dict[str, Any]:
        """Return JSON's types."""
        height, width = self.cells.shape
        return {
            "exit_status": self.exit_status,
            "preview": "by recorded odometry, no SLAM",
            "frame": self.frame,
            "robot_frame": self.robot_frame,
            "resolution": self.resolution,
            "origin": list(self.origin),
            "width": width,
            "height": height,
            "occupied": self._share(OCCUPIED),
            "free": self._share(FREE),
            "scans": self.scans,
            "converted": self.converted,
            "distance": json_value(self.distance),
            "duration": self.duration,
            "skipped": [{"topic": s.topic, "reason": s.reason, "count": s.count} for s in self.skipped],
            "notes": list(self.notes),
            "damage": [place.as_dict() for place in self.damage],
        }

    def _share(self, value: int) -> float:
        return float(np.count_nonzero(self.cells == value) / self.cells.size)

    def __repr__(self) -> str:
        height, width = self.cells.shape
        return f"<pc2scan.Map of {width} x {height} cells of {self.resolution:g} m in {self.frame!r}>"

    def lines(self) -> Iterator[str]:
        """Yield the text about the map, without skipped scans and damage."""
        height, width = self.cells.shape
        yield (
            f"map: {width:,} x {height:,} cells of {self.resolution:g} m "
            f"({width * self.resolution:.1f} x {height * self.resolution:.1f} m), "
            f"{self._share(OCCUPIED):.1%} occupied, {self._share(FREE):.1%} free"
        )
        of = ", ".join(f"{count:,} of {topic}" for topic, count in self.scans.items())
        yield f"scans: {of}{' (made of clouds)' if self.converted else ''}"
        yield f"robot: {self.robot_frame} drove {self.distance:.1f} m in {self.frame}, in {duration(self.duration)}"
        yield "This is a preview by the recorded odometry: no SLAM, nothing is matched or corrected."

    def _shown(self) -> Iterator[str | Table]:
        yield from self.lines()
        yield from listed([str(each) for each in self.skipped], "skipped", _MAX_SHOWN)
        yield from listed([str(place) for place in self.damage], "damaged", _MAX_SHOWN)
        yield from (f"warning: {note}" for note in self.notes)


def write_map(
    sources: Sequence[Path],
    destination: Path | None,
    picture: Path | None,
    options: ConvertOptions,
    asked: MapOptions,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Map:
    """Make a map of a recording, and write it; see `map_of`.

    Parameters
    ----------
    destination
        ``NAME.yaml``: its image and its picture are written beside it. None: only the picture is written.
    picture
        The path of the picture. None: beside ``destination``.
    overwrite
        Whether files of these names may be replaced.

    Raises
    ------
    DestinationError, OutputError
        If a file exists, or one cannot be written. Then none is written.
    """
    paths = map_paths(destination) if destination is not None else []
    if picture is not None:
        if picture.suffix.lower() != ".png":
            png = picture.with_suffix(".png").name if picture.name else "map.png"
            raise UsageError("is not the name of a PNG file", path=picture, hint=f"`png={png}`")
        paths = [picture] if destination is None else [paths[0], picture, paths[2]]
    if not paths:
        raise UsageError("no file to write is given", hint="name the map, `destination=map.yaml`, or `png=map.png`")
    refuse_overlap(
        [*map(InputPath, sources), *(InputPath(file, "file of `tf_from`") for file in options.frames.tf_from)],
        [OutputPath(path) for path in paths],
    )
    with files_output(paths, overwrite=overwrite) as deliver:
        made = map_of(sources, options, asked, progress=progress)
        deliver([made.png] if destination is None else made._files(destination))  # noqa: SLF001  # of this module
    return made


def map_of(
    sources: Sequence[Path], options: ConvertOptions, asked: MapOptions, *, progress: Progress | None = None
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
        Called regularly with bytes read, total bytes, and messages read.

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
    with opened(sources, options) as recording:
        buffer, notes = read_transforms([recording.reader, *recording.others], options.frames)
        topics, converted = _topics(recording.reader, options)
        further = recording.damage
    if not converted and _converts(options):
        notes.append("The recording has no clouds: options about clouds have no effect.")
    stream = _stream(sources, options, topics, converted=converted)
    drawn = _Drawn(OccupancyGrid(asked.resolution, MAX_MAP_CELLS), buffer, asked, options)
    stream.listener = notes.append
    with stream, closing(stream.reads(progress)) as reads:
        for read in reads:
            if read.error is not None:
                read.error.topic = read.connection.topic
                drawn.skip(read.connection.topic, read.error)
            for scan in read.items:
                level = None if read.converted is None else read.converted.level
                drawn.add(scan, level)  # type: ignore[arg-type]
    return drawn.result(
        list(dict.fromkeys((*stream.notes, *notes))),
        tuple(dict.fromkeys((*further, *stream.damage))),
        converted=converted,
    )


def _converts(options: ConvertOptions) -> bool:
    """Whether any option is about the conversion of clouds."""
    scan = options.scan
    return scan.params != ProjectionParams() or bool(scan.filters) or scan.deskew or scan.level or scan.may_combine


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
        return options.scan.topics or tuple(map(TopicRequest, sorted(clouds))), True
    # Without scans the stream raises an error that lists the topics.
    found = [topic for name in names for topic in find_topics(name, types, scans, LASERSCAN)] or sorted(scans)
    return tuple(map(TopicRequest, dict.fromkeys(found))), False


def _stream(
    sources: Sequence[Path], options: ConvertOptions, topics: tuple[TopicRequest, ...], *, converted: bool
) -> Scans:
    selection = Selection(
        paths=tuple(sources),
        topics=tuple(topic.source for topic in topics),
        start=options.start,
        end=options.end,
        verify=options.verify,
        strict=options.strict,
    )
    if not converted:
        return Scans(selection)
    scans_alone = replace(options, only_scans=True, keep=(), keep_clouds=False)
    return Scans(selection, scans_alone.with_scan(topics=topics))


def _scans_are(number: int) -> str:
    return f"{counted(number, 'scan', 'are')}"


@dataclass(slots=True)
class _Drawn:
    """Draws scans, and counts them."""

    grid: OccupancyGrid
    buffer: TransformBuffer
    asked: MapOptions
    options: ConvertOptions
    scans: Counter[str] = field(default_factory=Counter)
    skipped: Counter[tuple[str, str]] = field(default_factory=Counter)
    first_error: MessageError | None = None
    #: Stamp, x and y.
    way: list[tuple[int, float, float]] = field(default_factory=list)
    robot: str = ""
    tilted: int = 0
    beams_at_once: int = 0
    directions: dict[tuple[int, float, float], NDArray[np.float64]] = field(default_factory=dict)

    def add(self, scan: Scan, level: LevelTransform | None = None) -> None:
        """Draw a scan, or count why not; ``level`` is the transform of its frame, if that was made level."""
        asked = self.asked
        try:
            start = self._pose(scan.frame if level is None else level.row[0], scan.stamp_ns)
            if level is not None:
                start = start.compose(Rigid.from_pose(level.row[3:]))
            end = self._end(scan) if level is None else None
            beams = observing_beams(
                scan.ranges,
                scan.range_min,
                scan.range_max,
                longest=min(asked.max_range, LONGEST * asked.resolution),
                clear_to=asked.clear_to,
            )
            origins, ends = placed_beams(beams, self._directions(scan), len(scan.ranges), start, end)
            self.grid.add(origins, ends, beams.hits)
        except MessageError as err:
            self._explain(err, scan)
            self.skip(scan.topic, err)
            return
        self.scans[scan.topic] += 1
        self.tilted += abs(float(start.matrix[2, 2])) < _LEVEL
        self._drive(scan, start)

    def skip(self, topic: str, error: MessageError) -> None:
        """Count a message that is not drawn."""
        if self.options.on_error == "fail":
            raise error
        self.first_error = self.first_error or error
        reason = error.reason if isinstance(error, TransformError) else ""
        key = (topic, reason or error.message)
        if key not in self.skipped and len(self.skipped) >= _MOST_REASONS:
            key = (topic, "other reasons")
        self.skipped[key] += 1

    def _pose(self, frame: str, stamp_ns: int) -> Rigid:
        tolerance_ns = round(self.options.scan.params.transform_tolerance * 1e9)
        return self.buffer.lookup(self.asked.odom_frame, frame, stamp_ns, tolerance_ns)

    def _end(self, scan: Scan) -> Rigid | None:
        """Return the transform at the time of the last beam; None if there is none."""
        try:
            lasts_ns = last_beam_ns(len(scan.ranges), scan.time_increment)
            if lasts_ns and scan.stamp_ns and scan.stamp_ns + lasts_ns > 0:
                return self._pose(scan.frame, scan.stamp_ns + lasts_ns)
        except MessageError:
            self.beams_at_once += 1
        return None

    def _directions(self, scan: Scan) -> NDArray[np.float64]:
        """Return cosines and sines of the beams; those of the previous scan if it has the same beams."""
        key = (len(scan.ranges), scan.angle_min, scan.angle_increment)
        found = self.directions.get(key)
        if found is None:
            angles = beam_angles(*key)
            found = np.stack((np.cos(angles), np.sin(angles)))
            if len(self.directions) >= 4:
                self.directions.clear()
            self.directions[key] = found
        return found

    def _drive(self, scan: Scan, start: Rigid) -> None:
        """Note the position of the robot."""
        if not self.robot:
            known = {frame.removeprefix("/") for frame in self.buffer.frames}
            asked = self.asked.base_frame.removeprefix("/")
            if asked and asked not in known:
                near = did_you_mean(asked, sorted(known))
                there = f"the frames are {name_list(sorted(known))}"
                raise UsageError(f"there is no frame {asked!r} for `base_frame`; {there}", hint=near or None)
            usual = next((frame for frame in BASE_FRAMES if frame in known), "")
            self.robot = asked or usual or scan.frame.removeprefix("/")
        pose = start
        if self.robot != scan.frame.removeprefix("/"):
            try:
                pose = self._pose(self.robot, scan.stamp_ns)
            except TransformError:
                return
        x, y, _ = pose.translation.tolist()
        self.way.append((scan.stamp_ns, x, y))

    def _explain(self, error: MessageError, scan: Scan) -> None:
        """Raise an error with a hint what to type, if the frame of the map does not exist."""
        odom = self.asked.odom_frame.removeprefix("/")
        if not isinstance(error, TransformError) or odom in self.buffer.frames:
            return
        frame = scan.frame.removeprefix("/")
        roots = next((tree.roots for tree in self.buffer.trees if frame in tree.frames), ())
        if roots:
            hint = f"`odom_frame={roots[0]}` draws the map in the root of the frames of {scan.topic}"
        else:
            hint = f"`tf_from` adds transforms; `odom_frame={frame}` draws all scans as if the robot stood still"
        frames = name_list(sorted(self.buffer.frames))
        raise UsageError(
            f"there is no frame {odom!r} to draw a map in; "
            + (f"the frames are {frames}" if self.buffer.frames else "the recording has no transforms"),
            hint=hint,
        )

    def result(self, notes: Sequence[str], damage: tuple[Damage, ...], *, converted: bool) -> Map:
        """Return the map.

        Raises
        ------
        ResultError
            If the map is empty.
        """
        if not self.scans:
            why = f": {self.first_error.message}" if self.first_error else ", there are none"
            raise ResultError(
                f"no scan can be placed in {self.asked.odom_frame}{why}",
                topic=None if self.first_error is None else self.first_error.topic,
                hint=None if self.first_error is None else self.first_error.hint,
            )
        occupancy = self.grid.occupancy()
        if occupancy is None:
            scans = counted(self.scans.total(), "scan")
            hint = "pc2scan view shows which points `min_height` and `max_height` reject" if converted else None
            raise ResultError(f"no return in {scans}: there is nothing to draw", hint=hint)
        further = list(notes)
        if self.tilted:
            further.append(
                f"{_scans_are(self.tilted)} tilted by more than 5 deg against {self.asked.odom_frame}; "
                "the map is a view from above"
            )
        # One such scan is no warning: the last scan of a recording usually ends after the last transform.
        if self.beams_at_once > max(1, 0.01 * self.scans.total()):
            further.append(
                f"{_scans_are(self.beams_at_once)} placed at the stamp only: "
                "there is no transform at the time of the last beam"
            )
        way = np.array(sorted(self.way)).reshape(-1, 3)
        stamps = sorted(stamp_ns for stamp_ns, _, _ in self.way) or [0]
        return Map(
            cells=occupancy.cells,
            resolution=occupancy.resolution,
            origin=(occupancy.x, occupancy.y, 0.0),
            frame=self.asked.odom_frame.removeprefix("/"),
            robot_frame=self.robot,
            trajectory=way[:, 1:].astype(np.float64),
            duration=(stamps[-1] - stamps[0]) / 1e9,
            scans=dict(self.scans),
            converted=converted,
            skipped=tuple(NotDrawn(topic, reason, count) for (topic, reason), count in self.skipped.most_common()),
            notes=tuple(further),
            damage=damage,
        )
