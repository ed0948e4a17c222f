"""Counts what happens to the beams of scans in a new scan: some share a bin, and some bins between them stay empty."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray


class Rebinning(NamedTuple):
    """The beams of scans in the beams of a new scan.

    Attributes
    ----------
    beams
        Returns that are used.
    shared
        Returns that share a beam of the new scan with another return; the beam reads one of them.
    between
        Beams of the new scan that have no return, although they lie between two neighbouring beams of a source that
        have one.
    """

    beams: int
    shared: int
    between: int


def count_rebinning(
    sources: Iterable[tuple[NDArray[np.int32], NDArray[np.int32]]], length: int, *, full_circle: bool
) -> Rebinning:
    """Count how the beams of scans became the beams of a new scan.

    Parameters
    ----------
    sources
        For each source, of each of its returns in order: its beam in the new scan, and its beam in the source.
    length
        Beams of the new scan.
    full_circle
        Whether the last beam and the first are neighbours.
    """
    total = 0
    filled = np.zeros(length + 1, np.bool_)
    # +1 where a stretch between two neighbours begins, -1 where it ends.
    edges = np.zeros(length + 1, np.int64)
    for bins, numbers in sources:
        total += bins.size
        filled[bins] = True
        neighbours = np.flatnonzero(np.diff(numbers) == 1)
        first, last = (
            np.minimum(bins[neighbours], bins[neighbours + 1]),
            np.maximum(bins[neighbours], bins[neighbours + 1]),
        )
        # On a circle, the shorter way between two beams may lead past its end.
        around = (last - first > length // 2) if full_circle else np.zeros(first.size, np.bool_)
        np.add.at(edges, first[~around] + 1, 1)
        np.add.at(edges, last[~around], -1)
        edges[0] += np.count_nonzero(around)
        np.add.at(edges, first[around], -1)
        np.add.at(edges, last[around] + 1, 1)
    between = (np.cumsum(edges) > 0) & ~filled
    return Rebinning(total, total - int(np.count_nonzero(filled)), int(np.count_nonzero(between[:length])))
