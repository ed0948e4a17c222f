"""Tables of cases that are texts: what is given, and what is expected of it, a line each."""

from __future__ import annotations

import math
from ast import literal_eval
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path


def rows(path: Path, section: str, *, text: bool = False) -> list[tuple[Any, ...]]:
    """Read a section of a file: lines of Python's literals, separated by `` -> ``.

    Beside literals there are ``pi``, ``inf``, ``nan`` and products of them with numbers, such as ``-pi / 2``. A line
    that begins with ``# `` is a comment, and ``== name`` begins a section. With ``text`` the first value of a line is a
    text, in which ``\\n`` and ``\\t`` are the end of a line and a tab.
    """
    lines = path.read_text("utf-8").partition(f"== {section}\n")[2].partition("\n== ")[0].splitlines()
    found = []
    for line in lines:
        if line.strip() and not line.startswith("# "):
            given, *expected = line.split(" -> ")
            first = given.replace("\\n", "\n").replace("\\t", "\t") if text else _value(given)
            found.append((first, *map(_value, expected)))
    assert found, f"{path} has no cases of {section}"
    return found


def _value(text: str) -> Any:
    try:
        return literal_eval(text)
    except (SyntaxError, ValueError):
        return eval(text, {"__builtins__": {}}, {"pi": math.pi, "inf": math.inf, "nan": math.nan})  # of our own files
