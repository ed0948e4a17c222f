"""The table of the message types that are clouds, with their decoders to points.

A new type is one entry, because everything that needs to know which topics can be converted uses this table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from pc2scan.core.points import Points
from pc2scan.model import Buffer

from .pointcloud2 import POINTCLOUD2, CloudDecoder

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .pointcloud2 import PointCloud2

#: A decoder: returns the points of a message's bytes, or raises a `DecodeError`. Threads may share one.
Decode: TypeAlias = Callable[[Buffer], Points]


@dataclass(slots=True, eq=False)
class _Fields(Mapping[str, "NDArray[Any]"]):
    """The fields of a PointCloud2, which become arrays on request."""

    cloud: PointCloud2

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name == "x":
            self.cloud.check_size()
        return self.cloud.field(name)

    def __contains__(self, name: object) -> bool:
        return any(field.name == name for field in self.cloud.fields)

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys(field.name for field in self.cloud.fields))

    def __len__(self) -> int:
        return len({field.name for field in self.cloud.fields})


def message_of(points: Points) -> PointCloud2 | None:
    """Return the PointCloud2 that these points are all the points of; None for other types."""
    fields = points.fields
    return fields.cloud if isinstance(fields, _Fields) else None


def _pointcloud2(serialization: str) -> Decode:
    decode = CloudDecoder(serialization)

    def points(data: Buffer) -> Points:
        cloud = decode(data)
        return Points(cloud.sequence, cloud.stamp_ns, cloud.frame_id, _Fields(cloud))

    return points


def _livox(serialization: str) -> Decode:
    from .livox import livox_decoder  # noqa: PLC0415  # few recordings have them

    return livox_decoder(serialization)


#: By ROS type in ROS 2's spelling, the function that makes the decoder of a serialisation (``ros1`` or ``cdr``). A
#: decoder is fastest if it is used for only one topic.
CLOUDS: dict[str, Callable[[str], Decode]] = {
    POINTCLOUD2: _pointcloud2,
    "livox_ros_driver/msg/CustomMsg": _livox,
    "livox_ros_driver2/msg/CustomMsg": _livox,
}
