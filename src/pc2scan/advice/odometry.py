"""Judges whether the transforms to a fixed frame fit the clouds that are placed through it.

Which way round they are is judged by the robot's way, before the first cloud. Whether they fit the clouds is judged by
samples of those that are converted: what is seen in the seconds of the strongest motion must not be sharper by the
poses of another time, or by smoother ones.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.core.percentiles import median
from pc2scan.core.scene import GOLDEN, JUDGED_CLOUDS, find_ground
from pc2scan.core.sharpness import Window, busiest, spread
from pc2scan.errors import DecodeError, TransformError
from pc2scan.request.point_time import PointTime
from pc2scan.text import counted
from pc2scan.transforms.motion import spread_of_up

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.points import Points
    from pc2scan.core.rigid import Rigid
    from pc2scan.request.point_time import Times
    from pc2scan.request.spec import ScanSpec
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.frames import FrameHistory

#: A robot on wheels moves along its own x axis: less than the first share of its way is sideways. Poses of which more
#: than the second one is, and whose inverses move along x, are inverted. Nothing is known of a shorter way, metres, and
#: nothing of sideways if the robot turns by less, radians. The poses that are compared are nanoseconds apart.
_AHEAD, _SIDEWAYS = 0.1, 0.25
_LEAST_WAY, _LEAST_TURN = 1.0, 1.0
_STEP_NS = 200_000_000
#: Poses that are farther apart than this many steps are not compared.
_LONGEST_STEP = 3

#: A robot whose roll and pitch vary by more than this tilts, radians.
_TILTS = math.radians(1.0)

#: The windows in which surroundings are sampled, and the points of each cloud, of each topic in a window, and in all
#: windows that are needed.
_WINDOW_NS = 1_000_000_000
_WINDOWS = 3
_OF_CLOUD = 400
_OF_WINDOW = 3_000
_FEWEST = 300
_MOST_CLOUDS = 2_000

#: The places of the points of a cloud, as shares of all: spread evenly, following no ring and no column.
_EVENLY = np.arange(_OF_CLOUD) * GOLDEN % 1.0

#: The least share of points that has poses in both cases; the nearest and the farthest points, metres.
_KNOWN = 0.8
_NEAREST, _FARTHEST = 0.1, 1000.0

#: How far times are shifted, seconds: first these, then every hundredth from two on, if one of the first is a little
#: sharper; and the distance of poses that are interpolated, nanoseconds.
_FIRST_SHIFTS = (0.03, 0.1, 0.25)
_SHIFTS = np.arange(0.02, 0.315, 0.01).round(2).tolist()
_A_LITTLE = 1.02
_NODE_NS = 5_000_000

_IF_TURNED_OVER = (
    "times as sharp if the lidar is turned over: when the robot turns, they turn the wrong way; is it upside down "
    "against its transform? `static_tf` says how it is mounted"
)

#: Poses that jitter are compared with their means over so many seconds.
_SMOOTH = 0.1

#: Surroundings are sharper if they are spread over fewer cells by this factor, and in no window over more by the other.
_SHARPER = 1.1
_NOT_LESS = 0.97

#: Points are of walls if their column of this width is at least this high, metres: those of floors and ceilings move
#: with the robot.
_COLUMN, _TALL = 0.3, 0.4


class Odometry(NamedTuple):
    """What moves a robot in a fixed frame.

    Attributes
    ----------
    links
        The transforms between the two frames that move, first the one that carries the robot; empty if nothing moves.
    doubt
        What may place the robot wrongly, and what to do; empty if nothing does.
    fault
        What is wrong for programs that read the transforms; empty if nothing is.
    """

    links: Sequence[FrameHistory] = ()
    doubt: str = ""
    fault: str = ""


#: What to do if transforms are the wrong way round.
OTHER_ODOMETRY = "`odom_topic=/odom` uses the poses of a topic instead"


def odometry_of(buffer: TransformBuffer, fixed: str, source: str) -> Odometry:
    """Return what moves the robot in a fixed frame, and which way round.

    Parameters
    ----------
    buffer
        The transforms: all, or those of some times.
    source
        The robot's frame, or another one that is fixed to it.

    Notes
    -----
    The inverses of a robot's poses move it along no line of its own, unless it drives along one circle: then backwards,
    which tells something only if the frames are the other way round, too.
    """
    links = sorted(
        buffer.moving_links(fixed, source),
        key=lambda link: float(link.extent @ (1, 1, 1, 10, 10, 10, 10)),
        reverse=True,
    )
    if not links:
        return Odometry()
    parent, child = buffer.frames[links[0].parent_at(None)], buffer.frames[links[0].child]
    is_below = len(links) == 1 and child == fixed.removeprefix("/")
    way, is_sound = _way(links[0], is_below=is_below)
    text = f"{child} is below {parent} in the transforms, and REP 105 has it above" if is_below else ""
    if way:
        why = "the two frames are swapped" if is_below else "the poses are inverted"
        text = (
            f"by the transforms from {parent} to {child} the robot drives {way}, by their inverses straight ahead: "
            f"{why}"
        )
    elif is_below and not is_sound:
        text += ": if the poses are not inverted, too, the robot moves the wrong way"
    doubt = f"{text}; {OTHER_ODOMETRY}" if text and not is_sound else ""
    if is_below:
        text += (
            f"; programs that localise the robot publish the transform from map to {child}, which then has two parents"
        )
    return Odometry(links, doubt, text)


def _way(body: FrameHistory, *, is_below: bool) -> tuple[str, bool]:
    """Return how a robot drives if it drives straight ahead by the inverse poses, and whether it does by the poses."""
    stamps_ns = body.stamps_ns
    intervals = np.diff(stamps_ns)
    apart_ns = max(1, int(median(intervals))) if intervals.size else _STEP_NS
    every = max(1, _STEP_NS // apart_ns)
    x, y, _, a, b, c, d = body.poses[::every].T
    yaw = np.arctan2(2 * (d * c + a * b), 1 - 2 * (b * b + c * c))
    turned = np.remainder(np.diff(yaw) + math.pi, math.tau) - math.pi
    turns = np.ptp(np.append(0.0, np.cumsum(turned))) >= _LEAST_TURN
    # From one second with transforms to the next, nobody knows the way.
    known = np.diff(stamps_ns[::every]) <= _LONGEST_STEP * max(_STEP_NS, apart_ns)
    # Of the poses, and of their inverses: the shares of the way that are ahead, less those that are back, and sideways.
    ahead, beside = [], []
    for sign in (1, -1):
        # A chord of a circle has the direction of its middle.
        steps = ((np.diff(x) + 1j * np.diff(y)) * np.exp(-1j * sign * (yaw[:-1] + turned / 2)))[known]
        way = float((np.abs(steps.real) + np.abs(steps.imag)).sum())
        if way < _LEAST_WAY:
            return "", False
        ahead.append(float(steps.real.sum()) / way)
        beside.append(float(np.abs(steps.imag).sum()) / way)
        inverse = -(x + 1j * y) * np.exp(-1j * yaw)
        x, y = inverse.real, inverse.imag
    if is_below:
        ahead.reverse()
        beside.reverse()
    drives = ""
    if turns and beside[0] >= _SIDEWAYS and beside[1] <= _AHEAD:
        drives = "sideways"
    elif is_below and -ahead[0] >= 1 - _AHEAD and ahead[1] >= 1 - _AHEAD:
        drives = "backwards"
    is_sound = ahead[0] >= 1 - _AHEAD or (turns and beside[0] <= _AHEAD and beside[1] >= _SIDEWAYS)
    return drives, bool(is_sound)


class _Cloud(NamedTuple):
    """Some points of a cloud, (N, 3), in its own frame, and their times, seconds after the window's begin."""

    stamp_ns: int
    frame_id: str
    points: NDArray[np.float64]
    seconds: NDArray[np.float64]


