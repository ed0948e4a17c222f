"""Looks up one transform at many times, between which the transforms of points are interpolated.

The rules are those of `pc2scan.transforms.buffer`; results differ from its in the last bits of float64.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core import kernel

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from .chain import Chain
    from .history import FrameHistory

    Needed = Callable[[NDArray[np.int64], NDArray[np.float64]], int]
    _Side = tuple[FrameHistory, ...]

#: The stamps of a static link.
_ALWAYS = np.empty(0, np.int64)


def sample_chain(
    chain: Chain, begin_ns: int, end_ns: int, step_ns: int, needed_ns: Needed
) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
    """Look up a chain, whose parents do not change in the interval, at many times; see `TransformBuffer.rows`."""
    sides = (chain.source_side.links, chain.target_side.links, chain.above)
    source, target, above = (tuple([link.during(begin_ns, end_ns) for link in side]) for side in sides)
    # Samples of each link are among the times: there the motion may change.
    stamps = tuple([link.stamps_ns for link in (*source, *target) if not link.static])

    def looked_up(step_ns: int) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
        nodes, gap_ns = kernel.nodes(stamps, begin_ns, end_ns, step_ns)
        times = np.frombuffer(nodes, np.int64)
        return times[::2], _rows_of(source, target, above, times), gap_ns

    rows = looked_up(step_ns)
    needed = needed_ns(*rows[:2])
    return rows if needed >= step_ns else looked_up(needed)


def _rows_of(source: _Side, target: _Side, above: _Side, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return ``target_from_source`` at (N,) stamps.

    Returns
    -------
    (N, 12) float64
        The rows of the rotation, then the translation; NaN where a frame is not known.
    """
    rows = _rows_to_ancestor(source, stamps_ns)
    if not target:
        return rows
    down = _rows_to_ancestor(target, stamps_ns)
    back = down[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1)
    origin = np.einsum("nij,nj->ni", back, rows[:, 9:] - down[:, 9:])
    # As in `follow`. The inverse of the target's walk scales, and what both walks have in common scales before.
    for link in target:
        origin *= _squared_lengths(link, stamps_ns)[:, np.newaxis]
    if source:
        known = np.ones(stamps_ns.size, np.bool_)
        for link in above:
            squared = _squared_lengths(link, stamps_ns)
            known &= ~np.isnan(squared)
            origin[known] *= np.square(squared[known])[:, np.newaxis]
    return np.concatenate([(back @ rows[:, :9].reshape(-1, 3, 3)).reshape(-1, 9), origin], axis=1)


def _rows_to_ancestor(links: Iterable[FrameHistory], stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the transforms from a frame up to the common ancestor."""
    rows = np.zeros((stamps_ns.size, 12))
    rows[:, 0:9:4] = 1.0
    for link in links:
        if link.static:
            kernel.follow(stamps_ns, _ALWAYS, link.poses[-1:], rows)
        else:
            kernel.follow(stamps_ns, link.stamps_ns, link.poses, rows)
    return rows


def _squared_lengths(link: FrameHistory, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the squared lengths of a link's quaternions, (N,); NaN where it is not known."""
    samples, poses = _ALWAYS, link.poses[-1:]
    if not link.static:
        begin, end = link.stamps_ns.searchsorted(stamps_ns[[0, -1]]).tolist()
        needed = slice(max(begin - 1, 0), end + 1)
        samples, poses = link.stamps_ns[needed], link.poses[needed]
    # They are how much a rotation scales.
    rows = np.zeros((stamps_ns.size, 12))
    rows[:, 9] = 1.0
    kernel.follow(stamps_ns, samples, poses * [0, 0, 0, 1, 1, 1, 1], rows)
    lengths: NDArray[np.float64] = np.linalg.norm(rows[:, 9:], axis=1)
    return lengths
