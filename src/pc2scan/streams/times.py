"""Times of messages as NumPy has them."""

from __future__ import annotations

import numpy as np

__all__ = ["datetime64"]

#: The smallest of 64 bits is NumPy's "not a time".
_LARGEST = 2**63 - 1


def datetime64(nanoseconds: int) -> np.datetime64:
    """Nanoseconds since 1970 as ``numpy.datetime64`` in nanoseconds; ``NaT`` for what 64 bits cannot hold."""
    return np.datetime64(nanoseconds, "ns") if abs(nanoseconds) <= _LARGEST else np.datetime64("NaT", "ns")
