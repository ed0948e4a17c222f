"""Walks from frames up to their roots, and finds where two walks meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .chain import Chain, Side

if TYPE_CHECKING:
    from collections.abc import Callable

    from .history import FrameHistory


@dataclass(frozen=True, slots=True)
class Walk:
    """A walk from a frame up to the root.

    Attributes
    ----------
    links
        The link up from each visited frame, by the frame's index, in this order; None for a root.
    blocked
        The child whose parent is not known at the time, if that ended the walk.
    loop
        The frame that was visited twice, if that ended the walk.
    """

    links: dict[int, FrameHistory | None]
    blocked: FrameHistory | None = None
    loop: int | None = None


def walk_up(
    start: int, history: Callable[[int], FrameHistory | None], parent_of: Callable[[FrameHistory], int]
) -> Walk:
    """Walk up from a frame; ``parent_of`` returns -1 for an unknown parent."""
    met: dict[int, FrameHistory | None] = {}
    frame = start
    while frame not in met:
        link = met[frame] = history(frame)
        if link is None:
            return Walk(met)
        frame = parent_of(link)
        if frame < 0:
            return Walk(met, blocked=link)
    return Walk(met, loop=frame)


def joined(target_walk: Walk, source_walk: Walk) -> Chain | None:
    """Return the chain between the starts of two walks; None if they do not meet."""
    common = next((frame for frame in target_walk.links if frame in source_walk.links), None)
    if common is None:
        return None
    target_side, _ = _split(target_walk, common)
    source_side, above = _split(source_walk, common)
    return Chain(Side.of(target_side), Side.of(source_side), above)


def _split(walk: Walk, ancestor: int) -> tuple[tuple[FrameHistory, ...], tuple[FrameHistory, ...]]:
    """Return the links of a walk below an ancestor, and those from it on."""
    links = list(walk.links.values())
    below = list(walk.links).index(ancestor)
    return tuple(link for link in links[:below] if link), tuple(link for link in links[below:] if link)
