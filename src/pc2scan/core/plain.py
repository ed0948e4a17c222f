"""The loops over points and beams in NumPy. They run where those in C (``loops/``) are not compiled, and document them.

Points are compared with the numbers of a rule; see `pc2scan.core.rule`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import fdlibm
from .rigid import MovingTransform, rotation_matrices
from .rule import REJECTIONS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

#: How many points are processed at a time: few enough for the cache, and enough that calls of NumPy take little time.
BLOCK = 16384

#: About how many cells of lines are processed at a time.
_CROSSED = 1 << 18

#: Log-odds of a cell in steps of 0.05; see `pc2scan.core.occupancy`.
UNKNOWN, HIT, MISS, LOWEST, HIGHEST = -128, 17, -8, -40, 70


def project(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    rule: NDArray[np.float64],
    transform: NDArray[np.float32] | MovingTransform | None,
    ranges: NDArray[np.float32],
    limit: float,
    empty: float,
) -> tuple[int, ...]:
    """Find the smallest range of each beam.

    Parameters
    ----------
    x, y, z
        Coordinates in metres, of one shape, (M,) or (H, W), of any of PointField's datatypes.
    rule
        (13,), of `rule_of`.
    transform
        (4, 3): a transform to apply first, in float32: the rows of the rotation, then the translation. A motion: each
        point is transformed at its own time.
    ranges
        (N,), overwritten: the smallest range of each of N beams, metres.
    limit, empty
        A beam without a return below the limit reads ``empty``: float32 values, metres.

    Returns
    -------
    tuple of int
        How many points are rejected for each reason, in the order of `REJECTIONS`; with a motion, followed by how many
        have no time, and how many no transform at their time.
    """
    smallest = np.full(ranges.size, np.inf)
    rejected = _nothing(transform)
    with np.errstate(all="ignore"):
        for bins, squares, _ in _returns(x, y, z, rule, transform, ranges.size, rejected):
            np.minimum.at(smallest, bins, squares)
        # The smallest square has the smallest root. Roots are taken of beams, because there are fewer of them than
        # points.
        ranges[...] = np.sqrt(smallest)
    ranges[~(ranges < np.float32(limit))] = empty
    return _counts(rejected)


def gather(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    rule: NDArray[np.float64],
    transform: NDArray[np.float32] | MovingTransform | None,
    beams: int,
    bins: NDArray[np.int32],
    ranges: NDArray[np.float32],
    numbers: NDArray[np.int64],
) -> tuple[int, ...]:
    """Find all returns of the beams, in the order of the cloud.

    Parameters
    ----------
    x, y, z, rule, transform
        As for `project`.
    beams
        N, how many there are.
    bins, ranges, numbers
        (points,), overwritten, one for each return: its beam, its range in metres, and the number of its point.

    Returns
    -------
    tuple of int
        As `project`; all other points are returns.
    """
    rejected = _nothing(transform)
    begin = 0
    with np.errstate(all="ignore"):
        for own_bins, squares, points in _returns(x, y, z, rule, transform, beams, rejected):
            end = begin + own_bins.size
            bins[begin:end], numbers[begin:end] = own_bins, points
            ranges[begin:end] = np.sqrt(squares)
            begin = end
    return _counts(rejected)


def bins_of(angle: NDArray[np.float32], rule: NDArray[np.float64], beams: int) -> NDArray[np.intp]:
    """Return the beams that angles belong to.

    Parameters
    ----------
    angle
        (M,), radians, within -pi to pi, not NaN.
    rule
        (13,), of `rule_of`; its heights and ranges are not used.
    beams
        N, how many there are.

    Returns
    -------
    (M,) intp: 0 to N - 1; N for angles past the end; N + 1 for angles outside of the sector.
    """
    first, last, offset, turn, end, skew, increment, closed = rule[4:12].tolist()
    turned = angle + np.float64(offset)
    for _ in range(2):  # -float32(pi) to float32(pi) is more than one turn
        np.subtract(turned, turn, out=turned, where=turned >= turn)
    outside = (angle < np.float32(first)) | (angle > np.float32(last)) | (turned > end)
    # Outside of the sector, a quotient may be too large for an integer.
    bins = np.where(outside, 0.0, (turned + skew) / increment).astype(np.intp)
    np.minimum(bins, beams - 1 if closed else beams, out=bins)
    bins[outside] = beams + 1
    return bins


def _returns(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    rule: NDArray[np.float64],
    transform: NDArray[np.float32] | MovingTransform | None,
    beams: int,
    rejected: NDArray[np.int64],
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.intp]]]:
    """Yield beams, squared ranges and numbers of the returns, part by part; count other points in ``rejected``."""
    lowest, highest, least, most = rule[:4].tolist()
    if isinstance(transform, MovingTransform):
        transform = transform._replace(times=transform.times.reshape(-1))
    x, y, z = (part.reshape(-1) for part in (x, y, z))
    for start in range(0, x.size, BLOCK):
        px, py, pz = (part[start : start + BLOCK] for part in (x, y, z))
        px, py, pz = (part.astype(np.float32, copy=False) for part in (px, py, pz))
        lost = 0
        if isinstance(transform, MovingTransform):
            own = transform._replace(times=transform.times[start : start + BLOCK])
            (px, py, pz), lost, untimed = _move(px, py, pz, own)
            rejected[len(REJECTIONS) :] += untimed, lost - untimed
        elif transform is not None:
            px, py, pz = transform_points(px, py, pz, transform)
        known = ~(np.isnan(px) | np.isnan(py) | np.isnan(pz))
        level = np.flatnonzero(known & (pz >= np.float32(lowest)) & (pz <= np.float32(highest)))
        # Squares of float32 are exact in float64, in which libm's hypotf adds them.
        squares = np.square(px[level], dtype=np.float64) + np.square(py[level], dtype=np.float64)
        near = (squares >= least) & (squares <= most)
        kept, squares = level[near], squares[near]
        angle = np.empty(kept.size, np.float32)
        angles(px[kept], py[kept], angle, bool(rule[12]))
        bins = bins_of(angle, rule, beams)
        past_end, outside = np.count_nonzero(bins == beams), np.count_nonzero(bins == beams + 1)
        nan = px.size - np.count_nonzero(known)
        rejected[: len(REJECTIONS)] += nan - lost, px.size - nan - level.size, level.size - kept.size, outside, past_end
        inside = bins < beams
        yield bins[inside], squares[inside], kept[inside] + start


def _nothing(transform: NDArray[np.float32] | MovingTransform | None) -> NDArray[np.int64]:
    """Return new counts of rejected points."""
    return np.zeros(len(REJECTIONS) + (2 if isinstance(transform, MovingTransform) else 0), np.int64)


def _counts(rejected: NDArray[np.int64]) -> tuple[int, ...]:
    counts: list[int] = rejected.tolist()
    return tuple(counts)


def angles(x: NDArray[np.float32], y: NDArray[np.float32], out: NDArray[np.float32], glibc: bool = False, /) -> None:
    """Compute the angles of points, radians.

    Parameters
    ----------
    x, y
        (M,), contiguous: metres.
    out
        (M,), contiguous, overwritten.
    glibc
        Whether to return what ``atan2f`` of glibc 2.31 to 2.40 returns on x86-64, to the bit. Otherwise
        ``float32(atan2(y, x))``.
    """
    if glibc:
        out[...] = fdlibm.atan2f(y, x)
    else:
        # The error of float64 vanishes in the rounding, except for about one point in a hundred million.
        out[...] = np.arctan2(y, x, dtype=np.float64)


def deskew(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    motion: MovingTransform,
    out: NDArray[np.float32],
) -> tuple[int, int]:
    """Transform each point by the transform at its own time.

    Parameters
    ----------
    x, y, z
        Coordinates in metres, of one shape, (M,) or (H, W), of any of PointField's datatypes.
    motion
        How the sensor moved.
    out
        (points, 3), overwritten: the coordinates, NaN for points without a transform.

    Returns
    -------
    (int, int)
        How many points have coordinates, but no time; and how many have a time, but no transform at it: outside of the
        nodes, or beside a row that is NaN.
    """
    untimed = nowhere = 0
    shape = x.shape
    columns = [np.ravel(axis) for axis in (x, y, z)]
    times = np.ravel(np.broadcast_to(motion.times, shape))
    with np.errstate(all="ignore"):
        for begin in range(0, out.shape[0], BLOCK):
            part = slice(begin, begin + BLOCK)
            px, py, pz = (axis[part].astype(np.float32) for axis in columns)
            moved, missing, unknown = _move(px, py, pz, motion._replace(times=times[part]))
            for axis, values in enumerate(moved):
                out[part, axis] = values
            untimed += unknown
            nowhere += missing - unknown
    return untimed, nowhere


def _move(
    x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32], motion: MovingTransform
) -> tuple[list[NDArray[np.float32]], int, int]:
    """Return coordinates at their own times; how many have no transform, and how many of these have no time."""
    nodes, rows = motion.node_times, motion.rows
    times = (motion.times.astype(np.float64) - motion.offset) * motion.unit
    last = nodes.size - 2
    part = np.clip(np.searchsorted(nodes, times, "left") - 1, 0, last)
    first, middle, final = rows[:-1:2], rows[1::2], rows[2::2]
    known = ~np.isnan(first[:, 0] + middle[:, 0] + final[:, 0])
    # The end of a part without transforms is the beginning of a part that may have them.
    behind = ~known[part] & (times == nodes[part + 1]) & (part < last)
    part[behind] += 1
    rates = ((4 * middle - 3 * first) - final).astype(np.float32)
    bends = (2 * ((first - 2 * middle) + final)).astype(np.float32)
    begin = nodes[part]
    ratio = ((times - begin) * (1.0 / (nodes[part + 1] - begin))).astype(np.float32)
    has_transform = known[part] & (times >= nodes[0]) & (times <= nodes[-1])
    moved = []
    for axis in range(3):
        columns = (3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis)
        start, rate, bend = ([table[part, k] for k in columns] for table in (first, rates, bends))
        away = ratio * (_dot(rate, x, y, z) + ratio * _dot(bend, x, y, z))
        place = _dot(start, *(values.astype(np.float64) for values in (x, y, z))) + away
        moved.append(np.where(has_transform, place, np.nan).astype(np.float32))
    lost = ~has_transform & ~(np.isnan(x) | np.isnan(y) | np.isnan(z))
    return moved, int(np.count_nonzero(lost)), int(np.count_nonzero(lost & np.isnan(times)))


def _dot(row: Sequence[NDArray[Any]], x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> Any:
    return row[0] * x + row[1] * y + row[2] * z + row[3]


def span(x: NDArray[Any], values: NDArray[Any]) -> tuple[float, float, int, int]:
    """Return the least and the largest finite value of a field, of the points whose ``x`` is not NaN.

    Parameters
    ----------
    x, values
        Both have one shape, (M,) or (H, W), and any of PointField's datatypes.

    Returns
    -------
    least, largest : float
        inf and -inf if there is none.
    measured : int
        How many points have an ``x`` that is not NaN.
    unknown : int
        How many of them have a value that is NaN or infinite.
    """
    measured = ~np.isnan(x)
    elements = values[measured].astype(np.float64)
    finite = elements[np.isfinite(elements)]
    return (
        float(finite.min(initial=np.inf)),
        float(finite.max(initial=-np.inf)),
        elements.size,
        elements.size - finite.size,
    )


def follow(
    times: NDArray[np.int64], stamps: NDArray[np.int64], poses: NDArray[np.float64], rows: NDArray[np.float64]
) -> None:
    """Extend transforms to a frame by one link, to its parent.

    The compiled function differs in the last bits of float64.

    Parameters
    ----------
    times
        (N,) nanoseconds.
    stamps
        (S,) nanoseconds of the samples, increasing; (0,): the only pose is valid at any time.
    poses
        (S, 7) or (1, 7): ``parent_from_frame``, the translation in metres, then the quaternion x, y, z, w.
    rows
        (N, 12), overwritten: the rows of the rotation, then the translation, of ``frame_from_source``, then of
        ``parent_from_source``; NaN outside of the samples.

    Notes
    -----
    Within a lookup, tf2 rotates translations by quaternions as they are published. One that is not of unit length also
    scales by its squared length.
    """
    with np.errstate(all="ignore"):
        quaternions, offset = _poses(times, stamps, poses)
        squared = np.einsum("ni,ni->n", quaternions, quaternions)[:, np.newaxis]
        rotation = np.moveaxis(rotation_matrices(quaternions.T), -1, 0)
        turned = rotation @ rows[:, :9].reshape(-1, 3, 3)
        origin = np.einsum("nij,nj->ni", np.broadcast_to(rotation, (times.size, 3, 3)), rows[:, 9:]) * squared + offset
    rows[:, :9], rows[:, 9:] = turned.reshape(-1, 9), origin


def _poses(
    times: NDArray[np.int64], stamps: NDArray[np.int64], poses: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return quaternions (N, 4) and translations (N, 3) at times, NaN outside of the samples; or one for all times."""
    if not stamps.size:
        return poses[:, 3:], poses[:, :3]
    last = stamps.size - 1
    older = np.clip(stamps.searchsorted(times, "right") - 1, 0, last)
    newer = np.minimum(older + 1, last)
    ratio = np.where(newer > older, (times - stamps[older]) / (stamps[newer] - stamps[older]), 0.0)[:, np.newaxis]
    offset = (1 - ratio) * poses[older, :3] + ratio * poses[newer, :3]
    quaternions = _slerp(poses[older, 3:], poses[newer, 3:], ratio)
    outside = (times < stamps[0]) | (times > stamps[-1])
    quaternions[outside], offset[outside] = np.nan, np.nan
    return quaternions, offset


