"""The transforms of a whole recording, and the transform between two frames at a stamp.

The rules are those of tf2 0.7.6 (``BufferCore``, ``TimeCache``, ``StaticCache``), where upstream looks its
transforms up:

- One leading slash of a frame's name is stripped. Names are otherwise compared as they are.
- Quaternions are taken as published while their squared norm differs from 1 by less than 0.01. Others are refused.
- A child has one parent at a time. Between two samples with different parents the earlier sample holds,
  unchanged, up to the later one.
- Between two samples of one parent: translation by lerp, rotation by slerp; at the older one's stamp too, with the
  ratio 0. The ratio is that of two durations, each as seconds in float64. The first and the last sample hold at their
  stamps as they are.
- A child whose first accepted transform was static is static for good: its last transform holds at any
  time. Any other child is dynamic for good; what arrives for it as static is a sample like the others.
- Samples may arrive in any order. Of several with one stamp the first to arrive is kept.
- Transforms need be known only up to the common ancestor. Nothing is extrapolated.
- Both frames are walked up to the root, or to the first frame whose parent is not known at the time, unless one is the
  other's ancestor: the transforms above the common ancestor are in both walks and cancel out but for rounding.
- A stamp of 0 asks for the latest time that every frame of the chain has.

Where it departs from tf2, on purpose:

- Nothing expires (tf2 keeps 10 s), and chains may be longer than tf2's 1000 frames.
- Infinite components are refused like NaN.
- A walk towards the root that runs into a loop is refused. tf2 answers where it meets the other frame before
  it notices, with a transform that depends on the direction of the question.
- Lookups strip the leading slash too, and take a tolerance.

Every operation is done in tf2's order (see `pc2scan.core.rigid`), so that lookups are equal to tf2's to the bit.
ROS 2's tf2 takes the ratio of nanoseconds, which differs in the last bits of float64.
"""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass, field
from functools import cached_property
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.rigid import IDENTITY_POSE, Rigid, are_taken, compose_poses, interpolate_poses, inverse_pose
from pc2scan.errors import RecordingError, TransformError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.rigid import Pose, TransformRow

__all__ = [
    "FrameHistory",
    "FrameInfo",
    "Rejection",
    "TransformBuffer",
    "TransformBuilder",
    "Tree",
]

#: Groups of rejected transforms that are named one by one; all are counted.
MAX_REJECTIONS = 100

#: Frames that an error message names.
MAX_NAMES = 20

#: Frames, and pairs of a child and a parent, that are believed; each takes about a kilobyte. Robots have hundreds.
MAX_FRAMES = 100_000
MAX_PAIRS = 200_000

_ACCEPTED, _NO_CHILD, _NO_PARENT, _SELF, _NOT_FINITE, _ZERO, _DENORMALIZED = range(7)
_REASONS = {
    _NO_CHILD: "TF_NO_CHILD_FRAME_ID: child_frame_id is empty",
    _NO_PARENT: "TF_NO_FRAME_ID: frame_id is empty",
    _SELF: "TF_SELF_TRANSFORM: frame_id and child_frame_id are the same",
    _NOT_FINITE: "TF_NAN_INPUT: a component is NaN or infinite",
    _ZERO: "TF_DENORMALIZED_QUATERNION: the quaternion is zero",
    _DENORMALIZED: "TF_DENORMALIZED_QUATERNION: the squared norm of the quaternion differs from 1 by 0.01 or more",
}

_SEE_TF = "`pc2scan tf` shows the frames of a recording and the times they are known for"


