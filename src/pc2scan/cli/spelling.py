"""Translates the names of options from Python to the command line.

Messages name an option as in Python, in backticks: ```overwrite=True` replaces it``. The command shows
``--overwrite replaces it``.
"""

from __future__ import annotations

import re

from pc2scan.options.table import spelling_of

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
