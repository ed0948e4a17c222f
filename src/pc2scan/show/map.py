"""Maps of recordings: scans where the recorded transforms place them. A preview; scans are not matched.

A scan is placed at its own stamp, by the transform from its frame to the odometry's. If it has a ``time_increment``,
and there are transforms up to its last beam, each beam is placed at its own time.

Sources of the files' rules: map_saver and image_loader of ROS 1's map_server, and map_io of nav2_map_server. Both write
254 for free, 0 for occupied and 205 for unknown cells, the first row of the image being that with the largest y, and
both read a pixel by its darkness, ``(255 - pixel) / 255``: occupied above ``occupied_thresh``, free below
``free_thresh``. 205 is a darkness of 0.19608: unknown with ROS 1's ``free_thresh`` of 0.196, which means the same to
both; with nav2's default of 0.25 unknown cells come back as free (slam_toolbox issue 587).
"""

from __future__ import annotations

import json
import shlex
from collections import Counter
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from pc2scan.advice.odometry import odometry_of
from pc2scan.bags.topics import matches, types_by_topic
from pc2scan.conversion.corrections import corrected_transforms
from pc2scan.conversion.frame_checks import frame_that_stays
from pc2scan.core.occupancy import FREE, LONGEST, OCCUPIED, OccupancyGrid, observing_beams, place_beams
from pc2scan.core.rigid import Rigid
from pc2scan.core.unproject import beam_angles, last_beam_ns
from pc2scan.errors import MessageError, ResultError, TransformError, UsageError, name_list
from pc2scan.files.outputs import files_output, inputs_of, refuse_overlap
from pc2scan.files.paths import path_of, path_or_url
from pc2scan.files.png import png_of
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.options.table import options_about_scans
from pc2scan.parsing import conversion_of, first_output
from pc2scan.progress import Meter
from pc2scan.result import Part, Result, Skipped, tell_early
from pc2scan.streams.stream import Scans
from pc2scan.text import counted, did_you_mean
from pc2scan.transforms.buffer import ADDS_ODOMETRY, other_odometry
from pc2scan.transforms.frames import BODIES
from pc2scan.transforms.motion import find_body_motion

from .shots import damage_of, opened

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.files.paths import PathText
    from pc2scan.options.call import Options
    from pc2scan.parsing import Warn
    from pc2scan.progress import Progress
    from pc2scan.request.spec import Request
    from pc2scan.streams.objects import Scan
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import LevelTransform

#: Cells of a map: 410 m by 410 m at 5 cm. Two bytes each while scans are drawn.
_MAX_CELLS = 64 << 20

#: A robot whose way is narrower and shorter than this, metres, stands.
_STANDS = 0.01

#: What a pixel of the picture is, and its colour.
_UNKNOWN, _FREE, _OCCUPIED, _ROBOT = range(4)
_COLOURS = bytes.fromhex("e2e7ec ffffff 17222e d1495b")

