"""The way between two frames, and the product of the transforms on it."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import takewhile
from typing import TYPE_CHECKING

from pc2scan.core.rigid import IDENTITY_POSE, Rigid, compose_poses, inverse_pose

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pc2scan.core.rigid import Pose

    from .history import FrameHistory

__all__ = ["Chain", "Side"]


@dataclass(frozen=True, slots=True)
class Side:
    """The links on the way up from a frame, with what is the same at any time multiplied once.

    Attributes
    ----------
    links
        All of them, in this order.
    begin
        The product of the first ones, which are static.
    rest
        The others.
    """

    links: tuple[FrameHistory, ...]
    begin: Pose
    rest: tuple[FrameHistory, ...]

    @classmethod
    def of(cls, links: tuple[FrameHistory, ...]) -> Side:
        """Multiply the static links that come first."""
        static = tuple(takewhile(lambda link: link.static, links))
        return cls(links, _multiplied(static, None, IDENTITY_POSE), links[len(static) :])

    def pose_at(self, time_ns: int | None) -> Pose:
        """``ancestor_from_frame`` at a time; None asks for each link's latest."""
        return _multiplied(self.rest, time_ns, self.begin)


#: What tf2 multiplies with where the frame itself is the top of its walk: the same but for the signs of zeros.
_INVERSE_OF_NOTHING = inverse_pose(IDENTITY_POSE)


@dataclass(frozen=True, slots=True)
class Chain:
    """The way between two frames.

    Attributes
    ----------
    target_side, source_side
        The links up to the common ancestor.
    above
        Those above it.
    fixed
        What is found by static links alone, by the number of known links above.
    """

    target_side: Side
    source_side: Side
    above: tuple[FrameHistory, ...]
    fixed: dict[int, Rigid] = field(default_factory=dict)

    @property
    def links(self) -> tuple[FrameHistory, ...]:
        """Those that have to be known."""
        return self.source_side.links + self.target_side.links

    def target_from_source(self, time_ns: int | None) -> Rigid:
        """Multiply the links' transforms at a time; None asks for each link's latest.

        Source of the rule: ``BufferCore::walkToTopParent`` and ``TransformAccum``.
        """
        known = tuple(takewhile(lambda link: link.gap_ns(time_ns) == 0, self.above))
        if not (self.source_side.links and self.target_side.links):
            # Of an ancestor of the other frame, only whether its own parent is known has a say: in the signs of zeros.
            known = known[:1]
            moves = False
        else:
            moves = not all(link.static for link in known)
        if moves or self.source_side.rest or self.target_side.rest:
            return Rigid.from_pose(self._multiplied(known, time_ns))
        if len(known) not in self.fixed:
            self.fixed[len(known)] = Rigid.from_pose(self._multiplied(known, time_ns))
        return self.fixed[len(known)]

    def _multiplied(self, known: tuple[FrameHistory, ...], time_ns: int | None) -> Pose:
        source_pose, target_pose = self.source_side.pose_at(time_ns), self.target_side.pose_at(time_ns)
        if not self.target_side.links:
            return source_pose if known else compose_poses(_INVERSE_OF_NOTHING, source_pose)
        if not self.source_side.links:
            return inverse_pose(target_pose) if known else compose_poses(inverse_pose(target_pose), IDENTITY_POSE)
        for link in known:
            pose = link.pose_at(time_ns)
            source_pose, target_pose = compose_poses(pose, source_pose), compose_poses(pose, target_pose)
        return compose_poses(inverse_pose(target_pose), source_pose)


def _multiplied(links: Iterable[FrameHistory], time_ns: int | None, pose: Pose) -> Pose:
    """Go on from a pose in the first link's child up to the last link's parent."""
    for link in links:
        pose = compose_poses(link.pose_at(time_ns), pose)
    return pose
