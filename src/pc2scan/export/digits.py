"""Numbers as text, with the fewest digits that represent them exactly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


def float32_text(value: float) -> str:
    """Return the shortest text that float32 reads back as this value: ``nan``, ``inf``, ``1.5707964``."""
    return str(np.float32(value))


def float32_texts(values: NDArray[np.float32]) -> list[str]:
    """Return `float32_text` of each value."""
    return list(map(str, values))


def planar(rigid: Any) -> Sequence[float]:
    """Return x, y and yaw of a pose: metres and radians."""
    x, y, _ = rigid.translation.tolist()
    return x, y, rigid.rpy[2]
