"""Writes and reads scans as text: a small, bit-exact recording for reviews and version control.

A number is written with the fewest digits that read back as the same bits; a NaN with a payload is written as its bits.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import starmap, zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.errors import RecordingError, UsageError, stamp_text
from pc2scan.files.source_file import open_bytes, open_text
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan, encode_laserscan
from pc2scan.model import Connection, RawMessage

from .rules import GEOMETRY

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_FIRST_LINE = "# pc2scan scan text 1"
_HEADER = f"""{_FIRST_LINE}
# Every message to the bit. A scan's lines are beams: the first one's number, then the ranges in metres.
# Written by pc2scan golden --update: read it, compare it, but do not edit it."""
_VALUES_A_LINE = 10

_ARRAYS = ("ranges", "intensities")


@dataclass(frozen=True, slots=True)
class ScanText:
    """Scans read from text; a `pc2scan.compare.diff.OpenRecording`."""

    path: Path
    connections: list[Connection]
    content: list[RawMessage]

    def messages(
        self, connections: Collection[Connection] | None = None, start_ns: int = -(1 << 63), stop_ns: int = 1 << 63
    ) -> Iterator[RawMessage]:
        """Messages in the order of log time, ``start_ns <= log_time_ns < stop_ns``."""
        for message in sorted(self.content, key=lambda message: message.log_time_ns):
            is_wanted = connections is None or message.connection in connections
            if is_wanted and start_ns <= message.log_time_ns < stop_ns:
                yield message

    def close(self) -> None:
        """Do nothing: the file is closed."""


def is_scan_text(path: Path) -> bool:
    """Whether a file begins like the text of `render_scans`."""
    try:
        with open_bytes(path) as file:
            return file.read(len(_FIRST_LINE)) == _FIRST_LINE.encode()
    except OSError:
        # Opening it as a recording reports the error.
        return False


def render_scans(messages: Iterable[RawMessage]) -> str:
    """Write LaserScans, in the order of log time, as text.

    Raises
    ------
    UsageError
        If a message is no LaserScan.
    DecodeError
        If a message cannot be decoded.
    """
    lines = [_HEADER]
    declared: set[str] = set()
    for message in messages:
        connection = message.connection
        topic = json.dumps(connection.topic)
        if connection.ros_type != LASERSCAN:
            raise UsageError(f"{connection.msgtype} cannot be written as text", topic=connection.topic)
        if topic not in declared:
            declared.add(topic)
            lines += ["", f"topic {topic} {LASERSCAN} {connection.serialization}"]
        scan = decode_laserscan(message.data, connection.serialization)
        numbers = _texts(np.array([getattr(scan, name) for name in GEOMETRY], np.float32))
        lines += ["", f"message {topic}", f"  log_time {stamp_text(message.log_time_ns)}"]
        lines.append(f"  stamp {stamp_text(scan.stamp_ns)}")
        if connection.serialization == "ros1":
            lines.append(f"  seq {scan.sequence}")
        lines.append(f"  frame_id {json.dumps(scan.frame_id)}")
        lines += (f"  {name} {text}" for name, text in zip(GEOMETRY, numbers, strict=True))
        ranges = scan.ranges
        valid = ranges[np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)]
        comment = f"  # {len(valid)} returns" + (f", {valid.min():.3f} to {valid.max():.3f} m" if len(valid) else "")
        for name, values, remark in (("ranges", scan.ranges, comment), ("intensities", scan.intensities, "")):
            texts = _texts(values)
            lines.append(f"  {name} {len(texts)}{remark}")
            for start in range(0, len(texts), _VALUES_A_LINE):
                lines.append(f"  {start:6}: {' '.join(texts[start : start + _VALUES_A_LINE])}")
    return "\n".join(lines) + "\n"


def _texts(values: NDArray[np.float32]) -> list[str]:
    """Return numbers as texts that read back as the same bits."""
    native = np.ascontiguousarray(values, np.float32)
    texts: list[str] = native.astype(str).tolist()
    bits = native.view(np.uint32)
    for index in np.flatnonzero(_numbers(texts).view(np.uint32) != bits):
        texts[index] = f"bits:{bits[index]:08x}"
    return texts


def _numbers(texts: Sequence[str]) -> NDArray[np.float32]:
    """Read the texts of `_texts`."""
    bits = [int(text[5:], 16) if text.startswith("bits:") else np.float32(text).view(np.uint32) for text in texts]
    return np.array(bits, np.uint32).view(np.float32)


def open_scan_text(path: Path) -> ScanText:
    """Read the text of `render_scans` into memory.

    Raises
    ------
    RecordingError
        If it cannot be read, or `render_scans` does not write such text; the message names the line.
    """
    number = 1
    connections: dict[str, Connection] = {}
    scans: list[tuple[Connection, dict[str, Any]]] = []
    try:
        with open_text(path) as file:
            lines = file.read().splitlines()
        for number, line in enumerate(lines, start=1):  # noqa: B007  # the error names it
            word, _, rest = line.strip().partition(" ")
            if word == "topic":
                topic = json.JSONDecoder().raw_decode(rest)[0]
                connections[topic] = Connection(len(connections), topic, LASERSCAN, rest.split()[-1])
            elif word == "message":
                scans.append((connections[json.loads(rest)], {}))
            elif word in _ARRAYS:
                array = scans[-1][1][word] = []
            elif word.endswith(":"):
                array.append(_numbers(rest.split()))
            elif word and not word.startswith("#"):
                scans[-1][1][word] = _value(word, rest)
        messages = list(starmap(_message, scans))
        written = render_scans(messages).splitlines()
        for number, (line, expected) in enumerate(zip_longest(lines, written), 1):  # noqa: B007
            if line != expected:
                raise ValueError(f"{line!r} where {expected!r} belongs")
    except Exception as err:  # any that text can cause which `render_scans` does not write
        problem = f"line {number} has been changed: {str(err) or type(err).__name__}"
        hint = "restore it from version control, or write it again: pc2scan golden `update=True`"
        raise RecordingError(problem, path=path, hint=hint) from err
    return ScanText(path, list(connections.values()), messages)


def _message(connection: Connection, values: dict[str, Any]) -> RawMessage:
    """Return the message of a scan, given the values of its lines; numbers that have none are 0."""
    log_time_ns, stamp_ns, sequence = (values.get(name, 0) for name in ("log_time", "stamp", "seq"))
    geometry = [values.get(name, 0.0) for name in GEOMETRY]
    arrays = [np.concatenate([_numbers([]), *values.get(name, ())]) for name in _ARRAYS]
    scan = LaserScan(sequence, stamp_ns, values.get("frame_id", ""), *geometry, *arrays)
    return RawMessage(connection, log_time_ns, encode_laserscan(scan, connection.serialization), log_time_ns)


def _value(name: str, text: str) -> Any:
    """Return the value of a line that begins with a name."""
    if name == "frame_id":
        return json.loads(text)
    if name in GEOMETRY:
        return _numbers([text]).tolist()[0]
    # A time, in nanoseconds, or a sequence number.
    return int(text.replace(".", ""))
