"""Filters: classes that reject points for one reason. Their protocol, those that options ask for, and what makes these.

An option and its filter have the same name.
"""

from __future__ import annotations

import ast
import math
import operator
import warnings
from contextlib import suppress
from dataclasses import dataclass, field, fields
from enum import Enum
from functools import reduce
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from pc2scan.core.rule import within
from pc2scan.core.terrain import on_ground
from pc2scan.errors import UsageError
from pc2scan.transforms.static import number_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from pc2scan.core.points import Points


class Frame(Enum):
    """The frames that every conversion has; a filter may use any other frame by its name."""

    SOURCE = "source"
    TARGET = "target"


class Filter(Protocol):
    """Selects points of a cloud: a frozen dataclass with its parameters, and these attributes.

    The result of a filter depends only on the cloud; threads share the filter. One more attribute is optional:
    ``absent``, a warning for the case that nothing is rejected.
    """

    @property
    def name(self) -> str:
        """The name of the count of rejected points: a Python identifier."""
        ...

    @property
    def explanation(self) -> str:
        """Why points are rejected, for a user whose scans are empty: completes "40% of all points were"."""
        ...

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields that it needs besides ``x``, ``y`` and ``z``; if one is missing, the conversion does not begin."""
        ...

    @property
    def frame(self) -> Frame | str:
        """The frame of the coordinates that it needs."""
        ...

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return a mask of the points that are kept, in the shape of the points' fields.

        Points that it cannot judge are kept, such as those with NaN coordinates: the projection rejects and counts
        them. NumPy's floating-point warnings are off.
        """
        ...


def as_dict(chosen: Filter) -> dict[str, Any]:
    """Return the name and the parameters of a filter, for reports."""
    parameters = {attribute.name: getattr(chosen, attribute.name) for attribute in fields(chosen) if attribute.repr}  # type: ignore[arg-type]
    return {"name": chosen.name, **parameters}


#: Returns the value of a part of a condition for every point: float64, or bool for a condition.
_Part: TypeAlias = "Callable[[Points], Any]"

_CONDITION = (
    "write fields, numbers, == != < <= > >= in and or not, such as `where='ring in (3, 4, 5) and intensity > 10'`"
)

#: The longest condition.
_LONGEST_CONDITION = 2_000

_COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.Mod: np.mod,
}


@dataclass(frozen=True, slots=True)
class Where:
    """Keeps the points for which a condition holds.

    Fields have their values as the cloud has them, ``x``, ``y`` and ``z`` in the cloud's own frame. Numbers are
    computed and compared as float64; a field of float32 is compared with a number as float32, so that ``== 0.1`` is
    true for a float32 of 0.1. NaN fulfils no comparison except ``!=``.

    Parameters
    ----------
    condition
        An expression of Python with few of its nodes: ``and``, ``or``, ``not``, comparisons, ``in`` with numbers in
        parentheses, ``+ - * / %``, ``abs``, numbers, and the names of fields. Python parses it; nothing of it is
        executed.

    Raises
    ------
    UsageError
        If the condition cannot be read.
    """

    condition: str
    _read: _Condition = field(init=False, repr=False, compare=False)

    name = "where"
    explanation = "rejected by `where`"
    frame = Frame.SOURCE

    def __post_init__(self) -> None:
        object.__setattr__(self, "_read", _Condition(self.condition))

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields in the condition, in its order."""
        return tuple(self._read.fields)

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return for which points the condition holds; see `Filter`."""
        return np.asarray(self._read.holds(points))


