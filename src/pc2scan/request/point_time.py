"""When the points of a cloud were measured: which field says it, and in which unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from pc2scan.core import kernel
from pc2scan.core.points import TIME, Points
from pc2scan.core.timing import AZIMUTH, TIME_FIELDS, TIME_UNITS, absolute_times, offset_and_unit, time_field
from pc2scan.errors import DecodeError, UsageError

from .turn import Turn

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


#: Returns the times of points at some places, seconds after their cloud's stamp.
Times: TypeAlias = "Callable[[tuple[NDArray[np.intp], ...]], NDArray[np.float64]]"


#: What to type if the points' own times are of no use.
BY_AZIMUTH = "`point_time=azimuth` computes the times of a lidar that turns"


@dataclass(frozen=True, slots=True)
class PointTime:
    """The source of the points' times.

    Attributes
    ----------
    field
        The field with the times. Empty: the first of `TIME_FIELDS` that the cloud has.
    unit
        ``s``, ``ms``, ``us`` or ``ns``. Empty: the numbers decide; see `offset_and_unit`.
    turn
        How the lidar turned, if its points have no times. None: the times are in ``field``.
    """

    field: str = ""
    unit: str = ""
    turn: Turn | None = None

    @classmethod
    def parse(cls, text: str) -> PointTime:
        """Parse ``FIELD``, ``FIELD:UNIT``, or the forms that `Turn` parses; empty text means the default.

        Raises
        ------
        UsageError
            If the text has another form.
        """
        if not text:
            return cls()
        field, colon, unit = text.partition(":")
        if field == AZIMUTH:
            return cls(turn=Turn.parse(text))
        if not field or (colon and unit not in TIME_UNITS):
            raise UsageError(
                f"`point_time` is {text!r}, it must be a field, or a field and a unit",
                hint=f"write `point_time=t` or `point_time=t:ns`; units: {', '.join(TIME_UNITS)}",
            )
        return cls(field, unit)

    def read(self, points: Points) -> FieldTimes:
        """Return the times of a cloud's points; those of the field `TIME`, if it has that.

        Raises
        ------
        DecodeError
            If the cloud has no field with times, or one with several values a point.
        """
        offset, unit = 0.0, 1.0
        if given := TIME in points.fields:
            name, whole = TIME, False
        else:
            name = self.field or time_field(points.fields)
            if not name:
                raise DecodeError(
                    f"its points have no times: there is no field {', '.join(TIME_FIELDS)}",
                    stamp_ns=points.stamp_ns,
                    hint="name the field that has them: `point_time=FIELD`",
                )
            whole = points.field(name).dtype.kind in "iu"
            points = _mask_zero_times(points, name, self.unit)
        x, values = points.field("x"), points.field(name)
        if values.shape != x.shape:
            message = f"its field {name} has several values a point"
            raise DecodeError(
                message, stamp_ns=points.stamp_ns, hint="if another field has the times, name it: `point_time=FIELD`"
            )
        low, high, measured, unknown = kernel.span(x, values)
        if not given and measured > unknown:
            offset, unit = offset_and_unit(low, high, points.stamp_ns, self.unit, whole=whole)
        low, high = (low - offset) * unit, (high - offset) * unit
        return FieldTimes(points, name, offset, unit, low, high, measured, unknown)


class FieldTimes(NamedTuple):
    """The times of a cloud's points, as a field has them.

    Attributes
    ----------
    points
        The cloud; a time that is not known is NaN or infinite, also where drivers write 0.
    field
        The field.
    offset, unit
        A point was measured ``(value - offset) * unit`` seconds after the stamp.
    low, high
        Of the first and the last point, seconds after the stamp; inf and -inf if no time is known.
    measured
        How many points have an ``x`` that is not NaN.
    unknown
        How many of them have no time.
    """

    points: Points
    field: str
    offset: float
    unit: float
    low: float
    high: float
    measured: int
    unknown: int

    def at(self, places: Any = ...) -> NDArray[np.float64]:
        """Return the times of the points at some places, or of all, seconds after the stamp."""
        times: NDArray[np.float64] = self.points.field(self.field)[places].astype(np.float64)
        return (times - self.offset) * self.unit


def _mask_zero_times(points: Points, name: str, unit: str) -> Points:
    """Return points whose times that are 0 are NaN, if the others are absolute.

    Drivers write 0 for points without a return. Among times after the stamp, 0 is a time.
    """
    values = points.field(name)
    if absolute_times(values, points.stamp_ns, unit) is None or not (missing := values == 0).any():
        return points
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        times = values.astype(np.float64)
    times[missing] = np.nan
    return points.replace({name: times}, points.frame_id)
