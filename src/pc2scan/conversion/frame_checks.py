"""Checks of the frames that options name and add, before the first message is converted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError, UsageError, name_list
from pc2scan.text import did_you_mean, nearest
from pc2scan.transforms.buffer import frames_text
from pc2scan.transforms.frames import BODIES, WORLDS
from pc2scan.transforms.motion import find_body_motion
from pc2scan.transforms.static import static_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from pc2scan.request.spec import ScanSpec
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import FrameOptions
    from pc2scan.transforms.static import StaticTransform

    from .plan import Plan

_MOST_NAMES = 5


def check_given_frames(
    own: Iterable[str],
    plan: Plan,
    options: FrameOptions,
    buffer: TransformBuffer | None,
    robot: TransformBuffer | None,
) -> Iterator[str]:
    """Yield a warning for each added transform, and for a source frame, that is probably a mistake.

    Parameters
    ----------
    own
        The frames of the first messages that are converted.
    buffer
        All transforms; None if nothing is transformed.
    robot
        The transforms between the robot's frames, if nothing is transformed; None if there are none.

    Raises
    ------
    UsageError
        If an added transform and the recorded ones form a loop, or one is for a frame whose name is nearly that of the
        clouds, which no transform has.
    """
    frames = [frame.removeprefix("/") for frame in dict.fromkeys(own) if frame]
    if source := options.source_frame.removeprefix("/"):
        transforms = robot if buffer is None else buffer
        known = dict.fromkeys((*(() if transforms is None else transforms.frames), *frames))
        if source not in known and (meant := did_you_mean(source, known)):
            yield (
                f"`source_frame` is {source!r}, which neither a cloud nor a transform of the recording has (the clouds "
                f"are in {name_list(frames, _MOST_NAMES) or 'no frame'}); {meant}"
            )
        for frame in frames:
            recorded = None if transforms is None or source not in BODIES else transforms.known(source, frame, 0)
            if recorded is not None and recorded.translation.any():
                yield (
                    f"`source_frame` is {source}, so points in {frame} are used without the recorded transform to "
                    f"{source}; `target_frame={source}` applies it"
                )
        frames = [source]
    if buffer is None:
        return
    for static in options.static:
        _refuse_loop(static, buffer)
    targets = {spec.params.target_frame.removeprefix("/") for spec in plan.specs} - {""}
    named = {frame.removeprefix("/") for spec in plan.specs for frame in spec.frames}
    used = {name for frame in (*frames, *named) for name in _upwards(buffer, frame)}
    if options.write_static or not frames or any(spec.imu for spec in plan.specs):
        return
    for static in options.static:
        child = static.child.removeprefix("/")
        if child not in used:
            near = nearest(child, frames)
            text = (
                f"`static_tf` from {static.parent} to {static.child} has no effect: the clouds are in "
                f"{name_list(frames, _MOST_NAMES)}"
            )
            if near and targets and not any(frame in buffer.frames for frame in frames):
                # Nothing could be placed.
                raise UsageError(text, hint=f"did you mean `static_tf='{static_text(static.parent, near, static)}'`?")
            yield text + (f"; did you mean {near}?" if near else "")


def _upwards(buffer: TransformBuffer, frame: str) -> list[str]:
    """Return a frame and those above it; none twice."""
    ancestors: dict[str, None] = {}
    while frame and frame not in ancestors:
        ancestors[frame] = None
        history = buffer.history(frame)
        frame = "" if history is None else buffer.frames[history.parent_at(None)]
    return list(ancestors)


def _refuse_loop(static: StaticTransform, buffer: TransformBuffer) -> None:
    parent, child = static.parent.removeprefix("/"), static.child.removeprefix("/")
    above = _upwards(buffer, parent)
    if child not in above:
        return
    way = " in ".join(above[: above.index(child) + 1])
    raise UsageError(
        f"`static_tf` makes {parent} the parent of {child}, which is above {parent} already: {way}",
        hint=f"the parent comes first: `static_tf='{child} {parent} X Y Z ROLL PITCH YAW'` replaces what is recorded",
    )


def check_fixed_frame(source: str, spec: ScanSpec, buffer: TransformBuffer) -> list[str]:
    """Return a warning if nothing moves in the fixed frame.

    Parameters
    ----------
    source
        The frame of the clouds: the one that the user gives, or that of the first cloud; empty if there is none.

    Raises
    ------
    ParameterError
        If the frame does not exist.
    """
    fixed = spec.fixed_frame.removeprefix("/")
    if fixed not in buffer.frames:
        near = did_you_mean(fixed, sorted(buffer.frames)) or _offered(buffer, "")
        advice = "`static_tf` or `tf_from` adds a transform"
        raise ParameterError(
            f"`fixed_frame` is {fixed!r}, which is in no transform; {frames_text(buffer.frames)}",
            hint=f"{near}{'' if near.endswith('?') or not near else ';'} {advice}".strip(),
        )
    frame = (spec.params.target_frame or source).removeprefix("/")
    if not frame or not buffer.is_rigid(fixed, frame):
        return []
    if fixed == frame and find_body_motion(buffer, fixed, source):
        return []  # the target frame itself is wrong, which another warning says
    which = "the frame of the scans itself" if fixed == frame else f"and {frame} never moves in it"
    advice = _offered(buffer, fixed) or "no recorded transform moves; `tf_from` adds the odometry of another recording"
    return [f"`fixed_frame` is {fixed}, {which}: no point is moved; {advice}"]


def _offered(buffer: TransformBuffer, fixed: str) -> str:
    """Return a hint that suggests a frame in which something moves; empty if there is none."""
    frame = frame_that_stays(buffer, fixed)
    return f"`fixed_frame={frame}` is a frame that does not move" if frame else ""


def frame_that_stays(buffer: TransformBuffer, fixed: str) -> str:
    """Return a frame in which something moves, also against ``fixed``; empty if there is none."""
    roots = [root for tree in buffer.trees if not fixed or fixed in tree.frames for root in tree.roots]
    names = dict.fromkeys((*(name for name in WORLDS if name in buffer.frames), *roots))
    moving = {child for child in buffer.frames if (link := buffer.history(child)) is not None and not link.static}
    frames = [name for name in names if any(not buffer.is_rigid(name, child) for child in moving if child != name)]
    frames = [name for name in frames if not fixed or not buffer.is_rigid(name, fixed)]
    return frames[0] if frames else ""
