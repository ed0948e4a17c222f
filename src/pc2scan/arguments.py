"""Calls of the public functions: names in any of their usual forms, misspelt keywords."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from .text import nearest

if TYPE_CHECKING:
    from collections.abc import Mapping

#: Maximum number of characters of a value in an error message.
_LONGEST = 80


def value_text(value: object) -> str:
    """Return a value for an error message, as it is written in a file."""
    if value is None:
        return "nothing"
    if isinstance(value, list | tuple | dict):
        return "a mapping" if isinstance(value, dict) else "a list"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def value_and_type(value: object) -> str:
    """Return a value and its type, for an error message."""
    text = repr(value)
    return f"{text if len(text) <= _LONGEST else f'{text[:_LONGEST]}...'} ({type(value).__name__})"


def names_in(name: str, values: object) -> tuple[str, ...]:
    """Return the names of an argument that takes one name or several; an empty tuple for None.

    Raises
    ------
    TypeError
        If one of them is not text.
    """
    if values is None:
        return ()
    if isinstance(values, str):
        return (values,)
    if isinstance(values, bytes) or not isinstance(values, Iterable):
        raise TypeError(f"{name} is {value_and_type(values)}, it must be a str or several")
    names = tuple(values)
    for value in names:
        if not isinstance(value, str):
            raise TypeError(f"{name} has {value_and_type(value)}, it must be a str or several")
    return names


def refuse_unknown(
    function: str, names: Iterable[str], known: Iterable[str], synonyms: Mapping[str, str] | None = None
) -> None:
    """Raise a TypeError for the first unknown name, with a suggestion: the synonym's meaning, or a similar name."""
    candidates = sorted(known)
    for name in names:
        if name in candidates:
            continue
        word = name.lower().strip("_")
        synonym = (synonyms or {}).get(word)
        meant = synonym if synonym in candidates else nearest(word, candidates)
        raise TypeError(f"{function}() has no argument {name!r}{f'; did you mean {meant!r}?' if meant else ''}")
