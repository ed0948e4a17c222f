"""The options of a map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.errors import UsageError

if TYPE_CHECKING:
    from pc2scan.options.call import Options

#: Limits of the side of a cell, metres: smaller cells are finer than any lidar measures, larger ones show nothing.
_FINEST, _COARSEST = 0.001, 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MapOptions:
    """The options of a map.

    Attributes
    ----------
    odom_frame
        The frame in which the robot moves, and of the map.
    base_frame
        The robot's frame, whose path is shown; empty for ``base_link``, or ``base_footprint`` if the former does not
        exist.
    resolution
        The side of a cell, metres.
    max_range
        Returns beyond this range mark no cell as occupied; the cells up to it are cleared. Metres.
    clear_to
        The range up to which beams without a return clear cells, metres; 0: they are ignored.

    Raises
    ------
    UsageError
        If a number is not allowed.
    """

    odom_frame: str = "odom"
    base_frame: str = ""
    resolution: float = 0.05
    max_range: float = math.inf
    clear_to: float = 0.0

    @classmethod
    def of(cls, options: Options) -> MapOptions:
        """Return the options of a map among those of a call."""
        return cls(**{name: getattr(options, name) for name in cls.__dataclass_fields__})

    def __post_init__(self) -> None:
        if not _FINEST <= self.resolution <= _COARSEST:
            # A resolution of 5 nearly always means centimetres.
            meant = self.resolution / 100
            raise UsageError(
                f"`resolution` is {self.resolution:g} m, it must be from {_FINEST:g} to {_COARSEST:g}",
                hint=f"for {self.resolution:g} cm write `resolution={meant:g}`"
                if _FINEST <= meant <= _COARSEST
                else None,
            )
        if not self.max_range > 0:
            raise UsageError(f"`max_range` is {self.max_range:g} m, it must be greater than 0")
        if not 0 <= self.clear_to < math.inf:
            raise UsageError(f"`clear_to` is {self.clear_to:g} m, it must be 0 or more, and finite")
        if not self.odom_frame.removeprefix("/"):
            raise UsageError("`odom_frame` is empty", hint="pc2scan tf shows the frames of a recording")
