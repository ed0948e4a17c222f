"""Looks up one transform at many times at once, as the transforms between which points are interpolated.

The rules are those of `pc2scan.tf.buffer`; results differ from its in the last bits of float64.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import rotation_matrices

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from .chain import Chain
    from .history import FrameHistory

__all__ = ["longest_gap_ns", "rows_of", "sample_times"]


def sample_times(chain: Chain, begin_ns: int, end_ns: int) -> NDArray[np.int64]:
    """Return the stamps of all samples between two times, in order: there the motion may change."""
    found = [np.empty(0, np.int64)]
    for link in chain.links:
        if not link.static:
            first, last = link.stamps_ns.searchsorted([begin_ns, end_ns + 1])
            found.append(link.stamps_ns[first:last])
    return np.unique(np.concatenate(found))


def longest_gap_ns(chain: Chain, begin_ns: int, end_ns: int) -> int:
    """Return the longest time between two samples of one frame of which a part is between two times, nanoseconds."""
    longest = 0
    for link in chain.links:
        if not link.static:
            first = int(link.stamps_ns.searchsorted(begin_ns, "right"))
            last = int(link.stamps_ns.searchsorted(end_ns, "left"))
            around = link.stamps_ns[max(first - 1, 0) : last + 1]
            longest = max(longest, int(np.diff(around).max(initial=0)))
    return longest


def rows_of(chain: Chain, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return ``target_from_source`` at (N,) stamps.

    Returns
    -------
    (N, 12) float64
        The rows of the rotation, then the translation; NaN where a frame is not known.
    """
    source_rotation, source_origin = _up(chain.source_side.links, stamps_ns)
    target_rotation, target_origin = _up(chain.target_side.links, stamps_ns)
    back = target_rotation.transpose(0, 2, 1)
    rotation = back @ source_rotation
    origin = np.einsum("nij,nj->ni", back, source_origin - target_origin)
    return np.concatenate([rotation.reshape(-1, 9), origin], axis=1)


def _up(links: Iterable[FrameHistory], stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """From a frame up to the common ancestor: rotations (N, 3, 3) and translations (N, 3)."""
    rotation = np.broadcast_to(np.eye(3), (stamps_ns.size, 3, 3))
    origin = np.zeros((stamps_ns.size, 3))
    for link in links:
        own, offset = _poses(link, stamps_ns)
        rotation = own @ rotation
        origin = np.einsum("nij,nj->ni", own, origin) + offset
    return rotation, origin


def _poses(link: FrameHistory, stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A link's own rotations and translations at the stamps, NaN outside of its samples."""
    if link.static:
        rotation = rotation_matrices(link.quaternions[-1])
        return np.broadcast_to(rotation, (stamps_ns.size, 3, 3)), np.broadcast_to(
            link.translations[-1], (stamps_ns.size, 3)
        )
    last = link.stamps_ns.size - 1
    older = np.clip(link.stamps_ns.searchsorted(stamps_ns, "right") - 1, 0, last)
    newer = np.minimum(older + 1, last)
    begin = link.stamps_ns[older]
    with np.errstate(all="ignore"):
        ratio = np.where(newer > older, (stamps_ns - begin) / (link.stamps_ns[newer] - begin), 0.0)[:, np.newaxis]
        offset = (1 - ratio) * link.translations[older] + ratio * link.translations[newer]
        quaternions = _slerp(link.quaternions[older], link.quaternions[newer], ratio)
        outside = (stamps_ns < link.first_ns) | (stamps_ns > link.last_ns)
        rotation = np.moveaxis(rotation_matrices(quaternions.T), -1, 0)
    rotation[outside], offset[outside] = np.nan, np.nan
    return rotation, offset


def _slerp(first: NDArray[np.float64], last: NDArray[np.float64], ratio: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations between pairs of rotations (N, 4), as `pc2scan.core.rigid.slerp` finds them between one pair."""
    product = np.einsum("ni,ni->n", first, last)[:, np.newaxis]
    length = np.sqrt(np.einsum("ni,ni->n", first, first) * np.einsum("ni,ni->n", last, last))[:, np.newaxis]
    angle = np.arccos(np.minimum(np.abs(product) / length, 1.0))
    sign = np.where(product < 0, -1.0, 1.0)
    mixed = (np.sin((1 - ratio) * angle) * first + np.sin(ratio * angle) * sign * last) / np.sin(angle)
    return np.where(angle == 0, first, mixed)
