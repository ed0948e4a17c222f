"""Rigid transforms: rotation and translation, composition, and interpolation.

A transform is named by its direction: ``target_from_source`` takes coordinates in the frame ``source`` and
returns them in the frame ``target``, ``p_target = target_from_source.apply(p_source)``. The transform that
ROS publishes with ``header.frame_id`` parent and ``child_frame_id`` child is ``parent_from_child``.

There are three forms: `Rigid` is the general one; a `Pose`, a tuple of seven floats, is used to compute a chain of
lookups, because a call of NumPy takes longer than multiplying four numbers; a `MovingTransform` is that of a cloud that
was measured while its sensor moved.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from pc2scan.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

#: Translation x, y, z in metres, then the quaternion x, y, z, w, as published: not exactly of unit length.
Pose: TypeAlias = tuple[float, float, float, float, float, float, float]

#: A stamped transform as in a message, ``parent_from_child``: parent, child, stamp_ns, then a pose
#: whose quaternion is not checked.
TransformRow: TypeAlias = tuple[str, str, int, float, float, float, float, float, float, float]

_THREE, _FOUR, _NINE, _TWELVE = (struct.Struct(f"={count}f") for count in (3, 4, 9, 12))

IDENTITY_POSE: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

#: tf2 accepts quaternions whose squared norm differs from 1 by less than this, without normalising, and refuses others.
NORM_TOLERANCE = 10e-3


def are_accepted(quaternions: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether tf2 accepts quaternions, (N, 4) x, y, z, w; not with a NaN or an infinite component."""
    x, y, z, w = quaternions.T
    with np.errstate(all="ignore"):
        # In tf2's order of operations, which matters near the limit.
        return np.asarray(np.abs(w * w + x * x + y * y + z * z - 1.0) < NORM_TOLERANCE)


def _as_float32(numbers: struct.Struct, values: Sequence[float]) -> bytes:
    """Return numbers rounded to float32; for a few numbers much faster than NumPy."""
    try:
        return numbers.pack(*values)
    except OverflowError:
        with np.errstate(over="ignore"):
            return np.array(values).astype(np.float32).tobytes()


# tf2 never normalises, so its order of operations changes the last bits. These functions have the same order.


def compose_poses(a_from_b: Pose, b_from_c: Pose) -> Pose:
    """Return ``a_from_c``: the second transform, then the first."""
    ax, ay, az, ai, aj, ak, ar = a_from_b
    x, y, z, i, j, k, r = b_from_c
    # quatRotate: the quaternion times the vector, times the conjugate.
    ti, tj, tk, tr = (
        ar * x + aj * z - ak * y,
        ar * y + ak * x - ai * z,
        ar * z + ai * y - aj * x,
        -ai * x - aj * y - ak * z,
    )
    return (
        ti * ar - tr * ai - tj * ak + tk * aj + ax,
        tj * ar - tr * aj - tk * ai + ti * ak + ay,
        tk * ar - tr * ak - ti * aj + tj * ai + az,
        ar * i + ai * r + aj * k - ak * j,
        ar * j + aj * r + ak * i - ai * k,
        ar * k + ak * r + ai * j - aj * i,
        ar * r - ai * i - aj * j - ak * k,
    )


def inverse_pose(a_from_b: Pose) -> Pose:
    """Return ``b_from_a``."""
    x, y, z, i, j, k, r = a_from_b
    turned = compose_poses((-0.0, -0.0, -0.0, -i, -j, -k, r), (-x, -y, -z, 0.0, 0.0, 0.0, 1.0))
    return (*turned[:3], -i, -j, -k, r)


