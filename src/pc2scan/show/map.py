"""Maps of recordings: scans where the recorded transforms place them. A preview; scans are not matched.

A scan is placed at its own stamp, by the transform from its frame to the odometry's. If it has a ``time_increment``,
and there are transforms up to its last beam, each beam is placed at its own time.
"""

from __future__ import annotations

import shlex
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.advice.odometry import odometry_of
from pc2scan.bags.topics import find_topics, matches
from pc2scan.conversion.frame_checks import frame_that_stays
from pc2scan.core.occupancy import LONGEST, OccupancyGrid, observing_beams, place_beams
from pc2scan.core.params import ProjectionParams
from pc2scan.core.rigid import Rigid
from pc2scan.core.unproject import beam_angles, last_beam_ns
from pc2scan.errors import MessageError, ResultError, TransformError, UsageError, name_list
from pc2scan.files.outputs import files_output
from pc2scan.files.ownership import OutputPath, inputs_of, refuse_overlap
from pc2scan.messages.clouds import CLOUDS, usual_topics
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.progress import Meter
from pc2scan.request.options import TopicRequest
from pc2scan.requests import conversion_of, first_output
from pc2scan.result import Skipped, tell_early
from pc2scan.streams.scans import Scans
from pc2scan.text import counted, did_you_mean
from pc2scan.transforms.lookup_errors import mount_text, named_in_namespace
from pc2scan.transforms.summary import BODIES
from pc2scan.transforms.world_frames import find_body_motion

from .map_result import Map, map_paths
from .recording import open_recording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.bags.reader import Reader
    from pc2scan.options.call import Options
    from pc2scan.progress import Progress
    from pc2scan.request.options import ConvertOptions
    from pc2scan.requests import Warn
    from pc2scan.streams.scans import Scan
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import LevelTransform

#: Cells of a map: 410 m by 410 m at 5 cm. Two bytes each while scans are drawn.
_MAX_CELLS = 64 << 20

#: A robot whose way is narrower and shorter than this, metres, stands.
_STANDS = 0.01


def draw_map(
    sources: Sequence[Path], options: Options, *, warn: Warn | None = None, progress: Progress | None = None
) -> Map:
    """Draw the scans of a recording, or scans made of its clouds; see `pc2scan.map`.

    Parameters
    ----------
    sources
        Recordings; several are read as one, in time order.
    options
        The options of the call. Its topics decide whether scans or clouds are drawn. Without topics, clouds are drawn
        if there are no scans, or if any option is about the conversion of clouds.
    warn
        Called with each warning as soon as it is known, also if an error follows; the result has all of them.
    progress
        Called regularly; see `pc2scan.progress.Progress`.
    """
    return _draw(sources, first_output(conversion_of(options, warn), "drawn", warn), options, warn, progress)


def write_map(
    sources: Sequence[Path],
    destination: Path | None,
    options: Options,
    *,
    warn: Warn | None = None,
    progress: Progress | None = None,
) -> Map:
    """Draw a map, and write it: its files, or with a name that ends in ``.png`` only the picture; see `draw_map`."""
    if destination is None:
        raise UsageError(
            "no file to write is given", hint="`destination=map.yaml`; or `destination=map.png`, the picture"
        )
    request = first_output(conversion_of(options, warn), "drawn", warn)
    paths = map_paths(destination)
    refuse_overlap(inputs_of(sources, options.tf_from, request.files), [OutputPath(path) for path in paths])
    with files_output(paths, overwrite=options.overwrite) as deliver:
        made = _draw(sources, request, options, warn, progress)
        deliver(made.contents(destination))
    return made


def _draw(
    sources: Sequence[Path], options: ConvertOptions, asked: Options, warn: Warn | None, progress: Progress | None
) -> Map:
    if options.scan.reverse:
        raise UsageError("`reverse` makes clouds, but a map is made of scans")
    warnings = list(options.notes)
    tell = partial(tell_early, warnings, warn)
    frames = (asked.odom_frame, asked.base_frame)
    grid = OccupancyGrid(asked.resolution, _MAX_CELLS)
    with open_recording(sources, options) as recording:
        topics, converted = _topics(recording.reader, options)
        meter = None if progress is None else Meter(progress)
        reading = replace(options, only_scans=True, keep=(), keep_clouds=False) if converted else options
        stream = Scans(sources, reading.with_scan(topics=topics), converted, transform_frames=frames, meter=meter)
        buffer = stream.transforms
        if buffer is None:
            # Recorded scans are read as they are.
            found = recording.transforms(frames, meter)
            buffer = found.buffer
            tell(*found.warnings, *found.notes)
        damage = recording.damage
    if not converted and _converts(options):
        tell("recorded scans are drawn: options about clouds have no effect")
    drawing = _Drawing(grid, buffer, asked, options)
    stream.listener = tell
    with stream, closing(stream.results()) as results:
        for result in results:
            for error in result.errors:
                error.topic = result.topic
                drawing.skip(result.topic, error)
            for scan, level in result.items:
                drawing.add(scan, level)
    made = drawing.result(converted=converted)
    return replace(
        made,
        warnings=tuple(dict.fromkeys((*stream.notes, *warnings, *made.warnings))),
        damage=tuple(dict.fromkeys((*damage, *stream.damage))),
    )


