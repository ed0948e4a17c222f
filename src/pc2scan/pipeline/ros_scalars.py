"""Reads values as ROS writes them in plain text: numbers and truth values."""

from __future__ import annotations

import re

_TRUE = frozenset(["y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"])

_FALSE = frozenset(["n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"])

_NULL = frozenset({"", "~", "null", "Null", "NULL"})

_INTEGER = r"[-+]?([1-9][0-9]*|0[0-7]*|0[xX][0-9a-fA-F]+)"

_FLOAT = r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?"

_SPECIAL = r"([-+]?)\.?(inf|Inf|INF|nan|NaN|NAN)"


def plain_scalar(text: str) -> bool | int | float | str | None:
    """Read an unquoted scalar as ROS 2 does.

    Source of the rule: ``get_value`` of rcl_yaml_param_parser/src/parse.c tries YAML 1.1's booleans, then
    ``strtol`` with base 0, then ``strtod``; the rest is text. So ``1e5`` is a number, unlike in YAML 1.1.
    """
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if text in _NULL:
        return None
    if re.fullmatch(_INTEGER, text):
        return _integer(text)
    if re.fullmatch(_FLOAT, text):
        return float(text)
    special = re.fullmatch(_SPECIAL, text)
    return float("".join(special.groups())) if special else text


def _integer(text: str) -> int | str:
    digits = text.lstrip("+-")
    base = 16 if digits[:2] in {"0x", "0X"} else 8 if digits[0] == "0" else 10
    try:
        return int(text, base)
    except ValueError:  # more digits than Python reads
        return text
