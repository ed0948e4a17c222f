"""Compares two scans or two clouds, each in any wire format, by rules: tolerances, and names to ignore."""

from __future__ import annotations

import dataclasses
import struct
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.tolerance import Tolerance, compare_arrays
from pc2scan.errors import DecodeError, UsageError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from pc2scan.messages.pointcloud2 import DATATYPES, CloudFields, recorded_cloud
from pc2scan.messages.transcode import transcoder
from pc2scan.text import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from pc2scan.core.tolerance import ArrayDifference
    from pc2scan.messages.pointcloud2 import PointCloud2, PointField
    from pc2scan.model import Buffer, RawMessage
    from pc2scan.options.call import Options

#: The types that are compared field by field, in ROS 2's spelling.
DECODED_TYPES = frozenset({LASERSCAN, *CLOUDS})

#: The single numbers of a LaserScan; they are compared bit for bit.
GEOMETRY = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")

#: The names that `Rules.ignore` may have: of all messages, of scans, of clouds, and of clouds of other types.
IGNORABLE = (
    *("log_time", "seq", "frame_id", "order"),
    *(*GEOMETRY, "ranges", "intensities"),
    *("shape", "layout", "padding", "is_dense"),
    *("format", "packets", "timebase", "point_num", "lidar_id", "rsvd"),
)


class Change(NamedTuple):
    """A difference between two messages that is not one of values; both sides as text."""

    name: str
    a: str
    b: str


class ValueChange(NamedTuple):
    """Differing values of ``ranges``, ``intensities`` or a field of a cloud.

    ``beams`` are angle_min and angle_increment of a scan, rad; None for a cloud.
    """

    name: str
    difference: ArrayDifference
    beams: tuple[float, float] | None = None


class MessageDifference(NamedTuple):
    """The differences between two messages.

    Attributes
    ----------
    elements
        Beams or points of the first message.
    changes, values
        The differences after tolerances; empty for equal messages.
    """

    elements: int = 0
    changes: tuple[Change, ...] = ()
    values: tuple[ValueChange, ...] = ()

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return not self.changes and not self.values


def scan_changes(a: LaserScan, b: LaserScan) -> Iterator[Change]:
    """Yield differences in geometry, bit for bit."""
    for name in GEOMETRY:
        left, right = getattr(a, name), getattr(b, name)
        # By bits: NaN equals NaN, and -0.0 differs from 0.0.
        if struct.pack("<d", left) != struct.pack("<d", right):
            yield Change(name, str(np.float32(left)), str(np.float32(right)))
    if len(a.ranges) != len(b.ranges):
        yield Change("beams", f"{len(a.ranges)}", f"{len(b.ranges)}")
    if len(a.intensities) != len(b.intensities):
        yield Change("intensities", f"{len(a.intensities)} values", f"{len(b.intensities)} values")


def scan_values(a: LaserScan, b: LaserScan, rules: Rules) -> Iterator[ValueChange]:
    """Yield differing ranges and intensities, if both scans have as many."""
    for name in ("ranges", "intensities"):
        left, right = getattr(a, name), getattr(b, name)
        if name in rules.ignore or len(left) != len(right):
            continue
        # Values outside the scan's own limits mean no return.
        limits = (a.range_min, a.range_max) if name == "ranges" else None
        difference = compare_arrays(left, right, rules.tolerance(name), limits=limits)
        if difference.differing:
            yield ValueChange(name, difference, (a.angle_min, a.angle_increment))


def cloud_changes(a: PointCloud2, b: PointCloud2) -> Iterator[Change]:
    """Yield differences other than values: fields, shape, layout, and bytes that belong to no field."""
    sides = [
        {
            "is_dense": str(cloud.is_dense).lower(),
            "shape": f"{cloud.height} x {cloud.width}",
            "fields": ", ".join(sorted(map(_field_text, cloud.fields))),
            "layout": _layout_text(cloud),
        }
        for cloud in (a, b)
    ]
    changes = [Change(name, text, sides[1][name]) for name, text in sides[0].items() if text != sides[1][name]]
    yield from changes
    if not {"fields", "layout"} & {change.name for change in changes} and (differing := _differing_padding(a, b)):
        yield Change("padding", "", f"{differing:,} bytes differ")


