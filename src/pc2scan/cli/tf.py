"""``pc2scan tf``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.errors import TransformError, UnconnectedError, UsageError, stamp_text
from pc2scan.options.call import Options
from pc2scan.options.moment import TimeBound
from pc2scan.requests import frames_of
from pc2scan.show.tf import Lookup, frame_tree

from .render import show


def tf(sources: list[Path], lookup: tuple[str, str] | None, at: str | None, *, options: Options) -> int:
    """Show the frames of a recording."""
    if at is not None and lookup is None:
        raise UsageError("--at needs --lookup", hint="--lookup base_link lidar --at 1604515190.25")
    tree = frame_tree(sources, frames_of(options))
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
        place, rotation = rigid.translation.tolist(), rigid.quaternion.tolist()
        result = Lookup(lookup[0], lookup[1], stamp_ns or None, place, rotation, rigid.rpy, tree.damage)
        show(result, as_json=options.as_json)
        return result.exit_status
    show(tree, as_json=options.as_json)
    return tree.exit_status


#: Times below this, in nanoseconds since 1970 (1973), are probably meant to count from a recording's beginning.
_FIRST_DATE_NS = 100_000_000_000_000_000


def _stamp(text: str) -> int:
    bound = TimeBound.parse(text)
    # Seconds are always absolute here, never from the recording's beginning: simulated time begins at 0.
    return bound.nanoseconds
