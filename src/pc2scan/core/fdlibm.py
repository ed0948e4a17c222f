"""``atan2f`` of glibc 2.31 to 2.40 on x86-64, in NumPy: fdlibm's algorithm, with every operation rounded to float32.

These versions return other float32 values than glibc 2.41 and later, which round correctly, for 16 % of points. The
results depend on the order of the operations, and on none of them being fused: x86-64's glibc has no variant of
``atan2f`` with fused operations, whatever the processor. ``loops/angles.h`` has the same steps for compilers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: The quotients from which on the next row of the reduction applies.
_FROM = np.array([7 / 16, 11 / 16, 19 / 16, 39 / 16, 2.0**25], np.float32)

#: Argument reduction: ``atan(t) = high + low + atan((a * t + b) / (c * t + d))``, where ``high + low`` is the arc
#: tangent of 0, 1/2, 1, 3/2 and infinity. Rows: a, b, c, d, high, low.
_REDUCTION = np.array(
    [
        [1, 0, 0, 1, 0, 0],
        [2, -1, 1, 2, 4.6364760399e-01, 5.0121582440e-09],
        [1, -1, 1, 1, 7.8539812565e-01, 3.7748947079e-08],
        [1, -1.5, 1.5, 1, 9.8279368877e-01, 3.4473217170e-08],
        [0, -1, 1, 0, 1.5707962513, 7.5497894159e-08],
        [0, 0, 0, 1, 1.5707962513, 7.5497894159e-08],
    ],
    np.float32,
)

#: Coefficients of ``(t - atan(t)) / t`` in powers of ``t * t``, from the first on.
_COEFFICIENTS = np.array(
    [
        3.3333334327e-01,
        -2.0000000298e-01,
        1.4285714924e-01,
        -1.1111110449e-01,
        9.0908870101e-02,
        -7.6918758452e-02,
        6.6610731184e-02,
        -5.8335702866e-02,
        4.9768779427e-02,
        -3.6531571299e-02,
        1.6285819933e-02,
    ],
    np.float32,
)

_PI, _PI_LOW = np.float32(3.1415927410), np.float32(-8.7422776573e-08)
_HALF_PI, _QUARTER_PI = np.float32(1.5707963705), np.float32(0.78539818525)


@np.errstate(all="ignore")
def atan2f(y: NDArray[np.float32], x: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the angles of points, radians.

    Parameters
    ----------
    y, x
        (M,), any values.

    Returns
    -------
    (M,) float32. NaN where a coordinate is.
    """
    up, across, behind = np.abs(y), np.abs(x), np.signbit(x)
    quotient: NDArray[np.float32] = np.divide(up, across)
    ahead = _atan(quotient)
    turn = np.where(behind, _PI - (ahead - _PI_LOW), ahead)
    # The quotient does not determine the angle on the axes and at infinity.
    turn[(across == 0) | (up == np.inf)] = _HALF_PI
    far = (across == np.inf) & (up == np.inf)
    turn[far] = np.where(behind[far], np.float32(3) * _QUARTER_PI, _QUARTER_PI)
    along = up == 0
    turn[along] = np.where(behind[along], _PI, np.float32(0))
    turn[np.isnan(x) | np.isnan(y)] = np.nan
    angle: NDArray[np.float32] = np.copysign(turn, y)
    return angle


def _atan(t: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the arc tangent of quotients from 0 to infinity, radians."""
    a, b, c, d, high, low = _REDUCTION[np.searchsorted(_FROM, t, side="right")].T
    t = np.minimum(t, _FROM[-1])
    s = (a * t + b) / (c * t + d)
    z = s * s
    w = z * z
    odd, even = (_polynomial(w, _COEFFICIENTS[first::2]) for first in (0, 1))
    angle: NDArray[np.float32] = high - ((s * (z * odd + w * even) - low) - s)
    return angle


def _polynomial(w: NDArray[np.float32], coefficients: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a polynomial by Horner's rule; coefficients begin with the constant."""
    total = np.full_like(w, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = coefficient + w * total
    return total
