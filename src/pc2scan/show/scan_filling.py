"""Checks which of their directions the scans of one topic fill: packets are parts of a turn."""

from __future__ import annotations

import cmath
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.layout import TURN
from pc2scan.core.verdicts import are_returns

from .findings import Finding, Tally, finding

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.core.verdicts import ConsumerScan

#: A scan is a part of a turn if all its returns are in a sector of less than this share of its directions, and less
#: than this share of them in directions in which the scan before it has returns.
_PART = 0.5

#: Fewer returns than these, as of two posts in a field while the robot turns, are no part of a turn.
_FEWEST_RETURNS = 4

#: How constant the steps from part to part are: the length of the mean of the steps as directions. It is 1 for a lidar
#: that turns, and near 0 for single returns in directions by chance, such as of dust.
_STEADY = 0.5

#: If fewer than this share of the directions have a return in any scan, no consumer can match the scans.
_FEW = 0.05

#: Scans in more frames than this do not count.
_MOST_FRAMES = 100


class ScanFilling:
    """The directions that the scans of one topic fill, added in their order; scans without returns do not count."""

    def __init__(self) -> None:
        #: By frame: the last scan's directions with a return; None if it is no part.
        self._last: dict[str, NDArray[np.bool_] | None] = {}
        #: By frame: the directions with a return in any scan, as long as these are few.
        self._ever: dict[str, NDArray[np.bool_]] = {}
        self._few = True
        self._pairs = 0
        self._parts = Tally()
        self._steps = 0j
        self._returns = self._beams = 0

    def add(self, frame_id: str, scan: ConsumerScan, ranges: NDArray[np.float32], stamp_ns: int) -> None:
        """Add the next scan, and its ranges, float32, shape (beams,), metres."""
        if not scan.returns:
            return
        self._few = self._few and scan.returns < _FEW * scan.beams
        if frame_id not in self._last and len(self._last) == _MOST_FRAMES:
            return
        self._returns += scan.returns
        self._beams += scan.beams
        self._pairs += frame_id in self._last
        last, self._last[frame_id] = self._last.get(frame_id), None
        if scan.returns >= _PART * scan.beams:
            return
        returns = self._last[frame_id] = are_returns(ranges, scan.range_min, scan.range_max)
        if self._few:
            ever = self._ever.setdefault(frame_id, returns)
            self._ever[frame_id] = ever | returns if len(ever) == len(returns) else returns
        if scan.returns < _FEWEST_RETURNS:
            self._last[frame_id] = None
        elif last is not None and len(last) == len(returns):
            self._add_pair(last, returns, stamp_ns)

    def _add_pair(self, last: NDArray[np.bool_], returns: NDArray[np.bool_], stamp_ns: int) -> None:
        """Compare a scan with the one before."""
        shared = int(np.count_nonzero(last & returns))
        if shared >= _PART * min(np.count_nonzero(last), np.count_nonzero(returns)):
            return
        (start, size), (other, other_size) = _sector(returns), _sector(last)
        if max(size, other_size) < _PART * len(returns):
            self._parts.add(stamp_ns)
            self._steps += cmath.rect(1.0, (start - other) / len(returns) * TURN)

    def findings(self) -> list[Finding]:
        """Return the problems."""
        if not self._beams:
            return []
        share = self._returns / self._beams
        if self._parts.count > self._pairs / 2 and abs(self._steps) > _STEADY * self._parts.count:
            text = (
                f"the scans are parts of a turn: on average {share:.1%} of the directions have a return, and "
                f"{self._parts.count:,} of {self._pairs:,} scans have them in another sector than the scan before"
            )
            hint = (
                "packets of a lidar? For scans made from clouds, pc2scan convert `accumulate` with the time of a turn, "
                "such as `accumulate=0.1`, joins them"
            )
            return [finding("parts", "defect", text, hint, self._parts)]
        ever = sum(int(np.count_nonzero(found)) for found in self._ever.values())
        beams = sum(map(len, self._ever.values()))
        if self._few and ever < _FEW * beams:
            text = f"only {ever:,} of {beams:,} directions ever have a return: SLAM and localisation cannot match scans"
            hint = "a sector as wide as the sensor sees, or other heights: pc2scan info suggests them"
            return [Finding("few-directions", "defect", text, hint)]
        return []


def _sector(returns: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first beam and the number of beams of the smallest sector with all returns; the beams are a circle."""
    filled = np.flatnonzero(returns)
    gaps = np.diff(filled, prepend=filled[-1] - len(returns))
    widest = int(gaps.argmax())
    return int(filled[widest]), len(returns) - int(gaps[widest]) + 1
