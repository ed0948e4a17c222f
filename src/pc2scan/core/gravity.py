"""The direction of up: estimated from the gyroscope and the accelerometer of an IMU, and used to level a frame.

The estimate is a complementary filter: the gyroscope measures how the IMU turns, but drifts; the accelerometer measures
the direction of up, but only while the IMU is not accelerated. The filter rotates the direction of up by the gyroscope,
and moves it slowly towards the accelerometer's.

Sources of the rules:

- R. Mahony, T. Hamel, J.-M. Pflimlin: Nonlinear complementary filters on the special orthogonal group. IEEE
  Transactions on Automatic Control 53 (2008), 1203-1218: the explicit complementary filter with bias correction. With
  gravity as its only direction it needs no rotation: with the estimated direction ``u``, the measured one ``v``, the
  gyroscope's ``w`` and its bias ``b``, the error is ``e = v x u``; ``u' = u x (w - b + k_p e)`` and ``b' = -k_i e``.
- R. G. Valenti, I. Dryanovski, J. Xiao: Keeping a good attitude. Sensors 15 (2015), 19302-19330 (the filter of
  imu_tools): the gain falls where the length of the acceleration is not that of gravity.

The whole recording is available, so the filter runs forward, backward and forward again, each run from the end of the
one before, and the last two results are averaged, because one lags behind and the other runs ahead. The first run
begins with the bias for which the first seconds fit best to a constant direction of up.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from .rigid import Rigid, rotation_matrices

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

#: A direction of unit length: x, y, z.
Up: TypeAlias = tuple[float, float, float]

#: The tangent of the angle to the vertical below which an axis has no heading.
_VERTICAL = 1e-12


def up_in(world_from_frame: Sequence[float]) -> Up:
    """Return the direction of the world's z axis in a frame, by a quaternion x, y, z, w."""
    x, y, z, w = world_from_frame
    return _unit((2 * (x * z - w * y), 2 * (y * z + w * x), w * w + z * z - x * x - y * y))


def tilt(up: Up) -> float:
    """Return the angle between a frame's z axis and up, radians: 0 of a level frame, pi of one that is upside down."""
    return math.atan2(math.hypot(up[0], up[1]), up[2])


def upright_rotation(up: Up) -> Rigid:
    """Return the rotation ``frame_from_level``, where the level frame has the yaw of the frame, and no roll and pitch.

    Parameters
    ----------
    up
        The direction of up in the frame.

    Notes
    -----
    With ``world_from_frame = Rz(yaw) Ry(pitch) Rx(roll)``, as `Rigid.rpy` has them, this is ``Rx(-roll) Ry(-pitch)``,
    whatever the yaw. So the level x axis is the frame's own, projected onto the horizontal plane. At a pitch of
    +-pi/2, where that has no direction, roll is 0, as for `Rigid.rpy`: the level y axis is the frame's own.
    """
    x, y, z = up
    across = math.hypot(y, z)
    roll = math.atan2(y, z) if across > _VERTICAL * abs(x) else 0.0
    pitch = math.atan2(-x, across)
    (sr, cr), (sp, cp) = ((math.sin(-angle / 2), math.cos(angle / 2)) for angle in (roll, pitch))
    return Rigid.from_pose((0.0, 0.0, 0.0, sr * cp, cr * sp, sr * sp, cr * cp))


def _unit(direction: Sequence[float]) -> Up:
    length = math.hypot(*direction)
    x, y, z = (part / length for part in direction)
    return (x, y, z)


#: The longest time between two samples, nanoseconds, for which the turn in between can be computed.
LONGEST_GAP_NS = 250_000_000

#: How long the accelerometer needs to correct the direction of up, seconds.
TIME_CONSTANT = 20.0

#: The gains; the bias is critically damped.
_PROPORTIONAL = 1 / TIME_CONSTANT
_INTEGRAL = _PROPORTIONAL**2 / 4

#: Deviations of the length of the acceleration from gravity, as a share of it: the gain is full up to the first, and 0
#: from the second on.
_FULL, _NONE = 0.1, 0.2