def cloud_values(a: PointCloud2, b: PointCloud2, rules: Rules) -> Iterator[ValueChange]:
    """Yield the common fields of two clouds that differ in their values; none if the numbers of points differ."""
    if a.points != b.points or (_layout_text(a) == _layout_text(b) and np.array_equal(_byte_array(a), _byte_array(b))):
        return
    others = {field.name: field for field in _readable_fields(b)}
    for field in _readable_fields(a):
        other = others.get(field.name)
        if other is not None and _field_text(field) == _field_text(other):
            shape = a.points, max(field.count, 1)
            values = a.elements(field).reshape(shape), b.elements(other).reshape(shape)
            difference = compare_arrays(*values, rules.tolerance(field.name))
            if difference.differing:
                yield ValueChange(field.name, difference)


def _field_text(field: PointField) -> str:
    # Drivers write 0 for a single element, too.
    return f"{field.name} {field.datatype_name}" + (f"[{field.count}]" if field.count > 1 else "")


def _layout_text(cloud: PointCloud2) -> str:
    places = ", ".join(f"{f.name} @{f.offset}" + ("" if f.count == 1 else f" x {f.count}") for f in cloud.fields)
    order = "big" if cloud.is_bigendian else "little"
    steps = f"point_step {cloud.point_step}, row_step {cloud.row_step}, {len(cloud.data)} bytes"
    return f"{places}; {steps}, {order}-endian"


def _readable_fields(cloud: PointCloud2) -> list[PointField]:
    """Return the fields with a known datatype; the first of those with one name, or with the same bytes."""
    first: dict[str, PointField] = {}
    for field in cloud.fields:
        first.setdefault(field.name, field)
    places = {(field.offset, field.datatype, field.count): field for field in reversed(first.values())}
    return [field for field in first.values() if field.datatype in DATATYPES and field in places.values()]


def _byte_array(cloud: PointCloud2) -> NDArray[np.uint8]:
    return np.frombuffer(cloud.data, np.uint8)


def _differing_padding(a: PointCloud2, b: PointCloud2) -> int:
    """Count the differing bytes outside of all readable fields, of clouds with one layout."""
    differs = _byte_array(a) != _byte_array(b)
    if not differs.any():
        return 0
    # Clears the bytes of each field, with the field's view on the mask instead of the data.
    for field in _readable_fields(a) if a.points else ():
        width = a.elements(field).shape[-1] * np.dtype(DATATYPES[field.datatype]).itemsize
        first = a.field(field.name)
        np.ndarray((*first.shape, width), bool, differs, field.offset, (*first.strides, 1))[...] = False
    return int(np.count_nonzero(differs))


def compare_messages(a: RawMessage, b: RawMessage, rules: Rules) -> MessageDifference:
    """Compare two messages of one type of `DECODED_TYPES`.

    Parameters
    ----------
    a, b
        ``a`` is the reference of relative tolerances. The stamps are equal, because messages are matched by them.
    rules
        Tolerances and exceptions.

    Notes
    -----
    Messages that cannot be decoded are the same if their bytes are the same.
    """
    times = [Change("log_time", str(a.log_time_ns), str(b.log_time_ns))] if a.log_time_ns != b.log_time_ns else []
    try:
        elements, own_changes, values = _compare_fields(a, b, rules)
    except DecodeError as err:
        alike = a.connection.serialization == b.connection.serialization and a.data == b.data
        unreadable = Change("bytes", f"{len(a.data)} bytes", f"{len(b.data)} bytes; not decoded: {err.message}")
        elements, own_changes, values = MessageDifference(changes=() if alike else (unreadable,))
    changes = tuple(change for change in (*times, *own_changes) if change.name not in rules.ignore)
    return MessageDifference(elements, changes, values)


def compare_bytes(a: RawMessage, b: RawMessage, rules: Rules) -> MessageDifference:
    """Compare two messages of any type, in either ROS version's format.

    Notes
    -----
    Messages that cannot be re-encoded are the same if their bytes are the same.
    """
    if a.connection.serialization == b.connection.serialization and bytes(a.data) == bytes(b.data):
        return MessageDifference()
    note = ""
    versions = (a.connection.ros_version, b.connection.ros_version)
    # ROS 1's format has no padding and one byte order, so equal messages have equal bytes.
    if None not in versions and ("seq" in rules.ignore or versions != (1, 1)):
        try:
            if _ros1_bytes(a) == _ros1_bytes(b):
                return MessageDifference()
        except DecodeError as err:
            note = f"; not decoded: {err.message}"
    return MessageDifference(0, (Change("bytes", f"{len(a.data)} bytes", f"{len(b.data)} bytes{note}"),))


