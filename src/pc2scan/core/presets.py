"""What suits each consumer of laser scans, as parameters of the projection.

All of them want beams that are where the message says, and a finite ``range_max``: with an infinite one, infinite
ranges pass for returns. It is one figure for every recording, so that the scans of a dataset agree in it: gmapping and
slam_toolbox take it from the first scan. Returns beyond 100 m, more than 2D SLAM uses, are left out. ``range_min``
leaves out the (0, 0, 0) that some drivers write for no return: it would be an obstacle at distance zero.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["PRESETS"]

_COMMON: dict[str, float | str] = {
    "geometry": "centered",
    "range_min": 0.1,
    "range_max": 100.0,
    "no_return": "inf",
    "scan_time": "auto",
}

#: Consumers, and the parameters that suit them.
PRESETS: Mapping[str, Mapping[str, float | str]] = MappingProxyType(
    {
        # Karto skips ranges beyond range_max, infinite ones too.
        "slam_toolbox": _COMMON,
        # cartographer_ros keeps ranges up to range_max. It takes beams to be measured in their order, which those of a
        # lidar that turns clockwise are not: time_increment stays 0.
        "cartographer": _COMMON,
        # It places beams from the middle of the sector, and needs angle_max one increment behind the last beam. And a
        # number for no return, as the sensors of its time gave one: none of its arithmetic meets infinity.
        "gmapping": {**_COMMON, "geometry": "half-open", "no_return": "range-max-plus"},
        # Ranges from range_max on count as no return.
        "amcl": _COMMON,
        # Its inf_is_valid clears what is in front of an infinite range, and no other value.
        "nav2": _COMMON,
        # It takes every sector for symmetric around 0.
        "mrpt": {**_COMMON, "geometry": "symmetric"},
    }
)
