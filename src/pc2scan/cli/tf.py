"""``pc2scan tf``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.errors import UsageError
from pc2scan.options.call import Options
from pc2scan.options.moment import TimeBound
from pc2scan.parsing import frames_of
from pc2scan.show.tf import Lookup, frame_tree

from .render import show


def tf(sources: list[Path], lookup: tuple[str, str] | None, at: str | None, *, options: Options) -> int:
    """Show the frames of a recording."""
    if at is not None and lookup is None:
        raise UsageError("--at needs --lookup", hint="--lookup base_link lidar --at 1604515190.25")
    tree = frame_tree(sources, frames_of(options))
    if lookup is None:
        return show(tree, options)
    # Always since 1970, never from the recording's beginning: simulated time begins at 0.
    stamp_ns = 0 if at is None else TimeBound.parse(at).nanoseconds
    rigid = tree.lookup(*lookup, stamp_ns)
    place, rotation = rigid.translation.tolist(), rigid.quaternion.tolist()
    return show(Lookup(*lookup, stamp_ns or None, place, rotation, rigid.rpy, tree.damage), options)
