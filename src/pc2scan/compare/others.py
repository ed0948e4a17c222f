"""Compares topics that are neither scans nor clouds: messages are matched by log time and compared by their bytes.

If the wire formats differ (ROS 1 and ROS 2, byte order and padding of CDR), both messages are re-encoded and compared
again, so that only their content matters.
"""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from pc2scan.errors import DecodeError
from pc2scan.messages.transcode import transcoder

from .difference import Change, MessageDifference
from .match import TopicStream
from .topic_difference import MessageTimes

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pc2scan.model import Buffer, RawMessage

    from .rules import Rules
    from .topic_difference import TopicDifference

#: The messages of one log time, by the number of their topic.
_Group = dict[int, list["RawMessage"]]


def compare_others(
    pairs: Sequence[tuple[TopicStream, TopicStream]], entries: Sequence[TopicDifference], rules: Rules
) -> None:
    """Compare several topics in one pass over both recordings.

    Parameters
    ----------
    pairs
        Topics of one A and one B.
    entries
        The result of each pair; changed here.
    rules
        ``ignore`` may have ``seq``; tolerances are not used.
    """
    content = _Content(numbered="seq" not in rules.ignore)
    for log_time_ns, groups in _joined(*(_groups([pair[side] for pair in pairs]) for side in (0, 1))):
        times = MessageTimes(None, log_time_ns)
        for number in sorted({*groups[0], *groups[1]}):
            entry = entries[number]
            ours, theirs = (group.get(number, ()) for group in groups)
            entry.messages_a += len(ours)
            entry.messages_b += len(theirs)
            for a, b in zip(ours, theirs, strict=False):
                entry.count_pair(times, content.compare(a, b))
            for _ in ours[len(theirs) :]:
                entry.missing.add(times)
            for _ in theirs[len(ours) :]:
                entry.extra.add(times)


def _groups(streams: Sequence[TopicStream]) -> Iterator[tuple[int, _Group]]:
    """Yield the messages of several topics of one recording, grouped by log time."""
    numbers = {connection.id: n for n, stream in enumerate(streams) for connection in stream.connections}
    connections = tuple(connection for stream in streams for connection in stream.connections)
    messages = TopicStream(streams[0].source, connections).messages()
    for log_time_ns, together in groupby(messages, lambda message: message.log_time_ns):
        group: _Group = {}
        for message in together:
            group.setdefault(numbers[message.connection.id], []).append(message)
        yield log_time_ns, group


def _joined(
    a: Iterator[tuple[int, _Group]], b: Iterator[tuple[int, _Group]]
) -> Iterator[tuple[int, tuple[_Group, _Group]]]:
    """Yield both sides' groups by log time; an empty one if a side has none."""
    x, y = next(a, None), next(b, None)
    while x is not None or y is not None:
        if y is None or (x is not None and x[0] < y[0]):
            assert x is not None
            yield x[0], (x[1], {})
            x = next(a, None)
        elif x is None or y[0] < x[0]:
            yield y[0], ({}, y[1])
            y = next(b, None)
        else:
            yield x[0], (x[1], y[1])
            x, y = next(a, None), next(b, None)


class _Content:
    """Compares messages of any type, in either ROS version's wire format."""

    def __init__(self, *, numbered: bool) -> None:
        self._numbered = numbered

    def compare(self, a: RawMessage, b: RawMessage) -> MessageDifference:
        """Compare two messages; those that cannot be re-encoded, by their bytes alone."""
        alike = a.connection.serialization == b.connection.serialization
        if alike and bytes(a.data) == bytes(b.data):
            return MessageDifference()
        note = ""
        ros_versions = (a.connection.ros_version, b.connection.ros_version)
        # ROS 1's format has no padding and one byte order, so equal messages have equal bytes.
        if None not in ros_versions and not (self._numbered and ros_versions == (1, 1)):
            try:
                if self._plain(a) == self._plain(b):
                    return MessageDifference()
            except DecodeError as err:
                note = f"; not decoded: {err.message}"
        return MessageDifference(0, (Change("bytes", f"{len(a.data)} bytes", f"{len(b.data)} bytes{note}"),))

    def _plain(self, message: RawMessage) -> Buffer:
        """Return the message in ROS 1's format, its headers without sequence numbers."""
        connection, data = message.connection, message.data
        for ros_version in (1,) if connection.ros_version == 2 else (2, 1):
            coding = transcoder(connection, ros_version)
            connection, data = coding.connection, coding.encode(data)
        return data
