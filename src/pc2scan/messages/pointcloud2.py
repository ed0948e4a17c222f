"""Decodes and encodes sensor_msgs/PointCloud2."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError

from .wire import MAX_CACHED_BYTES, Cursor, Packer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from pc2scan.model import Buffer

#: The type in ROS 2's spelling.
POINTCLOUD2 = "sensor_msgs/msg/PointCloud2"

#: sensor_msgs/PointField's datatype constants, as NumPy spells them without byte order.
DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}

#: A cloud with more fields than this is damaged: real sensors have about twenty at most.
MAX_FIELDS = 4096

#: Limit of points smaller than three float32, because the arrays computed from them take far more memory than the
#: points. Real messages have some 100,000 points.
MAX_SMALL_POINTS = 2_000_000
_SMALL = 12

#: NumPy's names to the constants.
_DATATYPE_CODES = {name: code for code, name in DATATYPES.items()}

#: Some drivers have several names for the same bytes. More than so many times the bytes of a point are an attack.
_MOST_OVERLAP = 8

#: By byte order and datatype.
_DTYPES = {order: {code: np.dtype(order + name) for code, name in DATATYPES.items()} for order in "<>"}


@dataclass(frozen=True, slots=True)
class PointField:
    """sensor_msgs/PointField: a value of each point, its place and its datatype.

    Attributes
    ----------
    offset
        Bytes from the beginning of a point; may be unaligned.
    datatype
        A key of `DATATYPES`.
    count
        Elements; drivers also write 0 for a single one.
    """

    name: str
    offset: int
    datatype: int
    count: int = 1

    @property
    def datatype_name(self) -> str:
        """NumPy's name of the datatype, such as ``float32``."""
        return np.dtype(DATATYPES[self.datatype]).name if self.datatype in DATATYPES else f"datatype {self.datatype}"


class _FieldLayout(NamedTuple):
    """Where a field's values are in a cloud's data, which must have ``needed`` bytes."""

    dtype: np.dtype[Any]
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    needed: int


