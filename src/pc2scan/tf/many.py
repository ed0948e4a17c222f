"""Looks up one transform at many times, between which the transforms of points are interpolated.

The rules are those of `pc2scan.tf.buffer`; results differ from its in the last bits of float64.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core import kernel

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from .chain import Chain
    from .history import FrameHistory

__all__ = ["node_times", "rows_of"]


#: The stamps of a static link.
_ALWAYS = np.empty(0, np.int64)


def node_times(chain: Chain, begin_ns: int, end_ns: int, step_ns: int) -> tuple[NDArray[np.int64], int]:
    """Return the times at which a chain is looked up, nanoseconds, and its longest gap; see `kernel.nodes`.

    Samples of each link are among them: there the motion may change.
    """
    samples = tuple([link.stamps_ns for link in chain.links if not link.static])
    times, gap_ns = kernel.nodes(samples, begin_ns, end_ns, step_ns)
    return np.frombuffer(times, np.int64), gap_ns


def rows_of(chain: Chain, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return ``target_from_source`` at (N,) stamps.

    Returns
    -------
    (N, 12) float64
        The rows of the rotation, then the translation; NaN where a frame is not known.
    """
    rows = _up(chain.source_side.links, stamps_ns)
    if not chain.target_side.links:
        return rows
    target = _up(chain.target_side.links, stamps_ns)
    back = target[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1)
    origin = np.einsum("nij,nj->ni", back, rows[:, 9:] - target[:, 9:])
    return np.concatenate([(back @ rows[:, :9].reshape(-1, 3, 3)).reshape(-1, 9), origin], axis=1)


def _up(links: Iterable[FrameHistory], stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the transforms from a frame up to the common ancestor."""
    rows = np.zeros((stamps_ns.size, 12))
    rows[:, 0:9:4] = 1.0
    for link in links:
        if link.static:
            kernel.follow(stamps_ns, _ALWAYS, link.poses[-1:], rows)
        else:
            kernel.follow(stamps_ns, link.stamps_ns, link.poses, rows)
    return rows