class _Seen(NamedTuple):
    """What a topic shows in a window.

    Attributes
    ----------
    times, rows
        The poses of its sensor: seconds after the window's begin, and fixed_from_source as rows of twelve numbers.
    points, seconds
        (N, 3) points in the sensor's frame, and (N,) times of each.
    here
        The points in the fixed frame.
    """

    times: NDArray[np.float64]
    rows: NDArray[np.float64]
    points: NDArray[np.float64]
    seconds: NDArray[np.float64]
    here: NDArray[np.float64] = np.empty((0, 3))

    def of_walls(self) -> _Seen:
        """Return what is seen of walls, and where it is in the fixed frame."""
        here = self.placed()
        # What one ring shows is nearly all walls.
        walls = _are_walls(here) if np.ptp(self.points[:, 2]) > _TALL else np.isfinite(here[:, 2])
        return self._replace(points=self.points[walls], seconds=self.seconds[walls], here=here[walls])

    def smoothed(self) -> _Seen:
        """Return the same points with poses that are the means of some time."""
        width = round(_SMOOTH * 1e9 / _NODE_NS)
        sums = np.cumsum(np.pad(self.rows, ((1, 0), (0, 0))), axis=0)
        times = np.lib.stride_tricks.sliding_window_view(self.times, width).mean(axis=1)
        return self._replace(times=times, rows=(sums[width:] - sums[:-width]) / width)

    def placed(self, later: float = 0.0) -> NDArray[np.float64]:
        """Return the points in the fixed frame by the poses of so many seconds later, (N, 3); NaN without a pose."""
        rows = self._poses(self.seconds + later)
        placed: NDArray[np.float64] = np.einsum("nij,nj->ni", rows[:, :9].reshape(-1, 3, 3), self.points)
        return placed + rows[:, 9:]

    def moved(self, later: float) -> NDArray[np.float64]:
        """Return `placed`, moved as a whole so that the sensor stays in place in the middle of the points' times.

        Motion that is even is the same at all times: other ones only move all that is seen, which shows nothing.
        """
        (rotation, place), (later_rotation, later_place) = self._middle(0.0), self._middle(later)
        moved: NDArray[np.float64] = (self.placed(later) - later_place) @ later_rotation @ rotation.T + place
        return moved

    def turned_over(self) -> NDArray[np.float64]:
        """Return the points in the fixed frame if the sensor is turned over about its x axis, or y if x is upright.

        The world is turned, too, so that what is seen from the first pose stays in place: only how the sensor turns
        from there makes a difference.
        """
        row = self._poses(self.seconds[:1])[0]
        rotation, place = row[:9].reshape(3, 3), row[9:]
        ahead = np.append(next(axis for axis in rotation[:2].T if axis @ axis > 0.25), 0.0)
        turn = 2 * np.outer(ahead, ahead) / (ahead @ ahead) - np.eye(3)
        own = rotation.T @ turn @ rotation
        turned: NDArray[np.float64] = (self._replace(points=self.points @ own.T).placed() - place) @ turn.T + place
        return turned

    def _middle(self, later: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the pose in the middle of the points' times, so many seconds later: rotation and translation."""
        row = self._poses(np.array([(self.seconds.min() + self.seconds.max()) / 2 + later]))[0]
        return row[:9].reshape(3, 3), row[9:]

    def _poses(self, seconds: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the poses at some times, as rows; NaN without one."""
        newer = np.clip(self.times.searchsorted(seconds), 1, len(self.times) - 1)
        share = (seconds - self.times[newer - 1]) / (self.times[newer] - self.times[newer - 1])
        rows = self.rows[newer - 1] + share[:, None] * (self.rows[newer] - self.rows[newer - 1])
        rows[(share < 0) | (share > 1)] = np.nan
        return rows


class Surroundings:
    """What lidars see in the seconds in which the robot moves most, to judge whether the transforms fit.

    Parameters
    ----------
    spec
        The request.
    buffer
        The recording's transforms.
    odometry
        What moves the robot in the fixed frame.
    source_frame
        Replaces the clouds' frames; empty if nothing does.
    span
        The time of the recording, from and to, nanoseconds.
    together
        The topics that become one scan, the leading one first; empty if each becomes scans by itself.
    """

    def __init__(
        self,
        spec: ScanSpec,
        buffer: TransformBuffer,
        odometry: Odometry,
        source_frame: str,
        span: tuple[int, int],
        together: Sequence[str] = (),
    ) -> None:
        self._spec = spec
        self._buffer = buffer
        self._source_frame = source_frame
        self._together = together
        self._clouds: dict[tuple[str, Window], list[_Cloud]] = {}
        body = odometry.links[0]
        self._windows = busiest(body.stamps_ns, body.poses, Window(*span), _WINDOW_NS, _WINDOWS)

    def add(self, topic: str, points: Points, seconds: Times | None = None) -> None:
        """Add a sample of a cloud, if it is of one of the windows. On any thread.

        Parameters
        ----------
        seconds
            Returns the times of the points. None: those that a cloud has in one of the fields `TIME_FIELDS`; a cloud
            without is not sampled.
        """
        window = next((window for window in self._windows if window.begin_ns <= points.stamp_ns < window.end_ns), None)
        x, y, z = points.xyz()
        if window is None or not x.size:
            return
        try:
            seconds = seconds or PointTime().read(points).at
        except DecodeError:
            return
        places = np.unravel_index((_EVENLY * x.size).astype(np.intp), x.shape)
        with np.errstate(all="ignore"):
            sample = np.stack([np.asarray(part[places], np.float64) for part in (x, y, z)], axis=1)
            times = seconds(places)
            squares = np.einsum("ni,ni->n", sample, sample)
            good = np.isfinite(times) & (squares > _NEAREST**2) & (squares < _FARTHEST**2)
        clouds = self._clouds.setdefault((topic, window), [])
        if good.any() and len(clouds) < _MOST_CLOUDS:
            times += (points.stamp_ns - window.begin_ns) / 1e9
            clouds.append(_Cloud(points.stamp_ns, self._source_frame or points.frame_id, sample[good], times[good]))

    @np.errstate(all="ignore")
    def warnings(self) -> Iterator[str]:
        """Yield warnings about transforms, or times, that do not fit the clouds."""
        topics = self._together or sorted({topic for topic, _ in self._clouds})
        seen = {
            topic: {window: each for window in self._windows if (each := self._seen_in(topic, window)) is not None}
            for topic in topics
        }
        for topic, windows in seen.items():
            if topic not in self._together[1:]:
                yield from self._doubts(topic, list(windows.values()))
        for other in self._together[1:]:
            lead = self._together[0]
            pairs = [(seen[lead][window], mine) for window, mine in seen[other].items() if window in seen[lead]]
            yield from _clock_doubts(lead, other, pairs)

    def _seen_in(self, topic: str, window: Window) -> _Seen | None:
        """Return what a topic shows of walls in a window; None if that is too little."""
        clouds = sorted(self._clouds.get((topic, window), ()), key=lambda cloud: cloud.stamp_ns)
        own = [cloud for cloud in clouds if cloud.frame_id == clouds[0].frame_id]
        reach_ns = round((_SHIFTS[-1] + 0.2) * 1e9)
        begin_ns, end_ns = window.begin_ns - reach_ns, window.end_ns + reach_ns
        if not own:
            return None
        try:
            stamps_ns, rows, _ = self._buffer.rows(
                self._spec.fixed_frame, own[0].frame_id, begin_ns, end_ns, _NODE_NS, lambda *_: _NODE_NS
            )
        except TransformError:
            return None
        points, seconds = np.concatenate([part.points for part in own]), np.concatenate([part.seconds for part in own])
        some = slice(None, None, 1 + len(points) // _OF_WINDOW)
        seen = _Seen((stamps_ns - window.begin_ns) / 1e9, rows[::2], points[some], seconds[some]).of_walls()
        return seen if len(seen.points) >= _FEWEST else None

    def _doubts(self, topic: str, windows: Sequence[_Seen]) -> Iterator[str]:
        """Yield a warning if other times, or other poses, of the points of a topic fit better."""

        def gain(changed: Callable[[_Seen], NDArray[np.float64]]) -> float:
            return _gain((window.here, changed(window)) for window in windows)

        sharper, shift = _best_shift(lambda seconds: gain(lambda window: window.moved(seconds)))
        seen = f"{topic}: in {counted(len(windows), 'second')} of the strongest motion, surroundings are"
        turned = gain(_Seen.turned_over)
        if turned > max(sharper, _SHARPER):
            yield f"{seen} {turned:.2g} {_IF_TURNED_OVER}"
        elif shift:
            yield (
                f"{seen} {sharper:.2g} times as sharp with the transforms to {self._spec.fixed_frame} of "
                f"{1000 * abs(shift):.0f} ms {'later' if shift > 0 else 'earlier'}: the odometry "
                f"{'lags' if shift > 0 else 'is ahead'}, or its clock is another one; `time_offset={shift:.2f}s` "
                "corrects the clouds' stamps"
            )
        elif self._spec.deskew and (smooth := gain(lambda window: window.smoothed().placed())) >= _SHARPER:
            yield (
                f"{seen} {smooth:.2g} times as sharp by poses that are smoothed over {_SMOOTH} s: the "
                f"transforms to {self._spec.fixed_frame} jitter; a smoother `fixed_frame` deskews better, or none"
            )


def _clock_doubts(lead: str, other: str, pairs: Sequence[tuple[_Seen, _Seen]]) -> Iterator[str]:
    """Yield a warning if two topics fit each other better with a difference of their clocks."""

    def gain(seconds: float) -> float:
        ways = ((first.here, second.here, second.placed(seconds)) for first, second in pairs)
        return _gain((np.concatenate([both, here]), np.concatenate([both, shifted])) for both, here, shifted in ways)

    sharper, shift = _best_shift(gain)
    if shift:
        yield (
            f"{lead} and {other}: in {counted(len(pairs), 'second')} of the strongest motion, what both see fits "
            f"better ({sharper:.2g} times as sharp) if {other} was measured {1000 * abs(shift):.0f} ms "
            f"{'later' if shift > 0 else 'earlier'} than its stamps say: the clocks of the two lidars differ; "
            f"`time_offset={other}={shift:.2f}s` corrects them"
        )


def turns_upright(clouds: Sequence[tuple[Rigid, NDArray[np.floating[Any]]]]) -> float:
    """Return 1 if what a lidar sees from several places is sharper than with the lidar turned over.

    -1 if it is less sharp; 0 if nothing tells.

    Parameters
    ----------
    clouds
        The transform to a frame that does not move of each cloud, and its points, (N, 3), in the frame of the lidar.
    """
    some = [points[:: 1 + len(points) // _OF_WINDOW] for _, points in clouds]
    if len(clouds) < 2:
        return 0.0
    times = np.arange(float(len(clouds)))
    rows = np.array([[*rigid.matrix.ravel(), *rigid.translation] for rigid, _ in clouds])
    seen = _Seen(times, rows, np.concatenate(some), np.repeat(times, [len(points) for points in some])).of_walls()
    if len(seen.points) < _FEWEST:
        return 0.0
    sharper = spread(seen.turned_over()[:, :2]) / spread(seen.here[:, :2])
    return float(sharper > _SHARPER) - float(sharper < 1 / _SHARPER)


def floor_tilt(clouds: Iterable[NDArray[np.float64]]) -> float | None:
    """Return how far the floor is tilted from its mean, radians, in nine of ten clouds at most; None if few show it.

    Parameters
    ----------
    clouds
        The results of `thin_points`, relative to the sensor, along axes of which z points up.
    """
    ups = [ground.up for ground in map(find_ground, clouds) if ground.kind == "level" and ground.up]
    return spread_of_up(np.array(ups)) if len(ups) >= JUDGED_CLOUDS else None


def tilts(radians: float, of_floor: Callable[[], float | None], felt: float = 0.0) -> bool:
    """Return whether a robot tilts by as much as odometry, or an IMU, says.

    Parameters
    ----------
    radians
        How much that is.
    of_floor
        Returns `floor_tilt`, where it matters: a robot that drives on a slope does not tilt against it.
    felt
        What an IMU feels in curves, radians, which is no tilt.
    """
    return radians > _TILTS and (radians > _TILTS + felt if (floor := of_floor()) is None else floor >= radians / 2)


def _are_walls(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points are in a column that has points of several heights, (N,)."""
    cells = np.floor(np.nan_to_num(points[:, :2]) / _COLUMN).astype(np.int64)
    _, columns = np.unique(cells[:, 0] << 32 ^ (cells[:, 1] & 0xFFFFFFFF), return_inverse=True)
    low, high = np.full(len(points), np.inf), np.full(len(points), -np.inf)
    np.fmin.at(low, columns, points[:, 2])
    np.fmax.at(high, columns, points[:, 2])
    return np.asarray(((high - low)[columns] >= _TALL) & np.isfinite(points[:, 2]))


def _gain(windows: Iterable[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> float:
    """Return how many times as sharp surroundings are in another way; 0 if they are not, in one of the windows.

    Parameters
    ----------
    windows
        Where the points of each are, and where they are otherwise.
    """
    logarithms, weights = 0.0, 0.0
    for here, otherwise in windows:
        known = np.isfinite(otherwise[:, 0])
        if known.mean() < _KNOWN:
            continue
        now, then = spread(here[known, :2]), spread(otherwise[known, :2])
        if not then or now / then < _NOT_LESS:
            return 0.0
        logarithms += math.log(now / then) * len(otherwise)
        weights += len(otherwise)
    return math.exp(logarithms / weights) if weights else 0.0


def _best_shift(gain: Callable[[float], float]) -> tuple[float, float]:
    """Return by how much another time is sharper at most, and how many seconds later it is; 0 if it is not worth it."""
    best = max((gain(sign * shift), sign * shift) for shift in _FIRST_SHIFTS for sign in (1, -1))
    if best[0] >= _A_LITTLE:
        best = max(best, *((gain(sign * shift), sign * shift) for shift in _SHIFTS for sign in (1, -1)))
    return best if best[0] >= _SHARPER else (best[0], 0.0)
