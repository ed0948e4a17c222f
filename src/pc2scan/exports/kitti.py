"""KITTI's .bin files: x, y, z and intensity of each point as float32, and nothing else.

Files are numbered as in KITTI's odometry benchmark; ``times.txt`` has seconds from the first cloud on, ``stamps.txt``
nanoseconds since 1970, ``poses.txt`` the first three rows of each pose's matrix.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pc2scan.errors import UnwritableError, stamp_text

from .files import CloudFolder, TextFile

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.streams.clouds import Cloud

    from .poses import PosesAtStamp

#: Files beside the clouds.
_FURTHER = ("times.txt", "stamps.txt", "poses.txt")

#: Fields with the strength of a return, the best one first.
_INTENSITIES = ("intensity", "intensities", "i", "reflectivity", "reflectance")


class KittiWriter:
    """A folder with ``000000.bin``, ``000001.bin`` and so on, in the order of the recording."""

    def __init__(self, path: Path, *, posed: bool) -> None:
        self._folder = CloudFolder(path)
        self._texts = [TextFile(path / name) for name in _FURTHER[: 3 if posed else 2]]
        self._count = 0
        self._first_ns = 0

    def add(self, item: Cloud, placed: PosesAtStamp | None) -> None:
        """Write a cloud's returns: points with a NaN or an infinite coordinate are not returns."""
        fields = item.fields
        name = next((each for each in _INTENSITIES if each in fields), None)
        if name is None:
            raise UnwritableError(
                f"the cloud has no field with intensities: its fields are {', '.join(fields) or 'none'}",
                hint="`format=pcd` can hold any fields",
            )
        rows = ""
        if placed is not None:
            sensor = placed.sensor()
            matrix = np.column_stack([sensor.matrix, sensor.translation])
            rows = " ".join(map(repr, matrix.ravel().tolist()))
        with np.errstate(all="ignore"):
            xyz = item.xyz().astype("<f4")
            points = np.column_stack([xyz, item[name].astype("<f4")])
        kept = points[np.isfinite(xyz).all(axis=1)]
        if not self._count:
            self._first_ns = item.stamp_ns
        self._folder.write(f"{self._count:06d}.bin", kept.tobytes())
        self._count += 1
        lines = (stamp_text(item.stamp_ns - self._first_ns), str(item.stamp_ns), rows)
        for file, line in zip(self._texts, lines, strict=False):
            file.line(line)

    def finish(self) -> list[str]:
        """Complete the lists."""
        for file in self._texts:
            file.finish()
        return []

    def abort(self) -> None:
        """Release the lists."""
        for file in self._texts:
            file.abort()
