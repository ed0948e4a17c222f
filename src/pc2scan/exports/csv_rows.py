"""CSV: a row for each scan."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.tables import csv_cell

from .files import BeamCheck, TextFile, float32_text, float32_texts, has_intensities, planar

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.streams.scans import Scan

    from .poses import PosesAtStamp

#: Numbers of a scan that are float32 in the message.
_GEOMETRY = ("angle_min", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")


class CsvWriter:
    """Writes one row for each scan: stamps, pose, geometry, ``range_0`` and so on, ``intensity_0`` and so on.

    Numbers have the fewest digits from which float32 (for poses float64) reads the recorded value.
    """

    def __init__(self, path: Path, *, posed: bool) -> None:
        self._file = TextFile(path)
        self._posed = posed
        self._beams = BeamCheck("a CSV file", angles=False)
        self._begun = False

    def add(self, item: Scan, placed: PosesAtStamp | None) -> None:
        """Write a row."""
        self._beams.check(item)
        if not self._begun:
            self._begun = True
            self._file.line(",".join(self._columns(item)))
        row = [str(item.stamp_ns), str(item.log_time_ns), csv_cell(item.frame)]
        if placed is not None:
            row += map(repr, planar(placed.robot))
        row += (float32_text(getattr(item, name)) for name in _GEOMETRY)
        row += float32_texts(item.ranges)
        if has_intensities(item):
            row += float32_texts(item.intensities)
        self._file.line(",".join(row))

    def _columns(self, scan: Scan) -> list[str]:
        count = range(len(scan.ranges))
        names = ["stamp_ns", "log_time_ns", "frame", *(("x", "y", "yaw") if self._posed else ()), *_GEOMETRY]
        names += (f"range_{i}" for i in count)
        return names + [f"intensity_{i}" for i in count if has_intensities(scan)]

    def finish(self) -> list[str]:
        """Complete the file."""
        self._file.finish()
        return []

    def abort(self) -> None:
        """Release the file."""
        self._file.abort()
