"""Decodes CompressedPointCloud2, which point_cloud_transport's plugins publish.

Source of the layout: CompressedPointCloud2.msg of point_cloud_interfaces: a PointCloud2 whose ``data`` are compressed,
and then the name of the plugin. The first version of the message, of draco_point_cloud_transport in ROS 1, ends before
that. The plugins ``zlib`` (which writes gzip's header) and ``zstd`` compress ``data`` as they are. ``draco`` has an
attribute for each field, in their order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError
from pc2scan.files.compression import CompressionError, decompress_within
from pc2scan.files.limits import allowed_bytes

from .pointcloud2 import DATATYPES, CloudDecoder, CloudFields, bytes_of
from .wire import Cursor

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pc2scan.model import Buffer

    from .pointcloud2 import PointCloud2

#: Formats that are decompressed to the bytes that were compressed.
_LOSSLESS = ("zlib", "zstd")

_UNKNOWN = {
    "cloudini": "decode it with its own tool, cloudini_rosbag_converter: the only package for Python that reads this "
    "format has the licence GPL-3.0",
}


def compressed_cloud_decoder(serialization: str) -> Callable[[Buffer], Points]:
    """Return the decoder of messages in a serialisation: ``ros1`` or ``cdr``.

    Raises
    ------
    DecodeError
        From the decoder: if the message ends too early, or the data cannot be decompressed: their format is unknown,
        they are damaged, or larger than allowed. If a package that is not installed decompresses them.
    """
    decode = CloudDecoder(serialization)

    def points(data: Buffer) -> Points:
        cursor = Cursor(data, serialization)
        cloud = decode(data, cursor)
        name = cursor.string() if cursor.position < len(cursor.data) else "draco"
        try:
            _decompress(cloud, name)
        except CompressionError as err:
            raise DecodeError(f"its data cannot be decompressed with {name}: {err}", stamp_ns=cloud.stamp_ns) from err
        return Points(cloud.sequence, cloud.stamp_ns, cloud.frame_id, CloudFields(cloud, further={"format": name}))

    return points


def _decompress(cloud: PointCloud2, name: str) -> None:
    """Replace the data of a cloud by what they are decompressed to."""
    if name in _LOSSLESS:
        limit = allowed_bytes(len(cloud.data))
        cloud.data = memoryview(decompress_within(name, cloud.data, limit) if cloud.points or cloud.data else b"")
    elif name == "draco":
        _from_draco(cloud)
    else:
        raise DecodeError(
            f"its data are compressed with {name!r}; zlib, zstd and draco are read",
            stamp_ns=cloud.stamp_ns,
            hint=_UNKNOWN.get(name),
        )


def _from_draco(cloud: PointCloud2) -> None:
    """Replace the data by the points that Draco has kept, in its order: it may round, reorder and merge points."""
    try:
        import DracoPy  # noqa: PLC0415  # an optional package
    except ModuleNotFoundError as err:
        raise DecodeError(
            "its data are compressed with Draco, which the package DracoPy decompresses",
            stamp_ns=cloud.stamp_ns,
            hint="pip install 'pc2scan[draco]'",
        ) from err
    # Draco's header declares as many points as it likes, and a point takes at least some bits.
    if cloud.points * max(cloud.point_step, 1) > (limit := allowed_bytes(len(cloud.data))):
        raise CompressionError(f"{cloud.points:,} points are more than {limit:,} bytes, the limit for these data")
    try:
        found = DracoPy.decode(bytes(cloud.data))
    except Exception as err:  # the package raises exceptions of several kinds
        raise CompressionError(str(err)) from err
    attributes = [] if found is None else found.attributes
    if len(attributes) != len(cloud.fields):
        raise CompressionError(f"they have {len(attributes)} attributes, and the cloud has {len(cloud.fields)} fields")
    columns = [_column(each["data"]) for each in sorted(attributes, key=lambda each: int(each["unique_id"]))]
    sizes = {len(column) for column in columns}
    if len(sizes) > 1:
        raise CompressionError("the attributes have different numbers of values")
    count = sizes.pop() if sizes else 0
    data = np.zeros((count, cloud.point_step), np.uint8)
    for field, column in zip(cloud.fields, columns, strict=True):
        size = np.dtype(DATATYPES.get(field.datatype, "V")).itemsize * max(field.count, 1)
        # Colours are packed into a number, and Draco has their bytes.
        values = np.ascontiguousarray(column).view(np.uint8).reshape(count, -1)
        if values.shape[1] != size or field.offset + size > cloud.point_step:
            raise CompressionError(f"the attribute of the field {field.name!r} has {values.shape[1]} bytes, not {size}")
        data[:, field.offset : field.offset + size] = values
    cloud.height, cloud.width, cloud.row_step = 1, count, count * cloud.point_step
    cloud.is_bigendian = False
    cloud.data = bytes_of(data)
    # The table of layouts is shared with other messages, which have other sizes.
    cloud._layouts = {}  # noqa: SLF001  # the only other place that makes a cloud of parts


def _column(values: Any) -> NDArray[Any]:
    column = np.asarray(values)
    return column.astype(column.dtype.newbyteorder("<"), copy=False)
