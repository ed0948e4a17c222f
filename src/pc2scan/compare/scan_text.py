"""Writes and reads scans and clouds as text: a small, bit-exact recording for reviews and version control.

A number is written with the fewest digits that read back as the same bits; a NaN with a payload is written as its bits.
`open_scan_text` reads the text of `render_messages` as a recording.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.errors import DecodeError, RecordingError, UsageError, stamp_text
from pc2scan.files.compression import allowed_bytes
from pc2scan.files.source import open_bytes, open_text
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan, encode_laserscan
from pc2scan.messages.pointcloud2 import DATATYPES, POINTCLOUD2, PointField, decode_pointcloud2, encode_pointcloud2
from pc2scan.model import Connection, RawMessage

from .messages import compare_messages, field_elements
from .rules import GEOMETRY, Rules

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.messages.pointcloud2 import PointCloud2

_FIRST_LINE = "# pc2scan scan text 1"
_HEADER_LINES = (
    "# Every message to the bit. A scan's lines are beams: the first one's number, then the ranges in metres.",
    "# Written by pc2scan golden --update: read it, compare it, but do not edit it.",
)
#: The types that have a text, in ROS 2's spelling: those of messages that conversions make.
TEXT_TYPES = frozenset({LASERSCAN, POINTCLOUD2})
_VALUES_A_LINE = 10
_NAMES = {number: np.dtype(kind).name for number, kind in DATATYPES.items()}
#: The errors of reading values that `render_messages` does not write.
_PARSE_ERRORS = (ValueError, LookupError, ArithmeticError, TypeError, RecursionError, struct.error, DecodeError)
_NUMBERS = {name: number for number, name in _NAMES.items()}


@dataclass(frozen=True, slots=True)
class ScanText:
    """Messages read from text; a `pc2scan.compare.match.OpenRecording`."""

    path: Path
    connections: list[Connection] = field(default_factory=list)
    content: list[RawMessage] = field(default_factory=list)

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[RawMessage]:
        """Messages in the order of log time, ``start_ns <= log_time_ns < stop_ns``."""
        wanted = None if connections is None else {connection.id for connection in connections}
        for message in sorted(self.content, key=lambda message: message.log_time_ns):
            late_enough = start_ns is None or message.log_time_ns >= start_ns
            early_enough = stop_ns is None or message.log_time_ns < stop_ns
            if late_enough and early_enough and (wanted is None or message.connection.id in wanted):
                yield message

    def close(self) -> None:
        """Do nothing: the file is closed."""


def is_scan_text(path: Path) -> bool:
    """Whether a file begins like the text of `render_messages`."""
    try:
        with open_bytes(path) as file:
            return file.read(len(_FIRST_LINE)) == _FIRST_LINE.encode()
    except OSError:
        # Opening it as a recording reports the error.
        return False


# --- writing ---


def render_messages(messages: Iterable[RawMessage]) -> str:
    """Write LaserScans and PointCloud2s as text.

    Parameters
    ----------
    messages
        Of types of `TEXT_TYPES`, in the order of log time.

    Raises
    ------
    UsageError
        If the text cannot hold a message: another type, padding between fields, trailing bytes.
    DecodeError
        If a message cannot be decoded.
    """
    lines = [_FIRST_LINE, *_HEADER_LINES]
    declared: set[tuple[str, str, str]] = set()
    for message in messages:
        connection = message.connection
        if connection.ros_type not in TEXT_TYPES:
            raise UsageError(f"{connection.msgtype} cannot be written as text", topic=connection.topic)
        key = (connection.topic, connection.ros_type, connection.serialization)
        if key not in declared:
            declared.add(key)
            lines += ["", f"topic {json.dumps(key[0])} {key[1]} {key[2]}"]
        own = ["", f"message {json.dumps(connection.topic)}", *_message_lines(message)]
        _check_text(message, own[1:])
        lines += own
    return "\n".join(lines) + "\n"


def _message_lines(message: RawMessage) -> Iterator[str]:
    serialization = message.connection.serialization
    decoded: LaserScan | PointCloud2
    if message.connection.ros_type == LASERSCAN:
        decoded = decode_laserscan(message.data, serialization)
        body = _scan_lines(decoded)
    else:
        decoded = decode_pointcloud2(message.data, serialization)
        body = _cloud_lines(decoded)
    yield f"  log_time {stamp_text(message.log_time_ns)}"
    yield f"  stamp {stamp_text(decoded.stamp_ns)}"
    if serialization == "ros1":
        yield f"  seq {decoded.sequence}"
    yield f"  frame_id {json.dumps(decoded.frame_id)}"
    yield from body


def _scan_lines(scan: LaserScan) -> Iterator[str]:
    geometry = np.array([getattr(scan, name) for name in GEOMETRY], np.float32)
    for name, text in zip(GEOMETRY, _texts(geometry), strict=True):
        yield f"  {name} {text}"
    returns = scan.ranges[np.isfinite(scan.ranges) & (scan.ranges >= scan.range_min) & (scan.ranges <= scan.range_max)]
    comment = f"{len(returns)} returns" + (f", {returns.min():.3f} to {returns.max():.3f} m" if len(returns) else "")
    for name, values in (("ranges", scan.ranges), ("intensities", scan.intensities)):
        yield f"  {name} {len(values)}" + (f"  # {comment}" if name == "ranges" else "")
        texts = _texts(values)
        for start in range(0, len(texts), _VALUES_A_LINE):
            yield f"  {start:6}: {' '.join(texts[start : start + _VALUES_A_LINE])}"


def _cloud_lines(cloud: PointCloud2) -> Iterator[str]:
    yield f"  height {cloud.height}"
    yield f"  is_dense {int(cloud.is_dense)}"
    yield f"  point_step {cloud.point_step}"
    columns = []
    for point_field in cloud.fields:
        if point_field.datatype not in DATATYPES:
            raise UsageError(f"field {point_field.name!r} has datatype {point_field.datatype}: no text can hold it")
        name = json.dumps(point_field.name)
        yield f"  field {point_field.offset} {_NAMES[point_field.datatype]} {point_field.count} {name}"
        elements = field_elements(cloud, point_field)
        # Without points, a field may declare any number of elements.
        columns += [_texts(column) for column in elements.T] if cloud.points else []
    yield f"  points {cloud.points}"
    for number, row in enumerate(zip(*columns, strict=True)):
        yield f"  {number:6}: {' '.join(row)}"


def _texts(values: NDArray[Any]) -> list[str]:
    """Return numbers as texts that read back as the same bits."""
    native = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
    texts: list[str] = native.astype(str).tolist()
    if native.dtype.kind != "f":
        return texts
    bits = np.dtype(f"u{native.dtype.itemsize}")
    digits = 2 * native.dtype.itemsize
    for index in np.flatnonzero(_numbers(texts, native.dtype).view(bits) != native.view(bits)):
        texts[index] = f"bits:{native.view(bits)[index]:0{digits}x}"
    return texts


def _numbers(texts: Sequence[str], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Read the texts of `_texts`."""
    if dtype.kind != "f":
        return np.array([int(text) for text in texts], dtype)
    with np.errstate(over="raise"):
        exact = np.array([0.0 if text.startswith("bits:") else float(text) for text in texts], np.float64)
        numbers = exact.astype(dtype)
    bits = numbers.view(np.dtype(f"u{dtype.itemsize}"))
    for index, text in enumerate(texts):
        if text.startswith("bits:"):
            bits[index] = int(text[5:], 16)
    return numbers


