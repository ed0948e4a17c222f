"""The options of a conversion, besides the projection's own parameters."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from pc2scan.errors import UsageError
from pc2scan.tf.options import FrameOptions
from pc2scan.threads import MAX_JOBS

from .scan_spec import ScanSpec

if TYPE_CHECKING:
    import numpy as np

    #: The types that a time may have; see `TimeBound.of`.
    Time: TypeAlias = str | float | datetime | timedelta | np.datetime64 | np.timedelta64 | np.number[Any]

__all__ = ["ConvertOptions", "TimeBound", "bound_of", "destination_and_folder"]

#: Larger numbers are points in time, not seconds from the beginning: no recording lasts three years.
_ABSOLUTE_SECONDS = 100_000_000
#: Larger whole numbers are nanoseconds: as seconds they would be after the year 5000.
_ABSOLUTE_NANOSECONDS = 100_000_000_000

_SECONDS = r"@?(\d+\.?\d*|\.\d+) ?(s|ms)?"
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
        """Read ``12.5`` (seconds from the beginning; ``12.5s`` and ``500ms`` too) or a point in time.

        A point in time is ``@1604515190.25`` (seconds since 1970), the same without ``@`` if it is
        100,000,000 or more, nanoseconds since 1970 if it is beyond 100,000,000,000, or an ISO 8601 date and time
        (UTC if it names no zone).

        Raises
        ------
        UsageError
            If it is none of these.
        """
        from decimal import Decimal, InvalidOperation  # noqa: PLC0415  # only a conversion with a cut pays for it

        written = re.fullmatch(_SECONDS, text.strip())
        if written:
            try:
                value = Decimal(written[1])
            except InvalidOperation as err:  # pragma: no cover - the pattern admits only decimals
                raise UsageError(f"{text!r} is not a time") from err
            value = value / 1000 if written[2] == "ms" else value
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
    def of(cls, value: Time) -> TimeBound:
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


def bound_of(name: str, time: Time | None) -> TimeBound | None:
    """Read ``start`` or ``end``; an error names it."""
    try:
        return None if time is None else TimeBound.of(time)
    except UsageError as err:
        err.message = f"`{name}`: {err.message}"
        raise


def destination_and_folder(text: str | None) -> tuple[Path | None, Path | None]:
    """Return the destination, or the folder to write into if the text ends with a slash or is a dot.

    >>> destination_and_folder("scans/"), destination_and_folder("scans")
    ((None, PosixPath('scans')), (PosixPath('scans'), None))
    """
    if text is None:
        return None, None
    separators = tuple(filter(None, (os.sep, os.altsep)))
    # Not Path.name, which ignores the slash.
    if text.endswith(separators) or os.path.basename(text) in {".", ".."}:  # noqa: PTH119
        return None, Path(text)
    return Path(text), None


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvertOptions:
    """The checked options of a conversion: its outputs, and options that apply to all of them.

    Attributes
    ----------
    scans
        The outputs; usually only one.
    frames
        The source of transforms.
    keep_clouds
        Whether the converted messages are written, too.
    only_scans
        Whether only the new messages are written.
    keep, drop
        Topics or globs that choose among the topics that are not converted. ``drop`` has precedence, and also
        excludes a cloud topic that is not requested by name.
    start, end
        The cut, by log time: from ``start`` on, before ``end``.
    on_error
        What to do if a message cannot be converted: ``skip`` or ``fail``.
    ros_distro
        The ROS distribution whose message definitions are used if the recording has none; empty: a default.
    jobs
        Number of threads; 0: one for each processor core.
    verify
        Whether the CRCs of MCAP files are checked. The checksums of lz4 and bz2 always are.
    strict
        Whether damage of a source is an error; otherwise everything readable is recovered, and the report lists the
        damage.
    fail_on
        When the whole run fails and nothing is written: ``empty`` (if a scan has no return), or ``warning`` (also for
        any other warning, skipped message or damage); empty text for neither.
    min_used
        The share of the points of each topic, 0 to 1, that must be in its scans; otherwise the run fails.
    repair
        Convert nothing: all messages are copied, byte for byte.
    """

    scans: tuple[ScanSpec, ...] = (ScanSpec(),)
    frames: FrameOptions = FrameOptions()
    keep_clouds: bool = False
    only_scans: bool = False
    keep: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    start: TimeBound | None = None
    end: TimeBound | None = None
    on_error: str = "skip"
    ros_distro: str = ""
    jobs: int = 0
    verify: bool = True
    strict: bool = False
    fail_on: str = ""
    min_used: float = 0.0
    repair: bool = False

    def __post_init__(self) -> None:
        if self.on_error not in ("skip", "fail"):
            raise UsageError(f"on_error is {self.on_error!r}, it must be skip or fail")
        if self.fail_on not in ("", "empty", "warning"):
            raise UsageError(f"fail_on is {self.fail_on!r}, it must be empty or warning")
        if not 0 <= self.min_used <= 1:
            hint = f"{self.min_used:g} % is {self.min_used / 100:g}" if 1 < self.min_used <= 100 else None
            raise UsageError(f"`min_used` is {self.min_used:g}, it must be a share from 0 to 1", hint=hint)
        if not 0 <= self.jobs <= MAX_JOBS:
            raise UsageError(f"`jobs` is {self.jobs:,}, it must be from 0 to {MAX_JOBS:,}")
        if self.only_scans and (self.keep or self.keep_clouds):
            raise UsageError("`only_scans` contradicts `keep` and `keep_clouds`")

    @property
    def scan(self) -> ScanSpec:
        """The first output."""
        return self.scans[0]

    def with_scan(self, **changes: Any) -> ConvertOptions:
        """Return the options with only the first output, changed."""
        return replace(self, scans=(replace(self.scan, **changes),))
