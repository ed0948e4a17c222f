"""Why a lookup has no transform, and what to do about it; and which transforms tf2 rejects, and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import are_accepted
from pc2scan.errors import TransformError, UnconnectedError, name_list, stamp_text
from pc2scan.text import did_you_mean

from .summary import BODIES

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from .chain import Query, Walk
    from .history import FrameHistory
    from .summary import Tree

ACCEPTED, NO_CHILD, NO_PARENT, SELF, NOT_FINITE, ZERO, DENORMALIZED = range(7)
REASONS = {
    NO_CHILD: "TF_NO_CHILD_FRAME_ID: child_frame_id is empty",
    NO_PARENT: "TF_NO_FRAME_ID: frame_id is empty",
    SELF: "TF_SELF_TRANSFORM: frame_id and child_frame_id are the same",
    NOT_FINITE: "TF_NAN_INPUT: a component is NaN or infinite",
    ZERO: "TF_DENORMALIZED_QUATERNION: the quaternion is zero",
    DENORMALIZED: "TF_DENORMALIZED_QUATERNION: the squared norm of the quaternion differs from 1 by 0.01 or more",
}


@dataclass(frozen=True, slots=True)
class RejectedTransforms:
    """Rejected transforms of one pair of frames and one reason.

    Attributes
    ----------
    child, parent
        Frame names, a leading slash stripped.
    stamp_ns
        Stamp of the first one.
    reason
        tf2's name for the reason, and an explanation.
    count
        How many were rejected.
    """

    child: str
    parent: str
    stamp_ns: int
    reason: str
    count: int


def reason_of_names(parent: str, child: str) -> int:
    """Return why a pair of frames, leading slashes stripped, is rejected, or `ACCEPTED`."""
    if not child:
        return NO_CHILD
    if not parent:
        return NO_PARENT
    return SELF if parent == child else ACCEPTED


def reasons_of(poses: NDArray[np.float64], reasons: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return why each transform is rejected, or `ACCEPTED`; ``reasons`` are those of the names alone."""
    finite = np.isfinite(poses).all(axis=1)
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        zero = ~poses[:, 3:].any(axis=1)
    return np.select(
        [reasons != ACCEPTED, ~finite, zero, ~are_accepted(poses[:, 3:])],
        [reasons, NOT_FINITE, ZERO, DENORMALIZED],
        ACCEPTED,
    ).astype(np.int32)


#: Maximum number of frames that an error message names.
MAX_NAMES = 20

#: A gap up to this may be bridged.
_BRIDGED_NS = 1_000_000_000

_SEE_TF = "`pc2scan tf` shows the frames of a recording and their times"


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
    return f"`static_tf='{body} {frame} X Y Z ROLL PITCH YAW'` says where it is mounted (metres, radians)"


def named_in_namespace(name: str, frames: Collection[str]) -> str:
    """Return the frame that has this name in a namespace; empty if there is none, or several.

    >>> named_in_namespace("odom", ["robot1/odom", "robot1/base_link"])
    'robot1/odom'
    """
    matches = [frame for frame in frames if frame.endswith(f"/{name}")]
    return matches[0] if len(matches) == 1 else ""


def unknown_frame_error(
    name: str,
    target: str,
    stamp_ns: int,
    frames: Sequence[str],
    rejections: Sequence[RejectedTransforms],
    offered: str = "",
) -> TransformError:
    """Return the error for a frame that no transform has.

    Parameters
    ----------
    target
        If it is the frame of points, the one that they are transformed to; else empty.
    offered
        The value of `odom_topic` for a topic with poses that has the frame; empty: there is none.
    """
    known = frames_text(frames)
    rejected = next((entry for entry in rejections if name in (entry.child, entry.parent)), None)
    if rejected is not None:
        known += f"; [{rejected.child}] in [{rejected.parent}] was rejected: {rejected.reason}"
    namesake = named_in_namespace(name, frames)
    near = f"did you mean {namesake}?" if namesake else did_you_mean(name, sorted(frames))
    advice = "`static_tf`, `urdf` or `tf_from` adds a transform, `odom_topic` poses; `source_frame` corrects a frame_id"
    if offered:
        advice = f"`odom_topic={offered}` uses the poses of this topic, which have it"
    elif target and frames and not near:
        advice = f"{mount_text(name, frames, target)}, `urdf` or `tf_from` reads that from elsewhere"
    message = f"no transform has the {'source ' if target else ''}frame {name!r}; {known}"
    return UnconnectedError(message, stamp_ns=stamp_ns, hint=f"{near} {advice}".strip())


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
        advice = f"{mount_text(query.source, target_tree.frames)}, `urdf` or `tf_from` reads that from elsewhere"
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
