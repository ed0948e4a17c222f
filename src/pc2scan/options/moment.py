"""A time in a recording, in the forms that users have."""

from __future__ import annotations

import math
import re
from datetime import datetime, timedelta, timezone
from decimal import Decimal, InvalidOperation
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

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
        written = re.fullmatch(_SECONDS, text.strip())
        if written:
            try:
                value = Decimal(written[1])
            except InvalidOperation as err:  # pragma: no cover - the pattern admits only decimals
                raise UsageError(f"{text!r} is not a time") from err
            if unit := written[2]:
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
        if isinstance(value, str):
            return cls.parse(value)
        if isinstance(value, TimeBound):
            return value
        if isinstance(value, datetime):
            if value.utcoffset() is None:
                raise UsageError(
                    f"{value!r} has no time zone",
                    hint="give it one: `.replace(tzinfo=timezone.utc)`, or `.astimezone()` for local time",
                )
            return cls(_nanoseconds(value - _EPOCH), absolute=True)
        if isinstance(value, timedelta):
            return cls(_not_negative(value, _nanoseconds(value)))
        if type(value).__name__ in {"datetime64", "timedelta64"}:
            return cls._of_numpy(value)
        if isinstance(value, Real) and not isinstance(value, bool):
            return cls._of_number(value)
        raise UsageError(
            f"{value!r} is not a time",
            hint="give seconds from the beginning (12.5), seconds or nanoseconds since 1970 (1604515190.25), a "
            "datetime with a time zone, a numpy.datetime64, or text like on the command line",
        )

    @classmethod
    def _of_numpy(cls, value: Any) -> TimeBound:
        """Read NumPy's times without importing NumPy."""
        kind = type(value).__name__
        nanoseconds = value.astype(f"{kind}[ns]")
        if str(value) == "NaT":
            raise UsageError(f"{value!r} is not a time")
        # Beyond 64 bits NumPy's nanoseconds wrap around without an error.
        if nanoseconds.astype(value.dtype) != value:
            raise UsageError(f"{value!r} does not fit into nanoseconds of 64 bits")
        whole = int(nanoseconds.astype("int64"))
        return cls(whole, absolute=True) if kind == "datetime64" else cls(_not_negative(value, whole))

    @classmethod
    def _of_number(cls, value: Real) -> TimeBound:
        if isinstance(value, Integral):
            whole = _not_negative(value, int(value))
            if whole >= _ABSOLUTE_NANOSECONDS:
                return cls(whole, absolute=True)
            return cls(whole * 1_000_000_000, absolute=whole >= _ABSOLUTE_SECONDS)
        seconds = float(value)
        if not math.isfinite(seconds):
            raise UsageError(f"{value!r} is not a time")
        if seconds >= _ABSOLUTE_NANOSECONDS:
            raise UsageError(
                f"{value!r} looks like nanoseconds since 1970, which a float cannot hold exactly",
                hint=f"give a whole number, {int(seconds)}, or seconds, {seconds / 1e9}",
            )
        # By its decimal text: 0.1 means a tenth, not the nearest float.
        text = repr(_not_negative(value, seconds))
        return cls.parse(f"{seconds:.9f}" if "e" in text else text)

    def resolve(self, beginning_ns: int) -> int:
        """Return the log time in nanoseconds, given that of the recording's beginning."""
        return self.nanoseconds if self.absolute else beginning_ns + self.nanoseconds


_Number = TypeVar("_Number", int, float)


def _not_negative(value: object, number: _Number) -> _Number:
    """Return a number of seconds from the beginning of a recording; raise if it is negative."""
    if number < 0:
        raise UsageError(f"{value!r} is negative", hint="times count from the beginning of the recording")
    return number


def _moment(text: str) -> tuple[datetime, int]:
    """Read a date and time in ISO 8601; return the fraction of the second in nanoseconds, which `datetime` lacks."""
    written = re.fullmatch(_DATE_AND_TIME, text.strip())
    if not written:
        return datetime.fromisoformat(text), 0
    start, fraction, zone = written.groups(default="")
    # In the only form that Python 3.10 can read.
    zone = "+00:00" if zone == "Z" else zone and f"{zone[:3]}:{zone[3:].lstrip(':') or '00'}"
    return datetime.fromisoformat(start + zone), int(fraction[:9].ljust(9, "0"))


def _nanoseconds(since: timedelta) -> int:
    return (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