#: Seconds that the first bias is fitted to, and its expected size, radians per second; the expected deviation of the
#: acceleration from gravity, as a share of it, in the mean of a second.
_FIRST = 30.0
_USUAL_BIAS = 0.03
_USUAL_DEVIATION = 0.05

#: The signs of the columns of samples when time runs backward.
_BACKWARD = (-1, -1, -1, -1, 1, 1, 1)

#: How many samples are converted to lists at a time: Python's numbers take four times as much memory.
_BLOCK = 10_000


class _State(NamedTuple):
    """The state of the filter: up in the IMU's frame, and the bias of the gyroscope, radians per second."""

    up: tuple[float, ...]
    bias: tuple[float, ...]

    def reverse(self) -> _State:
        """The state for time that runs backward: rotations and the bias change their sign."""
        return self._replace(bias=tuple(-value for value in self.bias))


def up_by_gravity(
    stamps_ns: NDArray[np.int64], turning: NDArray[np.float64], acceleration: NDArray[np.float64], gravity: float
) -> NDArray[np.float64]:
    """Return the direction of up at every sample.

    Parameters
    ----------
    stamps_ns
        (N,) increasing, N > 0. After a gap of more than `LONGEST_GAP_NS` the filter begins again.
    turning
        (N, 3) angular velocity, radians per second.
    acceleration
        (N, 3) what the accelerometer measures: at rest, up with the length ``gravity``. Any unit.
    gravity
        The length of the acceleration at rest.

    Returns
    -------
    (N, 3) float64
        Directions of unit length in the IMU's frame.
    """
    seconds = (stamps_ns - stamps_ns[:1]) / 1e9
    samples = np.column_stack([seconds, turning, acceleration / gravity])
    later: NDArray[np.float64] = np.empty((len(samples), 3))
    earlier = np.empty_like(later)
    bias: tuple[float, ...] = (0.0, 0.0, 0.0)
    gaps = np.flatnonzero(np.diff(stamps_ns) > LONGEST_GAP_NS) + 1
    for begin, end in pairwise([0, *gaps.tolist(), len(samples)]):
        part = samples[begin:end]
        state = _filter(part, None, _first_bias(part, bias), later[begin:end])
        state = _filter(part[::-1] * _BACKWARD, state.up, state.reverse().bias, earlier[begin:end][::-1])
        bias = _filter(part, state.up, state.reverse().bias, later[begin:end]).bias
    both = later + earlier
    lengths = np.sqrt(np.einsum("ni,ni->n", both, both))[:, np.newaxis]
    # Two opposite directions have no mean, so one of them is returned.
    return np.where(lengths > 1e-9, both / np.maximum(lengths, 1e-9), later)


def _first_bias(samples: NDArray[np.float64], expected: tuple[float, ...]) -> tuple[float, ...]:
    """Return the bias of the gyroscope for which the first seconds fit best to gravity; see `_filter` for the rows.

    ``R`` is the rotation from the IMU to its first pose, by the gyroscope alone. If the rotation is correct, ``R a`` is
    gravity; a bias turns it by ``S b``, where ``S`` is the integral of ``R``. Solved by least squares, with the
    expected bias as one more observation, because a bias about the vertical axis has no effect.
    """
    samples = samples[: int(samples[:, 0].searchsorted(samples[0, 0] + _FIRST, "right"))]
    steps = np.diff(samples[:, 0], prepend=samples[0, 0])
    lengths = np.sqrt(np.square(samples[:, 4:]).sum(axis=1))
    weights = np.sqrt(steps * (np.abs(lengths - 1) < _NONE)) / _USUAL_DEVIATION
    bias = np.array(expected)
    for _ in range(3):
        rotations = _rotate(samples[:, 1:4] - bias, steps)
        shown = np.einsum("nij,nj->ni", rotations, samples[:, 4:])
        gravity = (weights[:, np.newaxis] ** 2 * shown).sum(axis=0)
        if not gravity.any():
            break
        gravity /= np.linalg.norm(gravity)
        integrals = (rotations * steps[:, np.newaxis, np.newaxis]).cumsum(axis=0)
        # A bias b turns the measured direction by S b: by S b x gravity.
        columns = np.cross(integrals, gravity, axisa=1, axisb=0, axisc=1)
        unknown = np.concatenate([np.broadcast_to(np.eye(3), columns.shape), columns], axis=2)
        weighted = weights[:, np.newaxis, np.newaxis] * unknown
        prior = np.hstack([np.zeros((3, 3)), np.eye(3) / _USUAL_BIAS])
        left = np.concatenate([weighted.reshape(-1, 6), prior])
        right = np.concatenate([(weights[:, np.newaxis] * shown).ravel(), (np.array(expected) - bias) / _USUAL_BIAS])
        bias = bias + np.linalg.lstsq(left, right, rcond=None)[0][3:]
    return tuple(bias.tolist())


