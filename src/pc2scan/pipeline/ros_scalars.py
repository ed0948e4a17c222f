"""Values as ROS writes them in plain text: numbers, truth values, and ROS 1's ``deg()`` and ``rad()``."""

from __future__ import annotations

import ast
import math
import operator
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ANGLE", "angle_value", "plain_scalar", "written_angle"]

_TRUE = frozenset(["y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"])

_FALSE = frozenset(["n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"])

_NULL = frozenset({"", "~", "null", "Null", "NULL"})

_INTEGER = re.compile(r"[-+]?([1-9][0-9]*|0[0-7]*|0[xX][0-9a-fA-F]+)")

_FLOAT = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")

_SPECIAL = re.compile(r"([-+]?)\.?(inf|Inf|INF|nan|NaN|NAN)")

ANGLE = re.compile(r"(deg|rad)\((.*)\)")


def plain_scalar(text: str) -> bool | int | float | str | None:
    """Read an unquoted scalar as ROS 2 does.

    Source of the rule: ``get_value`` of rcl_yaml_param_parser/src/parse.c tries YAML 1.1's booleans, then
    ``strtol`` with base 0, then ``strtod``; the rest is text. So ``1e5`` is a number, unlike in YAML 1.1.
    """
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if text in _NULL:
        return None
    if _INTEGER.fullmatch(text):
        return _integer(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    special = _SPECIAL.fullmatch(text)
    return float("".join(special.groups())) if special else text


def _integer(text: str) -> int | str:
    digits = text.lstrip("+-")
    base = 16 if digits[:2] in {"0x", "0X"} else 8 if digits[0] == "0" else 10
    try:
        return int(text, base)
    except ValueError:  # more digits than Python converts
        return text


_OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def angle_value(unit: str, expression: str) -> float:
    """Radians of rosparam's ``deg(...)`` and ``rad(...)``.

    Numbers, ``pi``, parentheses and ``+ - * /`` are understood. Nothing is executed.
    Source of the rule: ``construct_angle_degrees`` and ``construct_angle_radians`` of ros_comm's rosparam.

    Raises
    ------
    ValueError
        If the expression is anything else.
    """
    if len(expression) > 100:
        raise ValueError(expression)
    try:
        value = _arithmetic(ast.parse(expression.strip(), mode="eval").body)
    except (SyntaxError, ArithmeticError) as err:
        raise ValueError(expression) from err
    # rosparam's order of operations, so that the last bit is the same.
    return value * math.pi / 180.0 if unit == "deg" else value


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


def written_angle(text: str) -> float | None:
    """Value of a text such as ``rad(pi/2)``; None if it is no such text or cannot be computed."""
    written = ANGLE.fullmatch(text.strip())
    if written is None:
        return None
    try:
        return angle_value(*written.groups())
    except ValueError:
        return None