@dataclass(frozen=True, slots=True)
class Rejection:
    """Transforms that were not taken, those of one pair of frames and one reason together.

    Attributes
    ----------
    child, parent
        Frame names, a leading slash stripped.
    stamp_ns
        The first one's stamp.
    reason
        tf2's name for it and why.
    count
        How many there were.
    """

    child: str
    parent: str
    stamp_ns: int
    reason: str
    count: int


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """What is known of one child frame, for people.

    Attributes
    ----------
    child
        The frame.
    parents
        Every parent that it has had, the first first.
    static
        Whether its transform holds at any time.
    transforms
        Samples that are kept.
    received
        Transforms that were accepted, repeated stamps and overwritten static ones included.
    first_ns, last_ns
        Earliest and latest stamp.
    rate_hz
        Mean rate of the samples; None for fewer than two, or a static frame.
    largest_gap_ns
        Longest time between two neighbouring samples; None where there is no rate.
    largest_gap_at_ns
        Stamp at which it begins.
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
    """Frames that hang together at some time of the recording.

    Attributes
    ----------
    roots
        Frames without a parent, sorted. More than one where a child changed from one tree to another; none
        where the frames form a loop.
    frames
        All frames, the roots included, sorted.
    """

    roots: tuple[str, ...]
    frames: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FrameHistory:
    """The transforms ``parent_from_child`` of one child frame, in the order of their stamps.

    Attributes
    ----------
    child
        Index of the frame in `TransformBuffer.frames`.
    static
        Whether the only transform holds at any time.
    stamps_ns
        (N,) int64, increasing, N > 0.
    poses
        (N, 7) float64: translation x, y, z in metres, then quaternion x, y, z, w, as published.
    parents
        (N,) int32, indices of frames.
    sole_parent
        The parent, or -1 if it changes.
    """

    child: int
    static: bool
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    parents: NDArray[np.int32]
    sole_parent: int
    first_ns: int
    last_ns: int

    @property
    def translations(self) -> NDArray[np.float64]:
        """(N, 3) float64, metres, a view."""
        return self.poses[:, :3]

    @property
    def quaternions(self) -> NDArray[np.float64]:
        """(N, 4) float64 x, y, z, w, a view."""
        return self.poses[:, 3:]

    def gap_ns(self, stamp_ns: int | None) -> int:
        """How far a stamp lies outside: negative before the first sample, positive after the last."""
        if self.static or stamp_ns is None:
            return 0
        return min(stamp_ns - self.first_ns, 0) or max(stamp_ns - self.last_ns, 0)

    def _older(self, stamp_ns: int | None) -> int:
        """Index of the sample at a stamp or before it, the first one at least; None asks for the latest."""
        if self.static or stamp_ns is None or stamp_ns >= self.last_ns:
            return len(self.stamps_ns) - 1
        return max(int(self.stamps_ns.searchsorted(stamp_ns, "right")) - 1, 0)

    def parent_at(self, stamp_ns: int | None) -> int:
        """Index of the parent at a stamp, the nearest known one outside the history."""
        return self.sole_parent if self.sole_parent >= 0 else int(self.parents[self._older(stamp_ns)])

    def pose_at(self, stamp_ns: int | None) -> Pose:
        """``parent_from_child`` at a stamp, the nearest known one outside the history."""
        older = self._older(stamp_ns)
        first = self._pose(older)
        if self.static or stamp_ns is None or older + 1 == len(self.stamps_ns):
            return first
        # The first sample has no older one; what lies in front of it is within the tolerance.
        if stamp_ns <= self.first_ns or (self.sole_parent < 0 and self.parents[older] != self.parents[older + 1]):
            return first
        begin_ns, end_ns = self.stamps_ns[older : older + 2].tolist()
        ratio = _float_seconds(stamp_ns - begin_ns) / _float_seconds(end_ns - begin_ns)
        return interpolate_poses(first, self._pose(older + 1), ratio)

    def _pose(self, sample: int) -> Pose:
        x, y, z, i, j, k, r = self.poses[sample].tolist()
        return (x, y, z, i, j, k, r)


@dataclass(frozen=True, slots=True)
class _Query:
    """A lookup as it was asked for."""

    target: str
    source: str
    target_number: int
    source_number: int
    stamp_ns: int
    tolerance_ns: int


@dataclass(frozen=True, slots=True)
class _Side:
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
    def of(cls, links: tuple[FrameHistory, ...]) -> _Side:
        """Multiply the static links that come first."""
        static = tuple(takewhile(lambda link: link.static, links))
        return cls(links, _multiplied(static, None, IDENTITY_POSE), links[len(static) :])

    def pose_at(self, time_ns: int | None) -> Pose:
        """``ancestor_from_frame`` at a time; None asks for each link's latest."""
        return _multiplied(self.rest, time_ns, self.begin)


