"""Tables of cases that are texts: what is given, and what is expected of it, a line each."""

from __future__ import annotations

import math
from ast import literal_eval
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["rows"]


def rows(path: Path, section: str) -> list[tuple[Any, ...]]:
    """Read a section of a file: lines of a text, and of Python's literals after `` -> ``.

    In the text, ``\\n`` and ``\\t`` are the end of a line and a tab. Beside literals there are ``pi``, ``inf`` and
    products of them with numbers, such as ``-pi/2``. ``#`` begins a comment, ``== name`` a section.
    """
    text = path.read_text("utf-8").partition(f"== {section}\n")[2].partition("\n== ")[0]
    found = []
    for line in text.splitlines():
        if line.strip() and not line.startswith("# "):
            given, *expected = line.split(" -> ")
            found.append((given.replace("\\n", "\n").replace("\\t", "\t"), *map(_value, expected)))
    assert found, f"{path} has no cases of {section}"
    return found


def _value(text: str) -> Any:
    try:
        return literal_eval(text)
    except (SyntaxError, ValueError):
        return eval(text, {"__builtins__": {}}, {"pi": math.pi, "inf": math.inf})  # of our own files
