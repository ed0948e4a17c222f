"""Translates the names of options from Python to the command line.

Messages name an option as in Python, in backticks: ```overwrite=True` replaces it``. The command shows
``--overwrite replaces it``.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from pc2scan.options.table import spelling_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.result import Call

_NAMED = re.compile(r"`([a-z_]+)(?:=([^`]*))?`")


def as_typed(text: str) -> str:
    """Return a text with its options as they are typed; other text in backticks is unchanged.

    >>> as_typed("`overwrite=True` replaces it; `topics=/points:=/b` is free; see `min_height` and `ls`")
    '--overwrite replaces it; --topic /points:=/b is free; see --min-height and `ls`'
    """
    return _NAMED.sub(_spelled, text) if "`" in text else text


def _spelled(named: re.Match[str]) -> str:
    name, value = named.groups()
    option = spelling_of(name)
    if option is None:
        return named[0]
    return option if value in (None, "True") else f"{option} {value}"


def call_words(call: Call) -> list[str]:
    """Return the words of the command that a result proposes."""
    words = ["pc2scan", call.command, *call.sources]
    for name, value in call.options.items():
        words += _option_words(spelling_of(name) or f"--{name}", value)
    return words


def _option_words(spelling: str, value: Any) -> Iterator[str]:
    """Yield an option; negative numbers need no "=" before them, because no option begins with a digit."""
    if value is True:
        yield spelling
    elif isinstance(value, tuple):
        for each in value:
            yield from _option_words(spelling, each)
    else:
        yield from (spelling, f"{value:g}" if isinstance(value, float) else str(value))
