"""Deskewing: moves each point to where it was at its own time, as seen at the scan's time.

Source of the rule: tf2's lookup with two times, ``lookupTransform(target, target_time, source, source_time, fixed)``. A
point is transformed from its own frame to a frame that does not move, at the point's time, and from there to the target
frame, at the scan's time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core import kernel
from pc2scan.core.points import TIME, Points
from pc2scan.core.rigid import MovingTransform
from pc2scan.core.rule import NO_TIME, NO_TRANSFORM
from pc2scan.core.timing import AZIMUTH, IN_SECONDS, LONGEST, TIME_FIELDS, TIME_UNITS
from pc2scan.errors import DecodeError, TransformError
from pc2scan.request.point_time import BY_AZIMUTH, PointTime, directions_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pc2scan.core.rigid import Rigid
    from pc2scan.request.point_time import Times
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import Placer

_ANOTHER_FIELD = "if another field has the times, name it: `point_time=FIELD`"

#: If a cloud takes less with another unit, seconds, a hint names this unit.
_USUAL = 2.0
#: Points that are measured this long before or after their stamp, nanoseconds, probably have another clock.
_OTHER_CLOCK_NS = 1_000_000_000
#: If the times of all points span less than this, they count as equal, seconds. A lidar that turns measures a column at
#: once, in so many directions of `directions_of` at most.
_SHORTEST, _COLUMN = 1e-9, 4

#: The maximum distance of two nodes between which transforms are interpolated, nanoseconds and radians. Transforms are
#: also looked up in the middle between two nodes, so at least every millisecond. The error of the rotation is 0.008
#: times the third power of the angle: at most 0.8 micrometres at 100 m.
_STEP_NS = 2_000_000
_STEP = 0.01
_MOST_NODES = 20_000

#: The stamps of a transform that is valid at all times.
_ALWAYS = np.empty(0, np.int64)


class MovingCloud(NamedTuple):
    """A cloud that was measured while its sensor moved.

    Attributes
    ----------
    points
        As recorded.
    stamp_ns
        The scan's stamp.
    transform
        From the cloud's frame at the points' times to the target frame at the scan's time.
    time_field
        The field with the times.
    frame_id
        The target frame.
    gap_ns
        The longest time over which transforms were interpolated, nanoseconds.
    """

    points: Points
    stamp_ns: int
    transform: MovingTransform
    time_field: str
    frame_id: str
    gap_ns: int

    def transform_of(self, points: Points) -> MovingTransform:
        """Return the transform for these points, or for some of them."""
        return self.transform._replace(times=points.field(self.time_field))

    def place(self, points: Points) -> tuple[Points, NDArray[np.bool_] | None, dict[str, int]]:
        """Place these points, or some of them.

        Returns
        -------
        Points
            In the target frame at the scan's time.
        (M,) or (H, W) bool
            Which of them could be placed; None if all could.
        dict
            How many could not be placed, by the reasons `NO_TIME` and `NO_TRANSFORM`.
        """
        x, y, z = points.xyz()
        out = np.empty((x.size, 3), np.float32)
        untimed, nowhere = kernel.deskew(x, y, z, self.transform_of(points), out)
        coordinates = out.reshape(*x.shape, 3)
        placed = points.replace({axis: coordinates[..., k] for k, axis in enumerate("xyz")}, self.frame_id)
        lost = {NO_TIME.name: untimed, NO_TRANSFORM.name: nowhere}
        if not untimed + nowhere:
            return placed, None, lost
        return placed, ~np.isnan(coordinates[..., 0]) | np.isnan(x) | np.isnan(y) | np.isnan(z), lost


class Track(NamedTuple):
    """The path of a cloud's sensor in a frame that does not move, while its points were measured.

    Attributes
    ----------
    points
        As recorded; with the field `TIME` if their times are not.
    reference_ns
        The stamp of a scan of this cloud alone.
    time_field, offset, unit, node_times, rows
        See `MovingCloud` and `MovingTransform`. The rows are transforms to the fixed frame.
    gap_ns
        The longest time over which transforms were interpolated, nanoseconds.
    timed
        See `MovingTransform`.
    """

    points: Points
    reference_ns: int
    time_field: str
    offset: float
    unit: float
    node_times: NDArray[np.float64]
    rows: NDArray[np.float64]
    gap_ns: int
    timed: bool

    def seen_from(self, target_from_fixed: Rigid, frame_id: str, stamp_ns: int) -> MovingCloud:
        """Return the motion as seen from a frame at a scan's time, given the transform to that frame at this time."""
        rows = self.rows.copy()
        any_time = np.zeros(len(rows), np.int64)
        kernel.follow(any_time, _ALWAYS, _as_matrix(target_from_fixed), rows)
        values = self.points.field(self.time_field)
        transform = MovingTransform(values, self.offset, self.unit, self.node_times, rows, self.timed)
        return MovingCloud(self.points, stamp_ns, transform, self.time_field, frame_id, self.gap_ns)