#: What tf2 multiplies with where the frame itself is the top of its walk: the same but for the signs of zeros.
_INVERSE_OF_NOTHING = inverse_pose(IDENTITY_POSE)


@dataclass(frozen=True, slots=True)
class _Chain:
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

    target_side: _Side
    source_side: _Side
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


@dataclass(frozen=True, slots=True)
class _Walk:
    """A way up from a frame.

    Attributes
    ----------
    frames
        Indices of the frames met, in this order.
    blocked
        The child whose parent is not known at the time, where that ended the walk.
    loop
        The frame that was met for the second time, where that ended the walk.
    """

    frames: dict[int, None]
    blocked: FrameHistory | None = None
    loop: int | None = None


@dataclass(frozen=True, eq=False)  # not slotted: `infos` and `trees` are computed when first asked for
class TransformBuffer:
    """The transforms of a whole recording. Built by `TransformBuilder`; the rules are in the module's text.

    Attributes
    ----------
    frames
        Names of all frames, in the order of their first occurrence.
    rejections
        What was not taken, in the order of occurrence; at most `MAX_REJECTIONS` entries.
    rejected
        How many transforms were not taken in all.
    """

    frames: tuple[str, ...]
    rejections: tuple[Rejection, ...]
    rejected: int
    _stamps_ns: NDArray[np.int64] = field(repr=False)
    _poses: NDArray[np.float64] = field(repr=False)
    _parents: NDArray[np.int32] = field(repr=False)
    # Samples of child i are those from _offsets[i] to _offsets[i + 1].
    _offsets: NDArray[np.int64] = field(repr=False)
    _static: NDArray[np.bool_] = field(repr=False)
    _received: NDArray[np.int64] = field(repr=False)
    _numbers: dict[str, int] = field(repr=False)
    _histories: dict[int, FrameHistory | None] = field(default_factory=dict, repr=False)
    _chains: dict[tuple[int, int], _Chain | None] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        """How many samples are kept."""
        return len(self._stamps_ns)

    def history(self, frame: str) -> FrameHistory | None:
        """The samples of a child frame (views); None for a frame that is never a child, or unknown."""
        number = self._numbers.get(_stripped(frame))
        return None if number is None else self._history(number)

    def lookup(self, target: str, source: str, stamp_ns: int, tolerance_ns: int = 0) -> Rigid:
        """``target_from_source`` at a stamp.

        Parameters
        ----------
        target, source
            Frame names; one leading slash is stripped. Equal names give the identity, known or not.
        stamp_ns
            Nanoseconds since the epoch. 0 asks for the latest time that every frame of the chain has,
            as a time of 0 does in tf2 (a cloud stamped 0 gets the recording's last transform).
        tolerance_ns
            A frame of the chain whose samples begin or end at most this far from the stamp gives the nearest
            one. What is found without a tolerance is not changed by it.

        Raises
        ------
        TransformError
            If a name is empty or unknown, there is no connection at that time, the stamp lies outside
            a frame's samples, or the way up from a frame ends in a loop.
        """
        query = self._query(target, source, stamp_ns, tolerance_ns)
        if query is None:
            return Rigid.identity()
        time_ns = stamp_ns or self._latest_common_time(query)
        return self._chain(query, time_ns).target_from_source(time_ns)

    def latest_common_ns(self, target: str, source: str) -> int:
        """The time that `lookup` takes for a stamp of 0, which tf2 writes into its answer.

        0 if every frame on the way is static.

        Raises
        ------
        TransformError
            As `lookup` does.
        """
        query = self._query(target, source, 0, 0)
        return 0 if query is None else self._latest_common_time(query) or 0

    @cached_property
    def infos(self) -> tuple[FrameInfo, ...]:
        """What is known of each child frame, sorted by name."""
        children = np.flatnonzero(np.diff(self._offsets)).tolist()
        return tuple(self._info(child) for child in sorted(children, key=self.frames.__getitem__))

    @cached_property
    def trees(self) -> tuple[Tree, ...]:
        """The frames that hang together, the largest tree first.

        Two frames are in one tree if any transforms of the recording connect them, at whatever time.
        """
        # Union-find: every frame points to another of its tree, and in the end to the one that stands for it.
        stands_for = list(range(len(self.frames)))

        def leader(frame: int) -> int:
            while stands_for[frame] != frame:
                stands_for[frame] = frame = stands_for[stands_for[frame]]
            return frame

        counts = np.diff(self._offsets)
        edges = np.repeat(np.arange(len(self.frames)), counts) * len(self.frames) + self._parents
        for edge in np.unique(edges).tolist():
            child, parent = divmod(edge, len(self.frames))
            stands_for[leader(child)] = leader(parent)
        members: dict[int, list[int]] = {}
        for frame in range(len(self.frames)):
            members.setdefault(leader(frame), []).append(frame)
        is_child = (counts > 0).tolist()
        trees = (
            Tree(
                roots=tuple(sorted(self.frames[frame] for frame in frames if not is_child[frame])),
                frames=tuple(sorted(self.frames[frame] for frame in frames)),
            )
            for frames in members.values()
        )
        return tuple(sorted(trees, key=lambda tree: (-len(tree.frames), tree.frames)))

    def _history(self, number: int) -> FrameHistory | None:
        try:
            return self._histories[number]
        except KeyError:
            return self._histories.setdefault(number, self._new_history(number))

    def _new_history(self, number: int) -> FrameHistory | None:
        samples = slice(*self._offsets[number : number + 2].tolist())
        if samples.start == samples.stop:
            return None
        stamps, parents = self._stamps_ns[samples], self._parents[samples]
        parent = int(parents[0])
        return FrameHistory(
            number,
            bool(self._static[number]),
            stamps,
            self._poses[samples],
            parents,
            parent if (parents == parent).all() else -1,
            int(stamps[0]),
            int(stamps[-1]),
        )

    def _query(self, target: str, source: str, stamp_ns: int, tolerance_ns: int) -> _Query | None:
        """The lookup with its names checked; None if both are the same."""
        target, source = _stripped(target), _stripped(source)
        for name, role in ((target, "target_frame"), (source, "source_frame")):
            if not name:
                raise TransformError(
                    f"Invalid argument passed to lookupTransform argument {role}: frame_ids cannot be empty",
                    stamp_ns=stamp_ns,
                    hint="`source_frame` names the frame of clouds whose frame_id is empty",
                )
        if target == source:
            return None
        return _Query(
            target,
            source,
            self._number(target, "target_frame", stamp_ns),
            self._number(source, "source_frame", stamp_ns),
            stamp_ns,
            tolerance_ns,
        )

    def _number(self, name: str, role: str, stamp_ns: int) -> int:
        number = self._numbers.get(name)
        if number is not None:
            return number
        there_are = (
            f"The {len(self.frames)} frames with transforms are {_named(sorted(self.frames))}"
            if self.frames
            else "There are no transforms"
        )
        rejected = next((entry for entry in self.rejections if name in (entry.child, entry.parent)), None)
        if rejected is not None:
            there_are += f"; [{rejected.child}] in [{rejected.parent}] was rejected: {rejected.reason}"
        raise TransformError(
            f'"{name}" passed to lookupTransform argument {role} does not exist. {there_are}',
            stamp_ns=stamp_ns,
            hint="`static` adds a transform, `tf_from` takes them from another recording, "
            "`source_frame` corrects a wrong frame_id",
        )

    def _chain(self, query: _Query, time_ns: int | None) -> _Chain:
        """The way between the two frames, every frame on it known at the time, within the tolerance."""
        key = query.target_number, query.source_number
        if key not in self._chains:
            self._chains[key] = self._timeless_chain(*key)
        chain = self._chains[key]
        if chain is None:
            return self._timed_chain(query, time_ns)
        outside = [link for link in chain.links if abs(link.gap_ns(time_ns)) > query.tolerance_ns]
        if outside:
            raise self._extrapolation(max(outside, key=lambda link: abs(link.gap_ns(time_ns))), query, time_ns)
        return chain

    def _timeless_chain(self, target: int, source: int) -> _Chain | None:
        """The way that holds at all times; None where frames change parents, loop or are not connected."""
        target_walk = self._walk(target, lambda link: link.sole_parent)
        source_walk = self._walk(source, lambda link: link.sole_parent)
        for walk in (target_walk, source_walk):
            if walk.blocked is not None or walk.loop is not None:
                return None
        return self._joined(target_walk, source_walk)

    def _timed_chain(self, query: _Query, time_ns: int | None) -> _Chain:
        """The way at a time, or the error that says why there is none."""
        # Without tolerance first, so that a tolerance never changes an answer that there is without it.
        for tolerance_ns in dict.fromkeys((0, query.tolerance_ns)):

            def parent_of(link: FrameHistory, tolerance_ns: int = tolerance_ns) -> int:
                return link.parent_at(time_ns) if abs(link.gap_ns(time_ns)) <= tolerance_ns else -1

            source_walk = self._walk(query.source_number, parent_of)
            target_walk = self._walk(query.target_number, parent_of)
            for walk in (source_walk, target_walk):
                if walk.loop is not None:
                    raise self._looping(walk, walk.loop, query)
            chain = self._joined(target_walk, source_walk)
            if chain is not None:
                return chain
        # tf2 walks from the source first, but says what stopped the walk from the target if both were.
        blocked = target_walk.blocked or source_walk.blocked
        if blocked is not None:
            raise self._extrapolation(blocked, query, time_ns)
        raise self._unconnected(query, source_walk, target_walk)

    def _walk(self, start: int, parent_of: Callable[[FrameHistory], int]) -> _Walk:
        """Walk up from a frame; ``parent_of`` returns -1 where it cannot say."""
        met: dict[int, None] = {}
        frame = start
        while frame not in met:
            met[frame] = None
            link = self._history(frame)
            if link is None:
                return _Walk(met)
            frame = parent_of(link)
            if frame < 0:
                return _Walk(met, blocked=link)
        return _Walk(met, loop=frame)

    def _joined(self, target_walk: _Walk, source_walk: _Walk) -> _Chain | None:
        common = next((frame for frame in target_walk.frames if frame in source_walk.frames), None)
        if common is None:
            return None
        target_side, _ = self._parted(target_walk, common)
        source_side, above = self._parted(source_walk, common)
        return _Chain(_Side.of(target_side), _Side.of(source_side), above)

    def _parted(self, walk: _Walk, ancestor: int) -> tuple[tuple[FrameHistory, ...], tuple[FrameHistory, ...]]:
        """The links of a walk below an ancestor, and from it on."""
        frames = list(walk.frames)
        links = [self._history(frame) for frame in frames]
        below = frames.index(ancestor)
        return tuple(link for link in links[:below] if link), tuple(link for link in links[below:] if link)

    def _latest_common_time(self, query: _Query) -> int | None:
        """The earliest of the latest stamps on the way; None where no frame on it is dynamic.

        Source of the rule: ``BufferCore::getLatestCommonTime``, which walks by each frame's latest parent
        and passes over static frames and stamps of 0.
        """
        chain = self._chain(query, None)
        latest = (link.last_ns for link in chain.links if not link.static)
        return min((stamp_ns for stamp_ns in latest if stamp_ns != 0), default=None)

    def _extrapolation(self, link: FrameHistory, query: _Query, time_ns: int | None) -> TransformError:
        time_ns = time_ns or 0
        gap_ns = link.gap_ns(time_ns)
        gap, time, first, last = (_seconds(ns) for ns in (abs(gap_ns), time_ns, link.first_ns, link.last_ns))
        if link.first_ns == link.last_ns:
            text = f"Lookup would require extrapolation at time {time}, but only time {last} is in the buffer"
        else:
            way, end, known = ("past", "earliest", first) if gap_ns < 0 else ("future", "latest", last)
            text = (
                f"Lookup would require extrapolation {gap}s into the {way}. "
                f"Requested time {time} but the {end} data is at time {known}"
            )
        child, parent = self.frames[link.child], self.frames[link.parent_at(time_ns)]
        return TransformError(
            f"{text}, when looking up transform from frame [{query.source}] to frame [{query.target}]: "
            f"[{child}] in [{parent}] is known from {first} to {last}, "
            f"the time is {gap} s too {'early' if gap_ns < 0 else 'late'}, "
            f"the tolerance is {_seconds(query.tolerance_ns)} s",
            stamp_ns=query.stamp_ns,
            hint=f"a transform_tolerance of at least {gap} s would use the nearest transform; {_SEE_TF}",
        )

    def _unconnected(self, query: _Query, source_walk: _Walk, target_walk: _Walk) -> TransformError:
        source_tree, target_tree = (self._tree_of(name) for name in (query.source, query.target))
        where = (
            f"[{query.target}] is in {_described(target_tree)}, [{query.source}] in {_described(source_tree)}"
            if source_tree is not target_tree
            else f"at this time [{query.target}] leads up to [{self._top(target_walk)}], "
            f"[{query.source}] to [{self._top(source_walk)}]"
        )
        return TransformError(
            f"Could not find a connection between '{query.target}' and '{query.source}' because they are not "
            f"part of the same tree. Tf has two or more unconnected trees: {where}",
            stamp_ns=query.stamp_ns,
            hint=f"`static` or `tf_from` adds what connects them; {_SEE_TF}",
        )

    def _looping(self, walk: _Walk, loop: int, query: _Query) -> TransformError:
        met = list(walk.frames)
        names = [f"[{self.frames[frame]}]" for frame in met[met.index(loop) :][:MAX_NAMES]]
        return TransformError(
            "The tf tree is invalid because it contains a loop, when looking up transform from frame "
            f"[{query.source}] to frame [{query.target}]: {' in '.join([*names, names[0]])}",
            stamp_ns=query.stamp_ns,
            hint=_SEE_TF,
        )

    def _top(self, walk: _Walk) -> str:
        return self.frames[next(reversed(walk.frames))]

    def _tree_of(self, name: str) -> Tree:
        return next(tree for tree in self.trees if name in tree.frames)

    def _info(self, child: int) -> FrameInfo:
        link = self._history(child)
        assert link is not None  # children are the frames with samples
        parents, first = np.unique(link.parents, return_index=True)
        count = len(link.stamps_ns)
        gaps = np.diff(link.stamps_ns)
        widest = int(gaps.argmax()) if count > 1 else 0
        return FrameInfo(
            child=self.frames[child],
            parents=tuple(self.frames[parent] for parent in parents[np.argsort(first)].tolist()),
            static=link.static,
            transforms=count,
            received=int(self._received[child]),
            first_ns=link.first_ns,
            last_ns=link.last_ns,
            rate_hz=(count - 1) * 1e9 / (link.last_ns - link.first_ns) if count > 1 else None,
            largest_gap_ns=int(gaps[widest]) if count > 1 else None,
            largest_gap_at_ns=link.stamps_ns.item(widest) if count > 1 else None,
        )


