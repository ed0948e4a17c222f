"""The TUM format of trajectories: ``timestamp x y z qx qy qz qw``, seconds and metres, which evo reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import UnwritableError, stamp_text

from .files import TextFile

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.streams.scans import Scan

    from .poses import PosesAtStamp


class TumWriter:
    """Writes one line for each scan: its stamp, with all nine digits, and the robot's pose. Stamps ascend."""

    def __init__(self, path: Path, *, posed: bool) -> None:
        assert posed
        self._file = TextFile(path)
        self._last_ns: int | None = None

    def add(self, item: Scan, placed: PosesAtStamp | None) -> None:
        """Write a line; raise `UnwritableError` for a stamp that is not later than the one before."""
        assert placed is not None
        if self._last_ns is not None and item.stamp_ns <= self._last_ns:
            raise UnwritableError(
                f"its stamp is not later than the one before, {stamp_text(self._last_ns)}, but stamps have to ascend",
                stamp_ns=item.stamp_ns,
            )
        self._last_ns = item.stamp_ns
        self._file.line(" ".join((stamp_text(item.stamp_ns), *map(repr, placed.robot.pose))))

    def finish(self) -> list[str]:
        """Complete the file."""
        self._file.finish()
        return []

    def abort(self) -> None:
        """Release the file."""
        self._file.abort()