class _Condition:
    """A condition that was read.

    Attributes
    ----------
    fields
        The fields that it names.
    holds
        Returns for which points it holds.
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self.fields: dict[str, None] = {}
        if len(text) > _LONGEST_CONDITION:
            raise UsageError(f"`where` has {len(text):,} characters, at most {_LONGEST_CONDITION:,} are allowed")
        try:
            # Python warns of some expressions that it accepts, such as `3and 4`.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                # A condition in a file may have several lines.
                self.holds = self._part(ast.parse(" ".join(text.split()), mode="eval").body, is_condition=True)
        except (SyntaxError, ValueError, RecursionError, MemoryError) as err:
            raise self._error(getattr(err, "msg", "nested too deeply")) from None
        if not self.fields:
            raise self._error("no field is named")

    def _error(self, problem: str, part: ast.expr | None = None) -> UsageError:
        part_text = f", got {ast.unparse(part)!r}" if part else ""
        return UsageError(f"`where`: {self._text!r} cannot be read: {problem}{part_text}", hint=_CONDITION)

    def _part(self, node: ast.expr, *, is_condition: bool = False) -> _Part:
        """Return what computes a number for each point, or a condition."""
        holds, part = self._read(node)
        if holds != is_condition:
            raise self._error("expected a comparison" if is_condition else "expected a number", node)
        return part

    def _read(self, node: ast.expr) -> tuple[bool, _Part]:
        """Return whether a node is a condition, and what computes it."""
        match node:
            case ast.BoolOp(sign, values):
                join = np.logical_and if isinstance(sign, ast.And) else np.logical_or
                parts = [self._part(operand, is_condition=True) for operand in values]
                return True, lambda points: reduce(join, (part(points) for part in parts))
            case ast.UnaryOp(ast.Not(), operand):
                part = self._part(operand, is_condition=True)
                return True, lambda points: np.logical_not(part(points))
            case ast.Compare(left, signs, rights):
                checks = [
                    self._comparison(*comparison) for comparison in zip([left, *rights], signs, rights, strict=False)
                ]
                return True, lambda points: reduce(np.logical_and, (check(points) for check in checks))
            case ast.expr() if (number := _number_of(node)) is not None:
                return False, lambda _: np.float64(number)
            case ast.Name(name) if name.isascii():
                self.fields[name] = None
                return False, lambda points: points.field(name).astype(np.float64)
            case ast.UnaryOp(ast.USub(), operand):
                part = self._part(operand)
                return False, lambda points: -part(points)
            case ast.BinOp(left, operation, right) if (compute := _ARITHMETIC.get(type(operation))) is not None:
                first, second = self._part(left), self._part(right)
                return False, lambda points: compute(first(points), second(points))
            case ast.Call(ast.Name("abs"), [value], []):
                part = self._part(value)
                return False, lambda points: np.abs(part(points))
        raise self._error("expected fields, numbers and operators", node)

    def _comparison(self, left: ast.expr, sign: ast.cmpop, right: ast.expr) -> _Part:
        """Return what compares two values, or a value with several numbers."""
        if isinstance(sign, ast.In | ast.NotIn):
            numbers = right.elts if isinstance(right, ast.Tuple | ast.List | ast.Set) else [right]
            if not numbers or any(_number_of(element) is None for element in numbers):
                raise self._error("expected numbers", right)
            equal = [self._comparison(left, ast.Eq(), element) for element in numbers]
            is_in = isinstance(sign, ast.In)
            return lambda points: reduce(np.logical_or, (check(points) for check in equal)) == is_in
        compare = _COMPARISONS.get(type(sign))
        if compare is None:
            raise self._error("expected one of < <= > >= == != in before what follows", right)
        values = self._part(left), self._part(right)
        named, number = (left, _number_of(right)) if isinstance(left, ast.Name) else (right, _number_of(left))
        if not isinstance(named, ast.Name) or number is None:
            return lambda points: compare(values[0](points), values[1](points))

        def compare_field(points: Points) -> Any:
            own = points.field(named.id)
            if own.dtype != np.float32:
                return compare(values[0](points), values[1](points))
            return compare(own, np.float32(number)) if named is left else compare(np.float32(number), own)

        return compare_field


def _number_of(node: ast.expr) -> float | None:
    """Return the number that a node is, with its sign; None if it is anything else."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and isinstance(node.operand, ast.Constant):
        number = _number_of(node.operand)
        return None if number is None else -number
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        with suppress(OverflowError):
            return float(node.value)
    return None


_BOX = "write 'frame x0 x1 y0 y1 z0 z1' (metres), such as 'base_link -0.4 0.4 -0.3 0.3 0 1.2'"
_POLYGON = "write 'frame x0 y0 x1 y1 x2 y2 ...' (metres): three corners or more, in the order of the outline"

