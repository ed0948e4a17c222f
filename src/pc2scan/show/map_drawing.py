"""Draws scans into a map, as its options say.

A scan is placed at its own stamp, by the transform from its frame to the odometry's. If it has a ``time_increment``,
and there are transforms up to its last beam, each beam is placed at its own time.
"""

from __future__ import annotations

import math
import shlex
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.advice.odometry import odometry_of
from pc2scan.conversion.frame_checks import frame_that_stays
from pc2scan.core.occupancy import LONGEST, OccupancyGrid, observing_beams, place_beams
from pc2scan.core.rigid import Rigid
from pc2scan.core.unproject import beam_angles, last_beam_ns
from pc2scan.errors import MessageError, ResultError, TransformError, UsageError, name_list
from pc2scan.result import Skipped
from pc2scan.text import counted, did_you_mean
from pc2scan.transforms.lookup_errors import mount_text, named_in_namespace
from pc2scan.transforms.summary import BODIES
from pc2scan.transforms.world_frames import find_body_motion

from .map_result import Map

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from pc2scan.bags.damage import Damage
    from pc2scan.options.call import Options
    from pc2scan.request.options import ConvertOptions
    from pc2scan.streams.scans import Scan
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import LevelTransform

#: A scan is tilted if the cosine between its z axis and the map's is below this: 5 degrees.
_LEVEL = math.cos(math.radians(5))

#: A robot whose way is narrower and shorter than this, metres, stands.
_STANDS = 0.01

#: How many reasons for skipping are distinguished.
_MOST_REASONS = 100

#: Limits of the side of a cell, metres: smaller cells are finer than any lidar measures, larger ones show nothing.
_FINEST, _COARSEST = 0.001, 1.0


@dataclass(slots=True)
class Drawing:
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
                longest=LONGEST * asked.resolution,
            )
            origins, ends = place_beams(beams, self._directions(scan), len(scan.ranges), start, end)
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
        if self.options.strict:
            raise error
        self.first_error = self.first_error or error
        reason = error.reason if isinstance(error, TransformError) else ""
        key = (topic, reason or error.message)
        if key not in self.skipped and len(self.skipped) >= _MOST_REASONS:
            key = (topic, "other reasons")
        self.skipped[key] += 1

    def _pose(self, frame: str, stamp_ns: int) -> Rigid:
        return self.buffer.lookup(self.asked.odom_frame, frame, stamp_ns, self.options.scan.params.tolerance_ns)

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
            usual = next((frame for frame in BODIES if frame in known), "")
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
        if namesake := named_in_namespace(odom, self.buffer.frames):
            hint = f"`odom_frame={namesake}`"
        elif self.scans:
            drawn = " ".join(f"`topics={topic}`" for topic in self.scans)
            hint = f"{drawn} draws what can be placed; {mount_text(frame, self.buffer.frames, odom)}"
        elif roots:
            hint = f"`odom_frame={roots[0]}` draws the map in the root of the frames of {scan.topic}"
        elif self.buffer.frames:
            hint = mount_text(frame, self.buffer.frames)
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
        further += self._odometry_doubts(way[:, 1:])
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
            skipped=tuple(
                Skipped(topic, None, None, reason, messages=number)
                for (topic, reason), number in self.skipped.most_common()
            ),
            warnings=tuple(further),
            damage=damage,
        )

    def _odometry_doubts(self, way: NDArray[np.float64]) -> Iterator[str]:
        """Yield warnings about the frame of the map: the robot stands still in it, or moves the wrong way."""
        odom = self.asked.odom_frame.removeprefix("/")
        if len(way) and (np.ptp(way, axis=0) < _STANDS).all():
            other = frame_that_stays(self.buffer, odom)
            moved = find_body_motion(self.buffer, other, self.robot) if other else None
            if moved is not None:
                yield (
                    f"`odom_frame` is {odom}, in which {self.robot} does not move: the scans are drawn as if it had "
                    f"stood still; it moves by {moved.metres:.2f} m in {other}: `odom_frame={shlex.quote(other)}`"
                )
        if doubt := odometry_of(self.buffer, odom, self.robot).doubt:
            yield doubt


def _scans_are(number: int) -> str:
    return f"{counted(number, 'scan', 'are')}"


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

    Raises
    ------
    UsageError
        If a number is not allowed.
    """

    odom_frame: str = "odom"
    base_frame: str = ""
    resolution: float = 0.05

    @classmethod
    def of(cls, options: Options) -> MapOptions:
        """Return the options of a map among those of a call."""
        return cls(**{name: getattr(options, name) for name in cls.__dataclass_fields__})

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
        if not self.odom_frame.removeprefix("/"):
            raise UsageError("`odom_frame` is empty", hint="pc2scan tf shows the frames of a recording")
