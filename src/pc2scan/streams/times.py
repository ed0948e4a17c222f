"""Converts times of messages to NumPy's."""

from __future__ import annotations

import numpy as np

__all__ = ["datetime64"]

#: The smallest of 64 bits is NumPy's "not a time".
_LARGEST = 2**63 - 1


def datetime64(nanoseconds: int) -> np.datetime64:
    """Return nanoseconds since 1970 as ``numpy.datetime64``; ``NaT`` for values beyond 64 bits."""
    return np.datetime64(nanoseconds, "ns") if abs(nanoseconds) <= _LARGEST else np.datetime64("NaT", "ns")