#: The area of a polygon that is a line, square metres; that of a rectangle with corners in the wrong order is 0, too.
_NO_AREA = 1e-9


@dataclass(frozen=True, slots=True)
class ExcludeBox:
    """Rejects the points in a box, its faces included.

    Parameters
    ----------
    frame
        The frame of the box.
    x, y, z
        The limits of the box, metres; they may be infinite.

    Raises
    ------
    UsageError
        If a lower limit is not below the upper one.
    """

    frame: str
    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]

    name = "exclude_box"
    explanation = "inside a box of `exclude_box`"
    fields = ()

    def __post_init__(self) -> None:
        for axis in ("x", "y", "z"):
            low, high = getattr(self, axis)
            if not low < high:
                raise UsageError(
                    f"`exclude_box`: {axis}0 {low:g} m is not below {axis}1 {high:g} m in the box in {self.frame}",
                    hint=_BOX,
                )

    @classmethod
    def parse(cls, text: str) -> ExcludeBox:
        """Read ``frame x0 x1 y0 y1 z0 z1``: metres, or with a unit (``20cm``).

        Raises
        ------
        UsageError
            If the text cannot be read, or is not a box.
        """
        frame, numbers = _frame_and_numbers("exclude_box", text, _BOX)
        if len(numbers) != 6:
            raise UsageError(f"`exclude_box`: {text!r} has {len(numbers)} numbers, a box has 6", hint=_BOX)
        x0, x1, y0, y1, z0, z1 = numbers
        return cls(frame, (x0, x1), (y0, y1), (z0, z1))

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are outside; see `Filter`."""
        x, y, z = points.xyz()
        return ~(within(x, *self.x) & within(y, *self.y) & within(z, *self.z))


@dataclass(frozen=True, slots=True)
class ExcludePolygon:
    """Rejects the points above, below and inside of a polygon in the x-y plane of a frame.

    A point is inside if a ray from it crosses the outline an odd number of times. Points on the outline may be
    inside or outside.

    Parameters
    ----------
    frame
        The frame of the polygon.
    corners
        x and y of each corner in order, metres; the last one is connected to the first.

    Raises
    ------
    UsageError
        If the frame is empty, there are fewer than three corners, one is not finite, or the polygon has no area, as a
        rectangle whose corners are in the wrong order.
    """

    frame: str
    corners: tuple[tuple[float, float], ...]

    name = "exclude_polygon"
    explanation = "inside a polygon of `exclude_polygon`"
    fields = ()

    def __post_init__(self) -> None:
        is_finite = all(math.isfinite(value) for corner in self.corners for value in corner)
        sides = zip(self.corners, (*self.corners[1:], *self.corners[:1]), strict=True)
        area = abs(sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in sides))
        if not self.frame or len(self.corners) < 3 or not is_finite or area < _NO_AREA:
            corners = " ".join(f"{value:g}" for corner in self.corners for value in corner)
            raise UsageError(
                f"`exclude_polygon`: the corners {corners} in {self.frame!r} are no polygon", hint=_POLYGON
            )

    @classmethod
    def parse(cls, text: str) -> ExcludePolygon:
        """Read ``frame x0 y0 x1 y1 x2 y2 ...``; brackets, as in a footprint of Nav2, make no difference.

        Raises
        ------
        UsageError
            If the text cannot be read, or is not a polygon.
        """
        frame, numbers = _frame_and_numbers("exclude_polygon", text.translate(str.maketrans("[]()", "    ")), _POLYGON)
        if len(numbers) % 2:
            raise UsageError(f"`exclude_polygon`: {text!r} has {len(numbers)} numbers, which is odd", hint=_POLYGON)
        return cls(frame, tuple(zip(numbers[::2], numbers[1::2], strict=True)))

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are outside; see `Filter`."""
        xs, ys = zip(*self.corners, strict=True)
        all_x, all_y, _ = points.xyz()
        near = within(all_x, min(xs), max(xs)) & within(all_y, min(ys), max(ys))
        x, y = (axis[near].astype(np.float64) for axis in (all_x, all_y))
        inside = np.zeros(x.size, np.bool_)
        for (x0, y0), (x1, y1) in zip(self.corners, (*self.corners[1:], self.corners[0]), strict=True):
            if y0 != y1:
                inside ^= ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * ((y - y0) / (y1 - y0)) + x0)
        kept = np.ones(all_x.shape, np.bool_)
        kept[near] = ~inside
        return kept


