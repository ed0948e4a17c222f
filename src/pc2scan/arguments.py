"""Calls of the public functions: names in any of their usual forms, misspelt keywords, callable packages."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from .text import nearest

if TYPE_CHECKING:
    from collections.abc import Mapping
    from inspect import Signature
    from typing import Any

#: Maximum number of characters of a value in an error message.
_LONGEST = 80


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
    found = tuple(values)
    for value in found:
        if not isinstance(value, str):
            raise TypeError(f"{name} has {value_and_type(value)}, it must be a str or several")
    return found


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


# --- packages with the name of a public function ---
#
# ``pc2scan.tf`` and ``pc2scan.golden`` are packages. Python sets them as attributes of ``pc2scan`` when anything in
# them is imported, so a function of that name would be there or not depending on what was imported before.


class CallablePackage(ModuleType):
    """A package that is called like the function of its name in ``pc2scan.api``; its ``__init__`` makes it one."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call the function."""
        return _function(self)(*args, **kwargs)

    @property
    def __signature__(self) -> Signature:
        from inspect import signature  # noqa: PLC0415  # only who looks at signatures pays for it

        return signature(_function(self))

    @property
    def __doc__(self) -> str | None:  # type: ignore[override]  # what help() shows
        doc: str | None = _function(self).__doc__
        return doc


def _function(package: ModuleType) -> Any:
    parent, _, name = package.__name__.rpartition(".")
    return getattr(import_module(f"{parent}.api"), name)
