"""The parameters of the projection: upstream's names, types, defaults and meanings first, then pc2scan's own."""

from __future__ import annotations

import math
import numbers
import re
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pc2scan.arguments import refuse_unknown, value_text
from pc2scan.errors import ParameterError
from pc2scan.text import did_you_mean

from .layout import (
    SYMMETRIC_BEAMS,
    TURN,
    BeamLayout,
    centered_layout,
    float32,
    half_open_layout,
    symmetric_layout,
    upstream_layout,
)
from .presets import PRESETS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from os import PathLike

    from typing_extensions import Self

#: The most beams. More mean a mistyped increment: a ten-thousandth of a degree over a full circle makes 3.6 million.
MAX_BEAMS = 4_000_000

#: The largest number of returns of a beam that `min_points` may name.
_MOST_RETURNS = 2**31 - 1

#: A ``reduce`` that takes the Nth closest return of a beam.
_KTH = re.compile(r"kth=([1-9][0-9]{0,8})")

#: Nanoseconds between any two stamps are fewer, because their seconds are uint32; added to a stamp, it is an int64.
_FOREVER_NS = 2**62

#: The choices of text parameters.
CHOICES: dict[str, tuple[str, ...]] = {
    "geometry": ("upstream", "centered", "half-open", "symmetric"),
    "no_return": ("inf", "range-max-plus", "range-max-minus", "nan", "zero"),
    "reduce": ("min", "max", "mean", "median", "kth=N", "surface"),
    "angle_rounding": ("correct", "glibc-2.40"),
}

#: Parameters that may be ``auto``: they are then measured in the recording.
MEASURED = ("scan_time", "time_increment", "beams")

#: The names of the types in error messages.
_EXPECTED = {float: "a number", bool: "true or false", int: "a whole number", str: "text"}
#: Python's types, and NumPy's by their names in versions 1 and 2, so that NumPy need not be imported.
_TRUTHS = {"bool", "bool_"}

_LAYOUTS = {
    "upstream": upstream_layout,
    "centered": centered_layout,
    "half-open": half_open_layout,
    "symmetric": symmetric_layout,
}