def _frame_and_numbers(option: str, text: str, usage: str) -> tuple[str, list[float]]:
    """Read a frame and the numbers after it."""
    words = text.replace(",", " ").split()
    numbers = [number for word in words[1:] if (number := number_in(word, "m")) is not None and not math.isnan(number)]
    if not words or number_in(words[0], "m") is not None or len(numbers) < len(words) - 1:
        raise UsageError(f"`{option}`: {text!r} is not a frame and numbers", hint=usage)
    return words[0], numbers


@dataclass(frozen=True, slots=True)
class RemoveGround:
    """Rejects points on the ground, which `pc2scan.core.terrain` finds in each cloud.

    It needs a frame of the robot whose z axis points up. In a cloud without ground it rejects nothing.
    """

    name = "ground"
    explanation = "on the ground, as `ground` finds it"
    absent = (
        "`ground` found no ground in any cloud, so it removed nothing; it needs a frame of the robot whose z axis "
        "points up (`target_frame`), and ground that is seen from near to far"
    )
    fields = ()
    frame = Frame.TARGET

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are not on the ground; see `Filter`."""
        return ~on_ground(*points.xyz())


@dataclass(frozen=True, slots=True)
class MinHeightSlope:
    """Rejects points from ``min_height`` to ``min_height + slope * hypot(x, y)`` in the scan's frame.

    Parameters
    ----------
    min_height
        The limit at the origin of the scan's frame, metres.
    slope
        How much it grows with range, metres per metre: the tangent of an angle, 0.05 for about 3 degrees.

    Raises
    ------
    UsageError
        If the slope is negative or not finite, or ``min_height`` is not finite.
    """

    min_height: float
    slope: float

    name = "min_height_slope"
    explanation = "below `min_height_slope`"
    fields = ()
    frame = Frame.TARGET

    def __post_init__(self) -> None:
        if not 0 <= self.slope < math.inf:
            raise UsageError(
                f"`min_height_slope` is {self.slope}, it must be 0 or more, and finite",
                hint="it is in metres per metre: `min_height_slope=0.05` for about 3 degrees",
            )
        if not math.isfinite(self.min_height):
            raise UsageError(f"`min_height_slope` needs a finite min_height, which is {self.min_height}")

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are outside of the wedge; see `Filter`."""
        x, y, z = (axis.astype(np.float64) for axis in points.xyz())
        # NumPy's hypot takes ten times as long; squares of float32 cannot overflow in float64.
        below: NDArray[np.bool_] = z < self.min_height + self.slope * np.sqrt(x * x + y * y)
        return ~below | (z < self.min_height)


#: What makes the filter of an option, of its value and ``min_height``; in the order of the table of options, in which
#: they are applied.
FILTERS: Mapping[str, Callable[[Any, float], Filter]] = {
    "where": lambda text, _: Where(text),
    "exclude_box": lambda text, _: ExcludeBox.parse(text),
    "exclude_polygon": lambda text, _: ExcludePolygon.parse(text),
    "ground": lambda _, __: RemoveGround(),
    "min_height_slope": lambda slope, min_height: MinHeightSlope(min_height, slope),
}


def filters_of(values: Mapping[str, Any], min_height: float) -> Iterator[Filter]:
    """Yield the filters that options ask for, in the order of the table of options.

    Parameters
    ----------
    values
        Values of options by name; others than those with a filter are ignored.
    min_height
        The parameter of the projection.

    Raises
    ------
    UsageError
        If a value cannot be read.
    """
    for name, filter_of in FILTERS.items():
        value = values.get(name, ())
        for item in value if isinstance(value, tuple) else (value,):
            yield filter_of(item, min_height)
