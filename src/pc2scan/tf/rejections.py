"""Finds transforms that tf2 rejects, and the reasons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import are_taken

if TYPE_CHECKING:
    from numpy.typing import NDArray

ACCEPTED, NO_CHILD, NO_PARENT, SELF, NOT_FINITE, ZERO, DENORMALIZED = range(7)
REASONS = {
    NO_CHILD: "TF_NO_CHILD_FRAME_ID: child_frame_id is empty",
    NO_PARENT: "TF_NO_FRAME_ID: frame_id is empty",
    SELF: "TF_SELF_TRANSFORM: frame_id and child_frame_id are the same",
    NOT_FINITE: "TF_NAN_INPUT: a component is NaN or infinite",
    ZERO: "TF_DENORMALIZED_QUATERNION: the quaternion is zero",
    DENORMALIZED: "TF_DENORMALIZED_QUATERNION: the squared norm of the quaternion differs from 1 by 0.01 or more",
}


@dataclass(frozen=True, slots=True)
class RejectedTransforms:
    """Rejected transforms of one pair of frames and one reason.

    Attributes
    ----------
    child, parent
        Frame names, a leading slash stripped.
    stamp_ns
        Stamp of the first one.
    reason
        tf2's name for the reason, and an explanation.
    count
        How many were rejected.
    """

    child: str
    parent: str
    stamp_ns: int
    reason: str
    count: int


def reason_of_names(parent: str, child: str) -> int:
    """Return why a pair of frames, leading slashes stripped, is rejected, or `ACCEPTED`."""
    if not child:
        return NO_CHILD
    if not parent:
        return NO_PARENT
    return SELF if parent == child else ACCEPTED


def reasons_of(poses: NDArray[np.float64], reasons: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return why each transform is rejected, or `ACCEPTED`; ``reasons`` are those of the names alone."""
    finite = np.isfinite(poses).all(axis=1)
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        zero = ~poses[:, 3:].any(axis=1)
    return np.select(
        [reasons != ACCEPTED, ~finite, zero, ~are_taken(poses[:, 3:])],
        [reasons, NOT_FINITE, ZERO, DENORMALIZED],
        ACCEPTED,
    ).astype(np.int32)
