"""A time in a recording, in the forms that users have."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from decimal import Decimal
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from pc2scan.core.quantities import PARTS_OF_SECOND
from pc2scan.errors import UsageError

if TYPE_CHECKING:
    import numpy as np

    #: The types that a time may have; see `TimeBound.of`.
    Time: TypeAlias = str | float | datetime | timedelta | np.datetime64 | np.timedelta64 | np.number[Any]

#: Larger numbers are points in time, not seconds from the beginning: no recording lasts three years.
_ABSOLUTE_SECONDS = 100_000_000
#: Larger whole numbers are nanoseconds: as seconds they would be after the year 5000.
_ABSOLUTE_NANOSECONDS = 100_000_000_000

_SECONDS = r"@?(\d+\.?\d*|\.\d+) ?([mun]?s)?"
#: A date and time, with or without a time zone. Its groups: the fraction of the seconds, the time zone.
_DATE_AND_TIME = r"(\d{4}-\d\d-\d\d[T ][\d:]+?)(?:[.,](\d+))?(Z|[+-]\d\d(?::?\d\d)?)?"

_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


class TimeBound(NamedTuple):
    """One end of a cut.

    Attributes
    ----------
    nanoseconds
        From the beginning of the recording, or since 1970 if ``absolute``.
    """

    nanoseconds: int
    absolute: bool = False

    @classmethod
    def parse(cls, text: str) -> TimeBound:
        """Read ``12.5`` (seconds from the beginning; ``500ms``, ``48us`` and ``500ns`` too) or a point in time.

        A point in time is ``@1604515190.25`` (seconds since 1970), the same without ``@`` if it is
        100,000,000 or more, nanoseconds since 1970 if it is beyond 100,000,000,000, or an ISO 8601 date and time
        (UTC if it names no zone).

        Raises
        ------
        UsageError
            If it is none of these.
        """
        match = re.fullmatch(_SECONDS, text.strip())
        if match:
            value = Decimal(match[1])
            if unit := match[2]:
                value /= PARTS_OF_SECOND[unit]
            if value >= _ABSOLUTE_NANOSECONDS:
                return cls(int(value), absolute=True)
            absolute = text.startswith("@") or value >= _ABSOLUTE_SECONDS
            return cls(int(value * 1_000_000_000), absolute=absolute)
        try:
            moment, fraction_ns = _moment(text)
        except ValueError as err:
            raise UsageError(
                f"{text!r} is not a time",
                hint="give seconds from the beginning (12.5), @ and seconds since 1970 (@1604515190.25), "
                "or a date and time (2020-11-04T18:39:50.25Z)",
            ) from err
        moment = moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)
        return cls(_nanoseconds(moment - _EPOCH) + fraction_ns, absolute=True)

    @classmethod
    def of(cls, value: Time | TimeBound) -> TimeBound:
        """Read a time in the forms that Python users have.

        Parameters
        ----------
        value
            Text as in `parse`, or a number: seconds from the beginning; 100,000,000 and more are seconds since 1970,
            whole numbers of 100,000,000,000 and more nanoseconds since 1970. A `datetime` with a time zone, or
            a `numpy.datetime64` (UTC), is a point in time; a `timedelta` or `numpy.timedelta64` counts from the
            beginning.

        Raises
        ------
        UsageError
            If it is none of these, negative, not finite, a `datetime` without a time zone, or nanoseconds as a float,
            which cannot hold them.
        """
        if isinstance(value, TimeBound):
            return value
        if isinstance(value, str):
            return cls.parse(value)
        if isinstance(value, datetime):
            if value.utcoffset() is None:
                hint = "give it one: `.replace(tzinfo=timezone.utc)`, or `.astimezone()` for local time"
                raise UsageError(f"{value!r} has no time zone", hint=hint)
            return cls(_nanoseconds(value - _EPOCH), absolute=True)
        bound = None
        if isinstance(value, timedelta):
            bound = cls(_nanoseconds(value))
        elif (kind := type(value).__name__) in {"datetime64", "timedelta64"} and str(value) != "NaT":
            # NumPy's times, without importing NumPy. Beyond 64 bits, they would wrap around.
            exact: Any = value.astype(f"{kind}[ns]")  # type: ignore[union-attr]
            if exact.astype(value.dtype) == value:  # type: ignore[union-attr]
                bound = cls(int(exact.astype("int64")), absolute=kind == "datetime64")
        elif isinstance(value, Integral) and not isinstance(value, bool) and value >= 0:
            bound = cls.parse(str(int(value)))
        # Nanoseconds since 1970 do not fit into a float.
        elif isinstance(value, Real) and not isinstance(value, bool) and 0 <= value < _ABSOLUTE_NANOSECONDS:
            # By its decimal text: 0.1 means a tenth, not the nearest float.
            bound = cls.parse(f"{Decimal(repr(float(value))):f}")
        if bound is None or (bound.nanoseconds < 0 and not bound.absolute):
            raise UsageError(
                f"{value!r} is not a time",
                hint="give seconds from the beginning (12.5), seconds or whole nanoseconds since 1970, a datetime with "
                "a time zone, a numpy.datetime64, or text like on the command line",
            )
        return bound

    def resolve(self, beginning_ns: int) -> int:
        """Return the log time in nanoseconds, given that of the recording's beginning."""
        return self.nanoseconds if self.absolute else beginning_ns + self.nanoseconds


def _moment(text: str) -> tuple[datetime, int]:
    """Read a date and time in ISO 8601; return the fraction of the second in nanoseconds, which `datetime` lacks."""
    match = re.fullmatch(_DATE_AND_TIME, text.strip())
    if not match:
        return datetime.fromisoformat(text), 0
    start, fraction, zone = match.groups(default="")
    # In the only form that Python 3.10 can read.
    zone = "+00:00" if zone == "Z" else zone and f"{zone[:3]}:{zone[3:].lstrip(':') or '00'}"
    return datetime.fromisoformat(start + zone), int(fraction[:9].ljust(9, "0"))


def _nanoseconds(since: timedelta) -> int:
    return (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