def _ros1_bytes(message: RawMessage) -> Buffer:
    """Return a message in ROS 1's format, its headers without sequence numbers."""
    connection, data = message.connection, message.data
    for ros_version in (1,) if connection.ros_version == 2 else (2, 1):
        coding = transcoder(connection, ros_version)
        connection, data = coding.connection, coding.encode(data)
    return data


def _compare_fields(a: RawMessage, b: RawMessage, rules: Rules) -> MessageDifference:
    numbered = a.connection.ros_version == b.connection.ros_version == 1
    if a.connection.ros_type == LASERSCAN:
        scan, other = (decode_laserscan(m.data, m.connection.serialization) for m in (a, b))
        changes = (*_header_changes(scan, other, numbered=numbered), *scan_changes(scan, other))
        values = tuple(scan_values(scan, other, rules))
        return MessageDifference(len(scan.ranges), changes, values)
    points = [CLOUDS[m.connection.ros_type](m.connection.serialization)(m.data) for m in (a, b)]
    cloud, second = map(recorded_cloud, points)
    further = _further_changes(*(p.fields.further if isinstance(p.fields, CloudFields) else {} for p in points))
    changes = (*_header_changes(cloud, second, numbered=numbered), *further, *cloud_changes(cloud, second))
    return MessageDifference(cloud.points, changes, tuple(cloud_values(cloud, second, rules)))


def _further_changes(a: Mapping[str, object], b: Mapping[str, object]) -> Iterator[Change]:
    """Yield differences of what messages of one type have besides their points."""
    for name, value in a.items():
        if value != b[name]:
            yield Change(name, str(value), str(b[name]))


def _header_changes(a: LaserScan | PointCloud2, b: LaserScan | PointCloud2, *, numbered: bool) -> Iterator[Change]:
    # Only ROS 1 has sequence numbers.
    if numbered and a.sequence != b.sequence:
        yield Change("seq", str(a.sequence), str(b.sequence))
    if a.frame_id != b.frame_id:
        yield Change("frame_id", repr(a.frame_id), repr(b.frame_id))


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """The rules of a comparison. By default all bits must be equal.

    Attributes
    ----------
    atol, rtol
        Tolerances by name: ``ranges``, ``intensities``, or a field of a cloud; the empty name is for all others.
        See `pc2scan.core.tolerance.Tolerance`; A is the reference.
    allow_beams
        The share of a topic's beams (of a cloud: points), over all its messages, that may be beyond the tolerance.
    ignore
        Names of `IGNORABLE` that are not compared.

    Raises
    ------
    UsageError
        If a tolerance is negative, the share not within 0 and 1, or a name unknown.
    """

    atol: Mapping[str, float] = dataclasses.field(default_factory=dict)
    rtol: Mapping[str, float] = dataclasses.field(default_factory=dict)
    allow_beams: float = 0.0
    ignore: frozenset[str] = frozenset()

    @classmethod
    def of(cls, options: Options) -> Rules:
        """Return the rules among the options of a call."""
        return cls(
            atol=options.atol or {},
            rtol=options.rtol or {},
            allow_beams=options.allow_beams,
            ignore=frozenset(options.ignore),
        )

    def __post_init__(self) -> None:
        for name in {*self.atol, *self.rtol}:
            self.tolerance(name)
        if unknown := sorted(self.ignore - {*IGNORABLE}):
            near = did_you_mean(unknown[0], IGNORABLE)
            hint = f"{near} these can be ignored: {', '.join(IGNORABLE)}".strip()
            raise UsageError(f"{unknown[0]!r} cannot be ignored", hint=hint)

    def tolerance(self, name: str) -> Tolerance:
        """Return the tolerance of ``ranges``, ``intensities`` or a field."""
        return Tolerance(self.atol.get(name, self.atol.get("", 0.0)), self.rtol.get(name, self.rtol.get("", 0.0)))