class TransformBuilder:
    """Collects transforms in the order of the recording; `build` turns them into a `TransformBuffer`.

    Holds 69 bytes a transform until then.
    """

    # Pair of frames, stamp_ns, whether static, and the pose.
    _RECORD = struct.Struct("<iq?7d")
    _DTYPE = np.dtype([("pair", "<i4"), ("stamp_ns", "<i8"), ("static", "?"), ("pose", "<f8", 7)])

    def __init__(self) -> None:
        self._records = bytearray()
        self._pairs: dict[tuple[str, str], int] = {}
        self._names: dict[str, int] = {}
        # Parent, child and, where the names alone rule it out, the reason; three numbers a pair.
        self._pair_table = array("i")

    def __len__(self) -> int:
        """How many transforms were added."""
        return len(self._records) // self._RECORD.size

    def add(self, rows: Iterable[TransformRow], *, static: bool) -> None:
        """Append transforms in the order in which they were recorded.

        Parameters
        ----------
        rows
            ``(parent, child, stamp_ns, tx, ty, tz, qx, qy, qz, qw)``: ``parent_from_child`` in metres. Names
            and numbers may be anything; `build` sets aside what is unusable.
        static
            Whether they came on a static topic (``/tf_static``) or hold at any time by the user's word.

        Raises
        ------
        RecordingError
            If there are more frames than `MAX_FRAMES`, or more pairs than `MAX_PAIRS`.
        """
        pairs, pack = self._pairs, self._RECORD.pack
        for parent, child, stamp_ns, *pose in rows:
            pair = pairs.get((parent, child))
            if pair is None:
                pair = self._add_pair(parent, child)
            self._records += pack(pair, stamp_ns, static, *pose)

    def _add_pair(self, parent: str, child: str) -> int:
        pair = self._pairs[parent, child] = len(self._pairs)
        parent, child = _stripped(parent), _stripped(child)
        reason = _ACCEPTED
        if not child:
            reason = _NO_CHILD
        elif not parent:
            reason = _NO_PARENT
        elif parent == child:
            reason = _SELF
        numbers = [self._names.setdefault(name, len(self._names)) for name in (parent, child)]
        if len(self._names) > MAX_FRAMES or len(self._pairs) > MAX_PAIRS:
            raise RecordingError(
                f"the transforms have more than {MAX_FRAMES:,} frames or {MAX_PAIRS:,} pairs of frames, "
                "which no robot has",
                hint="`tf_topics` names the topics whose transforms count",
            )
        self._pair_table.extend((*numbers, reason))
        return pair

    def build(self) -> TransformBuffer:
        """Sort what was added and set aside what cannot be used. More may be added afterwards."""
        records = np.frombuffer(self._records, self._DTYPE)
        pairs = np.array(self._pair_table, np.int32).reshape(-1, 3)
        poses = records["pose"]
        reasons = _reasons(poses, pairs[records["pair"], 2])

        good = np.flatnonzero(reasons == _ACCEPTED)
        frames, parents, children = self._renumbered(pairs[records["pair"][good], :2])
        is_static = _first_of_each(children, records["static"][good], len(frames))
        order = _kept_order(children, records["stamp_ns"][good], is_static)
        kept = good[order]
        return TransformBuffer(
            frames=frames,
            rejections=self._rejections(records, pairs, reasons),
            rejected=len(records) - len(good),
            _stamps_ns=_read_only(records["stamp_ns"][kept]),
            _poses=_read_only(poses[kept]),
            _parents=_read_only(parents[order]),
            _offsets=np.searchsorted(children[order], np.arange(len(frames) + 1)),
            _static=is_static,
            _received=np.bincount(children, minlength=len(frames)),
            _numbers={name: number for number, name in enumerate(frames)},
        )

    def _renumbered(self, used: NDArray[np.int32]) -> tuple[tuple[str, ...], NDArray[np.int32], NDArray[np.int32]]:
        """Names of the frames that accepted transforms have, as tf2 knows no others; parents, children."""
        occurs = np.zeros(len(self._names), dtype=np.bool_)
        occurs[used] = True
        numbers = (np.cumsum(occurs) - 1).astype(np.int32)
        names = (name for name, known in zip(self._names, occurs.tolist(), strict=True) if known)
        return tuple(names), numbers[used[:, 0]], numbers[used[:, 1]]

    def _rejections(
        self, records: NDArray[np.void], pairs: NDArray[np.int32], reasons: NDArray[np.int32]
    ) -> tuple[Rejection, ...]:
        bad = np.flatnonzero(reasons != _ACCEPTED)
        causes = np.stack((records["pair"][bad], reasons[bad]), axis=1)
        groups, first, counts = np.unique(causes, axis=0, return_index=True, return_counts=True)
        names = list(self._names)
        rejections = []
        for group in np.argsort(first)[:MAX_REJECTIONS].tolist():
            pair, reason = groups[group].tolist()
            parent, child, _ = pairs[pair].tolist()
            stamp_ns = records["stamp_ns"].item(bad[first[group]])
            rejections.append(Rejection(names[child], names[parent], stamp_ns, _REASONS[reason], counts.item(group)))
        return tuple(rejections)