def interpolate_poses(first: Pose, last: Pose, ratio: float) -> Pose:
    """Return `lerp` of the translations and `slerp` of the rotations, at one ratio."""
    kept = 1 - ratio
    x0, y0, z0, i0, j0, k0, r0 = first
    x1, y1, z1, i1, j1, k1, r1 = last
    half_angle, sign = _half_angle((i0, j0, k0, r0), (i1, j1, k1, r1))
    if half_angle != 0:
        scale = 1 / math.sin(half_angle)
        from_first, from_last = math.sin(kept * half_angle), math.sin(ratio * half_angle) * sign
        i0 = (i0 * from_first + i1 * from_last) * scale
        j0 = (j0 * from_first + j1 * from_last) * scale
        k0 = (k0 * from_first + k1 * from_last) * scale
        r0 = (r0 * from_first + r1 * from_last) * scale
    return (
        kept * x0 + ratio * x1,
        kept * y0 + ratio * y1,
        kept * z0 + ratio * z1,
        i0,
        j0,
        k0,
        r0,
    )


def difference(one: TransformRow, other: TransformRow) -> tuple[float, float]:
    """Return how far two transforms are apart, metres and radians; 0 if their parents differ, NaN for no rotation."""
    if one[0] != other[0]:
        return 0.0, 0.0
    try:
        turned = 2 * _half_angle(one[6:], other[6:])[0]
    except ZeroDivisionError:
        turned = math.nan
    return math.dist(one[3:6], other[3:6]), turned


def _half_angle(first: Sequence[float], last: Sequence[float]) -> tuple[float, float]:
    """Return half the angle between two rotations on the shorter way, and the sign of the second one for it."""
    i0, j0, k0, r0 = first
    i1, j1, k1, r1 = last
    dot = i0 * i1 + j0 * j1 + k0 * k1 + r0 * r1
    norm0 = i0 * i0 + j0 * j0 + k0 * k0 + r0 * r0
    norm1 = i1 * i1 + j1 * j1 + k1 * k1 + r1 * r1
    cosine = abs(dot) / math.sqrt(norm0 * norm1)
    return math.acos(min(cosine, 1.0)), -1.0 if dot < 0 else 1.0


def slerp(first: ArrayLike, last: ArrayLike, ratio: ArrayLike) -> NDArray[np.float64]:
    """Return rotations between two rotations, at a constant rate on the shorter way.

    Parameters
    ----------
    first, last
        (4,) quaternions x, y, z, w.
    ratio
        0 is the first, 1 is the last; a scalar or an array of any shape.

    Returns
    -------
    ndarray
        ``ratio.shape + (4,)`` float64 quaternions. If the two are equal to within the resolution of
        arccos (about 1.5e-8 rad), all are ``first``.

    Notes
    -----
    Source of the rule: ``tf2::Quaternion::slerp`` and ``angleShortestPath`` (Bullet's formula):
    theta = arccos(abs(q0 . q1) / sqrt(|q0|^2 |q1|^2)); the weights are sin((1 - t) theta) / sin(theta) and
    sin(t theta) / sin(theta), the second one negated if q0 . q1 is negative.
    """
    start, stop = np.asarray(first, np.float64), np.asarray(last, np.float64)
    ratios = np.asarray(ratio, np.float64)[..., None]
    half_angle, sign = _half_angle(start.tolist(), stop.tolist())
    if half_angle == 0:
        return np.broadcast_to(start, (*ratios.shape[:-1], 4)).copy()
    from_start, from_stop = np.sin((1 - ratios) * half_angle), np.sin(ratios * half_angle) * sign
    # In tf2's order of operations.
    return np.asarray((from_start * start + from_stop * stop) * (1 / math.sin(half_angle)))


def lerp(first: ArrayLike, last: ArrayLike, ratio: ArrayLike) -> NDArray[np.float64]:
    """Return points on the straight line between two points.

    Parameters
    ----------
    first, last
        (3,) coordinates, metres.
    ratio
        0 is the first, 1 is the last; a scalar or an array of any shape.

    Returns
    -------
    ndarray
        ``ratio.shape + (3,)`` float64: (1 - ratio) first + ratio last, as ``tf2::Vector3::setInterpolate3``.
    """
    ratios = np.asarray(ratio, np.float64)[..., None]
    return np.asarray((1 - ratios) * np.asarray(first, np.float64) + ratios * np.asarray(last, np.float64))


