"""The library as people call it: tests that are texts, of Python: an expression, and what it returns or raises.

    tests.nearest("points", ["/imu", "/lidar/points"])
    = "/lidar/points"

    pc2scan.info(5)
    ! TypeError: it must be a path

An expression stands in a line of its own. ``=`` is before an expression with the same value. ``!`` is before the name
of the error and a part of its text, with any white space. ``#`` is a comment.
"""

from __future__ import annotations

import os
from datetime import datetime, timedelta, timezone
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

import pc2scan
from support import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

TEXTS = sorted(Path(__file__).parent.glob("*.calls"))

NAMES: dict[str, Any] = {name: getattr(pc2scan, name) for name in pc2scan.__all__}
NAMES |= {"np": np, "datetime": datetime, "timedelta": timedelta, "timezone": timezone, "Path": Path}
NAMES |= {"HALL": str(ROOT / "fixtures" / "hall.bag"), "CASES": ROOT / "fixtures" / "golden", "OUT": "out.mcap"}
#: Formats and small rules that are not public.
INNER = {
    "pc2scan.bags.damage": ["Damage"],
    "pc2scan.cli.render": ["as_typed"],
    "pc2scan.errors": ["ParameterError", "name_list", "stamp_text", "visible"],
    "pc2scan.files.paths": ["path_of"],
    "pc2scan.options.moment": ["TimeBound"],
    "pc2scan.text": ["count", "did_you_mean", "duration", "nearest", "size", "stamp"],
}
NAMES |= {name: getattr(import_module(module), name) for module, inner in INNER.items() for name in inner}


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


@pytest.fixture(autouse=True, scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An empty folder, in which nothing is written."""
    before, here = Path.cwd(), tmp_path_factory.mktemp("calls")
    os.chdir(here)
    yield here
    assert list(here.iterdir()) == []
    os.chdir(before)


@pytest.mark.parametrize(
    "call", [pytest.param(call, id=call.expression) for path in TEXTS for call in calls_of(path.read_text("utf-8"))]
)
def test_what_is_called_returns_or_raises(call: Call) -> None:
    check_call(call, NAMES)


@pytest.mark.parametrize(
    "text", ["1 + 1\n= 3", "1\n! TypeError: x", "int('x')\n! ValueError: y", "int('x')\n! TypeError: x"]
)
def test_a_call_can_fail(text: str) -> None:
    (call,) = calls_of(text)
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        check_call(call, {})


@pytest.mark.parametrize("text", ["= 1", "1\n2\n= 2"])
def test_what_is_no_call_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not an expression"):
        calls_of(text)