def range_max_minus(range_max: float) -> float:
    """Return the range of ``no_return: range-max-minus``: 0.1 mm less than a finite float32 ``range_max``, as float32.

    Source of the number: nav2_costmap_2d's ObstacleLayer::laserScanValidInfCallback puts infinite ranges there, so that
    they clear and do not mark. If float32 is coarser than that, the difference must not round to ``range_max``.
    """
    return float32(min(range_max - 0.0001, range_max * (1 - 2.0**-23)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectionParams:
    """Parameters of the projection, validated once and immutable.

    Names, units and defaults are those of the ROS node ``pointcloud_to_laserscan``. Parameters that it does not have
    leave its result unchanged by default. Angles and ranges reach the scan as float32; heights and
    ranges of points are compared as float64.

    Parameters
    ----------
    target_frame
        Frame that the cloud is transformed into first; empty: the cloud's own frame.
    transform_tolerance
        Seconds that a stamp may be outside of the recorded transforms.
    min_height, max_height
        Limits of z in the target frame, metres, inclusive. **The default of ``min_height`` is the
        smallest positive double: everything at or below z = 0 is dropped.**
    angle_min, angle_max
        The sector, radians, inclusive. With another ``geometry`` than upstream's: the middle of the first beam, and the
        limit of the middle of the last one; any angles, also 0 to 2 pi.
    angle_increment
        Width of a beam, radians.
    scan_time
        Seconds, copied into the scan; ``auto``: the median interval of the recorded stamps.
    range_min, range_max
        Limits of hypot(x, y), metres, inclusive.
    use_inf
        Whether a beam without a return reads +inf; otherwise it reads ``range_max + inf_epsilon``.
    inf_epsilon
        Metres, see ``use_inf``.
    queue_size
        The most chunks of messages in work at one time; 0 means as many as memory allows. No message is dropped.
    geometry
        ``upstream``: beam i begins at ``angle_min + i * angle_increment``. ``centered``: this angle is the middle of
        the beam, which has half an increment on either side; see `centered_layout`. ``half-open``: the same beams, with
        ``angle_max`` one increment after the last one, as gmapping reads it. ``symmetric``: the same beams, shifted so
        that their middle is 0, as MRPT reads it; the sector must be symmetric, or a full circle.
    beams
        The number of beams in the sector, from which ``angle_increment`` follows; 0: use ``angle_increment``. ``auto``:
        the azimuth resolution of the lidar, measured in a recording's clouds; see `at_resolution`.
    no_return
        What a beam without a return reads: ``inf``, ``range-max-plus`` (``range_max + inf_epsilon``),
        ``range-max-minus`` (0.1 mm below ``range_max``), ``nan`` or ``zero``; empty: as ``use_inf`` says.
    reduce
        The return that a beam reads: ``min``, ``max``, ``mean``, ``median`` (of an even number the lower one of the
        two in the middle), ``surface``: the median of the returns on the closest surface, or ``kth=3``: the third
        closest; a beam with fewer has no return.
    min_points
        A beam with fewer returns has none.
    intensity_field
        Field of the cloud whose values become the scan's intensities: the value of the point that the beam reads, the
        mean of all its points with ``reduce`` mean, 0 without a return. Empty: no intensities.
    time_increment
        Seconds from one beam to the next, copied into the scan; ``auto``: measured from the times
        of the clouds' points; the stamp becomes the first beam's.
    angle_rounding
        The ``atan2f`` of the angles of points: ``correct``, the float32 nearest to the exact angle, as glibc
        2.41 and later return it on any machine; ``glibc-2.40``, what glibc 2.31 to 2.40 return on x86-64, to the bit.

    Raises
    ------
    ParameterError
        If a value has the wrong type, is NaN or is not allowed (an increment that is not positive, an empty sector,
        range or height band, more than `MAX_BEAMS` beams, a word that is not one of the choices).
    """

    target_frame: str = ""
    transform_tolerance: float = 0.01
    min_height: float = 2.2250738585072014e-308
    max_height: float = 1.7976931348623157e308
    angle_min: float = -math.pi
    angle_max: float = math.pi
    angle_increment: float = math.pi / 180
    scan_time: float | Literal["auto"] = 1 / 30
    range_min: float = 0.0
    range_max: float = 1.7976931348623157e308
    use_inf: bool = True
    inf_epsilon: float = 1.0
    queue_size: int = 0
    geometry: str = "upstream"
    beams: int | Literal["auto"] = 0
    no_return: str = ""
    reduce: str = "min"
    min_points: int = 1
    intensity_field: str = ""
    time_increment: float | Literal["auto"] = 0.0
    angle_rounding: str = "correct"

    #: Reads the parameters of a file. The package gives it to `pc2scan.ProjectionParams`, because no module in this
    #: folder reads files.
    reader: ClassVar[Callable[[str | PathLike[str], str | None, Mapping[str, object]], ProjectionParams]]

    @classmethod
    def preset(cls, consumer: str, **changes: Any) -> ProjectionParams:
        """Return the parameters that suit a consumer of the scans.

        Parameters
        ----------
        consumer
            ``slam_toolbox``, ``cartographer``, ``gmapping``, ``amcl``, ``nav2`` or ``mrpt``.
        **changes
            Parameters that replace those of the preset.

        Examples
        --------
        >>> ProjectionParams.preset("slam_toolbox", min_height=-0.5).length
        360
        """
        if not isinstance(consumer, str):
            raise TypeError(f"preset is {consumer!r} ({type(consumer).__name__}), it must be a str")
        if consumer not in PRESETS:
            near = did_you_mean(consumer, PRESETS)
            hint = f"{near} the presets are {', '.join(PRESETS)}".strip()
            raise ParameterError(f"there is no preset {consumer!r}", name="preset", hint=hint)
        refuse_unknown(f"{cls.__name__}.preset", changes, (field.name for field in fields(cls)))
        values: dict[str, object] = {**PRESETS[consumer], **changes}
        return cls(**values)  # type: ignore[arg-type]

    @classmethod
    def from_file(cls, path: str | PathLike[str], *, node: str | None = None, **changes: Any) -> ProjectionParams:
        """Return the parameters of a ROS parameter file, such as the robot's own.

        Parameters
        ----------
        path
            A ROS 2 parameter file or a ROS 1 YAML.
        node
            The node whose section of the file is read. Default: the only one.
        **changes
            Parameters by name that replace those of the file.

        Raises
        ------
        UsageError
            If the file cannot be read, or a parameter is unknown or has a value that is not allowed.

        Examples
        --------
        >>> ProjectionParams.from_file("params.yaml", min_height=-0.5)  # doctest: +SKIP
        """
        return cls.reader(path, node, changes)

    def __new__(cls, **values: object) -> Self:
        """Raise for names that are no parameters; the error suggests the right one."""
        if not values.keys() <= cls.__dataclass_fields__.keys():
            refuse_unknown(cls.__name__, values, cls.__dataclass_fields__)
        return object.__new__(cls)

    def __post_init__(self) -> None:
        for field in fields(self):
            value = typed_value(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)
            if isinstance(value, float) and math.isnan(value):
                raise ParameterError(f"{field.name} is NaN", name=field.name)
        for name in ("transform_tolerance", "scan_time", "queue_size", "beams"):
            value = getattr(self, name)
            if value != "auto" and value < 0:
                raise ParameterError(f"{name} is {value}, it must not be negative", name=name)
        for name in ("angle_min", "angle_max", "angle_increment", "time_increment"):
            value = getattr(self, name)
            if value != "auto" and math.isinf(value):
                raise ParameterError(f"{name} is {value}, it must be finite", name=name)
        if not float32(self.angle_min) < float32(self.angle_max):
            message = f"angle_min {self.angle_min} rad is not below angle_max {self.angle_max} rad"
            raise ParameterError(message, name="angle_min")
        for low, high in (("range_min", "range_max"), ("min_height", "max_height")):
            if getattr(self, low) > getattr(self, high):
                raise ParameterError(f"{low} {getattr(self, low)} m is above {high} {getattr(self, high)} m", name=low)
        if not 1 <= self.min_points <= _MOST_RETURNS:
            message = f"min_points is {self.min_points:,}, it must be from 1 to {_MOST_RETURNS:,}"
            raise ParameterError(message, name="min_points")
        if self.no_return.startswith("range-max") and math.isinf(float32(self.range_max)):
            raise ParameterError(
                f"no_return is {self.no_return}, which needs a finite range_max",
                name="no_return",
                hint="say how far the sensor sees: `range_max=100.0`",
            )
        self._check_beams()

    def _check_beams(self) -> None:
        if self.beams != "auto" and (self.beams == 1 or self.beams > MAX_BEAMS):
            raise ParameterError(f"beams is {self.beams:,}, it must be from 2 to {MAX_BEAMS:,}", name="beams")
        if self.beams and self.beams != "auto":
            object.__setattr__(self, "angle_increment", self.layout.angle_increment)
        if not float32(self.angle_increment) > 0:
            message = f"angle_increment is {self.angle_increment} rad, it must be positive"
            raise ParameterError(message, name="angle_increment")
        layout = self.layout
        if not 0 < layout.count <= MAX_BEAMS:
            raise ParameterError(
                f"angle_increment is {self.angle_increment} rad, which divides the sector {self.angle_min} to "
                f"{self.angle_max} rad into {layout.count:,}; at most {MAX_BEAMS:,} are allowed",
                name="angle_increment",
            )
        if not layout.angle_min < layout.angle_max:
            message = (
                f"angle_increment is {self.angle_increment} rad; the {self.geometry} geometry needs two directions"
            )
            raise ParameterError(message, name="angle_increment")
        if self.geometry == "symmetric":
            self._check_symmetry(layout)

    def _check_symmetry(self, layout: BeamLayout) -> None:
        least, most = SYMMETRIC_BEAMS
        if not least <= layout.count <= most:
            raise ParameterError(
                f"the symmetric geometry has {least} to {most:,} beams, which MRPT reads right, not {layout.count:,}",
                name="beams" if self.beams else "angle_increment",
            )
        if not layout.full_circle and abs(self.angle_min + self.angle_max) > layout.angle_increment / 2:
            widest = max(abs(self.angle_min), abs(self.angle_max))
            raise ParameterError(
                f"angle_min {self.angle_min} rad and angle_max {self.angle_max} rad are not symmetric around 0, "
                "as the symmetric geometry requires: MRPT takes every sector for symmetric",
                name="angle_min",
                hint=f"`angle_min={-widest:.6g}` `angle_max={widest:.6g}`, or a full circle",
            )

    def at_resolution(self, step: float) -> ProjectionParams:
        """Return these parameters with the number of beams for ``beams`` auto.

        Parameters
        ----------
        step
            Azimuth resolution of the lidar, radians; rounded to a whole number of steps in a circle.
        """
        circle = max(1, round(TURN / step))
        if self.geometry == "upstream":
            # Upstream's beams cover the sector if it is a multiple of the increment.
            span = self.angle_max - self.angle_min
            return replace(self, beams=max(2, round(circle * span / TURN)), angle_increment=TURN / circle)
        return replace(self, beams=0, angle_increment=TURN / circle)

    @property
    def layout(self) -> BeamLayout:
        """The beams that the scan's message advertises; with ``beams`` auto, those of ``angle_increment``."""
        beams = 0 if self.beams == "auto" else self.beams
        return _LAYOUTS[self.geometry](self.angle_min, self.angle_max, self.angle_increment, beams)

    @property
    def tolerance_ns(self) -> int:
        """``transform_tolerance`` in nanoseconds; at most `_FOREVER_NS`."""
        return round(min(self.transform_tolerance * 1e9, _FOREVER_NS))

    @property
    def length(self) -> int:
        """Length of the scan's ``ranges``."""
        return self.layout.count

    @property
    def kth(self) -> int:
        """Which return a beam reads with ``reduce`` ``kth=N``, from 1 on; 0 with any other."""
        return kth_of(self.reduce)

    @property
    def empty_range(self) -> float:
        """The range of a beam without a return: a float32 value in metres.

        Source: ``range_max + inf_epsilon`` is the node's sum of the message's float32 ``range_max`` and a
        double, stored as float32; a default ``range_max`` is inf as float32, and so is the sum.
        """
        last = float32(self.range_max)
        match self.no_return or ("inf" if self.use_inf else "range-max-plus"):
            case "range-max-plus":
                return float32(last + self.inf_epsilon)
            case "range-max-minus":
                return range_max_minus(last)
            case "nan":
                return math.nan
            case "zero":
                return 0.0
        return math.inf


def kth_of(reduction: str) -> int:
    """Return N of ``kth=N``, 0 of other texts.

    >>> kth_of("kth=3"), kth_of("kth=0"), kth_of("median")
    (3, 0, 0)
    """
    match = _KTH.fullmatch(reduction)
    return int(match[1]) if match else 0


def typed_value(name: str, value: Any) -> float | bool | str:
    """Return a value as the Python type that its parameter has.

    NumPy's numbers are converted to Python's, because they would overflow when compared with limits beyond their range,
    and whole numbers to floats. Nothing else is converted: true is not a number, and 1.0 is not a whole number.

    Raises
    ------
    ParameterError
        If it has another type.
    """
    kind = type(ProjectionParams.__dataclass_fields__[name].default)
    words = ("auto",) if name in MEASURED else CHOICES.get(name, ())
    if isinstance(value, str):
        if (value in words and "=" not in value) or (kind is str and not words) or (name == "no_return" and not value):
            return str(value)
        if name == "reduce" and kth_of(value):
            return str(value)
    elif type(value).__name__ in _TRUTHS:
        if kind is bool:
            return bool(value)
    elif isinstance(value, numbers.Integral) and kind is int:
        return int(value)
    elif isinstance(value, numbers.Real) and kind is float:
        # A whole number of 309 digits does not fit into a float.
        with suppress(OverflowError):
            return float(value)
    expected = f"one of {', '.join(words)}" if kind is str and words else " or ".join((_EXPECTED[kind], *words))
    raise ParameterError(f"{name}: expected {expected}, got {value_text(value)}", name=name)
