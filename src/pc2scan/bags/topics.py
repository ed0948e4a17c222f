"""Topics of a recording as people name them, and as errors list them."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

from pc2scan.errors import TopicError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["find_topic", "listed", "short_type"]


def find_topic(asked: str, types: dict[str, set[str]], candidates: list[str], kind: str) -> str:
    """The topic of a type that a name means; a leading slash is no difference.

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
    there = f"{short_type(kind)} topics: {listed(candidates)}"
    for name in (asked, f"/{asked}", asked.removeprefix("/")):
        if name in types:
            if kind in types[name]:
                return name
            raise TopicError(f"topic {name} is {', '.join(sorted(types[name]))}, not {kind}", hint=there)
    near = difflib.get_close_matches(asked, candidates, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise TopicError(f"no topic {asked} in the recording", hint=f"{hint}{there}")


def short_type(kind: str) -> str:
    """A type without its package."""
    return kind.rsplit("/", 1)[-1]


def listed(names: Sequence[str], limit: int = 20) -> str:
    """Names for an error message: all of them, or the first ones and how many more."""
    if not names:
        return "none"
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more