def _reasons(poses: NDArray[np.float64], reasons: NDArray[np.int32]) -> NDArray[np.int32]:
    """Why each transform is unusable, or `_ACCEPTED`; ``reasons`` are those that the names alone give."""
    finite = np.isfinite(poses).all(axis=1)
    with np.errstate(invalid="ignore"):  # a NaN may be one that signals
        zero = ~poses[:, 3:].any(axis=1)
    return np.select(
        [reasons != _ACCEPTED, ~finite, zero, ~are_taken(poses[:, 3:])],
        [reasons, _NOT_FINITE, _ZERO, _DENORMALIZED],
        _ACCEPTED,
    ).astype(np.int32)


def _first_of_each(children: NDArray[np.int32], flags: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """The flag of each child's first transform; False for frames without one."""
    result = np.zeros(count, dtype=np.bool_)
    numbers, first = np.unique(children, return_index=True)
    result[numbers] = flags[first]
    return result


def _kept_order(
    children: NDArray[np.int32], stamps_ns: NDArray[np.int64], is_static: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Indices of the transforms to keep, by child and stamp.

    Of a dynamic child's transforms with one stamp the first is kept, of all a static one's the last.
    """
    static = is_static[children]
    arrival = np.arange(len(children))
    stamps_ns = np.where(static, 0, stamps_ns)
    order = np.lexsort((np.where(static, -arrival, arrival), stamps_ns, children))
    changes = (np.diff(children[order]) != 0) | (np.diff(stamps_ns[order]) != 0)
    return order[np.concatenate(([True], changes))] if len(order) else order


def _multiplied(links: Iterable[FrameHistory], time_ns: int | None, pose: Pose) -> Pose:
    """Go on from a pose in the first link's child up to the last link's parent."""
    for link in links:
        pose = compose_poses(link.pose_at(time_ns), pose)
    return pose


def _float_seconds(duration_ns: int) -> float:
    """Seconds as ``ros::Duration::toSec`` rounds them."""
    seconds, nanoseconds = divmod(duration_ns, 1_000_000_000)
    return seconds + 1e-9 * nanoseconds


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    values.flags.writeable = False
    return values


def _stripped(name: str) -> str:
    return name.removeprefix("/")


def _seconds(stamp_ns: int) -> str:
    seconds, nanoseconds = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{nanoseconds:09d}"


def _named(names: Sequence[str]) -> str:
    more = len(names) - MAX_NAMES
    return ", ".join(names[:MAX_NAMES]) + (f" and {more} more" if more > 0 else "")


def _described(tree: Tree) -> str:
    return f"the tree of [{', '.join(tree.roots[:MAX_NAMES]) or 'no root'}] ({_named(tree.frames)})"
