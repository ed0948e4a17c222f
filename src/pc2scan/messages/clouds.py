"""The table of the message types that are clouds, with their decoders to points.

A new type is one entry, because everything that needs to know which topics can be converted uses this table.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from pc2scan.core.points import Points
from pc2scan.model import Buffer

from .pointcloud2 import POINTCLOUD2, point_decoder

#: A decoder: returns the points of a message's bytes, or raises a `DecodeError`. Threads may share one.
Decode: TypeAlias = Callable[[Buffer], Points]


def _livox(serialization: str) -> Decode:
    from .livox import livox_decoder  # noqa: PLC0415  # few recordings have them

    return livox_decoder(serialization)


#: By ROS type in ROS 2's spelling, the function that makes the decoder of a serialisation (``ros1`` or ``cdr``). A
#: decoder is fastest if it is used for only one topic.
CLOUDS: dict[str, Callable[[str], Decode]] = {
    POINTCLOUD2: point_decoder,
    "livox_ros_driver/msg/CustomMsg": _livox,
    "livox_ros_driver2/msg/CustomMsg": _livox,
}
