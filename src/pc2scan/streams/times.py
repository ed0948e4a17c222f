"""Times of messages as NumPy's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

#: The smallest of 64 bits is NumPy's "not a time".
_LARGEST = 2**63 - 1


def datetime64(nanoseconds: int) -> np.datetime64:
    """Return nanoseconds since 1970 as ``numpy.datetime64``; ``NaT`` for values beyond 64 bits."""
    return np.datetime64(nanoseconds, "ns") if abs(nanoseconds) <= _LARGEST else np.datetime64("NaT", "ns")


class Stamped:
    """A message whose times are also NumPy's."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def log_time_ns(self) -> int:
            """The time of recording, nanoseconds since 1970."""

        @property
        def stamp_ns(self) -> int:
            """``header.stamp``, nanoseconds since 1970."""

    @property
    def stamp(self) -> np.datetime64:
        """``header.stamp`` as ``numpy.datetime64`` in nanoseconds."""
        return datetime64(self.stamp_ns)

    @property
    def log_time(self) -> np.datetime64:
        """The time of recording as ``numpy.datetime64`` in nanoseconds; ``NaT`` if that cannot represent it."""
        return datetime64(self.log_time_ns)