def rotation_matrices(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotation matrices (3, 3, ...) of quaternions (4, ...) x, y, z, w of any length.

    Source of the rule: ``tf2::Matrix3x3::setRotation``, in its order of operations.
    """
    # The product of thousands of quaternions, each a little too long or too short, may exceed float64.
    with np.errstate(all="ignore"):
        return np.array(_rows(quaternions))


def _rows(quaternion: Any) -> tuple[tuple[Any, Any, Any], ...]:
    """The rows of rotation matrices, of numbers or of arrays."""
    x, y, z, w = quaternion
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    xs, ys, zs = x * scale, y * scale, z * scale
    wx, wy, wz = w * xs, w * ys, w * zs
    xx, xy, xz = x * xs, x * ys, x * zs
    yy, yz, zz = y * ys, y * zs, z * zs
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


def _quaternion(m: Sequence[Sequence[float]]) -> tuple[float, float, float, float]:
    """Return the quaternion of a rotation matrix; its largest component is positive."""
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = m
    four_squares = (1 + m00 - m11 - m22, 1 - m00 + m11 - m22, 1 - m00 - m11 + m22, 1 + m00 + m11 + m22)
    largest = max(range(4), key=four_squares.__getitem__)
    products = (
        (four_squares[0], m10 + m01, m20 + m02, m21 - m12),
        (m10 + m01, four_squares[1], m21 + m12, m02 - m20),
        (m20 + m02, m21 + m12, four_squares[2], m10 - m01),
        (m21 - m12, m02 - m20, m10 - m01, four_squares[3]),
    )[largest]
    scale = 1 / (2 * math.sqrt(four_squares[largest]))
    x, y, z, w = (product * scale for product in products)
    return (x, y, z, w)


@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """A rigid transform, ``target_from_source``: ``p_target = rotation p_source + translation``.

    Parameters
    ----------
    quaternion
        (4,) x, y, z, w: the axes of ``source`` seen from ``target``; float64, read-only. Unchanged if tf2
        accepts it, which is if its squared norm differs from 1 by less than 0.01; normalised if tf2 would refuse it.
    translation
        (3,) the origin of ``source`` in ``target``, metres. float64, read-only.

    Raises
    ------
    ParameterError
        If a shape is wrong, a value is NaN or infinite, or the quaternion is zero.
    """

    quaternion: NDArray[np.float64]
    translation: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name, length in (("quaternion", 4), ("translation", 3)):
            given = np.array(getattr(self, name), dtype=np.float64)
            if given.shape != (length,):
                raise ParameterError(f"{name} has shape {given.shape}, expected ({length},)", name=name)
            if not np.isfinite(given).all():
                raise ParameterError(f"{name} is {given.tolist()}, it must be finite", name=name)
            if length == 4:
                if not given.any():
                    raise ParameterError("quaternion is zero, it has no direction", name=name)
                if not are_accepted(given[None])[0]:
                    # Scaled first, because the square of 1e-200 is 0, and that of 1e200 is inf.
                    scaled = given / np.abs(given).max()
                    given = scaled / np.sqrt(scaled @ scaled)
            given.flags.writeable = False
            object.__setattr__(self, name, given)

    @property
    def tilt(self) -> float:
        """The angle between the z axes of the two frames, radians."""
        return math.acos(max(-1.0, min(1.0, float(self.matrix[2, 2]))))

    @classmethod
    def identity(cls) -> Rigid:
        """The transform that changes nothing."""
        return cls.from_pose(IDENTITY_POSE)

    @classmethod
    def from_pose(cls, pose: Pose) -> Rigid:
        """Create a transform from a pose without checks: it must be finite, with a quaternion that tf2 accepts."""
        rigid = object.__new__(cls)
        both = np.array(pose)
        both.flags.writeable = False
        object.__setattr__(rigid, "quaternion", both[3:])
        object.__setattr__(rigid, "translation", both[:3])
        return rigid

    @classmethod
    def from_rpy(cls, roll: float, pitch: float, yaw: float, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Rigid:
        """Create a transform from roll, pitch and yaw, radians, about the fixed axes x, y and z of ``target`` in order.

        This is the convention of ``static_transform_publisher`` (``tf2::Quaternion::setRPY``).

        Raises
        ------
        ParameterError
            As the class does.
        """
        angles = {"roll": roll, "pitch": pitch, "yaw": yaw}
        for name, angle in angles.items():
            if not math.isfinite(angle):
                raise ParameterError(f"{name} is {angle} rad, it must be finite", name=name)
        (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a / 2), math.cos(a / 2)) for a in angles.values())
        quaternion = (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )
        return cls(np.array(quaternion), np.array(translation, dtype=np.float64))

    @property
    def rotation(self) -> Rigid:
        """The same rotation, without the translation."""
        return Rigid(self.quaternion, np.zeros(3))

    @property
    def pose(self) -> Pose:
        """The transform as seven floats: translation, then quaternion."""
        x, y, z = self.translation.tolist()
        i, j, k, r = self.quaternion.tolist()
        return (x, y, z, i, j, k, r)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The rotation, (3, 3) float64; its columns are the axes of ``source`` seen from ``target``."""
        return rotation_matrices(self.quaternion)

    @property
    def rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw in radians, as for `from_rpy`; pitch in -pi/2 to pi/2.

        At a pitch of +-pi/2 only the sum or the difference of the others is determined: roll is then 0.
        """
        m = self.matrix
        pitch = math.asin(min(1.0, max(-1.0, -float(m[2, 0]))))
        if abs(m[2, 0]) > 1 - 1e-12:
            return 0.0, pitch, math.atan2(-float(m[0, 1]), float(m[1, 1]))
        return (
            math.atan2(float(m[2, 1]), float(m[2, 2])),
            pitch,
            math.atan2(float(m[1, 0]), float(m[0, 0])),
        )

    def compose(self, other: Rigid) -> Rigid:
        """Return ``a_from_c``, for ``a_from_b.compose(b_from_c)``."""
        return Rigid.from_pose(compose_poses(self.pose, other.pose))

    def product(self, other: Rigid) -> Rigid:
        """Compose two lookups: tf2 multiplies these as matrices, and the quaternion has unit length.

        `compose` multiplies quaternions as published, as tf2 does within a lookup: one that is 0.1 % too long scales by
        0.2 %.
        """
        # By far quicker than NumPy for nine numbers, and the same on every machine.
        a, (b, c, d) = _rows(self.quaternion.tolist()), _rows(other.quaternion.tolist())
        x, y, z = other.translation.tolist()
        i, j, k, r = _quaternion(
            [
                (
                    p * b[0] + q * c[0] + s * d[0],
                    p * b[1] + q * c[1] + s * d[1],
                    p * b[2] + q * c[2] + s * d[2],
                )
                for p, q, s in a
            ]
        )
        length = math.sqrt(i * i + j * j + k * k + r * r)
        u, v, w = self.translation.tolist()
        (p, q, s), (e, f, g), (h, m, n) = a
        return Rigid.from_pose(
            (
                p * x + q * y + s * z + u,
                e * x + f * y + g * z + v,
                h * x + m * y + n * z + w,
                i / length,
                j / length,
                k / length,
                r / length,
            )
        )

    def inverse(self) -> Rigid:
        """Return ``source_from_target``."""
        return Rigid.from_pose(inverse_pose(self.pose))

    def as_float32(self) -> NDArray[np.float32]:
        """Return the rows of the rotation, then the translation, (4, 3), as tf2_sensor_msgs computes them, in float32.

        Source of the rule: ``doTransform`` for PointCloud2 in tf2_sensor_msgs, and ``toRotationMatrix`` of Eigen's
        ``QuaternionBase``: the quaternion is rounded to float32 and not normalised; each product and each sum is
        rounded.
        """
        x, y, z, w = _FOUR.unpack(_as_float32(_FOUR, self.quaternion.tolist()))
        # A product or a sum of two float32 numbers, computed in float64 and then rounded, equals the float32 result.
        # Twice x, y and z are exact.
        products = (2 * x * x, 2 * x * y, 2 * x * z, 2 * x * w, 2 * y * y, 2 * y * z, 2 * y * w, 2 * z * z, 2 * z * w)
        xx, xy, xz, xw, yy, yz, yw, zz, zw = _NINE.unpack(_as_float32(_NINE, products))
        one, two, three = _THREE.unpack(_as_float32(_THREE, (yy + zz, xx + zz, xx + yy)))
        rotation = (1 - one, xy - zw, xz + yw, xy + zw, 1 - two, yz - xw, xz - yw, yz + xw, 1 - three)
        return np.frombuffer(_as_float32(_TWELVE, (*rotation, *self.translation.tolist())), np.float32).reshape(4, 3)

    def apply(self, points: NDArray[Any]) -> NDArray[Any]:
        """Transform points from ``source`` to ``target``.

        Parameters
        ----------
        points
            (N, 3) coordinates in ``source``, metres, of any real dtype and any strides; not changed.

        Returns
        -------
        ndarray
            (N, 3) coordinates in ``target``, C order. If ``points`` is float32: computed in float32, to the bit as
            tf2_sensor_msgs transforms a PointCloud2 (every product and every sum is rounded, from left to right).
            Else computed in float64. A point with a NaN becomes NaN in every coordinate; an infinite coordinate
            becomes infinite or NaN (0 times inf), as in any matrix product, also upstream's.
        """
        narrow = points.dtype == np.float32
        *rotation, translation = self.as_float32() if narrow else (*self.matrix, self.translation)
        result = np.empty(points.shape, translation.dtype)
        # Column by column, without BLAS, so that the result does not depend on the number of points or threads.
        with np.errstate(invalid="ignore", over="ignore"):
            x, y, z = np.ascontiguousarray(points.T, translation.dtype)
            for column, (row, offset) in enumerate(zip(rotation, translation, strict=True)):
                result[:, column] = x * row[0] + y * row[1] + z * row[2] + offset
        return result


class MovingTransform(NamedTuple):
    """Transforms over time, and the time of each point of a cloud.

    Between two nodes, the transform is a polynomial of second degree through three rows: those of both nodes, and that
    of the middle between them. Its error is 0.008 times the third power of the angle by which the sensor turns between
    the nodes. A moved point is ``start p + s * (rate p + s * bend p)``: the first product in float64, the others, which
    are small, in float32.

    Attributes
    ----------
    times
        One value for each point, of the shape of the coordinates and of any of PointField's datatypes.
    offset, unit
        A point was measured at ``(value - offset) * unit`` seconds. NaN: its time is unknown.
    node_times
        (N,) seconds, increasing, at least two.
    rows
        (2 N - 1, 12): transforms at the nodes, and in the middle between each node and the next. A row holds the rows
        of the rotation, then the translation in metres; NaN where there is no transform.
    timed
        Whether every point with coordinates has a time between the first and the last node. The compiled loops then
        drop points that are too high or too low at any of these times without reading their own.
    """

    times: NDArray[Any]
    offset: float
    unit: float
    node_times: NDArray[np.float64]
    rows: NDArray[np.float64]
    timed: bool = False

    def as_float32(self) -> MovingTransform:
        """Return itself: it is as the loops apply it, like the result of `Rigid.as_float32`."""
        return self
