"""The request for scans of several messages."""

from __future__ import annotations

import math
import re
from datetime import timedelta
from numbers import Real
from typing import NamedTuple, TypeAlias

from pc2scan.errors import UsageError

__all__ = ["Combining", "Duration"]

#: A time: seconds, text with or without a unit, or a timedelta.
Duration: TypeAlias = "str | float | timedelta"

#: The largest time in seconds, and the largest number of messages, that one scan may be made of.
_LONGEST = 86_400.0
_MOST = 100_000

_CLOUDS = r"(\d+) ?(?:clouds?|scans?|messages?)"


class Combining(NamedTuple):
    """Which messages become one scan.

    Attributes
    ----------
    lead
        The topic whose stamps the scans have; empty: the topic that is named first.
    window_ns
        The largest difference between the stamps of another topic and of the leading one, nanoseconds; None: half the
        median period.
    span_ns, count
        A scan has the points of this many nanoseconds, or of this many messages of each topic, counted back from its
        stamp; both 0: of one message, or of its interval.
    every_ns
        The length of an interval that becomes one scan, nanoseconds; 0: each message of the leading topic becomes one.
    rebin
        Whether LaserScans are converted instead of clouds.
    """

    lead: str = ""
    window_ns: int | None = None
    span_ns: int = 0
    count: int = 0  # type: ignore[assignment]  # instead of the tuple's method
    every_ns: int = 0
    rebin: bool = False

    @classmethod
    def of(
        cls,
        *,
        lead: str = "",
        window: Duration | None = None,
        accumulate: Duration | None = None,
        every: Duration | None = None,
        rebin: bool = False,
    ) -> Combining:
        """Parse the values that a user gives.

        Parameters
        ----------
        accumulate
            A time, or a number of clouds as ``10clouds``.

        Raises
        ------
        UsageError
            If a value cannot be parsed, or is out of range.
        """
        count = span_ns = 0
        if isinstance(accumulate, str) and (written := re.fullmatch(_CLOUDS, accumulate.strip())):
            count = int(written[1])
            if not 1 <= count <= _MOST:
                raise UsageError(f"`accumulate` is {accumulate!r}, it must be 1 to {_MOST:,} clouds")
        elif accumulate is not None:
            span_ns = _nanoseconds("accumulate", accumulate, "; or a number of clouds (10clouds)")
        every_ns = 0 if every is None else _nanoseconds("every", every)
        window_ns = None if window is None else _nanoseconds("window", window)
        return cls(lead, window_ns, span_ns, count, every_ns, rebin)

    @property
    def accumulates(self) -> bool:
        """Whether scans are made of several messages of each topic."""
        return bool(self.span_ns or self.count or self.every_ns)


def _nanoseconds(name: str, value: Duration, more: str = "") -> int:
    """Parse a time; ``more`` is added to the hint of the error."""
    from pc2scan.core.quantities import EXAMPLES, quantity  # noqa: PLC0415  # most scans are made of one message

    seconds: float | None
    if isinstance(value, str):
        seconds = quantity(value, "s")
    elif isinstance(value, timedelta):
        seconds = value.total_seconds()
    elif isinstance(value, Real) and not isinstance(value, bool):
        seconds = float(value)
    else:
        seconds = None
    if seconds is None:
        raise UsageError(f"`{name}` is {value!r}, which is not a time", hint=EXAMPLES["s"] + more)
    if not (math.isfinite(seconds) and 1e-9 <= seconds <= _LONGEST):
        raise UsageError(f"`{name}` is {value!r}, it must be more than 0 and at most {_LONGEST:g} s")
    return round(seconds * 1e9)