#: Cells of small maps are enlarged, up to the second number, until the longer side of a picture has these pixels.
_SIDE, _LARGEST_CELL = 1600, 12


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Map(Result):
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
        Why scans are not in the map, and how many.
    warnings
        What may be wrong with the map.
    damage
        The damage in the parts of the recording that were read.
    """

    kind: ClassVar[str] = "map"
    json_names: ClassVar[tuple[str, ...]] = (
        *("preview", "frame", "robot_frame", "resolution", "origin", "width", "height", "scans"),
        *("converted", "distance", "skipped", "skipped_count"),
    )

    #: What the map is.
    preview: ClassVar[str] = "by recorded odometry, no SLAM"

    cells: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]
    frame: str
    robot_frame: str
    trajectory: NDArray[np.float64]
    scans: dict[str, int]
    converted: bool
    skipped: tuple[Skipped, ...] = ()
    warnings: tuple[str, ...] = ()
    damage: tuple[Damage, ...] = ()

    @property
    def distance(self) -> float:
        """The length of the robot's path, metres."""
        steps = np.diff(self.trajectory, axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    @property
    def width(self) -> int:
        """Cells along x."""
        return int(self.cells.shape[1])

    @property
    def height(self) -> int:
        """Cells along y."""
        return int(self.cells.shape[0])

    @property
    def png(self) -> bytes:
        """The picture: the map, and where the robot was at each scan."""
        pixels = np.select([self.cells == OCCUPIED, self.cells == FREE], [_OCCUPIED, _FREE], _UNKNOWN).astype(np.uint8)
        places = np.floor((self.trajectory - self.origin[:2]) / self.resolution)
        inside = ((places >= 0) & (places < (self.width, self.height))).all(axis=1)
        pixels[tuple(places[inside].astype(int).T[::-1])] = _ROBOT
        enlarged = max(1, min(_LARGEST_CELL, _SIDE // max(pixels.shape)))
        return png_of(list(pixels[::-1].repeat(enlarged, axis=0).repeat(enlarged, axis=1)), _COLOURS)

    def _repr_png_(self) -> bytes:
        return self.png

    def save(self, destination: str | Path, *, overwrite: bool = False) -> Path:
        """Write the map, as map_server reads it: ``NAME.yaml``, ``NAME.pgm``, and the picture ``NAME.png``.

        With a name that ends in ``.png``, only the picture is written.

        Raises
        ------
        DestinationError, UsageError
            If there is such a file, or the name ends in neither ``.yaml`` nor ``.png``.
        OutputError
            If one cannot be written.
        """
        path = path_of("destination", destination)
        with files_output(_paths(path), overwrite=overwrite) as deliver:
            deliver(self.contents(path))
        return path

    def contents(self, path: Path) -> list[bytes]:
        """Return the contents of the map's files: image, picture and YAML, or of ``NAME.png`` only the picture."""
        image, *others = _paths(path)
        if not others:
            return [self.png]
        pixels = np.select([self.cells == OCCUPIED, self.cells == FREE], [0, 254], 205).astype(np.uint8)
        head = f"P5\n# CREATOR: pc2scan map {self.resolution:.3f} m/pix\n{self.width} {self.height}\n255\n"
        # YAML reads JSON's quotes. A name that is not UTF-8 keeps its bytes.
        text = f"""\
# A preview by recorded odometry, made by pc2scan map. Not a result of SLAM.
image: {json.dumps(image.name, ensure_ascii=False)}
mode: trinary
resolution: {self.resolution!r}
origin: {[round(number, 6) + 0.0 for number in self.origin]}
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
        return [head.encode("ascii") + pixels[::-1].tobytes(), self.png, text.encode("utf-8", "surrogateescape")]

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the size of the map, its scans, and the robot's way."""
        yield (
            f"map: {self.width:,} x {self.height:,} cells of {self.resolution:g} m "
            f"({self.width * self.resolution:.1f} x {self.height * self.resolution:.1f} m)"
        )
        of = ", ".join(f"{count:,} of {topic}" for topic, count in self.scans.items())
        yield f"scans: {of}{' (made of clouds)' if self.converted else ''}"
        yield f"robot: {self.robot_frame} drove {self.distance:.1f} m in {self.frame}"
        yield "This is a preview by the recorded odometry: no SLAM, nothing is matched or corrected."


def _paths(path: Path) -> list[Path]:
    """Return the files of a map: image, picture, and the YAML file; for ``NAME.png`` only the picture."""
    if path.suffix == ".png":
        return [path]
    if path.suffix != ".yaml":
        hint = f"maps are NAME.yaml: `destination={path.stem}.yaml`; a picture is NAME.png"
        raise UsageError("is not the name of a map", path=path, hint=hint)
    return [path.with_suffix(".pgm"), path.with_suffix(".png"), path]


def draw_map(
    sources: Sequence[Path],
    destination: PathText | None,
    options: Options,
    *,
    warn: Warn | None = None,
    progress: Progress | None = None,
) -> Map:
    """Draw the scans of a recording, or scans made of its clouds; see `pc2scan.map`. Write it if it has a destination.

    Parameters
    ----------
    sources
        Recordings; several are read as one, in time order.
    destination
        ``NAME.yaml``, or ``NAME.png`` for only the picture; None: no file is written.
    options
        The options of the call. Its topics decide whether scans or clouds are drawn. Without topics, clouds are drawn
        if there are no scans, or if any option is about the conversion of clouds.
    warn
        Called with each warning as soon as it is known, also if an error follows; the result has all of them.
    progress
        Called regularly; see `pc2scan.progress.Progress`.
    """
    request = first_output(conversion_of(options, warn), "drawn", warn)
    if destination is None:
        return _draw(sources, request, options, warn, progress)
    path = path_or_url(destination)
    paths = _paths(path)
    refuse_overlap(inputs_of(sources, options.tf_from, request.files), paths)
    with files_output(paths, overwrite=options.overwrite) as deliver:
        result = _draw(sources, request, options, warn, progress)
        deliver(result.contents(path))
    return result


def _draw(
    sources: Sequence[Path], request: Request, options: Options, warn: Warn | None, progress: Progress | None
) -> Map:
    warnings = list(request.notes)
    tell = partial(tell_early, warnings, warn)
    frames = (options.odom_frame, options.base_frame)
    grid = OccupancyGrid(options.resolution, _MAX_CELLS)
    # A tolerance is one for recorded scans, too.
    about_clouds = {*options_about_scans(), "source_frame"} - {"topics", "remap", "transform_tolerance"}
    is_about_clouds = not about_clouds.isdisjoint(options.given)
    with opened(sources, request, options, warn) as recording:
        reader = recording.reader
        converted = _converts(reader, request, is_about_clouds=is_about_clouds)
        meter = None if progress is None else Meter(progress)
        reading = replace(request, only_scans=True, keep=(), keep_clouds=False) if converted else request
        stream = Scans(sources, reading, converted, transform_frames=frames, all_topics=True, meter=meter)
        buffer = stream.transforms
        others: Sequence[Reader] = ()
        if buffer is None:
            # Recorded scans are read as they are.
            transforms, others = corrected_transforms(reader, request, recording.stack, frames, meter)
            buffer = transforms.buffer
            tell(*transforms.warnings, *transforms.notes)
        damage = damage_of(reader, *others)
    if is_about_clouds and not converted:
        tell("recorded scans are drawn: options about clouds have no effect")
    drawing = _Drawing(grid, buffer, options, request)
    stream.listener = tell
    with stream, closing(stream.results()) as results:
        for item in results:
            for error in item.errors:
                drawing.skip(item.route.connection.topic, error)
            for scan, level in stream.objects(item):
                drawing.add(scan, level)
    return drawing.result((*stream.notes, *warnings), (*damage, *stream.damage), converted=converted)


def _converts(reader: Reader, request: Request, *, is_about_clouds: bool) -> bool:
    """Whether scans are made of clouds, or of scans in another geometry; otherwise scans are drawn as they are."""
    types = types_by_topic(reader.connections)
    scans = [topic for topic, kinds in types.items() if LASERSCAN in kinds]
    clouds = [topic for topic, kinds in types.items() if not kinds.isdisjoint(CLOUDS)]
    names = [topic.source for topic in request.scan.topics]
    if request.scan.may_share or request.scan.combining.rebin:
        return True
    of_scans, of_clouds = (any(matches(topic, names) for topic in kind) for kind in (scans, clouds))
    if of_scans and of_clouds:
        raise UsageError(f"`topics` has scans and clouds: {name_list(names)}", hint="a map is drawn of either")
    return of_clouds or bool(clouds and not names and (is_about_clouds or not scans))


class _Drawing:
    """Draws scans, and counts them."""

    def __init__(self, grid: OccupancyGrid, buffer: TransformBuffer, options: Options, request: Request) -> None:
        self._grid, self._buffer, self._request = grid, buffer, request
        self._longest = LONGEST * options.resolution
        self._odom, self._robot = (name.removeprefix("/") for name in (options.odom_frame, options.base_frame))
        self._scans, self._skipped = Counter[str](), Counter[tuple[str, str]]()
        self._first_error = MessageError("there are none")
        #: Stamp, x and y.
        self._path: list[tuple[int, float, float]] = []
        if self._robot and self._robot not in (names := sorted(name.removeprefix("/") for name in buffer.frames)):
            text = f"there is no frame {self._robot!r} for `base_frame`; the frames are {name_list(names)}"
            raise UsageError(text, hint=did_you_mean(self._robot, names) or None)
        self._robot = self._robot or next((name for name in BODIES if name in buffer.frames), "")

    def add(self, scan: Scan, level: LevelTransform | None) -> None:
        """Draw a scan, or count why not; ``level`` is the transform of its frame, if that was made level."""
        try:
            start = self._pose(scan.frame if level is None else level.row[0], scan.stamp_ns)
            end = None
            if level is not None:
                start = start.compose(Rigid.from_pose(level.row[3:]))
            elif scan.time_increment and scan.stamp_ns:
                # Without a transform at the time of the last beam, all are placed at the stamp.
                with suppress(MessageError):
                    end_ns = scan.stamp_ns + last_beam_ns(len(scan.ranges), scan.time_increment)
                    end = self._pose(scan.frame, end_ns) if end_ns > 0 else None
            beams = observing_beams(scan.ranges, scan.range_min, scan.range_max, longest=self._longest)
            count = len(scan.ranges)
            angles = beam_angles(count, scan.angle_min, scan.angle_increment)
            origins, ends = place_beams(beams, np.stack((np.cos(angles), np.sin(angles))), count, start, end)
            self._grid.add(origins, ends, beams.hits)
        except MessageError as err:
            if isinstance(err, TransformError) and not self._scans and self._odom not in self._buffer.frames:
                raise self._no_frame(scan.frame.removeprefix("/")) from err
            self.skip(scan.topic, err)
            return
        self._scans[scan.topic] += 1
        self._robot = self._robot or scan.frame.removeprefix("/")
        with suppress(TransformError):
            x, y, _ = self._pose(self._robot, scan.stamp_ns).translation.tolist()
            self._path.append((scan.stamp_ns, x, y))

    def skip(self, topic: str, error: MessageError) -> None:
        """Count a message that is not drawn."""
        error.topic = topic
        if self._request.strict:
            raise error
        if not self._skipped:
            self._first_error = error
        self._skipped[topic, error.reason or error.message] += 1

    def _pose(self, frame: str, stamp_ns: int) -> Rigid:
        return self._buffer.lookup(self._odom, frame, stamp_ns, self._request.scan.params.tolerance_ns)

    def _no_frame(self, frame: str) -> UsageError:
        """Return the error that the frame of the map does not exist, with a hint what to type."""
        frames, other = self._buffer.frames, other_odometry(self._buffer, self._odom)
        hint = f"`odom_frame={other}` draws the map in that frame"
        if not other:
            hint = f"{ADDS_ODOMETRY}; `odom_frame={frame}` draws all scans as if the robot stood still"
        known = f"the frames are {name_list(sorted(frames))}" if frames else "the recording has no transforms"
        return UsageError(f"there is no frame {self._odom!r} to draw a map in; {known}", hint=hint)

    def result(self, warnings: Iterable[str], damage: Iterable[Damage], *, converted: bool) -> Map:
        """Return the map, with these warnings and its own.

        Raises
        ------
        ResultError
            If the map is empty.
        """
        if not self._scans:
            first = self._first_error
            text = f"no scan can be placed in {self._odom}: {first.message}"
            raise ResultError(text, topic=first.topic, hint=first.hint)
        occupancy = self._grid.occupancy()
        if occupancy is None:
            hint = "pc2scan view shows which points `min_height` and `max_height` reject" if converted else None
            text = f"no return in {counted(self._scans.total(), 'scan')}: there is nothing to draw"
            raise ResultError(text, hint=hint)
        path = np.array(sorted(self._path)).reshape(-1, 3)[:, 1:]
        skipped = tuple(
            Skipped(topic, None, None, reason, messages=number)
            for (topic, reason), number in self._skipped.most_common()
        )
        texts, places = dict.fromkeys((*warnings, *self._doubts(path))), dict.fromkeys(damage)
        origin, scans = (occupancy.x, occupancy.y, 0.0), dict(self._scans)
        drawn = occupancy.cells, occupancy.resolution, origin, self._odom, self._robot, path, scans, converted
        return Map(*drawn, skipped, tuple(texts), tuple(places))

    def _doubts(self, path: NDArray[np.float64]) -> Iterator[str]:
        """Yield warnings about the frame of the map: the robot stands still in it, or moves the wrong way."""
        if len(path) and (np.ptp(path, axis=0) < _STANDS).all():
            other = frame_that_stays(self._buffer, self._odom)
            moved = find_body_motion(self._buffer, other, self._robot) if other else None
            if moved is not None:
                drawn = f"{self._robot} does not move: the scans are drawn as if it had stood still"
                motion = f"it moves by {moved.metres:.2f} m in {other}: `odom_frame={shlex.quote(other)}`"
                yield f"`odom_frame` is {self._odom}, in which {drawn}; {motion}"
        if doubt := odometry_of(self._buffer, self._odom, self._robot).doubt:
            yield doubt
