"""Removes the beams that beam filters find."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.layout import TURN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.conversion.steps import ConvertedMessage
    from pc2scan.request.beam_filters import BeamFilter


def remove_beams(filters: Sequence[BeamFilter], empty_range: float, result: ConvertedMessage) -> ConvertedMessage:
    """Remove beams of a scan: a removed beam has no return.

    Parameters
    ----------
    filters
        The filters in order; each one sees the result of those before it.
    empty_range
        The range of a beam without a return, metres.
    """
    empty = np.float32(empty_range)
    scan = result.message
    seen = np.array(scan.ranges)
    # Beams without a return may have a finite range, which filters must not take for a return.
    seen[seen == empty] = np.inf
    returns = np.isfinite(seen)
    counts = dict(result.removed or {"returns": int(np.count_nonzero(returns))})
    closed = abs(seen.size * float(scan.angle_increment) - TURN) < abs(float(scan.angle_increment)) / 2
    for chosen in filters:
        gone = chosen(seen, float(scan.angle_increment), closed=closed) & np.isfinite(seen)
        counts[chosen.name] = counts.get(chosen.name, 0) + int(np.count_nonzero(gone))
        seen[gone] = np.inf
    removed = returns & ~np.isfinite(seen)
    if removed.any():
        ranges = np.where(removed, empty, scan.ranges)
        lit = np.where(removed, np.float32(0), scan.intensities) if len(scan.intensities) else scan.intensities
        result.message = dataclasses.replace(scan, ranges=ranges, intensities=lit)
        result.empty = not np.isfinite(seen).any()
        if result.used is not None:
            kept = ~removed[result.used.beams]
            result.used = dataclasses.replace(
                result.used, numbers=result.used.numbers[kept], beams=result.used.beams[kept]
            )
    result.removed = counts
    return result
