"""The chain of transforms between two frames: found by walks up from both, and multiplied at one time, or at many.

Between many times the transforms of points are interpolated. They differ from those of single lookups in the last bits
of float64.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import takewhile
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core import kernel
from pc2scan.core.rigid import IDENTITY_POSE, Rigid, compose_poses, inverse_pose

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.rigid import Pose

    from .history import FrameHistory

    Needed = Callable[[NDArray[np.int64], NDArray[np.float64]], int]
    _Side = tuple[FrameHistory, ...]

#: The factor that tf2 uses if the frame itself is the top of its walk; it changes only the signs of zeros.
_INVERSE_OF_NOTHING = inverse_pose(IDENTITY_POSE)

#: The stamps of a static link.
_ALWAYS = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class Query:
    """The names and numbers of two frames, the stamp, and the tolerance."""

    target: str
    source: str
    target_number: int
    source_number: int
    stamp_ns: int
    tolerance_ns: int


@dataclass(frozen=True, slots=True)
class Side:
    """The links from a frame up to the common ancestor. Static links at the beginning are multiplied only once.

    Attributes
    ----------
    links
        All links, in this order.
    begin
        The product of the static links that come first.
    rest
        The other links.
    """

    links: tuple[FrameHistory, ...]
    begin: Pose
    rest: tuple[FrameHistory, ...]

    @classmethod
    def of(cls, links: tuple[FrameHistory, ...]) -> Side:
        """Multiply the static links that come first."""
        static = tuple(takewhile(attrgetter("static"), links))
        return cls(links, _multiply_links(IDENTITY_POSE, static, None), links[len(static) :])

    def pose_at(self, time_ns: int | None) -> Pose:
        """Return ``ancestor_from_frame`` at a time; None asks for each link's latest."""
        return _multiply_links(self.begin, self.rest, time_ns)


@dataclass(frozen=True, slots=True)
class Chain:
    """The links between two frames.

    Attributes
    ----------
    target_side, source_side
        The links up to the common ancestor.
    above
        The links above it.
    fixed
        Results that depend on static links alone, by the number of known links above.
    """

    target_side: Side
    source_side: Side
    above: tuple[FrameHistory, ...]
    fixed: dict[int, Rigid] = field(default_factory=dict)

    @property
    def links(self) -> tuple[FrameHistory, ...]:
        """The links that have to be known."""
        return self.source_side.links + self.target_side.links

    def target_from_source(self, time_ns: int | None) -> Rigid:
        """Multiply the links' transforms at a time; None asks for each link's latest.

        Source of the rule: ``BufferCore::walkToTopParent`` and ``TransformAccum``.
        """
        known = tuple(takewhile(lambda link: link.gap_ns(time_ns) == 0, self.above))
        if not (self.source_side.links and self.target_side.links):
            # One frame is the other's ancestor: whether its own parent is known decides the signs of zeros.
            known = known[:1]
            is_dynamic = False
        else:
            is_dynamic = not all(link.static for link in known)
        if is_dynamic or self.source_side.rest or self.target_side.rest:
            return Rigid.from_pose(self._multiply(known, time_ns))
        if len(known) not in self.fixed:
            self.fixed[len(known)] = Rigid.from_pose(self._multiply(known, time_ns))
        return self.fixed[len(known)]

    def _multiply(self, known: tuple[FrameHistory, ...], time_ns: int | None) -> Pose:
        source_pose, target_pose = self.source_side.pose_at(time_ns), self.target_side.pose_at(time_ns)
        if not self.target_side.links:
            return source_pose if known else compose_poses(_INVERSE_OF_NOTHING, source_pose)
        if not self.source_side.links:
            return inverse_pose(target_pose) if known else compose_poses(inverse_pose(target_pose), IDENTITY_POSE)
        for link in known:
            pose = link.pose_at(time_ns)
            source_pose, target_pose = compose_poses(pose, source_pose), compose_poses(pose, target_pose)
        return compose_poses(inverse_pose(target_pose), source_pose)


def _multiply_links(pose: Pose, links: Iterable[FrameHistory], time_ns: int | None) -> Pose:
    """Transform a pose from the first link's child up to the last link's parent."""
    for link in links:
        pose = compose_poses(link.pose_at(time_ns), pose)
    return pose


