"""The angles of glibc 2.31 to 2.40, in both loops, to the bit."""

from __future__ import annotations

import hashlib
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.core import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Of the angles below, as glibc 2.36's atan2f returned them on x86-64.
DIGEST = "2f348e99fd8ae2db7109eb7f6e2aef124b3847674a8c75211825c9be8f996398"


def recorded_points() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Y and x, the same anywhere: float32 of any bits, then float32 from 0.5 to 2 of either sign; no NaN."""
    numbers = np.arange(400_000, dtype=np.uint32)
    bits = [numbers * np.uint32(2654435761), numbers * np.uint32(2246822519) + np.uint32(374761393)]
    y, x = (
        np.concatenate([part, (part & 0x80FFFFFF) | 0x3F000000]).astype(np.uint32).view(np.float32) for part in bits
    )
    numbered = ~(np.isnan(y) | np.isnan(x))
    return y[numbered], x[numbered]


@pytest.mark.usefixtures("loops")
def test_angles_are_those_that_glibc_once_returned() -> None:
    y, x = recorded_points()
    angle = np.empty_like(x)
    kernel.angles(x, y, angle, True)
    assert hashlib.sha256(angle.astype("<f4").tobytes()).hexdigest() == DIGEST
    correct = np.empty_like(x)
    kernel.angles(x, y, correct)
    # From 0.5 to 2 a sixth of all angles differ, each by the last bit.
    steps = np.abs(angle.view(np.int32) - correct.view(np.int32))
    assert set(np.unique(steps).tolist()) == {0, 1}
    assert 0.1 < np.count_nonzero(steps[-400_000:]) / 400_000 < 0.2


#: y, x and their angle.
SPECIAL = [
    (0.0, 0.0, 0.0), (-0.0, 0.0, -0.0), (0.0, -0.0, math.pi), (-0.0, -0.0, -math.pi),
    (0.0, 1.0, 0.0), (-0.0, 1e-45, -0.0), (0.0, -1.0, math.pi), (-0.0, -math.inf, -math.pi),
    (1e-45, 0.0, math.pi / 2), (-1.0, -0.0, -math.pi / 2), (math.inf, -3e38, math.pi / 2),
    (-math.inf, 0.0, -math.pi / 2),
    (3e38, math.inf, 0.0), (-1.0, math.inf, -0.0), (1.0, -math.inf, math.pi), (-3e38, -math.inf, -math.pi),
    (math.inf, math.inf, math.pi / 4), (-math.inf, math.inf, -math.pi / 4),
    (math.inf, -math.inf, 3 * math.pi / 4), (-math.inf, -math.inf, -3 * math.pi / 4),
    (1e-45, -1.0, math.pi), (1e-45, 1.0, 1e-45), (1.0, 1e-45, math.pi / 2),
    # Not the nearest float32 to pi / 2.
    (1.0, -1e-45, 1.5707963), (1.0, -1e-30, 1.5707963), (1.0, -2.0**-25, 1.5707963),
    (math.nan, 0.0, math.nan), (0.0, math.nan, math.nan), (math.inf, math.nan, math.nan),
    (math.nan, -1.0, math.nan),
]  # fmt: skip


@pytest.mark.usefixtures("loops")
def test_zeros_and_infinities_and_what_is_next_to_them() -> None:
    y, x, expected = np.array(SPECIAL, np.float32).T
    angle = np.empty_like(x)
    kernel.angles(x.copy(), y.copy(), angle, True)
    np.testing.assert_array_equal(angle, expected)
    known = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(angle[known]), np.signbit(expected[known]))