def _slerp(first: NDArray[np.float64], last: NDArray[np.float64], ratio: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotations between pairs of rotations (N, 4), as `pc2scan.core.rigid.slerp` does for one pair."""
    product = np.einsum("ni,ni->n", first, last)[:, np.newaxis]
    length = np.sqrt(np.einsum("ni,ni->n", first, first) * np.einsum("ni,ni->n", last, last))[:, np.newaxis]
    angle = np.arccos(np.minimum(np.abs(product) / length, 1.0))
    sign = np.where(product < 0, -1.0, 1.0)
    mixed = (np.sin((1 - ratio) * angle) * first + np.sin(ratio * angle) * sign * last) / np.sin(angle)
    return np.where(angle == 0, first, mixed)


def nodes(stamps: tuple[NDArray[np.int64], ...], begin_ns: int, end_ns: int, step_ns: int, /) -> tuple[bytes, int]:
    """Return the times at which transforms are looked up so that they can be interpolated between these.

    Parameters
    ----------
    stamps
        (S,) nanoseconds, increasing: the samples of each frame.
    begin_ns, end_ns
        The first and the last time; the second is later.
    step_ns
        How far times may be apart.

    Returns
    -------
    times : bytes
        (2 N - 1,) int64, increasing: both ends, the times of all samples between them and evenly spaced ones; and the
        middle between each and the next one.
    gap_ns : int
        The longest time between two samples of one frame of which a part is between the ends.
    """
    gap_ns, inside = 0, []
    for samples in stamps:
        inside.append(samples[samples.searchsorted(begin_ns) : samples.searchsorted(end_ns, "right")])
        first, last = samples.searchsorted(begin_ns, "right"), samples.searchsorted(end_ns, "left")
        gaps = np.diff(samples[max(int(first) - 1, 0) : int(last) + 1])
        gap_ns = max(gap_ns, int(gaps.max(initial=0)))
    count = -(-(end_ns - begin_ns) // step_ns)
    times = np.unique(np.concatenate([begin_ns + np.arange(count + 1) * (end_ns - begin_ns) // count, *inside]))
    both = np.empty(2 * times.size - 1, np.int64)
    both[::2], both[1::2] = times, times[:-1] + np.diff(times) // 2
    return both.tobytes(), gap_ns


def trace(
    cells: NDArray[np.int16],
    width: int,
    mark: int,
    rays: NDArray[np.int32],
    hits: NDArray[np.bool_],
) -> None:
    """Draw the rays of a scan into a grid of log-odds; `pc2scan.core.occupancy` has the rules and the numbers.

    Parameters
    ----------
    cells
        (H, W), contiguous, changed in place: the log-odds times 256, and the mark of the last scan that changed it.
    width
        W.
    mark
        0 to 255: cells with this mark are not changed; cells that change get it.
    rays
        (N, 4), contiguous: column and row of the cell of the sensor, and of the cell where the beam ends.
    hits
        (N,), contiguous: whether there is an object at the beam's end.

    Raises
    ------
    ValueError
        If a ray leaves the grid.
    """
    height = cells.size // width
    if rays.size and (rays.min() < 0 or rays[:, 0::2].max() >= width or rays[:, 1::2].max() >= height):
        raise ValueError("a ray leaves the grid")
    lines = rays.astype(np.int64)
    _observe(cells, mark, lines[hits, 3] * width + lines[hits, 2], HIT)
    ends = np.cumsum(np.abs(lines[:, 2:] - lines[:, :2]).max(axis=1, initial=0))
    for part in np.split(np.arange(len(lines)), np.flatnonzero(np.diff(ends // _CROSSED)) + 1):
        _observe(cells, mark, _line_cells(lines[part], hits[part], width), MISS)


def _line_cells(lines: NDArray[np.int64], hits: NDArray[np.bool_], width: int) -> NDArray[np.int64]:
    """Return the indices of lines' cells, by Bresenham's algorithm, without the last cell of lines that hit."""
    begin, change = lines[:, :2], lines[:, 2:] - lines[:, :2]
    steep = np.abs(change[:, 1]) >= np.abs(change[:, 0])
    longer, shorter = np.abs(change).max(axis=1), np.abs(change).min(axis=1)
    counts = longer + ~hits
    step = np.repeat(np.arange(len(lines)), counts)
    along = np.arange(step.size) - np.repeat(np.cumsum(counts) - counts, counts)
    # Rounded half up, in whole numbers.
    aside = (2 * along * shorter[step] + longer[step]) // np.maximum(2 * longer[step], 1)
    columns = begin[step, 0] + np.sign(change[step, 0]) * np.where(steep[step], aside, along)
    rows = begin[step, 1] + np.sign(change[step, 1]) * np.where(steep[step], along, aside)
    places: NDArray[np.int64] = rows * width + columns
    return places


def _observe(cells: NDArray[np.int16], mark: int, places: NDArray[np.int64], change: int) -> None:
    """Change the log-odds of cells, except those that the scan has changed before."""
    flat = cells.reshape(-1)
    places = np.unique(places)
    odds, marks = flat[places] >> 8, flat[places] & 255
    odds[odds == UNKNOWN] = 0
    fresh = marks != mark
    flat[places[fresh]] = np.clip(odds[fresh] + change, LOWEST, HIGHEST) * 256 + mark


def transform_points(
    x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32], transform: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Transform coordinates in float32: every product and every sum is rounded, from left to right.

    Parameters
    ----------
    x, y, z
        Coordinates in metres, of one shape.
    transform
        (4, 3): the rows of the rotation, then the translation.
    """
    # Written out, because a matrix product may sum in any order.
    *rotation, translation = transform
    across, up, high = (
        x * row[0] + y * row[1] + z * row[2] + offset for row, offset in zip(rotation, translation, strict=True)
    )
    return across, up, high