@dataclass(frozen=True, slots=True)
class Walk:
    """A walk up from a frame.

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
    start: int,
    histories: Sequence[FrameHistory | None],
    parent_of: Callable[[FrameHistory], int],
    stops: Collection[int] = (),
) -> Walk:
    """Walk up from a frame, to the first of ``stops`` at most; ``parent_of`` returns -1 for an unknown parent."""
    met: dict[int, FrameHistory | None] = {}
    frame = start
    while frame not in met:
        link = met[frame] = histories[frame]
        if link is None or frame in stops:
            return Walk(met)
        frame = parent_of(link)
        if frame < 0:
            return Walk(met, blocked=link)
    return Walk(met, loop=frame)


def walk_both(
    target: int, source: int, histories: Sequence[FrameHistory | None], parent_of: Callable[[FrameHistory], int]
) -> tuple[Walk, Walk]:
    """Walk like tf2: from the source up to the target or the root, then from the target until the walks meet."""
    source_walk = walk_up(source, histories, parent_of, (target,))
    return walk_up(target, histories, parent_of, source_walk.links), source_walk


def join_walks(target_walk: Walk, source_walk: Walk) -> Chain | None:
    """Return the chain between the starts of two walks; None if they do not meet."""
    common = next(reversed(target_walk.links))
    if common not in source_walk.links:
        return None
    target_side, _ = _split(target_walk, common)
    source_side, above = _split(source_walk, common)
    return Chain(Side.of(target_side), Side.of(source_side), above)


def _split(walk: Walk, ancestor: int) -> tuple[tuple[FrameHistory, ...], tuple[FrameHistory, ...]]:
    """Return the links of a walk below an ancestor, and those from it on."""
    links = list(walk.links.values())
    below = list(walk.links).index(ancestor)
    return tuple(link for link in links[:below] if link), tuple(link for link in links[below:] if link)


def sample_chain(
    chain: Chain, begin_ns: int, end_ns: int, step_ns: int, needed_ns: Needed
) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
    """Look up a chain, whose parents do not change in the interval, at many times; see `TransformBuffer.rows`."""
    sides = (chain.source_side.links, chain.target_side.links, chain.above)
    source, target, above = (tuple([link.during(begin_ns, end_ns) for link in side]) for side in sides)
    # Samples of each link are among the times: there the motion may change.
    stamps = tuple([link.stamps_ns for link in (*source, *target) if not link.static])

    def looked_up(step_ns: int) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
        nodes, gap_ns = kernel.nodes(stamps, begin_ns, end_ns, step_ns)
        times = np.frombuffer(nodes, np.int64)
        return times[::2], _rows_of(source, target, above, times), gap_ns

    rows = looked_up(step_ns)
    needed = needed_ns(*rows[:2])
    return rows if needed >= step_ns else looked_up(needed)


def _rows_of(source: _Side, target: _Side, above: _Side, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return ``target_from_source`` at (N,) stamps.

    Returns
    -------
    (N, 12) float64
        The rows of the rotation, then the translation; NaN where a frame is not known.
    """
    rows = _rows_to_ancestor(source, stamps_ns)
    if not target:
        return rows
    down = _rows_to_ancestor(target, stamps_ns)
    back = down[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1)
    origin = np.einsum("nij,nj->ni", back, rows[:, 9:] - down[:, 9:])
    # As in `follow`. The inverse of the target's walk scales, and what both walks have in common scales before.
    for link in target:
        origin *= _squared_lengths(link, stamps_ns)[:, np.newaxis]
    if source:
        known = np.ones(stamps_ns.size, np.bool_)
        for link in above:
            squared = _squared_lengths(link, stamps_ns)
            known &= ~np.isnan(squared)
            origin[known] *= np.square(squared[known])[:, np.newaxis]
    return np.concatenate([(back @ rows[:, :9].reshape(-1, 3, 3)).reshape(-1, 9), origin], axis=1)


def _rows_to_ancestor(links: Iterable[FrameHistory], stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the transforms from a frame up to the common ancestor."""
    rows = np.zeros((stamps_ns.size, 12))
    rows[:, 0:9:4] = 1.0
    for link in links:
        if link.static:
            kernel.follow(stamps_ns, _ALWAYS, link.poses[-1:], rows)
        else:
            kernel.follow(stamps_ns, link.stamps_ns, link.poses, rows)
    return rows


def _squared_lengths(link: FrameHistory, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the squared lengths of a link's quaternions, (N,); NaN where it is not known."""
    samples, poses = _ALWAYS, link.poses[-1:]
    if not link.static:
        begin, end = link.stamps_ns.searchsorted(stamps_ns[[0, -1]]).tolist()
        needed = slice(max(begin - 1, 0), end + 1)
        samples, poses = link.stamps_ns[needed], link.poses[needed]
    # They are how much a rotation scales.
    rows = np.zeros((stamps_ns.size, 12))
    rows[:, 9] = 1.0
    kernel.follow(stamps_ns, samples, poses * [0, 0, 0, 1, 1, 1, 1], rows)
    lengths: NDArray[np.float64] = np.linalg.norm(rows[:, 9:], axis=1)
    return lengths
