"""Checks that all scans of a topic have the same beams, for formats that require it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import UsageError, stamp_text

if TYPE_CHECKING:
    from pc2scan.streams.scans import Scan


class SameBeams:
    """Compares each scan with the first one.

    Parameters
    ----------
    what
        What errors call the format's file: ``an .npz archive``.
    angles
        Whether the angles must be the same, too.
    """

    def __init__(self, what: str, *, angles: bool) -> None:
        self._what = what
        self._angles = angles
        self._first: Scan | None = None

    def check(self, scan: Scan) -> None:
        """Raise a `UsageError` if a scan has other beams than the first, or intensities while the first has none."""
        first = self._first
        if first is None:
            self._first = scan
            return
        if len(scan.ranges) != len(first.ranges):
            found = f"{len(scan.ranges)} beams, but the first has {len(first.ranges)}"
        elif self._angles and (scan.angle_min, scan.angle_increment) != (first.angle_min, first.angle_increment):
            found = f"its beams from {scan.angle_min:.6g} rad on, {scan.angle_increment:.6g} rad apart, but the first "
            found += f"from {first.angle_min:.6g} on, {first.angle_increment:.6g} apart"
        elif has_intensities(scan) != has_intensities(first):
            found = (
                "intensities, but the first has none" if has_intensities(scan) else "no intensities, but the first has"
            )
        else:
            return
        raise UsageError(
            f"the scan at {stamp_text(scan.stamp_ns)} has {found}: {self._what} needs scans with the same beams",
            topic=scan.topic,
            hint="`pc2scan convert` with `rebin` gives all scans the same beams; `start` and `end` export a part",
        )


def has_intensities(scan: Scan) -> bool:
    """Whether each beam has an intensity."""
    return len(scan.intensities) == len(scan.ranges) > 0
