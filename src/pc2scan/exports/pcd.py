"""The Point Cloud Library's .pcd: one binary file for each cloud, with its own fields.

Source of the rules: "The PCD (Point Cloud Data) file format", version 0.7, of PCL's documentation.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from pc2scan.core.rigid import IDENTITY_POSE
from pc2scan.errors import UnwritableError

from .files import CloudFolder

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.streams.clouds import Cloud

    from .poses import PosesAtStamp

_WORD = re.compile(r"[!-~]+")

#: NumPy's kinds of numbers, and PCD's.
_TYPES = {"f": "F", "i": "I", "u": "U"}


class PcdWriter:
    """A folder with a file for each cloud, named after its stamp in nanoseconds."""

    def __init__(self, path: Path, *, posed: bool) -> None:
        self._folder = CloudFolder(path)
        self._posed = posed
        self._names: dict[int, int] = {}

    def add(self, item: Cloud, placed: PosesAtStamp | None) -> None:
        """Write a cloud; raise an `UnwritableError` if the header cannot represent a field's name."""
        points = item.points()
        names = points.dtype.names or ()
        if odd := [name for name in names if name == "_" or not _WORD.fullmatch(name)]:
            raise UnwritableError(f"a field is named {odd[0]!r:.60}: names in a .pcd file are words of ASCII")
        fields = [points.dtype[name] for name in names]
        height, width = item.shape
        x, y, z, i, j, k, r = IDENTITY_POSE if placed is None else placed.sensor().pose
        header = {
            "VERSION": ["0.7"],
            "FIELDS": names,
            "SIZE": [str(field.base.itemsize) for field in fields],
            "TYPE": [_TYPES[field.base.kind] for field in fields],
            "COUNT": [str(field.shape[0] if field.shape else 1) for field in fields],
            "WIDTH": [str(width)],
            "HEIGHT": [str(height)],
            "VIEWPOINT": [f"{value:.17g}" for value in (x, y, z, r, i, j, k)],
            "POINTS": [str(len(points))],
            "DATA": ["binary"],
        }
        lines = "".join(f"{key} {' '.join(values)}\n" for key, values in header.items())
        stamp_ns = item.stamp_ns
        number = self._names[stamp_ns] = self._names.get(stamp_ns, -1) + 1
        name = f"{stamp_ns}_{number}.pcd" if number else f"{stamp_ns}.pcd"
        self._folder.write(name, lines.encode(), points.tobytes())

    def finish(self) -> list[str]:
        """Do nothing: each file is complete."""
        return []

    def abort(self) -> None:
        """Do nothing: no file is open."""
