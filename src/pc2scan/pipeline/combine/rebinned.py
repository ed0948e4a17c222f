"""What becomes of the beams of scans in the beams of another one: some share a bin, and some bins lie between two."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

__all__ = ["Rebinned", "rebinned"]


class Rebinned(NamedTuple):
    """How beams became other beams.

    Attributes
    ----------
    beams
        Returns that are used.
    shared
        Those of them that share a beam of the new scan with another one: one of them is read.
    between
        Beams of the new scan without a return between two neighbouring beams of a source that have one.
    """

    beams: int
    shared: int
    between: int


def rebinned(
    sources: Iterable[tuple[NDArray[np.int32], NDArray[np.int32]]], length: int, *, full_circle: bool
) -> Rebinned:
    """Count how beams became other beams.

    Parameters
    ----------
    sources
        For each source: where its returns are in the new scan, and the numbers of their beams in it, in their order.
    length
        Beams of the new scan.
    full_circle
        Whether its last beam and its first are neighbours.
    """
    total = 0
    filled = np.zeros(length + 1, np.bool_)
    # Where stretches between neighbours begin and end.
    edges = np.zeros(length + 1, np.int64)
    for bins, numbers in sources:
        total += bins.size
        filled[bins] = True
        neighbours = np.flatnonzero(np.diff(numbers) == 1)
        first, last = (
            np.minimum(bins[neighbours], bins[neighbours + 1]),
            np.maximum(bins[neighbours], bins[neighbours + 1]),
        )
        # The shorter way around a circle.
        around = (last - first > length // 2) if full_circle else np.zeros(first.size, np.bool_)
        np.add.at(edges, first[~around] + 1, 1)
        np.add.at(edges, last[~around], -1)
        edges[0] += np.count_nonzero(around)
        np.add.at(edges, first[around], -1)
        np.add.at(edges, last[around] + 1, 1)
    between = (np.cumsum(edges) > 0) & ~filled
    return Rebinned(total, total - int(np.count_nonzero(filled)), int(np.count_nonzero(between[:length])))