def _rotate(turning: NDArray[np.float64], steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotations (N, 3, 3) from each sample to the first one, from angular velocities."""
    half = (turning + np.vstack([turning[:1], turning[:-1]])) / 4 * steps[:, np.newaxis]
    x, y, z, w = 0.0, 0.0, 0.0, 1.0
    quaternions = np.empty((len(half), 4))
    for place, (i, j, k) in enumerate(half.tolist()):
        x, y, z, w = (
            x + w * i + y * k - z * j,
            y + w * j + z * i - x * k,
            z + w * k + x * j - y * i,
            w - x * i - y * j - z * k,
        )
        length = math.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x / length, y / length, z / length, w / length
        quaternions[place] = x, y, z, w
    return np.moveaxis(rotation_matrices(quaternions.T), -1, 0)


def _rows(samples: NDArray[np.float64]) -> Iterator[list[float]]:
    for begin in range(0, len(samples), _BLOCK):
        yield from samples[begin : begin + _BLOCK].tolist()


def _filter(
    samples: NDArray[np.float64], up: tuple[float, ...] | None, bias: tuple[float, ...], out: NDArray[np.float64]
) -> _State:
    """Filter rows of a time, an angular velocity and an acceleration in units of gravity.

    If ``up`` is None, the gain begins high and falls with time, so that up is at first the mean of the accelerometer's
    directions.
    """
    bx, by, bz = bias
    last, lx, ly, lz, ax, ay, az = samples[0].tolist()
    ux, uy, uz = up or (ax, ay, az)
    began = -math.inf if up else last
    directions: list[tuple[float, float, float]] = []
    place = 0
    for now, wx, wy, wz, ax, ay, az in _rows(samples):
        step = now - last
        length = math.sqrt(ax * ax + ay * ay + az * az)
        deviation = abs(length - 1.0)
        trust = 0.0 if deviation >= _NONE else min(1.0, (_NONE - deviation) / (_NONE - _FULL))
        ex = ey = ez = 0.0
        if trust > 0:
            # The cross product of the measured and the estimated direction.
            vx, vy, vz = ax / length, ay / length, az / length
            ex, ey, ez = vy * uz - vz * uy, vz * ux - vx * uz, vx * uy - vy * ux
        gain = trust * max(_PROPORTIONAL, 1.0 / (now - began + step + 1e-9))
        slow = step * trust * _INTEGRAL
        bx, by, bz = bx - slow * ex, by - slow * ey, bz - slow * ez
        # Between two samples the IMU turned at their mean rate.
        tx = ((wx + lx) / 2 - bx + gain * ex) * step
        ty = ((wy + ly) / 2 - by + gain * ey) * step
        tz = ((wz + lz) / 2 - bz + gain * ez) * step
        ux, uy, uz = ux + uy * tz - uz * ty, uy + uz * tx - ux * tz, uz + ux * ty - uy * tx
        length = math.sqrt(ux * ux + uy * uy + uz * uz) or 1.0
        ux, uy, uz = ux / length, uy / length, uz / length
        last, lx, ly, lz = now, wx, wy, wz
        directions.append((ux, uy, uz))
        if len(directions) == _BLOCK:
            out[place : place + _BLOCK] = directions
            place += _BLOCK
            directions.clear()
    out[place:] = np.array(directions).reshape(-1, 3)
    return _State((ux, uy, uz), (bx, by, bz))