def _check_text(message: RawMessage, lines: Sequence[str]) -> None:
    """Raise if the text does not read back as the same message."""
    connection = message.connection
    try:
        again = _parse_message(iter(lines[1:]), connection, len(message.data))
        difference = compare_messages(message, again, Rules()).changes
        lost = difference[0].name if difference else ""
    except _PARSE_ERRORS:
        # Points without fields have no text.
        lost = "points"
    if lost:
        raise UsageError(
            f"cannot be written as text: its {lost} would be lost",
            topic=connection.topic,
            hint="keep the expected output as a recording",
        )


# --- reading ---


def open_scan_text(path: Path) -> ScanText:
    """Read the text of `render_messages` into memory.

    Raises
    ------
    RecordingError
        If it cannot be read, or `render_messages` does not write such text; the message names the line.
    """
    try:
        with open_text(path) as file:
            text = file.read()
    except (OSError, UnicodeDecodeError) as err:
        raise RecordingError(f"cannot be read: {err}", path=path) from err
    reading = _Lines(text)
    result = ScanText(path)
    left = allowed_bytes(len(text))
    by_topic: dict[str, Connection] = {}
    try:
        for line in reading:
            word, _, rest = line.partition(" ")
            if word == "topic":
                topic, end = json.JSONDecoder().raw_decode(rest)
                topic = _string(topic)
                msgtype, serialization = rest[end:].split()
                if msgtype not in TEXT_TYPES or serialization not in ("ros1", "cdr"):
                    raise ValueError(f"a topic of {msgtype} in {serialization}")
                connection = Connection(len(by_topic), topic, msgtype, serialization)
                by_topic[topic] = connection
                result.connections.append(connection)
            elif word == "message":
                message = _parse_message(reading, by_topic[_string(json.loads(rest))], left)
                left -= len(message.data)
                result.content.append(message)
            else:
                raise ValueError(f"{word!r}")
    except _PARSE_ERRORS as err:
        raise RecordingError(
            f"line {reading.number} has been changed: {str(err) or type(err).__name__}",
            path=path,
            hint="restore it from version control, or write it again: pc2scan golden `update=True`",
        ) from err
    return result