@dataclass(frozen=True, slots=True)
class Deskew:
    """Looks up the motion of the sensor within clouds. Two instances that place points alike are equal.

    Attributes
    ----------
    placer
        The recording's transforms, with a buffer.
    fixed_frame
        A frame that does not move.
    point_time
        The source of the points' times.
    stamp
        ``header``, ``start``, ``middle`` or ``end``.
    sample
        Called with the points of each cloud and a function that returns the times of the points at some places; None:
        nothing is.
    """

    placer: Placer
    fixed_frame: str
    point_time: PointTime
    stamp: str = "header"
    sample: Callable[[Points, Times], None] | None = field(default=None, compare=False)

    def __call__(self, points: Points) -> MovingCloud | None:
        """Look up the motion of a cloud's sensor; None for a cloud without a point.

        Raises
        ------
        DecodeError
            If its points have no times, or impossible ones.
        TransformError
            If there is no transform at the scan's time, or at none of the points' times.
        """
        track = self.track(points)
        if track is None:
            return None
        target, from_fixed = self.placer.from_fixed(self.fixed_frame, points.frame_id, track.reference_ns)
        return track.seen_from(from_fixed, target, track.reference_ns)

    def track(self, points: Points) -> Track | None:
        """Look up the path of a cloud's sensor in the fixed frame; None for a cloud without a point.

        If the points have the field `TIME`, it is used: they are beams of a scan, which may all have the same time.

        Raises
        ------
        DecodeError
            If its points have no times, or impossible ones.
        TransformError
            If there is no transform at any of the points' times.
        """
        turn, of_scan = self.point_time.turn, TIME in points.fields
        if turn is not None and not of_scan:
            points = points.replace({TIME: turn.times(points)}, points.frame_id)
        known = self.point_time.read(points)
        points, name, offset, unit, low, high, measured, unknown = known
        given = name == TIME
        if not measured:
            return None
        if unknown == measured:
            message = f"none of its points has a time: {name} is not finite"
            hint = None if of_scan else _ANOTHER_FIELD
            raise DecodeError(message, stamp_ns=points.stamp_ns, hint=hint)
        label = AZIMUTH if turn is not None else "time_increment" if given else name
        is_still = not given and high - low < _SHORTEST and directions_of(points).bit_count() > _COLUMN
        self._check(label, low, high, unit, is_still=is_still, stamp_ns=points.stamp_ns)
        stamp_ns = points.stamp_ns
        begin_ns = stamp_ns + math.floor(low * 1e9)
        end_ns = max(stamp_ns + math.ceil(high * 1e9), begin_ns + 1)
        middle_ns = begin_ns + (end_ns - begin_ns) // 2
        reference_ns = {"header": stamp_ns, "start": begin_ns, "middle": middle_ns, "end": end_ns}[self.stamp]
        buffer, source = self.placer.buffer, self.placer.source_frame or points.frame_id
        assert buffer is not None
        measured_ns = begin_ns, end_ns
        # The pose at the scan's time is needed as well.
        if end_ns - begin_ns > 4 * _STEP_NS:
            begin_ns = reference_ns if 0 < begin_ns - reference_ns <= _STEP_NS else begin_ns
            end_ns = reference_ns if 0 < reference_ns - end_ns <= _STEP_NS else end_ns
        step_ns = max(_STEP_NS, (end_ns - begin_ns) // _MOST_NODES)
        stamps_ns, rows, gap_ns = buffer.rows(self.fixed_frame, source, begin_ns, end_ns, step_ns, _step_ns)
        # Checked first, because there nearly always is a transform in the middle of the points' times.
        if math.isnan(rows[2 * int(stamps_ns.searchsorted(sum(measured_ns) // 2)), 0]):
            nodes = np.flatnonzero((stamps_ns >= measured_ns[0]) & (stamps_ns <= measured_ns[1]))
            if np.isnan(rows[2 * nodes[0] : 2 * nodes[-1] + 1]).all():
                _raise_why(buffer, self.fixed_frame, source, measured_ns[0], stamp_ns)
        times = (stamps_ns - stamp_ns) / 1e9
        # A product and a quotient may differ in the last bit: without this, the first and the last points are outside.
        times[0], times[-1] = min(times[0], low), max(times[-1], high)
        if self.sample is not None and not of_scan:
            self.sample(points, known.at)
        all_timed = not unknown and bool(times[0] <= low and high <= times[-1])
        return Track(points, reference_ns, name, offset, unit, times, rows, gap_ns, all_timed)

    def _check(self, name: str, low: float, high: float, unit: float, *, is_still: bool, stamp_ns: int) -> None:
        """Raise an error for impossible times."""
        of, hint = f"by their field {name}", _ANOTHER_FIELD
        if high - low > LONGEST:
            message = f"its points span {high - low:.6g} s {of}, at most {LONGEST:g} s are possible"
            units = (other for other, size in TIME_UNITS.items() if size < unit and (high - low) / unit * size < _USUAL)
            if name in {*TIME_FIELDS, self.point_time.field} and (fitting := next(units, "")):
                hint = f"name the unit of the times: `point_time={name}:{fitting}`"
        elif low < -LONGEST or high > LONGEST:
            message = f"its points are {low:.6g} to {high:.6g} s after its stamp {of}"
            hint = "the times of the points and the stamps come from different clocks, or have another unit"
            hint += f": `point_time={name}:us`; {BY_AZIMUTH}"
        elif is_still:
            message = f"its points all have the same time in their field {name}, {low:.6g} s after its stamp"
            hint = "name the field with the times: `point_time=FIELD`; clouds measured at once need no `deskew`"
        else:
            return
        raise DecodeError(message, stamp_ns=stamp_ns, hint=IN_SECONDS if name == "time_increment" else hint)


def _raise_why(buffer: TransformBuffer, fixed: str, source: str, time_ns: int, stamp_ns: int) -> None:
    """Raise the error of a lookup at the time of a point, without its hint about the tolerance of stamps."""
    try:
        buffer.lookup(fixed, source, time_ns)
    except TransformError as err:
        err.hint = (
            "no point of the cloud was measured while there were transforms; if the clocks differ, `time_offset=auto` "
            "measures by how much"
        )
        is_other_clock = abs(time_ns - stamp_ns) > _OTHER_CLOCK_NS
        if is_other_clock and buffer.known(fixed, source, stamp_ns) is not None:
            err.hint = (
                f"there are transforms at the stamp of the cloud, from which its points are "
                f"{abs(time_ns - stamp_ns) / 1e9:.3g} s away: their clock is another one; {BY_AZIMUTH}"
            )
        raise


def _step_ns(stamps_ns: NDArray[np.int64], rows: NDArray[np.float64]) -> int:
    """Return how far nodes may be apart, given some nodes, and the rows at these and at the middles between them."""
    differences = rows[2::2, :9] - rows[:-2:2, :9]
    squares = np.einsum("ni,ni->n", differences, differences)
    # np.fmax ignores NaN.
    largest = float(np.fmax.reduce(squares, initial=0.0))
    # A rotation by an angle changes the matrix by sqrt(8) times the sine of half the angle.
    angle = 2 * math.asin(min(1.0, math.sqrt(largest / 8)))
    if angle <= _STEP:
        return int(stamps_ns[-1] - stamps_ns[0])
    rates = 2 * np.arcsin(np.minimum(np.sqrt(squares) / math.sqrt(8), 1.0)) / np.diff(stamps_ns)
    return max(1, int(_STEP / np.nanmax(rates)), int(stamps_ns[-1] - stamps_ns[0]) // _MOST_NODES)


def _as_matrix(transform: Rigid) -> NDArray[np.float64]:
    """Return a pose, (1, 7), that does not scale: tf2 multiplies two lookups as matrices; see `kernel.follow`."""
    x, y, z, i, j, k, r = transform.pose
    # Not 0: the product of thousands of quaternions that are a little too short may underflow.
    length = math.sqrt(i * i + j * j + k * k + r * r) or 1.0
    return np.array([(x, y, z, i / length, j / length, k / length, r / length)])
