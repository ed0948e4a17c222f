"""Finds topics of a recording by the names that users give."""

from __future__ import annotations

from pc2scan.errors import TopicError, name_list
from pc2scan.names import did_you_mean

__all__ = ["find_topic", "short_type"]


def find_topic(asked: str, types: dict[str, set[str]], candidates: list[str], kind: str) -> str:
    """Return the topic of a type by its name, with or without the leading slash.

    Parameters
    ----------
    asked
        The name.
    types
        The types that each topic of the recording has.
    candidates
        The topics of the type.
    kind
        The type, in ROS 2's spelling.

    Raises
    ------
    TopicError
        If there is no such topic, or it has another type.
    """
    there = f"{short_type(kind)} topics: {name_list(candidates)}"
    for name in (asked, f"/{asked}", asked.removeprefix("/")):
        if name in types:
            if kind in types[name]:
                return name
            raise TopicError(f"topic {name} is {', '.join(sorted(types[name]))}, not {kind}", hint=there)
    near = did_you_mean(asked, candidates)
    raise TopicError(f"no topic {asked} in the recording", hint=f"{near} {there}".strip())


def short_type(kind: str) -> str:
    """Return a type without its package."""
    return kind.rsplit("/", 1)[-1]
