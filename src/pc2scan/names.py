"""Finds the name that a user probably meant, among existing names."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["did_you_mean", "nearest"]

#: Maximum number of names that are compared, and their maximum length: recordings may have any number of names.
_MOST = 2_000
_LONGEST = 255


def nearest(asked: str, known: Iterable[str]) -> str | None:
    """Return the name that is most similar to the requested one, or None if none is similar.

    Case, slashes at the ends, and hyphens instead of underscores are ignored. A part of a name matches, too.

    >>> nearest("Base-Link", ["odom", "base_link"]), nearest("points", ["/lidar/points", "/imu"])
    ('base_link', '/lidar/points')
    >>> nearest("x", ["odom"])
    """
    import difflib  # noqa: PLC0415  # few commands are wrong, and all start quickly

    names = {_normalized(name): name for name in reversed(list(islice(known, _MOST))) if len(name) <= _LONGEST}
    wanted = _normalized(asked[:_LONGEST])
    if not wanted:
        return None
    close = difflib.get_close_matches(wanted, names, n=1)
    # Then names that contain it as a part, or are a part of it, the shortest first.
    close += sorted((name for name in names if _is_part(wanted, name) or _is_part(name, wanted)), key=len)
    if not close:
        ends = {name.rpartition("/")[2]: name for name in names}
        close = [ends[end] for end in difflib.get_close_matches(wanted.rpartition("/")[2], ends, n=1)]
    return names[close[0]] if close else None


def did_you_mean(asked: str, known: Iterable[str]) -> str:
    """Return ``did you mean base_link?``, or empty text if no name is similar to the requested one."""
    name = nearest(asked, known)
    return f"did you mean {name}?" if name else ""


def _normalized(name: str) -> str:
    return name.casefold().replace("-", "_").strip("/ ")


def _is_part(short: str, long: str) -> bool:
    return len(short) >= 3 and (long.endswith(f"/{short}") or long.startswith(f"{short}/") or f"/{short}/" in long)
