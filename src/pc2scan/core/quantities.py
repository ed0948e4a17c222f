"""Reads angles, lengths and times as people write them: ``pi/2``, ``deg(180)``, ``-90deg``, ``50cm``, ``100ms``.

Numbers, ``pi``, parentheses and ``+ - * /`` are allowed, followed by a unit. Nothing is executed.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from decimal import Decimal
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

#: ROS 1's notation of angles.
ANGLE = re.compile(r"(deg|rad)\((.*)\)")

#: Hints, by the unit of the result.
EXAMPLES = {
    "rad": "write radians (1.5708, pi/2) or degrees (90deg)",
    "m": "write metres (0.5, 0.5m), centimetres (50cm) or millimetres (500mm)",
    "s": "write seconds (0.1, 0.1s), 100ms, 48us or 500ns",
}

_NUMBER_AND_UNIT = re.compile(r"([0-9]{1,18}(?:\.[0-9]{0,18})?|\.[0-9]{1,18}) ?([A-Za-z]+)")

#: Units of times, as parts of a second.
PARTS_OF_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}

#: Units in lower case, as nanoseconds.
_DURATIONS = {
    **{unit: 10**9 // parts for unit, parts in PARTS_OF_SECOND.items()},
    "min": 60 * 10**9,
    "h": 3600 * 10**9,
}

#: The longest arithmetic expression, characters.
_LONGEST = 100

_OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def _divided(parts: int, value: float) -> float:
    return value / parts


# Units divide by whole numbers, so that 10cm is the float64 nearest to 0.1. Degrees are computed in rosparam's order of
# operations, so that the last bit is the same.
_UNITS: Mapping[str, Mapping[str, Callable[[float], float]]] = {
    "rad": {"rad": float, "deg": lambda value: value * math.pi / 180.0, "°": lambda value: value * math.pi / 180.0},
    "m": {"m": float, "cm": lambda value: value / 100, "mm": lambda value: value / 1000},
    "s": {unit: partial(_divided, parts) for unit, parts in PARTS_OF_SECOND.items()},
}


def quantity(text: str, unit: str) -> float | None:
    """Read a number with or without a unit; None if the text is something else.

    Parameters
    ----------
    text
        ``1.57``, ``pi/2``, ``90deg``, ``90°``, ``deg(90)``, ``rad(pi/2)`` for an angle; ``0.5``, ``0.5m``, ``50cm``,
        ``500mm`` for a length; ``0.1``, ``1/10``, ``100ms``, ``48us``, ``500ns`` for a time.
    unit
        The unit of the result: ``rad``, ``m`` or ``s``.

    Examples
    --------
    >>> quantity("50cm", "m"), quantity("-180deg", "rad"), quantity("1/4 s", "s"), quantity("5m", "rad")
    (0.5, -3.141592653589793, 0.25, None)
    """
    text = text.strip()
    if unit == "rad" and ANGLE.fullmatch(text):
        return written_angle(text)
    # A unit is not the end of a longer word: 5mm is not in metres.
    units = [name for name in _UNITS[unit] if re.search(rf"[^a-z°]{name}$", text)]
    number, convert = (text.removesuffix(units[0]), _UNITS[unit][units[0]]) if units else (text, float)
    try:
        return convert(_compute(number))
    except ValueError:
        return None


def angle_value(unit: str, expression: str) -> float:
    """Return rosparam's ``deg(...)`` or ``rad(...)`` in radians.

    Source of the rule: ``construct_angle_degrees`` and ``construct_angle_radians`` of ros_comm's rosparam.

    Raises
    ------
    ValueError
        If the expression is more than arithmetic.
    """
    return _UNITS["rad"][unit](_compute(expression))


def written_angle(text: str) -> float | None:
    """Return the value of a text such as ``rad(pi/2)``; None if it is another text or cannot be computed."""
    written = ANGLE.fullmatch(text.strip())
    if written is None:
        return None
    try:
        return angle_value(*written.groups())
    except ValueError:
        return None


def duration_ns(text: str) -> int | None:
    """Read a time of ``60s``, ``1.5min``, ``2h``, ``500ms``, ``48us`` or ``7ns`` as nanoseconds; None for other texts.

    >>> duration_ns("60s"), duration_ns("1.5 min"), duration_ns("0.1s"), duration_ns("60")
    (60000000000, 90000000000, 100000000, None)
    """
    written = _NUMBER_AND_UNIT.fullmatch(text.strip())
    scale = None if written is None else _DURATIONS.get(written[2].lower())
    if written is None or scale is None:
        return None
    return int(Decimal(written[1]) * scale)


def _compute(expression: str) -> float:
    if len(expression) > _LONGEST:
        raise ValueError(expression)
    try:
        return _arithmetic(ast.parse(expression.strip(), mode="eval").body)
    except (SyntaxError, ArithmeticError) as err:
        raise ValueError(expression) from err


def _arithmetic(node: ast.expr) -> float:
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name(id="pi"):
            return math.pi
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_arithmetic(operand)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _arithmetic(operand)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_arithmetic(left), _arithmetic(right))
    raise ValueError(ast.dump(node))