def _converts(options: ConvertOptions) -> bool:
    """Whether any option is about the conversion of clouds."""
    scan = options.scan
    # Recorded scans are placed with the tolerance, too.
    params = replace(scan.params, transform_tolerance=ProjectionParams().transform_tolerance)
    chooses = bool(scan.filters or scan.remove or options.frames.source_frame)
    return params != ProjectionParams() or chooses or scan.deskew or scan.level or scan.may_combine


def _topics(reader: Reader, options: ConvertOptions) -> tuple[tuple[TopicRequest, ...], bool]:
    """Return the topics to draw, and whether scans are made of them."""
    types: dict[str, set[str]] = {}
    for connection in reader.connections:
        types.setdefault(connection.topic, set()).add(connection.ros_type)
    scans = sorted(topic for topic, kinds in types.items() if LASERSCAN in kinds)
    clouds = [topic for topic, kinds in types.items() if not kinds.isdisjoint(CLOUDS)]
    asked = options.scan.topics
    names = [request.source for request in asked]
    if options.scan.may_share:
        return asked, True
    if options.scan.combining.rebin:
        return asked or tuple(map(TopicRequest, scans)), True
    of_scans, of_clouds = (any(matches(topic, names) for topic in kind) for kind in (scans, clouds))
    if of_scans and of_clouds:
        raise UsageError(f"`topics` has scans and clouds: {name_list(names)}", hint="a map is drawn of either")
    if of_clouds or (clouds and not names and (_converts(options) or not scans)):
        return asked or tuple(map(TopicRequest, sorted(usual_topics(types, CLOUDS)))), True
    # Without scans the stream raises an error that lists the topics.
    chosen = [topic for name in names for topic in find_topics(name, types, scans, LASERSCAN)] or scans
    return tuple(map(TopicRequest, dict.fromkeys(chosen))), False


@lru_cache(maxsize=4)
def _directions(beams: int, angle_min: float, angle_increment: float) -> NDArray[np.float64]:
    """Return cosines and sines of a scan's beams."""
    angles = beam_angles(beams, angle_min, angle_increment)
    return np.stack((np.cos(angles), np.sin(angles)))


