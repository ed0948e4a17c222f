"""The request for scans of several messages."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import UsageError
from pc2scan.options.values import nanoseconds_of

if TYPE_CHECKING:
    from pc2scan.options.option import Period

#: The largest number of messages that one scan may be made of.
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
        window: Period | None = None,
        accumulate: Period | None = None,
        every: Period | None = None,
        rebin: bool = False,
        **_others: object,
    ) -> Combining:
        """Parse the values that a user gives; other options are ignored.

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
            span_ns = nanoseconds_of("accumulate", accumulate, "; or a number of clouds (10clouds)")
        every_ns = 0 if every is None else nanoseconds_of("every", every)
        window_ns = None if window is None else nanoseconds_of("window", window)
        return cls(lead, window_ns, span_ns, count, every_ns, rebin)

    @property
    def accumulates(self) -> bool:
        """Whether scans are made of several messages of each topic."""
        return bool(self.span_ns or self.count or self.every_ns)
