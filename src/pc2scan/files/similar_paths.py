"""Suggests what the user probably meant by a path that does not exist."""

from __future__ import annotations

import os
from itertools import islice
from typing import TYPE_CHECKING

from pc2scan.text import nearest

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

#: Maximum number of a directory's entries that are compared.
_MOST = 2_000


def missing_hint(path: Path, suffixes: Iterable[str] = ()) -> str | None:
    """Return a hint for a path that does not exist.

    Parameters
    ----------
    path
        The path.
    suffixes
        Suffixes of the files that are listed if no name is similar.

    Returns
    -------
    str or None
        The target of a broken link, a similar name in the directory, the files in it, or the directory that is missing;
        None if there is no hint.
    """
    if str(path) == "-":
        return "recordings cannot be read from a pipe; save it as a file first"
    # Not Path.is_symlink: the name may be too long.
    if os.path.islink(path):  # noqa: PTH114
        return f"it is a link to {path.readlink()}, which does not exist"
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
    return f"the folder has {', '.join(there[:3])}{more}"
