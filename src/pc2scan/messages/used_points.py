"""Encodes the points that give a scan its ranges as PointCloud2, with the numbers of their beams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.points import Points

from .pointcloud2 import PointField, as_pointcloud2, encode_pointcloud2

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from .laserscan import LaserScan
    from .pointcloud2 import PointCloud2

#: The field with the number of the beam. If the cloud has such a field, ``scan_`` precedes its name.
BEAM = "beam"

#: The field with the number of the source topic, of points of several messages. If they have such a field, as `BEAM`.
SOURCE = "source"

_UINT32 = 6
_AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class UsedPoints:
    """The points of a cloud that give a scan its ranges.

    Attributes
    ----------
    cloud
        All decoded points.
    numbers
        (K,) indices of the used points, in the order of the cloud.
    beams
        (K,) the beam of each used point.
    """

    cloud: Points
    numbers: NDArray[np.int64]
    beams: NDArray[np.int32]

    def encode(self, serialization: str) -> bytes:
        """Serialise them as PointCloud2: with the cloud's header, the unchanged bytes of its points, and the beam.

        Points of types other than PointCloud2 have the fields that `as_pointcloud2` gives them.

        Parameters
        ----------
        serialization
            ``ros1`` or ``cdr``.
        """
        message = as_pointcloud2(self.cloud)
        step = message.point_step
        points = np.empty((self.numbers.size, step + 4), np.uint8)
        points[:, :step] = _bytes_of(message)[np.divmod(self.numbers, max(message.width, 1))]
        beams = self.beams.astype(">u4" if message.is_bigendian else "<u4")
        points[:, step:] = beams.view(np.uint8).reshape(-1, 4)
        return encode_pointcloud2(
            serialization=serialization,
            sequence=message.sequence,
            stamp_ns=message.stamp_ns,
            frame_id=message.frame_id,
            fields=[*message.fields, PointField(_unused_name(field.name for field in message.fields), step, _UINT32)],
            point_step=step + 4,
            data=points.tobytes(),
            is_dense=message.is_dense,
            is_bigendian=message.is_bigendian,
        )


def gather_points(
    scan: LaserScan, parts: Sequence[tuple[int, Points, NDArray[np.int64], NDArray[np.int32]]]
) -> UsedPoints:
    """Return the points that give a scan of several messages its ranges, as one cloud in the scan's frame.

    It has ``x``, ``y`` and ``z`` as they were projected, all other fields that the messages have in common, and the
    number of each point's topic.

    Parameters
    ----------
    scan
        The scan, whose header the cloud gets.
    parts
        For each message the number of its topic, its points in the scan's frame, the indices of the used points, and
        the beam of each.
    """
    shared = _shared_fields(points for _, points, _, _ in parts)
    columns: dict[str, NDArray[Any]] = {}
    for name in shared:
        values = [np.asarray(points.field(name)).reshape(-1)[numbers] for _, points, numbers, _ in parts]
        columns[name] = np.concatenate([each.astype(np.float32) for each in values] if name in _AXES else values)
    sources = [np.full(numbers.size, topic, np.uint32) for topic, _, numbers, _ in parts]
    columns[_unused_name(columns, SOURCE)] = np.concatenate(sources)
    beams = np.concatenate([beams for _, _, _, beams in parts])
    cloud = Points(scan.sequence, scan.stamp_ns, scan.frame_id, columns)
    return UsedPoints(cloud, np.arange(beams.size), beams)


def _shared_fields(clouds: Iterable[Points]) -> list[str]:
    """Return the fields that all clouds have with one datatype: the axes, then the others as in the first cloud."""
    first, *others = clouds
    kinds = {name: first.field(name).dtype.newbyteorder("=") for name in first.fields}
    same = [
        name
        for name, kind in kinds.items()
        if name not in _AXES
        and not name.startswith("<")
        and all(name in each.fields and each.field(name).dtype.newbyteorder("=") == kind for each in others)
    ]
    return [*_AXES, *same]


def _bytes_of(message: PointCloud2) -> NDArray[np.uint8]:
    """Return the bytes of each point, (height, width, point_step)."""
    shape = (message.height, message.width, message.point_step)
    data: Any = message.data
    stride = message.row_stride
    needed = (shape[0] - 1) * stride + shape[1] * message.point_step
    if len(data) < needed:
        # The last point may end after its last field, without the padding.
        data = bytes(data) + bytes(needed - len(data))
    return np.ndarray(shape, np.uint8, data, 0, (stride, message.point_step, 1))


def _unused_name(names: Iterable[str], name: str = BEAM) -> str:
    """Return the name of a new field."""
    taken = set(names)
    while name in taken:
        name = f"scan_{name}"
    return name
