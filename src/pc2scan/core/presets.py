"""The presets: parameters of the projection that suit each consumer of laser scans.

All consumers need beams in the directions that the message says, and a finite ``range_max``: with an infinite one,
infinite ranges count as returns. It is the same for every recording, so that the scans of a dataset agree: gmapping and
slam_toolbox use the first scan's. Returns beyond 100 m, which is more than 2D SLAM uses, are rejected. ``range_min``
rejects the (0, 0, 0) that some drivers write for no return, which would be an obstacle at distance zero.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

_COMMON: dict[str, float | str] = {
    "geometry": "centered",
    "range_min": 0.1,
    "range_max": 100.0,
    "no_return": "inf",
    "scan_time": "auto",
}

#: The parameters by consumer.
PRESETS: Mapping[str, Mapping[str, float | str]] = MappingProxyType(
    {
        # Karto skips ranges beyond range_max, also infinite ones.
        "slam_toolbox": _COMMON,
        # cartographer_ros uses ranges up to range_max. It assumes that beams are measured in their order, which is
        # wrong for a lidar that turns clockwise, so time_increment stays 0.
        "cartographer": _COMMON,
        # gmapping places beams from the middle of the sector, and needs angle_max one increment after the last beam. It
        # also needs a number for no return, because its arithmetic is not made for infinity.
        "gmapping": {**_COMMON, "geometry": "half-open", "no_return": "range-max-plus"},
        # AMCL reads ranges from range_max on as no return.
        "amcl": _COMMON,
        # Nav2's inf_is_valid clears the space in front of infinite ranges, and of no other value.
        "nav2": _COMMON,
        # MRPT reads every sector as symmetric around 0.
        "mrpt": {**_COMMON, "geometry": "symmetric"},
    }
)