# Not frozen, although it is never changed, because a frozen dataclass takes three times as long to make.
@dataclass(slots=True)
class PointCloud2:
    """A decoded cloud; its points are a view of the message's bytes.

    Attributes
    ----------
    sequence
        ROS 1's ``header.seq``; 0 from ROS 2.
    stamp_ns
        ``header.stamp``, nanoseconds.
    data
        The points, read-only: row r, column c begins at ``r * row_stride + c * point_step``.
    """

    sequence: int
    stamp_ns: int
    frame_id: str
    height: int
    width: int
    fields: tuple[PointField, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: memoryview
    is_dense: bool
    #: The layouts by name of a field. Clouds with the same description share this table.
    _layouts: dict[str, _FieldLayout] = field(default_factory=dict, repr=False, compare=False)

    @property
    def points(self) -> int:
        """Number of declared points, non-returns included."""
        return self.height * self.width

    @property
    def row_stride(self) -> int:
        """Bytes from one row to the next: ``row_step``, unless there is one row, or the rows of ``data`` are packed.

        Drivers write any ``row_step`` beside packed data: 0, ``point_step``, the size of all rows.
        """
        row = self.width * self.point_step
        is_packed = self.height < 2 or not self.row_step or len(self.data) == self.height * row
        return row if is_packed else self.row_step

    def field(self, name: str) -> NDArray[Any]:
        """Return one field of every point, as a view.

        Parameters
        ----------
        name
            A field's name; if several fields have it, the first is returned, as upstream does.

        Returns
        -------
        numpy.ndarray
            Read-only view in the recorded datatype and byte order: shape ``(points,)`` if the rows follow each
            other without a gap, else ``(height, width)``. Only the first element of a field with a
            ``count`` above 1.

        Raises
        ------
        DecodeError
            If the field is missing or of an unknown datatype, if it does not fit into a point, if ``data`` is shorter
            than declared, or if there are more than `MAX_SMALL_POINTS` tiny points.
        """
        layout = self._layouts.get(name)
        if layout is None:
            layout = self._layouts[name] = self._layout_of(name)
        if len(self.data) < layout.needed:
            raise self._error(
                f"data has {len(self.data)} bytes, but {self.height} x {self.width} points of "
                f"{self.point_step} bytes (row_step {self.row_step}) take {layout.needed}"
            )
        if not layout.needed:
            return np.empty(0, layout.dtype)
        return np.ndarray(layout.shape, layout.dtype, self.data, layout.offset, layout.strides)

    def structured_points(self) -> NDArray[Any]:
        """Return all fields of every point, with all their elements, packed and little-endian.

        Returns
        -------
        numpy.ndarray
            Structured, shape ``(points,)``; a copy.

        Raises
        ------
        DecodeError
            If two fields have one name, or one has none; as `field` does; if a field's elements do not fit into a
            point, or many fields are made of the same bytes.
        """
        names = Counter(field.name for field in self.fields)
        if "" in names:
            raise self._error("a field has no name")
        if twice := [name for name, count in names.items() if count > 1]:
            raise self._error(f"two fields are named {twice[0]!r}")
        sizes = [np.dtype(DATATYPES.get(field.datatype, "f8")).itemsize * max(field.count, 1) for field in self.fields]
        if sum(sizes) > _MOST_OVERLAP * max(self.point_step, 1):
            raise self._error(f"its fields have {sum(sizes)} bytes, and a point has {self.point_step}")
        views = {field.name: self.elements(field) for field in self.fields}
        dtype = np.dtype(
            [
                (name, view.dtype.newbyteorder("<"), view.shape[-1:] if view.shape[-1] != 1 else ())
                for name, view in views.items()
            ]
        )
        packed = np.empty(self.points, dtype)
        for name, view in views.items():
            packed[name] = view.reshape(self.points, *dtype[name].shape)
        return packed

    def elements(self, field: PointField) -> NDArray[Any]:
        """Return all elements of a field, along the last axis."""
        first = self.field(field.name)
        # Drivers write 0 for a single element.
        count = max(field.count, 1)
        size = first.dtype.itemsize
        if self.points and field.offset + count * size > self.point_step:
            raise self._outside(field, count * size)
        if not first.size:
            return np.empty((0, count), first.dtype)
        return np.ndarray((*first.shape, count), first.dtype, self.data, field.offset, (*first.strides, size))

    def _layout_of(self, name: str) -> _FieldLayout:
        if self.point_step < _SMALL and self.points > MAX_SMALL_POINTS:
            raise self._error(
                f"the cloud declares {self.points:,} points of {self.point_step} bytes, "
                f"at most {MAX_SMALL_POINTS:,} of fewer than {_SMALL} bytes are allowed"
            )
        requested = next((field for field in self.fields if field.name == name), None)
        if requested is None:
            names = ", ".join(field.name for field in self.fields) or "none"
            raise self._error(f"no field {name!r}; the cloud's fields are: {names}")
        if requested.datatype not in DATATYPES:
            raise self._error(f"field {name!r} has datatype {requested.datatype}, known are 1 to 8")
        dtype = _DTYPES[">" if self.is_bigendian else "<"][requested.datatype]
        if not self.points:
            return _FieldLayout(dtype, requested.offset, (0,), (0,), 0)
        if requested.offset + dtype.itemsize > self.point_step:
            raise self._outside(requested, dtype.itemsize)
        row, row_step = self.width * self.point_step, self.row_stride
        if row_step < row:
            raise self._error(
                f"row_step is {self.row_step}, but {self.width} points of {self.point_step} bytes take {row}"
            )
        needed = (self.height - 1) * row_step + row
        if row_step == row:
            return _FieldLayout(dtype, requested.offset, (self.points,), (self.point_step,), needed)
        return _FieldLayout(dtype, requested.offset, (self.height, self.width), (row_step, self.point_step), needed)

    def xyz(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return the coordinates: `field` of ``x``, ``y`` and ``z``, metres in ``frame_id``."""
        return self.field("x"), self.field("y"), self.field("z")

    def _outside(self, field: PointField, size: int) -> DecodeError:
        place = f"bytes {field.offset} to {field.offset + size} of a point"
        return self._error(f"field {field.name!r} takes {place}, but point_step is {self.point_step}")

    def _error(self, message: str) -> DecodeError:
        return DecodeError(message, stamp_ns=self.stamp_ns)


class _Description(NamedTuple):
    """The fields of a message between its stamp and its points."""

    frame_id: str
    height: int
    width: int
    fields: tuple[PointField, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    size: int
    layouts: dict[str, _FieldLayout]


@dataclass(slots=True, eq=False)
class CloudDecoder:
    """Decodes clouds of one serialisation, fastest if they are of one topic. Threads may share one.

    The bytes between the stamp and the points are usually the same in all clouds of a topic. Decoding them takes as
    long as projecting some thousand points, so the last result is kept and used again for equal bytes.
    """

    serialization: str
    #: The byte order, the bytes of a description, and the description.
    _last: tuple[str, bytes, _Description] | None = None

    def __call__(self, data: Buffer, cursor: Cursor | None = None) -> PointCloud2:
        """Decode a message; see `decode_pointcloud2`.

        With a cursor at the beginning of a message that has further fields, it is at these afterwards.
        """
        cursor = cursor or Cursor(data, self.serialization)
        sequence, stamp_ns = cursor.stamp()
        try:
            description = self._description(cursor)
            points = cursor.take(description.size)
            (is_dense,) = cursor.read("?")
        except DecodeError as err:
            err.stamp_ns = stamp_ns
            raise
        return PointCloud2(sequence, stamp_ns, *description[:7], points, is_dense, description.layouts)

    def _description(self, cursor: Cursor) -> _Description:
        order = cursor.byte_order
        start = cursor.position
        if self._last is not None:
            known_order, raw, description = self._last
            end = start + len(raw)
            if known_order == order and bytes(cursor.data[start:end]) == raw:
                cursor.position = end
                return description
        description = _read_description(cursor)
        if cursor.position - start <= MAX_CACHED_BYTES:
            self._last = order, bytes(cursor.data[start : cursor.position]), description
        return description


def _read_description(cursor: Cursor) -> _Description:
    frame_id = cursor.string()
    height, width, count = cursor.read("III")
    if count > MAX_FIELDS:
        raise DecodeError(f"the cloud declares {count} fields, at most {MAX_FIELDS} are allowed")
    fields = []
    for _ in range(count):
        name = cursor.string()
        fields.append(PointField(name, *cursor.read("IBI" if cursor.ros1 else "IB3xI")))
    (is_bigendian,) = cursor.read("?")
    point_step, row_step, size = cursor.read("III")
    return _Description(frame_id, height, width, tuple(fields), is_bigendian, point_step, row_step, size, {})


def decode_pointcloud2(data: Buffer, serialization: str) -> PointCloud2:
    """Decode a serialised sensor_msgs/PointCloud2; the points are not copied.

    Parameters
    ----------
    data
        The whole message.
    serialization
        ``ros1`` or ``cdr``.

    Raises
    ------
    DecodeError
        If the message ends too early or declares more than `MAX_FIELDS`.
    """
    return CloudDecoder(serialization)(data)


@dataclass(slots=True, eq=False)
class CloudFields(Mapping[str, "NDArray[Any]"]):
    """The fields of a message that is laid out like a PointCloud2, which become arrays on request.

    Attributes
    ----------
    cloud
        The message's points, as they were recorded.
    replaced
        What is used instead of some fields, by name.
    further
        What the message has besides a PointCloud2, by name.
    """

    cloud: PointCloud2
    replaced: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    further: Mapping[str, object] = field(default_factory=dict)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.replaced[name] if name in self.replaced else self.cloud.field(name)

    def __contains__(self, name: object) -> bool:
        return any(field.name == name for field in self.cloud.fields)

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys(field.name for field in self.cloud.fields))

    def __len__(self) -> int:
        return len({field.name for field in self.cloud.fields})

    def recorded(self) -> PointCloud2:
        """Return the points as they were recorded, laid out alike in every wire format."""
        return self.cloud

    def as_pointcloud2(self) -> PointCloud2:
        """Return the PointCloud2 that is written of the message."""
        return self.cloud


def recorded_cloud(points: Points) -> PointCloud2:
    """Return the points of a message as they were recorded; a copy if the message is not laid out like a PointCloud2.

    Raises
    ------
    DecodeError
        If their fields cannot be decoded.
    """
    fields = points.fields
    return fields.recorded() if isinstance(fields, CloudFields) else pack_cloud(points)


def as_pointcloud2(points: Points) -> PointCloud2:
    """Return the PointCloud2 that is written of all points of a message.

    Raises
    ------
    DecodeError
        If their fields cannot be decoded.
    """
    fields = points.fields
    return fields.as_pointcloud2() if isinstance(fields, CloudFields) else pack_cloud(points)


def pack_cloud(points: Points) -> PointCloud2:
    """Return a cloud of one row with a copy of all fields, little-endian and without padding."""
    columns = {name: np.asarray(values).reshape(-1) for name, values in points.fields.items()}
    count = next((values.size for values in columns.values()), 0)
    packed = np.empty(count, [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    for name, values in columns.items():
        packed[name] = values
    return structured_cloud(points.sequence, points.stamp_ns, points.frame_id, packed)


def bytes_of(array: NDArray[Any]) -> memoryview:
    """Return the bytes of a contiguous array."""
    data: Any = array.view(np.uint8).reshape(-1)
    return memoryview(data).toreadonly() if array.size else memoryview(b"")


def point_decoder(serialization: str) -> Callable[[Buffer], Points]:
    """Return the decoder of messages to points; it is fastest for one topic. Threads may share it."""
    decode = CloudDecoder(serialization)

    def points(data: Buffer) -> Points:
        cloud = decode(data)
        return Points(cloud.sequence, cloud.stamp_ns, cloud.frame_id, CloudFields(cloud))

    return points


def encode_cloud(cloud: PointCloud2, serialization: str) -> bytes:
    """Serialise a cloud as ``ros1`` or ``cdr``."""
    packer = Packer(serialization)
    packer.header(cloud.sequence, cloud.stamp_ns, cloud.frame_id)
    packer.write("III", cloud.height, cloud.width, len(cloud.fields))
    for part in cloud.fields:
        packer.string(part.name)
        packer.write("IBI" if packer.ros1 else "IB3xI", part.offset, part.datatype, part.count)
    packer.write("B", cloud.is_bigendian)
    packer.write("III", cloud.point_step, cloud.row_step, len(cloud.data))
    packer.raw(cloud.data)
    packer.write("B", cloud.is_dense)
    return packer.finish()


def structured_cloud(
    sequence: int, stamp_ns: int, frame_id: str, points: NDArray[np.void], *, is_dense: bool = False
) -> PointCloud2:
    """Return structured points, little-endian, as a PointCloud2 of one row, without a copy."""
    step, count = points.dtype.itemsize, len(points)
    fields = tuple(
        PointField(name, offset, _DATATYPE_CODES[kind.str[1:]])
        for name, (kind, offset, *_) in (points.dtype.fields or {}).items()
    )
    layout = 1, count, fields, False, step, count * step
    return PointCloud2(sequence, stamp_ns, frame_id, *layout, bytes_of(points), is_dense)
