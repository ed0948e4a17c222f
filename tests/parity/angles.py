"""``angle_rounding: glibc-2.40`` against the ``atan2f`` of this machine's glibc, over random and adversarial points."""

from __future__ import annotations

import ctypes
import platform
import sys
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core import fdlibm, kernel

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

#: Quotients at which the algorithm, or glibc's treatment of its result, changes.
_EDGES = [7 / 16, 11 / 16, 1.0, 19 / 16, 39 / 16, 2.0**25, 2.0**26, 2.0**60, 2.0**61, 2.0**-29, 2.0**-60, 2.0**-61]
_SPECIAL = np.array(
    [0, 1e-45, 1.1754942e-38, 1.1754944e-38, 1e-30, 0.5, 1, 2, 3, 1e30, 1.7e38, 3.4028235e38, np.inf, np.nan],
    np.float32,
)


def why_not() -> str:
    """Why this machine's ``atan2f`` is none to compare with; empty if it is one."""
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return f"the results of glibc on x86-64 are compared, this is {sys.platform} on {platform.machine()}"
    try:
        version = ctypes.CDLL(None).gnu_get_libc_version
    except AttributeError:
        return "there is no glibc"
    version.restype = ctypes.c_char_p
    found = tuple(map(int, version().decode().split(".")[:2]))
    return "" if (2, 31) <= found <= (2, 40) else f"glibc is {found[0]}.{found[1]}, 2.31 to 2.40 are compared"


@cache
def _libm() -> Callable[[float, float], float]:
    function = ctypes.CDLL("libm.so.6").atan2f
    function.argtypes = (ctypes.c_float, ctypes.c_float)
    function.restype = ctypes.c_float
    return function


def glibc_atan2f(y: Floats, x: Floats) -> Floats:
    """What this machine's ``atan2f`` returns."""
    return np.fromiter(map(_libm(), y.tolist(), x.tolist()), np.float32, x.size)


def points(rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    """About ``count`` points, y and x, of all kinds."""
    part = count // 8

    def any_bits() -> Floats:
        return rng.integers(0, 1 << 32, part, dtype=np.uint32).view(np.float32)

    def signs() -> NDArray[np.float64]:
        return rng.choice([-1.0, 1.0], part)

    def beside(values: NDArray[np.float64]) -> Floats:
        """Values, or one of the next three float32 on either side."""
        bits = values.astype(np.float32).view(np.int32)
        return (bits + rng.integers(-3, 4, part, dtype=np.int32)).view(np.float32)

    wide = signs() * 10.0 ** rng.uniform(-38, 38, part)
    near = signs() * 10.0 ** rng.uniform(-1, 2, part)
    edge = rng.choice(_EDGES, part) * signs()
    beams = rng.choice([90, 360, 720, 1024, 36_000], part)
    angle = rng.integers(0, 36_000, part) * (2 * np.pi / beams)
    subnormal = (rng.integers(0, 1 << 23, (2, part), dtype=np.uint32)).view(np.float32) * signs().astype(np.float32)
    kinds = [
        (any_bits(), any_bits()),
        (rng.normal(scale=10, size=part), rng.normal(scale=10, size=part)),
        (beside(wide * edge), beside(wide)),
        (beside(near * edge), beside(near)),
        (beside(near * np.sin(angle)), beside(near * np.cos(angle))),
        (near * 2.0 ** rng.uniform(20, 30, part), beside(near)),
        (rng.integers(-99, 100, part), rng.integers(-99, 100, part)),
        (subnormal[0], np.where(rng.random(part) < 0.5, subnormal[1], wide)),
    ]
    special = np.concatenate([_SPECIAL, -_SPECIAL])
    kinds.append((np.repeat(special, special.size), np.tile(special, special.size)))
    y, x = (np.concatenate([kind[side] for kind in kinds]).astype(np.float32) for side in (0, 1))
    return y, x


def differing(y: Floats, x: Floats, expected: Floats) -> NDArray[np.intp]:
    """Indices of points whose angle, compiled or in NumPy, is not the expected one to the bit; NaN is NaN."""
    compiled = np.empty_like(x)
    kernel.angles(x, y, compiled, True)
    wrong = np.zeros(x.size, bool)
    for found in (compiled, fdlibm.atan2f(y, x)):
        wrong |= (found.view(np.int32) != expected.view(np.int32)) & ~(np.isnan(found) & np.isnan(expected))
    return np.flatnonzero(wrong)
