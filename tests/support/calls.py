"""Tests that are texts, of Python: an expression, and what it returns or raises.

    tests.nearest("points", ["/imu", "/lidar/points"])
    = "/lidar/points"

    pc2scan.info(5)
    ! TypeError: it must be a path

An expression stands in a line of its own. ``=`` is before an expression with the same value. ``!`` is before the name
of the error and a part of its text, with any white space. ``#`` is a comment.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["Call", "calls_of", "check_call"]


class Call(NamedTuple):
    """An expression, and what is expected of it."""

    expression: str
    sign: str
    expected: str


def calls_of(text: str) -> list[Call]:
    """Read the calls of a file.

    Raises
    ------
    ValueError
        If an expression has no expectation, or an expectation no expression.
    """
    found: list[Call] = []
    waiting = ""
    for line in (line.strip() for line in text.splitlines()):
        if not line or line.startswith("#"):
            continue
        if line[0] in "=!" and waiting:
            found.append(Call(waiting, line[0], line[1:].strip()))
            waiting = ""
        elif line[0] in "=!" or waiting:
            raise ValueError(f"not an expression and what is expected of it: {waiting} {line}")
        else:
            waiting = line
    return found


def check_call(call: Call, names: Mapping[str, Any]) -> None:
    """Evaluate an expression, and hold it to what is expected."""
    if call.sign == "=":
        assert eval(call.expression, dict(names)) == eval(call.expected, dict(names))
        return
    kind, _, part = call.expected.partition(": ")
    with pytest.raises(Exception) as raised:  # noqa: PT011 - compared below
        eval(call.expression, dict(names))
    assert type(raised.value).__name__ == kind, raised.value
    assert " ".join(part.split()) in " ".join(str(raised.value).split())
