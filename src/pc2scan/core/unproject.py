"""Converts the beams of a laser scan to points, as laser_geometry's ``projectLaser`` does.

Source of the rules: ros-perception/laser_geometry 1.6.7, src/laser_geometry.cpp (``projectLaser_`` and
``transformLaserScanToPointCloud_`` for PointCloud2) and tf2/LinearMath (slerp, rotation matrix). ROS 2's
version has the same results.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.errors import DecodeError, ParameterError

from .rigid import rotation_matrices, slerp

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from .rigid import Rigid

#: ROS 1 stores the seconds of a duration in 32 bits.
_LONGEST = 2**31


@dataclass(frozen=True, slots=True, kw_only=True)
class UnprojectParams:
    """The fields of a cloud that is made from a scan; the defaults are those of laser_geometry and the upstream node.

    Parameters
    ----------
    intensity
        Channel ``intensity``: the beam's intensity. A scan without intensities has no such channel.
    index
        Channel ``index``: the beam's number in ``ranges``.
    distances
        Channel ``distances``: the beam's range, metres.
    stamps
        Channel ``stamps``: seconds since the scan's stamp, ``index * time_increment``.
    viewpoint
        Channels ``vp_x``, ``vp_y``, ``vp_z``: the position of the sensor, metres.
    range_cutoff
        Metres; a beam must read less. Negative means the scan's ``range_max``. A value above ``range_max``
        keeps readings at and beyond it.

    Raises
    ------
    ParameterError
        If ``range_cutoff`` is NaN.
    """

    intensity: bool = True
    index: bool = True
    distances: bool = False
    stamps: bool = False
    viewpoint: bool = False
    range_cutoff: float = -1.0

    def __post_init__(self) -> None:
        if math.isnan(self.range_cutoff):
            raise ParameterError("range_cutoff is NaN", name="range_cutoff")


class UnprojectedScan(NamedTuple):
    """The points of a scan.

    Attributes
    ----------
    points
        Structured, shape (N,), in the order of the beams; read-only. The fields are packed in
        laser_geometry's order: ``x``, ``y``, ``z``, then those requested of ``intensity``, ``index``,
        ``distances``, ``stamps``, ``vp_x``, ``vp_y``, ``vp_z``. All are little-endian float32 but ``index``,
        which is int32. Names, offsets and bytes (``points.tobytes()``) are those of upstream's PointCloud2.
    beams
        int32, shape (N,): which beam each point comes from, even if ``index`` was not requested.
    beam_count
        How many beams the scan has.
    rejected
        How many beams became no point, by the projection's reasons: ``nan``, and ``range``, which are those that are
        infinite, below ``range_min``, or from ``range_max`` (or the cutoff) on.
    """

    points: NDArray[np.void]
    beams: NDArray[np.int32]
    beam_count: int
    rejected: dict[str, int]

    @property
    def xyz(self) -> NDArray[np.float32]:
        """Coordinates, float32, shape (N, 3), metres; a read-only view of `points`."""
        return _three_fields(self.points, "x")

    @property
    def viewpoint(self) -> NDArray[np.float32] | None:
        """The position of the sensor, float32, shape (N, 3), metres; a read-only view, or None if not requested."""
        return _three_fields(self.points, "vp_x") if "vp_x" in (self.points.dtype.names or ()) else None

    def with_xyz(self, xyz: ArrayLike, viewpoint: ArrayLike | None = None) -> UnprojectedScan:
        """Return the scan with other coordinates of the points, and of the sensor.

        Parameters
        ----------
        xyz
            Shape (N, 3), metres; becomes float32.
        viewpoint
            Shape (N, 3) or (3,), metres; None keeps it. Ignored without viewpoint channels.

        Returns
        -------
        UnprojectedScan
            A copy; the other channels are unchanged.
        """
        points = self.points.copy()
        with np.errstate(over="ignore"):
            _three_fields(points, "x")[:] = xyz
            if viewpoint is not None and self.viewpoint is not None:
                _three_fields(points, "vp_x")[:] = viewpoint
        points.flags.writeable = False
        return self._replace(points=points)


def unproject(
    ranges: NDArray[np.float32],
    intensities: NDArray[np.float32],
    *,
    angle_min: float,
    angle_increment: float,
    range_min: float,
    range_max: float,
    time_increment: float = 0.0,
    params: UnprojectParams | None = None,
) -> UnprojectedScan:
    """Convert the beams of a scan to points in the plane z = 0 of its frame.

    A beam is kept if ``range_min <= range < cutoff``, so NaN, +inf and a range of exactly ``range_max`` are not kept.
    Beam i points to ``angle_min + i * angle_increment`` in float64; x and y are the float64 products of range and
    cosine or sine, rounded to float32.

    Upstream reuses its table of cosines for as long as ``angle_min``, ``angle_max`` and the number of beams
    stay, even when ``angle_increment`` changes; here every scan has its own angles.

    Parameters
    ----------
    ranges
        float32, shape (beams,), metres. May be empty, and have any values.
    intensities
        float32, empty or as long as ``ranges``.
    angle_min, angle_increment
        Radians, of any sign; float32 in the message and rounded to it here.
    range_min, range_max
        Metres; rounded to float32, too.
    time_increment
        Seconds from beam to beam; rounded to float32, too.
    params
        Channels and cutoff; None means the defaults.

    Returns
    -------
    UnprojectedScan
        The points, in the order of the beams.

    Raises
    ------
    DecodeError
        If there are intensities, but not one for every range (upstream reads past their end); if there are
        beams, but ``angle_min`` or ``angle_increment`` is not finite (upstream's points are NaN).
    """
    params = params or UnprojectParams()
    if len(intensities) not in (0, len(ranges)):
        raise DecodeError(
            f"intensities has {len(intensities)} values, but ranges has {len(ranges)}; "
            "intensities must be empty or as long"
        )
    lowest, highest = _float32(range_min, range_max)
    cutoff = params.range_cutoff if params.range_cutoff >= 0 else highest
    # In float64, as upstream: a cutoff need not be a float32 number. A NaN may be a signalling one.
    with np.errstate(invalid="ignore"):
        distances = np.asarray(ranges, np.float32).astype(np.float64)
    beams = np.flatnonzero((distances >= lowest) & (distances < cutoff)).astype(np.int32)

    points = np.zeros(len(beams), _point_dtype(params, has_intensities=len(intensities) > 0))
    names = points.dtype.names or ()
    angles = beam_angles(len(ranges), angle_min, angle_increment)[beams]
    # NaN: -inf (kept where range_min is -inf) straight along an axis, beam 0 of an infinite time_increment.
    with np.errstate(invalid="ignore", over="ignore"):
        points["x"] = distances[beams] * np.cos(angles)
        points["y"] = distances[beams] * np.sin(angles)
        if "intensity" in names:
            points["intensity"] = intensities[beams]
        if "index" in names:
            points["index"] = beams
        if "distances" in names:
            points["distances"] = distances[beams]
        if "stamps" in names:
            points["stamps"] = beams * _float32(time_increment)[0]
    points.flags.writeable = False
    nan = int(np.count_nonzero(np.isnan(distances)))
    return UnprojectedScan(points, beams, len(ranges), {"nan": nan, "range": len(ranges) - len(beams) - nan})


def last_beam_ns(beams: int, time_increment: float) -> int:
    """Return when the last beam of a scan was measured, nanoseconds after the first; negative for a negative increment.

    Source of the rule: ``transformLaserScanToPointCloud_`` of laser_geometry 1.6.7, which computes the product in
    float32, and ``ros::Duration::fromSec``, which rounds it to nanoseconds. ROS 2's version computes it in float64.

    Parameters
    ----------
    beams
        The number of beams; without any, no product is computed.
    time_increment
        Seconds from beam to beam; float32 in the message and rounded to it here.

    Raises
    ------
    DecodeError
        If the result is NaN, or longer than a ROS 1 duration can be.
    """
    if not beams:
        return 0
    with np.errstate(all="ignore"):
        seconds = float(np.float32(beams - 1) * np.float32(time_increment))
    if not -_LONGEST <= seconds < _LONGEST:
        raise DecodeError(
            f"time_increment is {time_increment} s: the last of {beams} beams would be {seconds} s after the first, "
            f"the limit is {_LONGEST} s"
        )
    whole = math.floor(seconds)
    rest = (seconds - whole) * 1e9
    nanoseconds = math.floor(rest)
    return whole * 1_000_000_000 + nanoseconds + (rest - nanoseconds >= 0.5)


def deskew(scan: UnprojectedScan, start: Rigid, end: Rigid) -> UnprojectedScan:
    """Transform every point by the pose of the sensor at the time of its beam.

    laser_geometry's high-fidelity projection: beam i of n lies at the ratio ``i / (n - 1)`` between the two
    transforms; translations are interpolated linearly, rotations by slerp along the shorter way. All is
    computed in float64, from and to float32 coordinates. If a scan has only one beam, it gets the start's transform;
    upstream divides by zero.

    Parameters
    ----------
    scan
        Points in the sensor's frame.
    start, end
        target_from_sensor at the times of the scan's first and last beam, even if these were not kept.

    Returns
    -------
    UnprojectedScan
        A copy in the target frame, viewpoint channels included.
    """
    # Upstream multiplies by the reciprocal, which does not always equal the quotient.
    step = 1.0 / (scan.beam_count - 1) if scan.beam_count > 1 else 0.0
    ratio = scan.beams.astype(np.float64) * step
    matrix = rotation_matrices(slerp(start.quaternion, end.quaternion, ratio).T)
    origin = (1.0 - ratio)[:, np.newaxis] * start.translation + ratio[:, np.newaxis] * end.translation
    viewpoint = scan.viewpoint
    return scan.with_xyz(
        _transform_points(scan.xyz, matrix, origin),
        None if viewpoint is None else _transform_points(viewpoint, matrix, origin),
    )


def _point_dtype(params: UnprojectParams, *, has_intensities: bool) -> np.dtype[np.void]:
    """Return the layout of a point, as in laser_geometry."""
    channels = [
        ("intensity", "<f4", params.intensity and has_intensities),
        ("index", "<i4", params.index),
        ("distances", "<f4", params.distances),
        ("stamps", "<f4", params.stamps),
        *((name, "<f4", params.viewpoint) for name in ("vp_x", "vp_y", "vp_z")),
    ]
    xyz = [(name, "<f4") for name in ("x", "y", "z")]
    return np.dtype(xyz + [(name, code) for name, code, wanted in channels if wanted])


def _float32(*values: float) -> list[float]:
    """Round to float32, the message's type; larger numbers become infinite."""
    with np.errstate(over="ignore"):
        rounded: list[float] = np.array(values).astype(np.float32).tolist()
    return rounded


def beam_angles(count: int, angle_min: float, angle_increment: float) -> NDArray[np.float64]:
    """Return the direction of every beam, radians: float64 arithmetic on the message's float32 values.

    Raises
    ------
    DecodeError
        If there are beams, and the angles are not finite.
    """
    if not count:
        return np.empty(0)
    first, step = _float32(angle_min, angle_increment)
    if not (math.isfinite(first) and math.isfinite(step)):
        raise DecodeError(f"angle_min is {first} rad and angle_increment {step} rad; both must be finite")
    angles: NDArray[np.float64] = first + np.arange(count, dtype=np.float64) * step
    return angles


def _three_fields(points: NDArray[np.void], first: str) -> NDArray[np.float32]:
    """Return a view of three neighbouring float32 fields of packed points, (N, 3)."""
    begin = (points.dtype.names or ()).index(first)
    words = points.view("<f4").reshape(len(points), points.dtype.itemsize // 4)
    columns: NDArray[np.float32] = words[:, begin : begin + 3]
    return columns


def _transform_points(
    xyz: NDArray[np.float32], matrix: NDArray[np.float64], origin: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Rotate and translate points (N, 3), each by its own matrix (3, 3, N) and origin (N, 3), in tf2's order."""
    x, y, z = xyz.T.astype(np.float64)
    with np.errstate(invalid="ignore"):  # an infinite coordinate times 0
        rows = [row[0] * x + row[1] * y + row[2] * z for row in matrix]
    return np.stack(rows, axis=1) + origin
