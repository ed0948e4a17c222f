"""What a path that leads nowhere was probably meant to be."""

from __future__ import annotations

import os
from itertools import islice
from typing import TYPE_CHECKING

from pc2scan.names import nearest

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

__all__ = ["missing_hint"]

#: Entries of a directory that are looked at.
_MOST = 2_000


def missing_hint(path: Path, suffixes: Iterable[str] = ()) -> str | None:
    """Say what may have been meant by a path that is not there.

    Parameters
    ----------
    path
        Nothing has this name.
    suffixes
        Of the files that are listed where no name is similar.

    Returns
    -------
    str or None
        Where a link leads, the file beside it with a similar name, or what there is, or the directory that is
        missing; None where nothing can be said.
    """
    if str(path) == "-":
        return "recordings are not read from a pipe: save it as a file first"
    # Not Path.is_symlink: the name may be too long.
    if os.path.islink(path):  # noqa: PTH114
        return f"it is a link to {path.readlink()}, which is not there"
    above = path.parent
    while not above.is_dir():
        if above == above.parent:
            return None
        path, above = above, above.parent
    try:
        with os.scandir(above) as entries:
            names = sorted(entry.name for entry in islice(entries, _MOST) if not entry.name.startswith("."))
    except OSError:
        return None
    similar = nearest(path.name, names)
    if similar is not None:
        return f"did you mean {above / similar}?"
    wanted = tuple(suffixes)
    there = [str(above / name) for name in names if wanted and name.endswith(wanted)]
    if not there:
        return None
    more = f" and {len(there) - 3} more" if len(there) > 3 else ""
    return f"in that place there is {', '.join(there[:3])}{more}"
