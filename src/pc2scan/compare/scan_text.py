"""Writes and reads scans as text: a small, bit-exact recording for reviews and version control.

A number is written with the fewest digits that read back as the same bits; a NaN with a payload is written as its bits.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

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


@dataclass(frozen=True, slots=True)
class ScanText:
    """Scans read from text; a `pc2scan.compare.diff.OpenRecording`."""

    path: Path
    connections: list[Connection] = field(default_factory=list)
    content: list[RawMessage] = field(default_factory=list)

    def messages(
        self, connections: Collection[Connection] | None = None, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages in the order of log time, ``start_ns <= log_time_ns < stop_ns``."""
        for message in sorted(self.content, key=lambda message: message.log_time_ns):
            is_wanted = connections is None or message.connection in connections
            is_early = start_ns is not None and message.log_time_ns < start_ns
            if is_wanted and not is_early and (stop_ns is None or message.log_time_ns < stop_ns):
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
    with np.errstate(over="raise"):
        numbers = np.array([0.0 if text.startswith("bits:") else float(text) for text in texts], float).astype("f4")
    for index, text in enumerate(texts):
        if text.startswith("bits:"):
            numbers.view(np.uint32)[index] = int(text[5:], 16)
    return numbers


def open_scan_text(path: Path) -> ScanText:
    """Read the text of `render_scans` into memory.

    Raises
    ------
    RecordingError
        If it cannot be read, or `render_scans` does not write such text; the message names the line.
    """
    try:
        with open_text(path) as file:
            lines = _Lines(file.read())
    except (OSError, UnicodeDecodeError) as err:
        raise RecordingError(f"cannot be read: {err}", path=path) from err
    result = ScanText(path)
    connections: dict[str, Connection] = {}
    try:
        for word, rest in lines:
            topic, end = json.JSONDecoder().raw_decode(rest)
            if word == "message":
                result.content.append(_scan(lines, connections[topic]))
                continue
            msgtype, serialization = rest[end:].split()
            if (word, msgtype) != ("topic", LASERSCAN) or serialization not in ("ros1", "cdr"):
                raise ValueError(f"{word} {rest}")
            connections[topic] = Connection(len(connections), str(topic), msgtype, serialization)
    except Exception as err:  # any that text can cause which `render_scans` does not write
        raise RecordingError(
            f"line {lines.number} has been changed: {str(err) or type(err).__name__}",
            path=path,
            hint="restore it from version control, or write it again: pc2scan golden `update=True`",
        ) from err
    result.connections.extend(connections.values())
    return result


class _Lines:
    """Lines as their first word and the rest, without comments and blank lines; has the number of the last one."""

    def __init__(self, text: str) -> None:
        self.number = 0
        self._lines = enumerate(text.split("\n"), start=1)

    def __iter__(self) -> Iterator[tuple[str, str]]:
        for number, line in self._lines:
            self.number = number
            word, _, rest = line.strip().partition(" ")
            if word and not word.startswith("#"):
                yield word, rest

    def value(self, name: str) -> str:
        """Return what stands behind the word that must be next."""
        word, rest = next(iter(self))
        if word != name:
            raise ValueError(f"{word!r} where {name!r} belongs")
        return rest

    def values(self, name: str) -> NDArray[np.float32]:
        """Return the numbers of an array."""
        count, texts = int(self.value(name).partition(" ")[0]), list[str]()
        while len(texts) < count:
            texts += self.value(f"{len(texts)}:").split() or ("",)
        if len(texts) > count:
            raise ValueError(f"{len(texts)} values where {count} belong")
        return _numbers(texts)


def _scan(lines: _Lines, connection: Connection) -> RawMessage:
    """Read a scan, behind its first line."""
    log_time_ns, stamp_ns = (_nanoseconds(lines.value(name)) for name in ("log_time", "stamp"))
    sequence = int(lines.value("seq")) if connection.serialization == "ros1" else 0
    frame_id = json.loads(lines.value("frame_id"))
    geometry = _numbers([lines.value(name) for name in GEOMETRY]).tolist()
    arrays = [lines.values(name) for name in ("ranges", "intensities")]
    data = encode_laserscan(LaserScan(sequence, stamp_ns, frame_id, *geometry, *arrays), connection.serialization)
    return RawMessage(connection, log_time_ns, data, log_time_ns)


def _nanoseconds(text: str) -> int:
    seconds, _, fraction = text.partition(".")
    nanoseconds = int(seconds + fraction)
    if len(fraction) != 9 or abs(nanoseconds) >> 63:
        raise ValueError(f"{text!r} is not a time in nanoseconds")
    return nanoseconds
