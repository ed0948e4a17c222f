"""The frames of a recording: their statistics, their trees, and the usual names of a robot's frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .history import FrameHistory


#: Usual names of a robot's frame, whose z is up; the first that exists is used.
BODIES = ("base_link", "base_footprint")

#: Frames that a robot moves in (REP 105); the frames below them move with the robot.
WORLDS = ("odom", "map", "world", "earth")


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """Statistics of one child frame.

    Attributes
    ----------
    child
        The frame.
    parents
        Every parent that it had, in the order of time.
    static
        Whether its transform is valid at any time.
    transforms
        Number of samples that are kept.
    received
        Number of accepted transforms, repeated stamps and overwritten static ones included.
    first_ns, last_ns
        Earliest and latest stamp.
    rate_hz
        Mean rate of the samples; None for fewer than two, or a static frame.
    largest_gap_ns
        Longest time between two neighbouring samples; None if there is no rate.
    largest_gap_at_ns
        Stamp at which that gap begins.
    """

    child: str
    parents: tuple[str, ...]
    static: bool
    transforms: int
    received: int
    first_ns: int
    last_ns: int
    rate_hz: float | None
    largest_gap_ns: int | None
    largest_gap_at_ns: int | None


@dataclass(frozen=True, slots=True)
class Tree:
    """Frames that are connected at some time of the recording.

    Attributes
    ----------
    roots
        Frames without a parent, sorted. More than one if a child changed from one tree to another; none
        if the frames form a loop.
    frames
        All frames, the roots included, sorted.
    """

    roots: tuple[str, ...]
    frames: tuple[str, ...]


def frame_info(link: FrameHistory, names: Sequence[str]) -> FrameInfo:
    """Return the statistics of one child frame; ``names`` are those of all frames."""
    count, stamps_ns = link.size, link.stamps_ns
    gaps = np.diff(stamps_ns)
    widest = int(gaps.argmax()) if count > 1 else 0
    return FrameInfo(
        child=names[link.child],
        parents=tuple(names[parent] for parent in link.all_parents()),
        static=link.static,
        transforms=count,
        received=link.received,
        first_ns=link.first_ns,
        last_ns=link.last_ns,
        rate_hz=(count - 1) * 1e9 / (link.last_ns - link.first_ns) if count > 1 else None,
        largest_gap_ns=int(gaps[widest]) if count > 1 else None,
        largest_gap_at_ns=stamps_ns.item(widest) if count > 1 else None,
    )


def top_of(tops: dict[str, str], frame: str) -> str:
    """Return the frame that stands for the tree of a frame: ``tops`` leads from each frame towards it (union-find)."""
    tops.setdefault(frame, frame)
    while tops[frame] != frame:
        tops[frame] = frame = tops[tops[frame]]
    return frame


def trees_of(names: Sequence[str], histories: Sequence[FrameHistory | None]) -> tuple[Tree, ...]:
    """Return the connected frames, the largest tree first.

    Parameters
    ----------
    names
        Names of all frames.
    histories
        Their transforms, in the same order; None for a frame that is never a child.
    """
    tops: dict[str, str] = {}
    for link in filter(None, histories):
        for parent in sorted(link.all_parents()):
            tops[top_of(tops, names[link.child])] = top_of(tops, names[parent])
    members: dict[str, list[int]] = {}
    for frame, name in enumerate(names):
        members.setdefault(top_of(tops, name), []).append(frame)
    trees = (
        Tree(
            roots=tuple(sorted(names[frame] for frame in frames if histories[frame] is None)),
            frames=tuple(sorted(names[frame] for frame in frames)),
        )
        for frames in members.values()
    )
    return tuple(sorted(trees, key=lambda tree: (-len(tree.frames), tree.frames)))