@dataclass(slots=True)
class _Drawing:
    """Draws scans, and counts them."""

    grid: OccupancyGrid
    buffer: TransformBuffer
    asked: Options
    options: ConvertOptions
    scans: Counter[str] = field(default_factory=Counter)
    skipped: Counter[tuple[str, str]] = field(default_factory=Counter)
    first_error: MessageError | None = None
    #: Stamp, x and y.
    path: list[tuple[int, float, float]] = field(default_factory=list)
    robot: str = ""
    odom: str = field(init=False)

    def __post_init__(self) -> None:
        self.odom = self.asked.odom_frame.removeprefix("/")

    def add(self, scan: Scan, level: LevelTransform | None) -> None:
        """Draw a scan, or count why not; ``level`` is the transform of its frame, if that was made level."""
        try:
            start = self._pose(scan.frame if level is None else level.row[0], scan.stamp_ns)
            end = None
            if level is not None:
                start = start.compose(Rigid.from_pose(level.row[3:]))
            elif scan.time_increment:
                end = self._end(scan)
            longest = LONGEST * self.asked.resolution
            beams = observing_beams(scan.ranges, scan.range_min, scan.range_max, longest=longest)
            count = len(scan.ranges)
            origins, ends = place_beams(
                beams, _directions(count, scan.angle_min, scan.angle_increment), count, start, end
            )
            self.grid.add(origins, ends, beams.hits)
        except MessageError as err:
            if isinstance(err, TransformError) and not self.scans and self.odom not in self.buffer.frames:
                raise self._no_frame(scan) from err
            self.skip(scan.topic, err)
            return
        self.scans[scan.topic] += 1
        self._drive(scan, start)

    def skip(self, topic: str, error: MessageError) -> None:
        """Count a message that is not drawn."""
        if self.options.strict:
            raise error
        self.first_error = self.first_error or error
        reason = error.reason if isinstance(error, TransformError) else ""
        self.skipped[topic, reason or error.message] += 1

    def _pose(self, frame: str, stamp_ns: int) -> Rigid:
        return self.buffer.lookup(self.odom, frame, stamp_ns, self.options.scan.params.tolerance_ns)

    def _end(self, scan: Scan) -> Rigid | None:
        """Return the transform at the time of the last beam; None if there is none."""
        try:
            end_ns = scan.stamp_ns + last_beam_ns(len(scan.ranges), scan.time_increment)
            return self._pose(scan.frame, end_ns) if scan.stamp_ns and end_ns > 0 else None
        except MessageError:
            return None

    def _drive(self, scan: Scan, start: Rigid) -> None:
        """Note the position of the robot."""
        frame = scan.frame.removeprefix("/")
        if not self.robot:
            known = {name.removeprefix("/") for name in self.buffer.frames}
            asked = self.asked.base_frame.removeprefix("/")
            if asked and asked not in known:
                names = sorted(known)
                raise UsageError(
                    f"there is no frame {asked!r} for `base_frame`; the frames are {name_list(names)}",
                    hint=did_you_mean(asked, names) or None,
                )
            self.robot = asked or next((name for name in BODIES if name in known), frame)
        try:
            pose = start if self.robot == frame else self._pose(self.robot, scan.stamp_ns)
        except TransformError:
            return
        x, y, _ = pose.translation.tolist()
        self.path.append((scan.stamp_ns, x, y))

    def _no_frame(self, scan: Scan) -> UsageError:
        """Return the error that the frame of the map does not exist, with a hint what to type."""
        frame, frames = scan.frame.removeprefix("/"), self.buffer.frames
        roots = next((tree.roots for tree in self.buffer.trees if frame in tree.frames), ())
        if namesake := named_in_namespace(self.odom, frames):
            hint = f"`odom_frame={namesake}`"
        elif roots:
            hint = f"`odom_frame={roots[0]}` draws the map in the root of the frames of {scan.topic}"
        elif frames:
            hint = mount_text(frame, frames)
        else:
            hint = f"`tf_from` adds transforms; `odom_frame={frame}` draws all scans as if the robot stood still"
        known = f"the frames are {name_list(sorted(frames))}" if frames else "the recording has no transforms"
        return UsageError(f"there is no frame {self.odom!r} to draw a map in; {known}", hint=hint)

    def result(self, *, converted: bool) -> Map:
        """Return the map.

        Raises
        ------
        ResultError
            If the map is empty.
        """
        if not self.scans:
            if self.first_error is None:
                raise ResultError(f"no scan can be placed in {self.odom}, there are none")
            first = self.first_error
            raise ResultError(
                f"no scan can be placed in {self.odom}: {first.message}", topic=first.topic, hint=first.hint
            )
        occupancy = self.grid.occupancy()
        if occupancy is None:
            hint = "pc2scan view shows which points `min_height` and `max_height` reject" if converted else None
            raise ResultError(
                f"no return in {counted(self.scans.total(), 'scan')}: there is nothing to draw", hint=hint
            )
        path = np.array(sorted(self.path)).reshape(-1, 3)
        stamps = [stamp_ns for stamp_ns, _, _ in self.path] or [0]
        return Map(
            cells=occupancy.cells,
            resolution=occupancy.resolution,
            origin=(occupancy.x, occupancy.y, 0.0),
            frame=self.odom,
            robot_frame=self.robot,
            trajectory=path[:, 1:],
            duration=(max(stamps) - min(stamps)) / 1e9,
            scans=dict(self.scans),
            converted=converted,
            skipped=tuple(
                Skipped(topic, None, None, reason, messages=number)
                for (topic, reason), number in self.skipped.most_common()
            ),
            warnings=tuple(self._doubts(path[:, 1:])),
        )

    def _doubts(self, path: NDArray[np.float64]) -> Iterator[str]:
        """Yield warnings about the frame of the map: the robot stands still in it, or moves the wrong way."""
        if len(path) and (np.ptp(path, axis=0) < _STANDS).all():
            other = frame_that_stays(self.buffer, self.odom)
            moved = find_body_motion(self.buffer, other, self.robot) if other else None
            if moved is not None:
                yield (
                    f"`odom_frame` is {self.odom}, in which {self.robot} does not move: the scans are drawn as if it "
                    f"had stood still; it moves by {moved.metres:.2f} m in {other}: `odom_frame={shlex.quote(other)}`"
                )
        if doubt := odometry_of(self.buffer, self.odom, self.robot).doubt:
            yield doubt
