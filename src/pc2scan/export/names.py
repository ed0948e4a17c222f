"""Names for the files of topics."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

#: The longest name: file systems allow 255 bytes, and staging adds an ending.
_LONGEST = 120

#: Names that Windows reserves for devices.
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def file_names(topics: Iterable[str]) -> dict[str, str]:
    """Return a name for the file of each topic: safe on every file system, and no two the same.

    >>> list(file_names(["/front/scan", "/front_scan", "/Front_Scan", "/../x y", "/"]).values())
    ['front_scan', 'front_scan_2', 'Front_Scan_3', 'x_y', 'topic']
    """
    taken: set[str] = set()
    found = {}
    for topic in topics:
        safe = re.sub(r"[^A-Za-z0-9_.-]+", "_", topic).strip("_.-")[:_LONGEST] or "topic"
        if _DEVICES.fullmatch(safe):
            safe = f"topic_{safe}"
        name, number = safe, 1
        # File systems may ignore case.
        while name.lower() in taken:
            number += 1
            name = f"{safe}_{number}"
        taken.add(name.lower())
        found[topic] = name
    return found
