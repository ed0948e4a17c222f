"""The page of the library: the signature and the docstring of every public name."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

import pc2scan

if TYPE_CHECKING:
    from collections.abc import Iterator


def page() -> str:
    """Return the page, functions first: their names are in lower case."""
    names = sorted((name for name in pc2scan.__all__ if name != "errors"), key=lambda name: (name[0].isupper(), name))
    parts = ["# Python\n", "[Python](../python.md) is the introduction; these are the docstrings.\n"]
    for name in names:
        parts += _described(name, getattr(pc2scan, name))
    return "\n".join(parts)


def _described(name: str, thing: Any) -> Iterator[str]:
    """Yield the heading and the docstring of a function or class, with its keywords or its members."""
    yield f"## {name}\n"
    if inspect.isclass(thing):
        yield f"```text\n{inspect.getdoc(thing)}\n```\n"
        for member, value in inspect.getmembers(thing):
            is_own = isinstance(value, property) or inspect.isroutine(value)
            if is_own and not member.startswith("_") and (text := inspect.getdoc(value)):
                yield f"- `{member}`: {text.partition(chr(10))[0]}"
        yield ""
        return
    given = inspect.signature(thing).parameters.values()
    lines = "".join(f"    {each.replace(annotation=inspect.Parameter.empty)},\n" for each in given)
    yield f"```python\n{name}(\n{lines})\n```\n"
    yield f"```text\n{inspect.getdoc(thing)}\n```\n"
