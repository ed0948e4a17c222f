"""A filter that removes the ground: level, sloped, or with kerbs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.core.terrain import on_ground
from pc2scan.errors import UsageError
from pc2scan.text import did_you_mean

from .filters import Frame

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pc2scan.core.points import Points

#: The values of `ground`.
GROUND = ("keep", "remove")


@dataclass(frozen=True, slots=True)
class RemoveGround:
    """Rejects points on the ground, which `pc2scan.core.terrain` finds in each cloud.

    It needs a frame of the robot whose z axis points up. In a cloud without ground it rejects nothing.
    """

    name = "ground"
    explanation = "on the ground, as `ground` finds it"
    absent = (
        "`ground` found no ground in any cloud, so it removed nothing; it needs a frame of the robot whose z axis "
        "points up (`target_frame`), and ground that is seen from near to far"
    )
    fields = ()
    frame = Frame.TARGET
    text = "remove"

    @classmethod
    def parse(cls, text: str) -> RemoveGround:
        """Read ``remove``.

        Raises
        ------
        UsageError
            If it is anything else.
        """
        if text != "remove":
            raise UsageError(
                f"`ground` is {text!r}, it must be one of {', '.join(GROUND)}", hint=did_you_mean(text, GROUND) or None
            )
        return cls()

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are not on the ground; see `pc2scan.pipeline.stages.filters.Filter`."""
        return ~on_ground(*points.xyz())
