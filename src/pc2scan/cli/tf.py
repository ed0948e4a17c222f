"""``pc2scan tf``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import TransformError, UnconnectedError, UsageError, leading, stamp_text
from pc2scan.options.call import Options
from pc2scan.options.moment import TimeBound

from . import completion
from .damage import show_damage
from .render import print_json, say, show_parts, warn

if TYPE_CHECKING:
    from pc2scan.core.rigid import Rigid
    from pc2scan.inspect.tf import FrameTree
    from pc2scan.tf.summary import FrameInfo

#: Maximum indentation of the drawing, because a chain may have a million frames.
_MAX_DEPTH = 60
_MAX_LINES = 500


def tf(
    sources: Annotated[list[Path], typer.Argument(metavar="SRC...", help="Recordings; their transforms are merged.")],
    lookup: Annotated[
        tuple[str, str] | None,
        typer.Option(
            "--lookup",
            metavar="TARGET SOURCE",
            help="Print the transform from SOURCE to TARGET.",
            autocompletion=completion.frames,
        ),
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="With --lookup: the stamp, in seconds (or nanoseconds) since 1970, or as a date and time.  "
            "[default: the latest time common to all frames between]",
            show_default=False,
        ),
    ] = None,
    *,
    options: Options,
) -> None:
    """Show the frames of a recording.

    It shows the tree, and the rate, first and last times, and largest gap of each frame. Unconnected parts are shown
    separately.
    """
    from pc2scan.inspect.tf import frame_tree
    from pc2scan.options.frames import frames_of

    if at is not None and lookup is None:
        raise UsageError("--at needs --lookup", hint="--lookup base_link lidar --at 1604515190.25")
    tree = frame_tree(sources, frames_of(options))
    show_damage(tree.damage)
    if lookup is not None:
        stamp_ns = 0 if at is None else _stamp(at)
        try:
            rigid = tree.buffer.lookup(lookup[0], lookup[1], stamp_ns)
        except TransformError as err:
            # 0 stands for the latest time, so it is not shown as a stamp.
            err.stamp_ns = err.stamp_ns or None
            first_ns = min((info.first_ns for info in tree.buffer.infos if not info.static), default=0)
            if at and not isinstance(err, UnconnectedError) and first_ns - stamp_ns > _FIRST_DATE_NS > stamp_ns:
                meant = stamp_text(first_ns + stamp_ns)
                err.hint = f"--at counts from 1970; {at} s after the first transform is --at {meant}"
            raise
        _show_transform(lookup[0], lookup[1], stamp_ns, rigid, as_json=options.as_json)
    elif options.as_json:
        print_json(tree.as_dict())
    else:
        _show(tree)


#: Times below this, in nanoseconds since 1970 (1973), are probably meant to count from a recording's beginning.
_FIRST_DATE_NS = 100_000_000_000_000_000


def _stamp(text: str) -> int:
    bound = TimeBound.parse(text)
    # Seconds are always absolute here, never from the recording's beginning: simulated time begins at 0.
    return bound.nanoseconds


def _show_transform(target: str, source: str, stamp_ns: int, rigid: Rigid, *, as_json: bool) -> None:
    translation, quaternion = rigid.translation.tolist(), rigid.quaternion.tolist()
    roll, pitch, yaw = rigid.rpy
    if as_json:
        print_json(
            {
                "target": target,
                "source": source,
                "stamp_ns": stamp_ns or None,
                "translation": translation,
                "rotation": quaternion,
                "rpy": [roll, pitch, yaw],
            }
        )
        return
    when = f"at {stamp_text(stamp_ns)}" if stamp_ns else "at the latest common time"
    say(f"{leading(target)} from {source} {when}")
    say("  translation  x {:.6f}  y {:.6f}  z {:.6f} m".format(*translation))
    say("  quaternion   x {:.9f}  y {:.9f}  z {:.9f}  w {:.9f}".format(*quaternion))
    say(f"  rotation     roll {roll:.6f}  pitch {pitch:.6f}  yaw {yaw:.6f} rad")


def _show(tree: FrameTree) -> None:
    if not tree.frames:
        say("no transforms")
    children: dict[str, list[FrameInfo]] = {}
    for frame in tree.frames:
        for parent in frame.parents:
            children.setdefault(parent, []).append(frame)
    for number, part in enumerate(tree.trees):
        if number:
            say()
        if len(tree.trees) > 1:
            say(f"part {number + 1} of {len(tree.trees)}, not connected with the others:")
        for line in _drawn(part.roots or part.frames[:1], children):
            say(line)
    if tree.frames:
        say()
        show_parts([tree.table()])
    for warning in tree.warnings:
        warn(warning)


def _drawn(roots: tuple[str, ...], children: dict[str, list[FrameInfo]]) -> list[str]:
    """Return the tree as indented lines. It uses a stack, because a hostile tree may be very deep, and ends loops."""
    lines: list[str] = []
    seen: set[str] = set()
    stack = [(root, 0, "") for root in reversed(roots)]
    while stack:
        name, depth, kind = stack.pop()
        if len(lines) >= _MAX_LINES:
            lines.append("... and more")
            break
        again = name in seen
        lines.append(f"{'  ' * min(depth, _MAX_DEPTH)}{leading(name)}{kind}{' (see above)' if again else ''}")
        if again:
            continue
        seen.add(name)
        stack += [
            (frame.child, depth + 1, " (static)" if frame.static else "") for frame in reversed(children.get(name, []))
        ]
    return lines
