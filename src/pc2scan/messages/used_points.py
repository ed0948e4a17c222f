"""Encodes the points that give a scan its ranges as PointCloud2, with the numbers of their beams."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .pointcloud2 import PointField, as_pointcloud2, bytes_of, encode_cloud

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from pc2scan.core.points import Points

    from .pointcloud2 import PointCloud2

#: The field with the number of the beam. If the cloud has such a field, ``scan_`` precedes its name.
BEAM = "beam"

_UINT32 = 6


class UsedPoints(NamedTuple):
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
        added = PointField(_unused_name(field.name for field in message.fields), step, _UINT32)
        return encode_cloud(
            replace(
                message,
                height=1,
                width=len(points),
                fields=(*message.fields, added),
                point_step=step + 4,
                row_step=points.size,
                data=bytes_of(points),
            ),
            serialization,
        )


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


def _unused_name(names: Iterable[str]) -> str:
    """Return the name of the new field."""
    taken, name = set(names), BEAM
    while name in taken:
        name = f"scan_{name}"
    return name
