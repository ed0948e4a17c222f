"""Looks up the transform between two frames at a stamp, among all transforms of a recording.

The rules are those of tf2 0.7.6 (``BufferCore``, ``TimeCache``, ``StaticCache``), which upstream uses:

- One leading slash of a frame's name is stripped. Names are otherwise compared as they are.
- A quaternion is accepted, and used as published, if its squared norm differs from 1 by less than 0.01.
- A child has one parent at a time. Between two samples with different parents the earlier sample is valid,
  unchanged, up to the later one.
- Between two samples of one parent, the translation is interpolated linearly and the rotation by slerp; at the older
  one's stamp too, with the ratio 0. The ratio is that of two durations, each as seconds in float64. The first and the
  last sample are used as they are at their own stamps.
- A child whose first accepted transform was static stays static: its last transform is valid at any time. Any other
  child stays dynamic; a transform that arrives for it as static is a sample like the others.
- Samples may arrive in any order. If several have one stamp, the first to arrive is kept.
- Transforms are needed only up to the common ancestor. Nothing is extrapolated.
- The source is walked up first, to the target, the root, or the first frame whose parent is not known at the time, and
  then the target, if it was not met. The transforms above a common ancestor are in both walks and cancel out but for
  rounding.
- A walk that runs into a loop is an error. A loop above the target has no effect.
- A stamp of 0 asks for the latest time that every frame of the chain has.

Intended differences from tf2:

- Nothing expires (tf2 keeps 10 s), and chains may be longer than tf2's 1000 frames.
- Infinite components are refused like NaN.
- Lookups strip the leading slash too, and take a tolerance.

A chain of transforms between two frames is found by walks up from both, and multiplied at one time, or at many. Between
many times the transforms of points are interpolated, which differs from single lookups in the last bits of float64.

Operations are in tf2's order (see `pc2scan.core.rigid`), so that lookups are bit-exact. ROS 2's tf2 computes the ratio
from nanoseconds, which differs in the last bits of float64.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import takewhile
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core import kernel
from pc2scan.core.rigid import IDENTITY_POSE, Rigid, compose_poses, inverse_pose
from pc2scan.errors import TransformError, UnconnectedError, name_list, stamp_text
from pc2scan.text import did_you_mean

from .frames import BODIES, frame_info, trees_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.rigid import Pose

    from .frames import FrameHistory, FrameInfo, RejectedTransforms, Tree

    Needed = Callable[[NDArray[np.int64], NDArray[np.float64]], int]
    _Side = tuple[FrameHistory, ...]

#: The most frames above one that are of interest; robots have a dozen.
_MOST_ABOVE = 100

#: What to do about a recording in which no transform moves the robot.
ADDS_ODOMETRY = "`odom_topic` or `trajectory` adds odometry, `tf_from` that of another recording"

#: Maximum number of frames that an error message names.
MAX_NAMES = 20

#: A gap up to this may be bridged.
_BRIDGED_NS = 1_000_000_000

_SEE_TF = "`pc2scan tf` shows the frames of a recording and their times"


#: The stamps of a static link.
_ALWAYS = np.empty(0, np.int64)


@dataclass(frozen=True, eq=False)  # not slotted: `infos` and `trees` are computed when first asked for
class TransformBuffer:
    """The transforms of a whole recording, built by `TransformBuilder`. The module's docstring has the rules.

    Attributes
    ----------
    frames
        Names of all frames, in the order of their first occurrence.
    rejections
        The rejected transforms, in the order of occurrence; at most 100 entries.
    rejected
        Number of all rejected transforms.
    """

    frames: tuple[str, ...]
    rejections: tuple[RejectedTransforms, ...]
    rejected: int
    # By the frames' indices; None for a frame that is never a child.
    _histories: tuple[FrameHistory | None, ...] = field(repr=False)
    _numbers: dict[str, int] = field(repr=False)
    _chains: dict[tuple[int, int], Chain | None] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        """Return the number of samples that are kept."""
        return sum(history.size for history in self._histories if history is not None)

    def history(self, frame: str) -> FrameHistory | None:
        """Return the transforms of a child frame; None for a frame that is never a child, or unknown."""
        number = self._numbers.get(frame.removeprefix("/"))
        return None if number is None else self._histories[number]

    def above(self, frame: str) -> list[str]:
        """Return the frames above a frame, by their latest parents, the nearest first."""
        names: list[str] = []
        while (history := self.history(frame)) is not None:
            frame = self.frames[history.parent_at(None)]
            if frame in names or len(names) == _MOST_ABOVE:
                break
            names.append(frame)
        return names

    def lookup(self, target: str, source: str, stamp_ns: int, tolerance_ns: int = 0) -> Rigid:
        """Return ``target_from_source`` at a stamp.

        Parameters
        ----------
        target, source
            Frame names; one leading slash is stripped. Equal names give the identity, even if they are unknown.
        stamp_ns
            Nanoseconds since the epoch. 0 asks for the latest time that every frame of the chain has,
            as a time of 0 does in tf2 (a cloud stamped 0 gets the recording's last transform).
        tolerance_ns
            How far the stamp may be outside the samples of a frame of the chain; its nearest sample is then used.
            The tolerance never changes a result that is found without it.

        Raises
        ------
        TransformError
            If a name is empty or unknown, the frames are not connected at that time, the stamp is outside
            a frame's samples, or the frames above one form a loop.
        """
        query = self._query(target, source, stamp_ns, tolerance_ns)
        if query is None:
            return Rigid.identity()
        time_ns = stamp_ns or self._latest_common_time(query)
        return self._chain(query, time_ns).target_from_source(time_ns)

    def known(self, target: str, source: str, stamp_ns: int) -> Rigid | None:
        """Return ``target_from_source`` at a stamp; None if there is none. See `lookup`."""
        with suppress(TransformError):
            return self.lookup(target, source, stamp_ns)
        return None

    def rows(
        self,
        target: str,
        source: str,
        begin_ns: int,
        end_ns: int,
        step_ns: int,
        needed_ns: Callable[[NDArray[np.int64], NDArray[np.float64]], int],
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
        """Look up a transform at many times in an interval, which are close enough to interpolate between them.

        Parameters
        ----------
        target, source
            As for `lookup`.
        begin_ns, end_ns
            The first and the last time, nanoseconds; the second is later.
        step_ns
            Maximum distance between two times, nanoseconds.
        needed_ns
            Returns the maximum distance that the motion needs, given the times that were looked up with ``step_ns`` and
            the rows that are returned for them. If it is less than ``step_ns``, more times are looked up.

        Returns
        -------
        stamps_ns : (N,) int64
            Both ends, the times of all samples between them, and times between these.
        rows : (2 N - 1, 12) float64
            ``target_from_source`` at these times, and in the middle between each and the next one: the rows of the
            rotation, then the translation; NaN where there is no transform.
        gap_ns : int
            The longest time between two samples that it was interpolated over, nanoseconds.

        Raises
        ------
        TransformError
            If a frame is unknown, the two are not connected, or a frame changes its parent in the interval.
        """
        query = self._query(target, source, begin_ns, 0)
        if query is None:
            identity = np.array([1.0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0])
            return np.array([begin_ns, end_ns]), np.broadcast_to(identity, (3, 12)).copy(), 0
        key = query.target_number, query.source_number
        if key not in self._chains:
            self._chains[key] = self._timeless_chain(*key)
        chain = self._chains[key]
        if chain is not None:
            return sample_chain(chain, begin_ns, end_ns, step_ns, needed_ns)
        chain = self._timed_chain(query, begin_ns)
        if any(link.changes_within(begin_ns, end_ns) for link in chain.links):
            raise parent_change_error(query, end_ns)
        return sample_chain(chain, begin_ns, end_ns, step_ns, needed_ns)

    def between_ns(self, target: str, source: str, stamp_ns: int, tolerance_ns: int = 0) -> int:
        """Return over how long a time `lookup` interpolates: the longest one of all frames of the chain, nanoseconds.

        0 where it does not interpolate, as for a stamp of 0.

        Raises
        ------
        TransformError
            As `lookup` does.
        """
        query = self._query(target, source, stamp_ns, tolerance_ns)
        if query is None or not stamp_ns:
            return 0
        return max((link.between_ns(stamp_ns) for link in self._chain(query, stamp_ns).links), default=0)

    def latest_common_ns(self, target: str, source: str) -> int:
        """Return the time that `lookup` uses for a stamp of 0; tf2 writes it into its result.

        0 if every frame of the chain is static.

        Raises
        ------
        TransformError
            As `lookup` does.
        """
        query = self._query(target, source, 0, 0)
        return 0 if query is None else self._latest_common_time(query) or 0

    def is_rigid(self, one: str, other: str) -> bool:
        """Return whether there are only static transforms between two frames; False if they are not connected."""
        chain = self._chain_of(one, other)
        return chain is not None and all(link.static for link in chain.links)

    def moving_links(self, one: str, other: str) -> tuple[FrameHistory, ...]:
        """Return the frames between two that move; none if these are not connected, or frames change their parents."""
        chain = self._chain_of(one, other)
        return () if chain is None else tuple(link for link in chain.links if not link.static)

    def _chain_of(self, one: str, other: str) -> Chain | None:
        numbers = [self._numbers.get(name.removeprefix("/")) for name in (one, other)]
        return None if numbers[0] is None or numbers[1] is None else self._timeless_chain(numbers[0], numbers[1])

    @cached_property
    def infos(self) -> tuple[FrameInfo, ...]:
        """Statistics of each child frame, sorted by name."""
        infos = (frame_info(history, self.frames) for history in self._histories if history is not None)
        return tuple(sorted(infos, key=attrgetter("child")))

    @cached_property
    def trees(self) -> tuple[Tree, ...]:
        """The connected frames, the largest tree first.

        Two frames are in one tree if any transforms of the recording connect them, at any time.
        """
        return trees_of(self.frames, self._histories)

    def _query(self, target: str, source: str, stamp_ns: int, tolerance_ns: int) -> Query | None:
        """Return the lookup with its names checked; None if both are the same."""
        target, source = target.removeprefix("/"), source.removeprefix("/")
        if not target or not source:
            raise UnconnectedError(
                f"the {'source' if target else 'target'} frame has no name",
                stamp_ns=stamp_ns,
                hint="`source_frame` names the frame of clouds whose frame_id is empty",
            )
        if target == source:
            return None
        numbers = self._number(target, "", stamp_ns), self._number(source, target, stamp_ns)
        return Query(target, source, *numbers, stamp_ns, tolerance_ns)

    def _number(self, name: str, target: str, stamp_ns: int) -> int:
        """Return the index of a frame; ``target`` is empty, or where points of this frame are transformed to."""
        number = self._numbers.get(name)
        if number is not None:
            return number
        known = frames_text(self.frames)
        rejected = next((entry for entry in self.rejections if name in (entry.child, entry.parent)), None)
        if rejected is not None:
            known += f"; [{rejected.child}] in [{rejected.parent}] was rejected: {rejected.reason}"
        namesake = named_in_namespace(name, self.frames)
        near = f"did you mean {namesake}?" if namesake else did_you_mean(name, sorted(self.frames))
        advice = (
            "`static_tf`, `urdf` or `tf_from` adds a transform, `odom_topic` poses; `source_frame` corrects a frame_id"
        )
        if target and self.frames and not near:
            advice = mount_text(name, self.frames, target)
        message = f"no transform has the {'source ' if target else ''}frame {name!r}; {known}"
        raise UnconnectedError(message, stamp_ns=stamp_ns, hint=f"{near} {advice}".strip())

    def _chain(self, query: Query, time_ns: int | None) -> Chain:
        """Return the chain between the two frames; raise if one of them has no transform at the time."""
        key = query.target_number, query.source_number
        if key not in self._chains:
            self._chains[key] = self._timeless_chain(*key)
        chain = self._chains[key]
        if chain is None:
            return self._timed_chain(query, time_ns)
        outside = [link for link in chain.links if abs(link.gap_ns(time_ns)) > query.tolerance_ns]
        if outside:
            farthest = max(outside, key=lambda link: abs(link.gap_ns(time_ns)))
            raise extrapolation_error(query, farthest, self.frames, time_ns)
        return chain

    def _timeless_chain(self, target: int, source: int) -> Chain | None:
        """Return the chain that is valid at all times; None if frames change parents, loop or are not connected."""
        parent_of = attrgetter("sole_parent")
        walks = walk_both(target, source, self._histories, parent_of)
        if any(walk.blocked is not None or walk.loop is not None for walk in walks):
            return None
        chain = join_walks(*walks)
        if chain is None or all(link.static for link in chain.links):
            return chain
        # While one of its frames has no transform, a loop above it may be another way.
        above = walk_up(source, self._histories, parent_of)
        return None if above.blocked is not None or above.loop is not None else chain

    def _timed_chain(self, query: Query, time_ns: int | None) -> Chain:
        """Return the chain at a time; raise if there is none."""
        # Without tolerance first, so that a tolerance never changes a result that is found without it.
        for tolerance_ns in dict.fromkeys((0, query.tolerance_ns)):

            def parent_of(link: FrameHistory, tolerance_ns: int = tolerance_ns) -> int:
                return link.parent_at(time_ns) if abs(link.gap_ns(time_ns)) <= tolerance_ns else -1

            target_walk, source_walk = walk_both(query.target_number, query.source_number, self._histories, parent_of)
            for walk in (source_walk, target_walk):
                if walk.loop is not None:
                    raise loop_error(query, walk, walk.loop, self.frames)
            chain = join_walks(target_walk, source_walk)
            if chain is not None:
                return chain
        # tf2 walks from the source first, but if both walks were blocked it reports the target's.
        blocked = target_walk.blocked or source_walk.blocked
        if blocked is not None:
            raise extrapolation_error(query, blocked, self.frames, time_ns)
        raise unconnected_error(query, source_walk, target_walk, self.frames, self.trees)

    def _latest_common_time(self, query: Query) -> int | None:
        """Return the earliest of the frames' latest stamps; None if no frame of the chain is dynamic.

        Source of the rule: ``BufferCore::getLatestCommonTime``, which walks by each frame's latest parent
        and skips static frames and stamps of 0.
        """
        chain = self._chain(query, None)
        latest = (link.last_ns for link in chain.links if not link.static)
        return min((stamp_ns for stamp_ns in latest if stamp_ns != 0), default=None)


def frames_text(frames: Collection[str]) -> str:
    """Return which frames have transforms, as a part of an error message."""
    if not frames:
        return "there are no transforms at all"
    return f"the {len(frames)} frames with transforms are {name_list(sorted(frames), MAX_NAMES)}"


def mount_text(frame: str, frames: Collection[str], body: str = "") -> str:
    """Return how to add the mount of a sensor's frame, which no transform has.

    Parameters
    ----------
    frames
        The frames with transforms; the robot's is among them, or ``body``.
    """
    body = next((name for name in BODIES if name in frames), body) or "base_link"
    static = f"`static_tf='{body} {frame} X Y Z ROLL PITCH YAW'` says where it is mounted (metres, radians)"
    return f"{static}, `urdf` or `tf_from` reads that from elsewhere"


def named_in_namespace(name: str, frames: Collection[str]) -> str:
    """Return the frame that has this name in a namespace; empty if there is none, or several.

    >>> named_in_namespace("odom", ["robot1/odom", "robot1/base_link"])
    'robot1/odom'
    """
    matches = [frame for frame in frames if frame.endswith(f"/{name}")]
    return matches[0] if len(matches) == 1 else ""


def other_odometry(buffer: TransformBuffer, odom: str) -> str:
    """Return the frame in which the robot probably drives, if none is named ``odom``; empty if nothing moves it."""
    roots = ((root, tree.frames) for tree in buffer.trees for root in tree.roots if root not in BODIES)
    moved = (root for root, frames in roots if not all(buffer.is_rigid(root, frame) for frame in frames))
    return named_in_namespace(odom, buffer.frames) or next(moved, "")


def extrapolation_error(query: Query, link: FrameHistory, frames: Sequence[str], time_ns: int | None) -> TransformError:
    """Return the error for a frame of the chain without a transform at the time; ``frames`` are all names."""
    time_ns = time_ns or 0
    gap_ns = link.gap_ns(time_ns)
    gap, time, first, last = (stamp_text(ns) for ns in (abs(gap_ns), time_ns, link.first_ns, link.last_ns))
    child, parent = frames[link.child], frames[link.parent_at(time_ns)]
    error = TransformError(
        f"the transform from [{query.source}] to [{query.target}] is not known at {time}: "
        f"[{child}] in [{parent}] is known {f'only at {first}' if first == last else f'from {first} to {last}'}, "
        f"the time is {gap} s too {'early' if gap_ns < 0 else 'late'}, "
        f"the tolerance is {stamp_text(query.tolerance_ns)} s",
        stamp_ns=query.stamp_ns,
        hint=f"{_tolerance_hint(abs(gap_ns))}; {_SEE_TF}",
    )
    error.gap_ns = abs(gap_ns)
    error.reason = f"their stamps are {'before the first' if gap_ns < 0 else 'after the last'} [{child}] in [{parent}]"
    return error


def _tolerance_hint(gap_ns: int) -> str:
    """Return what helps if the nearest transform is this far away."""
    seconds = stamp_text(gap_ns).rstrip("0").rstrip(".")
    if gap_ns <= _BRIDGED_NS:
        nearest = f"pc2scan convert `transform_tolerance={seconds}` uses the nearest transform"
        return f"{nearest}, unless the clocks differ, which `time_offset=auto` corrects"
    return f"the nearest transform is {seconds} s away: `time_offset=auto` measures whether the clocks differ"


def unconnected_error(
    query: Query, source_walk: Walk, target_walk: Walk, frames: Sequence[str], trees: Sequence[Tree]
) -> TransformError:
    """Return the error for two frames whose walks do not meet."""
    names = query.target, query.source
    target_tree, source_tree = (next(tree for tree in trees if name in tree.frames) for name in names)
    kind: type[TransformError] = UnconnectedError
    advice = "`static_tf`, `urdf`, `odom_topic` or `tf_from` adds what connects them"
    where = f"[{query.target}] is in {_tree_text(target_tree)}, [{query.source}] in {_tree_text(source_tree)}"
    if source_tree is target_tree:
        kind, tops = TransformError, [frames[next(reversed(walk.links))] for walk in (target_walk, source_walk)]
        where = f"at this time [{query.target}] leads up to [{tops[0]}], [{query.source}] to [{tops[1]}]"
    elif not set(BODIES).isdisjoint(target_tree.frames) and set(BODIES).isdisjoint(source_tree.frames):
        advice = mount_text(query.source, target_tree.frames)
    message = f"no transforms connect [{query.source}] with [{query.target}]: {where}"
    return kind(message, stamp_ns=query.stamp_ns, hint=f"{advice}; {_SEE_TF}")


def loop_error(query: Query, walk: Walk, loop: int, frames: Sequence[str]) -> TransformError:
    """Return the error for a walk that visits the frame ``loop`` twice."""
    met = list(walk.links)
    names = [f"[{frames[frame]}]" for frame in met[met.index(loop) :][:MAX_NAMES]]
    return TransformError(
        f"the tree of frames contains a loop, on the way from [{query.source}] to [{query.target}]: "
        f"{' in '.join([*names, names[0]])}",
        stamp_ns=query.stamp_ns,
        hint=_SEE_TF,
    )


def parent_change_error(query: Query, end_ns: int) -> TransformError:
    """Return the error for frames that change their parents while a cloud is measured."""
    message = f"between [{query.source}] and [{query.target}], a frame changes its parent before {stamp_text(end_ns)}"
    hint = f"two nodes may publish one frame with different parents; {_SEE_TF}"
    return TransformError(f"{message}, while the cloud is measured", stamp_ns=query.stamp_ns, hint=hint)


def _tree_text(tree: Tree) -> str:
    roots = ", ".join(tree.roots[:MAX_NAMES]) or "no root"
    return f"the tree of [{roots}] ({name_list(tree.frames, MAX_NAMES)})"


# --- Chains ---


class Query(NamedTuple):
    """The names and numbers of two frames, the stamp, and the tolerance."""

    target: str
    source: str
    target_number: int
    source_number: int
    stamp_ns: int
    tolerance_ns: int


class Side(NamedTuple):
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


class Chain(NamedTuple):
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
    fixed: dict[int, Rigid]

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
            # The factor that tf2 uses if the frame itself is the top of its walk changes only the signs of zeros.
            return source_pose if known else compose_poses(inverse_pose(IDENTITY_POSE), source_pose)
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


class Walk(NamedTuple):
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
    return Chain(Side.of(target_side), Side.of(source_side), above, {})


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
