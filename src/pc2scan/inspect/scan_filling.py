"""Checks which of their directions the scans of one topic fill: packets are parts of a turn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .findings import Finding, Tally, finding

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["ScanFilling"]

#: Two scans are parts if each has all its returns in a sector of less than this share of its directions, and less than
#: this share of them in directions in which the other has returns, too.
_PART = 0.5

#: If fewer than this share of the directions have a return in any scan, no consumer can match the scans.
_FEW = 0.1


@dataclass(slots=True)
class _Frame:
    """The directions with a return in the last scan of a frame, and in any of its scans."""

    last: NDArray[np.bool_]
    ever: NDArray[np.bool_]


class ScanFilling:
    """The directions that the scans of one topic fill, added in their order; scans without returns do not count."""

    def __init__(self) -> None:
        self._frames: dict[str, _Frame] = {}
        self._pairs = 0
        self._parts = Tally()
        self._returns = self._beams = 0

    def add(self, frame_id: str, returns: NDArray[np.bool_], stamp_ns: int) -> None:
        """Add the next scan; ``returns`` says which beams have one, bool, shape (beams,)."""
        number = int(np.count_nonzero(returns))
        if not number:
            return
        self._returns += number
        self._beams += len(returns)
        frame = self._frames.get(frame_id)
        if frame is None or len(frame.last) != len(returns):
            self._frames[frame_id] = _Frame(returns, returns.copy())
            return
        self._pairs += 1
        last, frame.last = frame.last, returns
        frame.ever |= returns
        shared = int(np.count_nonzero(last & returns))
        if shared < _PART * min(number, int(np.count_nonzero(last))) and _is_part(last) and _is_part(returns):
            self._parts.add(stamp_ns)

    def findings(self) -> list[Finding]:
        """Return the problems."""
        if not self._beams:
            return []
        share = self._returns / self._beams
        if self._parts.count > self._pairs / 2:
            text = (
                f"the scans are parts of a turn: on average {share:.1%} of the directions have a return, and "
                f"{self._parts.count:,} of {self._pairs:,} scans have them in another sector than the scan before"
            )
            hint = (
                "packets of a lidar? For scans made from clouds, pc2scan convert `accumulate` with the time of a turn, "
                "such as `accumulate=0.1`, joins them"
            )
            return [finding("parts", "defect", text, hint, self._parts)]
        ever = sum(int(np.count_nonzero(frame.ever)) for frame in self._frames.values())
        beams = sum(len(frame.ever) for frame in self._frames.values())
        if ever < _FEW * beams:
            text = f"only {ever:,} of {beams:,} directions ever have a return: SLAM and localisation cannot match scans"
            hint = "a sector as wide as the sensor sees, or other heights: pc2scan info suggests them"
            return [Finding("few-directions", "defect", text, hint)]
        return []


def _is_part(returns: NDArray[np.bool_]) -> bool:
    """Whether all returns are in a sector of at most half of the directions; these may be a circle."""
    filled = np.flatnonzero(returns)
    gaps = np.diff(filled, append=filled[0] + len(returns))
    return len(returns) - int(gaps.max()) < _PART * len(returns)