class _Lines:
    """Lines without comments, blank lines and indentation, with the number of the last one."""

    def __init__(self, text: str) -> None:
        self.number = 0
        self._lines = text.splitlines()

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        while self.number < len(self._lines):
            line = self._lines[self.number].strip()
            self.number += 1
            if line and not line.startswith("#"):
                return line
        raise StopIteration


def _parse_message(lines: Iterator[str], connection: Connection, most: int) -> RawMessage:
    """Read a message; its points may take at most ``most`` bytes."""
    log_time_ns, stamp_ns = (_nanoseconds(_value(lines, name)) for name in ("log_time", "stamp"))
    sequence = int(_value(lines, "seq")) if connection.serialization == "ros1" else 0
    frame_id = _string(json.loads(_value(lines, "frame_id")))
    if connection.ros_type == LASERSCAN:
        numbers = _numbers([_value(lines, name) for name in GEOMETRY], np.dtype(np.float32))
        values: dict[str, Any] = dict(zip(GEOMETRY, numbers.tolist(), strict=True))
        values |= {name: _parse_values(lines, name) for name in ("ranges", "intensities")}
        scan = LaserScan(sequence, stamp_ns, frame_id, **values)
        data = encode_laserscan(scan, connection.serialization)
    else:
        height, is_dense, step = (int(_value(lines, name)) for name in ("height", "is_dense", "point_step"))
        fields, points = _parse_fields(lines, step)
        if points * step > most:
            raise ValueError(f"{points} points of {step} bytes are more than the text can hold")
        data = encode_pointcloud2(
            serialization=connection.serialization,
            sequence=sequence,
            stamp_ns=stamp_ns,
            frame_id=frame_id,
            fields=fields,
            point_step=step,
            data=_parse_points(lines, fields, points, step),
            height=height,
            is_dense=bool(is_dense),
        )
    return RawMessage(connection, log_time_ns, data, log_time_ns)


def _value(lines: Iterator[str], name: str) -> str:
    word, _, rest = next(lines, "").strip().partition(" ")
    if word != name:
        raise ValueError(f"{word!r} where {name!r} belongs")
    return rest.split("  # ")[0] if name == "ranges" else rest


def _string(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} where text belongs")
    return value


def _nanoseconds(text: str) -> int:
    seconds, _, fraction = text.partition(".")
    if len(fraction) != 9:
        raise ValueError(f"{text!r} is not a time in nanoseconds")
    sign = -1 if text.startswith("-") else 1
    nanoseconds = sign * (abs(int(seconds)) * 1_000_000_000 + int(fraction))
    if not -(1 << 63) <= nanoseconds < 1 << 63:
        raise ValueError(f"{text!r} is not a time in 64 bits")
    return nanoseconds


def _row(line: str, number: int) -> list[str]:
    label, _, rest = line.strip().partition(":")
    if label != str(number):
        raise ValueError(f"{label!r} where {number} belongs")
    return rest.split()


def _parse_values(lines: Iterator[str], name: str) -> NDArray[np.float32]:
    count = int(_value(lines, name))
    texts: list[str] = []
    while len(texts) < count:
        texts += _row(next(lines, ""), len(texts))
    if len(texts) > count:
        raise ValueError(f"{len(texts)} values where {count} belong")
    return _numbers(texts, np.dtype(np.float32))


def _parse_fields(lines: Iterator[str], step: int) -> tuple[list[PointField], int]:
    fields: list[PointField] = []
    for line in lines:
        word, _, rest = line.strip().partition(" ")
        if word == "points":
            return fields, int(rest)
        if word != "field":
            raise ValueError(f"{word!r} where a field belongs")
        offset, kind, count, name = rest.split(" ", 3)
        made = PointField(_string(json.loads(name)), int(offset), _NUMBERS[kind], int(count))
        if not 0 <= made.offset <= step - max(made.count, 1) * np.dtype(kind).itemsize:
            raise ValueError(f"field {made.name!r} is outside of the {step} bytes of a point")
        fields.append(made)
    raise ValueError("the points are missing")


def _parse_points(lines: Iterator[str], fields: Sequence[PointField], points: int, step: int) -> bytes:
    if points == 0:
        return b""
    rows = [_row(next(lines, ""), number) for number in range(points)]
    data = np.zeros((points, step), np.uint8)
    place = 0
    for point_field in fields:
        count = max(point_field.count, 1)
        dtype = np.dtype("<" + DATATYPES[point_field.datatype])
        for element in range(count):
            column = _numbers([row[place] for row in rows], dtype.newbyteorder("=")).astype(dtype)
            offset = point_field.offset + element * dtype.itemsize
            data[:, offset : offset + dtype.itemsize] = column.view(np.uint8).reshape(points, dtype.itemsize)
            place += 1
    if any(len(row) != place for row in rows):
        raise ValueError(f"a point has {place} values")
    return data.tobytes()
