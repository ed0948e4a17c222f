"""Finds topics of a recording by the names that users give."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import TopicError, name_list
from pc2scan.names import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["find_topic", "short_types"]


def find_topic(asked: str, types: dict[str, set[str]], candidates: list[str], *kinds: str) -> str:
    """Return the topic of a type by its name, with or without the leading slash.

    Parameters
    ----------
    asked
        The name.
    types
        The types that each topic of the recording has.
    candidates
        The topics of the type.
    kinds
        The type, in ROS 2's spelling, or several that are possible.

    Raises
    ------
    TopicError
        If there is no such topic, or it has another type.
    """
    there = f"{short_types(kinds)} topics: {name_list(candidates)}"
    for name in (asked, f"/{asked}", asked.removeprefix("/")):
        if name in types:
            if not types[name].isdisjoint(kinds):
                return name
            raise TopicError(f"topic {name} is {', '.join(sorted(types[name]))}, not {' or '.join(kinds)}", hint=there)
    near = did_you_mean(asked, candidates)
    raise TopicError(f"no topic {asked} in the recording", hint=f"{near} {there}".strip())


def short_types(kinds: Iterable[str]) -> str:
    """Return types without their packages, for a message."""
    return " or ".join(kind.rsplit("/", 1)[-1] for kind in kinds)
