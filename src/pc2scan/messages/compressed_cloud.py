"""Decodes CompressedPointCloud2, which point_cloud_transport's plugins publish.

Source of the layout: CompressedPointCloud2.msg of point_cloud_interfaces: a PointCloud2 whose ``data`` are compressed,
and then the name of the plugin. The first version of the message, of draco_point_cloud_transport in ROS 1, ends before
that. The plugins ``zlib`` (which writes gzip's header) and ``zstd`` compress ``data`` as they are. ``draco`` has an
attribute for each field, in their order.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError
from pc2scan.files.compression import CompressionError, allowed_bytes, decompress_within

from .pointcloud2 import DATATYPES, CloudDecoder, CloudFields, PointCloud2, bytes_of
from .wire import Cursor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.model import Buffer

    from .pointcloud2 import PointField

#: Draco's header and metadata, and what describes the attributes, are shorter.
_MOST_HEAD = 1 << 16

_LOSSY = (
    "its clouds are compressed with Draco, which may round coordinates, reorder points and merge equal ones: scans and "
    "points are those of the compressed clouds"
)

#: Formats that are decompressed to the bytes that were compressed.
_LOSSLESS = ("zlib", "zstd")

_CLOUDINI = (
    "Cloudini's own cloudini_rosbag_converter makes PointCloud2 of them; the only package for Python that reads this "
    "format has the licence GPL-3.0"
)


def decode_compressed_cloud(data: Buffer, serialization: str) -> Points:
    """Decode a message in a serialisation: ``ros1`` or ``cdr``.

    Raises
    ------
    DecodeError
        If the message ends too early, or the data cannot be decompressed: their format is unknown, they are damaged, or
        larger than allowed. If a package that is not installed decompresses them.
    """
    cursor = Cursor(data, serialization)
    cloud = CloudDecoder(serialization)(data, cursor)
    name = cursor.string() if cursor.position < len(cursor.data) else "draco"
    try:
        cloud = _decompressed(cloud, name)
    except CompressionError as err:
        raise DecodeError(f"its data cannot be decompressed with {name}: {err}", stamp_ns=cloud.stamp_ns) from err
    fields = CloudFields(cloud, further={"format": name})
    return Points(cloud.sequence, cloud.stamp_ns, cloud.frame_id, fields, _LOSSY if name == "draco" else "")


def _decompressed(cloud: PointCloud2, name: str) -> PointCloud2:
    """Return a cloud with what its data are decompressed to."""
    if name in _LOSSLESS:
        limit = allowed_bytes(len(cloud.data))
        cloud.data = memoryview(decompress_within(name, cloud.data, limit) if cloud.data else b"")
        return cloud
    if name == "draco":
        return _from_draco(cloud)
    raise DecodeError(
        f"its data are compressed with {name!r}; zlib, zstd and draco are read",
        stamp_ns=cloud.stamp_ns,
        hint=_CLOUDINI if name.startswith("cloudini") else None,
    )


def _from_draco(cloud: PointCloud2) -> PointCloud2:
    """Return the points that Draco has kept, in its order: it may round, reorder and merge points."""
    try:
        import DracoPy  # noqa: PLC0415  # an optional package
    except ModuleNotFoundError as err:
        raise DecodeError(
            "its data are compressed with Draco, which the package DracoPy decompresses",
            stamp_ns=cloud.stamp_ns,
            hint='pip install "pc2scan[draco]"',
        ) from err
    count, components = _read_draco_head(cloud.data)
    if len(components) != len(cloud.fields):
        raise CompressionError(f"they have {len(components)} attributes, and the cloud has {len(cloud.fields)} fields")
    # The library makes room for as many points as the data declare.
    if count * max(sum(components) * 8, cloud.point_step) > (limit := allowed_bytes(len(cloud.data))):
        raise CompressionError(f"they declare {count:,} points, which take more than {limit:,} bytes")
    try:
        attributes = DracoPy.decode(bytes(cloud.data)).attributes
    except Exception as err:  # the package raises exceptions of several kinds
        raise CompressionError(str(err)) from err
    columns = [attribute["data"] for attribute in sorted(attributes, key=lambda attribute: int(attribute["unique_id"]))]
    data = np.zeros((count, cloud.point_step), np.uint8)
    for field, column in zip(cloud.fields, columns, strict=True):
        values = _field_bytes(field, column)
        if values.shape[0] != count or field.offset + values.shape[1] > cloud.point_step:
            raise CompressionError(f"the attribute of the field {field.name!r} does not fit into the cloud")
        data[:, field.offset : field.offset + values.shape[1]] = values
    layout = 1, count, cloud.fields, False, cloud.point_step, count * cloud.point_step
    return PointCloud2(cloud.sequence, cloud.stamp_ns, cloud.frame_id, *layout, bytes_of(data), cloud.is_dense)


def _read_draco_head(data: Buffer) -> tuple[int, list[int]]:
    """Return the number of points that Draco's data declare, and the number of components of each attribute.

    Source of the layout: draco/compression, Decoder and PointCloudDecoder of Draco 1.5: a header, metadata (names and
    values), the number of points, and the attributes.
    """
    head = bytes(data[:_MOST_HEAD])
    place = 11

    def number() -> int:
        """Read a variable-length integer."""
        nonlocal place
        value = shift = 0
        while True:
            byte = head[place]
            place += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80 or shift > 63:
                return value

    try:
        if head[:5] != b"DRACO" or head[7] != 0:
            raise CompressionError("they are no point cloud of Draco")
        if head[10] & 0x80:
            if number():
                raise CompressionError("their attributes have metadata, which no plugin writes")
            for _ in range(number()):
                place += 1 + head[place]
                size = number()
                place += size
            if number():
                raise CompressionError("their metadata are nested, which no plugin writes")
        (count,) = struct.unpack_from("<i", head, place)
        decoders, place = head[place + 4], place + 5
        if decoders != 1 or count < 0:
            raise CompressionError("they are no point cloud of Draco")
        components = []
        for _ in range(number()):
            components.append(head[place + 2])
            place += 4
            number()
    except (IndexError, struct.error) as err:
        raise CompressionError("the data are cut off") from err
    return count, components


def _field_bytes(field: PointField, values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of a field for each point, made of the values of its attribute."""
    if field.datatype not in DATATYPES:
        raise CompressionError(f"field {field.name!r} has datatype {field.datatype}, known are 1 to 8")
    kind, elements = np.dtype("<" + DATATYPES[field.datatype]), max(field.count, 1)
    column = np.asarray(values).reshape(len(values), -1)
    if column.shape[1] == 4 * elements and kind.itemsize >= 4:
        # A colour that is packed into a number: four numbers.
        column = column.astype(np.dtype(f"<u{kind.itemsize // 4}"))
    elif column.shape[1] == elements:
        # The package has other types than Draco.
        column = column.astype(kind)
    else:
        raise CompressionError(f"the attribute of {field.name!r} has {column.shape[1]} elements, and it {elements}")
    return np.ascontiguousarray(column).view(np.uint8).reshape(len(column), -1)
