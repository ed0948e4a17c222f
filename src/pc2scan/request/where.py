"""A filter by the values of fields: ``ring in (3, 4, 5) and intensity > 10``.

A condition is an expression of Python with few of its nodes: ``and``, ``or``, ``not``, comparisons, ``in`` with numbers
in parentheses, ``+ - * / %``, ``abs``, numbers, and the names of fields. Python parses it; nothing of it is executed.
"""

from __future__ import annotations

import ast
import operator
import warnings
from contextlib import suppress
from dataclasses import dataclass, field
from functools import reduce
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pc2scan.errors import UsageError

from .filters import Frame

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from pc2scan.core.points import Points

#: Returns the value of a part of a condition for every point: float64, or bool for a condition.
_Part: TypeAlias = "Callable[[Points], Any]"

_HINT = "write fields, numbers, == != < <= > >= in and or not, such as `where='ring in (3, 4, 5) and intensity > 10'`"

#: The longest condition.
_LONGEST = 2_000

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
        See this module.

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

    @classmethod
    def parse(cls, text: str, _: float = 0.0) -> Where:
        """Return the filter of a condition."""
        return cls(text)

    @property
    def text(self) -> str:
        """The condition."""
        return self.condition

    def __post_init__(self) -> None:
        object.__setattr__(self, "_read", _Condition(self.condition))

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields in the condition, in its order."""
        return tuple(self._read.fields)

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return for which points the condition holds; see `pc2scan.request.filters.Filter`."""
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
        if len(text) > _LONGEST:
            raise UsageError(f"`where` has {len(text):,} characters, at most {_LONGEST:,} are allowed")
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
        got = f", got {ast.unparse(part)!r}" if part else ""
        return UsageError(f"`where`: {self._text!r} cannot be read: {problem}{got}", hint=_HINT)

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
                parts = [self._part(each, is_condition=True) for each in values]
                return True, lambda points: reduce(join, (part(points) for part in parts))
            case ast.UnaryOp(ast.Not(), operand):
                part = self._part(operand, is_condition=True)
                return True, lambda points: np.logical_not(part(points))
            case ast.Compare(left, signs, rights):
                checks = [self._comparison(*each) for each in zip([left, *rights], signs, rights, strict=False)]
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
