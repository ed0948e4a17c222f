"""Compares two recordings, topic by topic.

Scans and clouds are compared field by field, all other messages by their bytes: they are matched by log time. If the
wire formats differ (ROS 1 and ROS 2, byte order and padding of CDR), both messages are re-encoded and compared again,
so that only their content matters.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

from pc2scan.bags.opening import open_recording
from pc2scan.errors import DecodeError, TopicError, UsageError, name_list
from pc2scan.files.transfers import fetched
from pc2scan.messages.schema import canonical_type
from pc2scan.messages.transcode import transcoder
from pc2scan.progress import Meter
from pc2scan.text import did_you_mean

from .match import OpenRecording, TopicStream, header_stamp_ns, match_messages, read_into_memory
from .messages import DECODED_TYPES, Change, MessageDifference, compare_messages
from .result import Difference
from .rules import Rules
from .scan_text import is_scan_text, open_scan_text
from .topic_difference import MessageTimes, TopicDifference

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.model import Buffer, Connection, RawMessage
    from pc2scan.progress import Progress


#: If there are more topics of scans or clouds, they are read together, because one after the other takes too long.
_MANY_TOPICS = 16


@dataclass(frozen=True, slots=True)
class TopicPair:
    """A topic of A, and the topic of B to compare it with."""

    a: str
    b: str

    @classmethod
    def parse(cls, text: str) -> TopicPair:
        """Read ``/scan``, or ``/scan:=/scan2`` if the topic has another name in B.

        Raises
        ------
        UsageError
            If a side of ``:=`` is empty.
        """
        a, renamed, b = text.partition(":=")
        if not a or (renamed and not b):
            raise UsageError(f"{text!r} is not a topic", hint="write /scan, or /scan:=/scan2 if B has another name")
        return cls(a, b or a)


def diff(
    a: Path,
    b: Path | None,
    *,
    topics: Sequence[TopicPair] = (),
    all_topics: bool = False,
    rules: Rules | None = None,
    progress: Progress | None = None,
) -> Difference:
    """Compare two recordings; see `pc2scan.diff`.

    Parameters
    ----------
    progress
        Called regularly with the pairs of messages that are compared, the pairs in all, and those again.
    """
    if b is None and not (topics and all(pair.a != pair.b for pair in topics)):
        raise UsageError(
            "to compare a recording with itself, two topics are needed",
            path=a,
            hint="give a second recording, or two topics: `topics=/scan:=/scan2`",
        )
    with ExitStack() as stack:
        sources = []
        for path in stack.enter_context(fetched((a, a if b is None else b))):
            source = open_source(path)
            stack.callback(source.close)
            sources.append(source)
        meter = None if progress is None else Meter(progress)
        return diff_sources(sources[0], sources[1], topics=topics, all_topics=all_topics, rules=rules, meter=meter)


def open_source(path: Path) -> OpenRecording:
    """Open a recording, or a text file of scans.

    Raises
    ------
    RecordingError
        If it cannot be read, also while messages are read: damaged recordings are not compared.
    """
    return open_scan_text(path) if is_scan_text(path) else open_recording(path, strict=True)


def diff_sources(
    a: OpenRecording,
    b: OpenRecording,
    *,
    topics: Sequence[TopicPair] = (),
    all_topics: bool = False,
    rules: Rules | None = None,
    meter: Meter | None = None,
) -> Difference:
    """Compare open recordings.

    Raises
    ------
    TopicError
        If a topic does not exist, or there is nothing to compare.
    RecordingError
        If one cannot be read to its end.
    """
    rules = rules or Rules()
    result = Difference(str(a.path), str(b.path))
    asked = pair_streams(a, b, topics)
    others = [] if topics and not all_topics else _topics_of_type(a, b, decoded=False, without=topics)
    if meter is not None:
        meter.expect(sum(max(map(_messages_of, pair)) for pair in asked))
    for pair in _read_into_memory(asked) if len(asked) > _MANY_TOPICS else asked:
        _compare([pair], rules, result, meter)
    if meter is not None:
        meter.finish()
    if all_topics:
        _compare(others, rules, result)
    else:
        result.left_aside = len(others)
    if not result.topics:
        raise TopicError(
            "nothing to compare: neither recording has a topic of scans or clouds",
            path=a.path,
            hint="`all_topics=True` compares the other topics too, `topics` one of them",
        )
    return result


def pair_streams(
    a: OpenRecording, b: OpenRecording, topics: Sequence[TopicPair] = ()
) -> list[tuple[TopicStream, TopicStream]]:
    """Pair the requested topics, or all that have scans or clouds on either side.

    Raises
    ------
    TopicError
        If a requested topic does not exist.
    """
    return _requested_streams(a, b, topics) if topics else _topics_of_type(a, b, decoded=True)


def _read_into_memory(pairs: Sequence[tuple[TopicStream, TopicStream]]) -> list[tuple[TopicStream, TopicStream]]:
    """Return the same streams, from memory if their messages are few enough."""
    sides = []
    for streams in zip(*pairs, strict=True):
        source = read_into_memory(
            streams[0].source, [connection for stream in streams for connection in stream.connections]
        )
        sides.append([stream._replace(source=source) for stream in streams])
    return list(zip(*sides, strict=True))


def _by_topic(source: OpenRecording) -> dict[str, tuple[Connection, ...]]:
    topics: dict[str, tuple[Connection, ...]] = {}
    for connection in source.connections:
        topics[connection.topic] = (*topics.get(connection.topic, ()), connection)
    return topics


def _requested_streams(
    a: OpenRecording, b: OpenRecording, pairs: Sequence[TopicPair]
) -> list[tuple[TopicStream, TopicStream]]:
    """Return the streams of the given topics."""
    streams = []
    for pair in pairs:
        sides = []
        for source, topic in ((a, pair.a), (b, pair.b)):
            topics = _by_topic(source)
            if topic not in topics:
                near = did_you_mean(topic, sorted(topics))
                raise TopicError(
                    "there is no such topic",
                    path=source.path,
                    topic=topic,
                    hint=f"{near} the recording's topics are: {name_list(sorted(topics))}".strip(),
                )
            sides.append(TopicStream(source, topics[topic]))
        streams.append((sides[0], sides[1]))
    return streams


def _topics_of_type(
    a: OpenRecording, b: OpenRecording, *, decoded: bool, without: Sequence[TopicPair] = ()
) -> list[tuple[TopicStream, TopicStream]]:
    """Return the topics that have scans or clouds (or have none) on either side, with the same topic of the other."""
    of_a, of_b = _by_topic(a), _by_topic(b)
    taken = {name for pair in without for name in (pair.a, pair.b)}
    pairs = []
    for topic in sorted({*of_a, *of_b} - taken):
        one, other = of_a.get(topic, ()), of_b.get(topic, ())
        if any(c.ros_type in DECODED_TYPES for c in (*one, *other)) == decoded:
            pairs.append((TopicStream(a, one), TopicStream(b, other)))
    return pairs


def _messages_of(stream: TopicStream) -> int:
    """Return how many messages a topic has; those are 0 that its recording does not count."""
    return sum(connection.message_count or 0 for connection in stream.connections)


def _compare(
    pairs: Sequence[tuple[TopicStream, TopicStream]],
    rules: Rules,
    result: Difference,
    meter: Meter | None = None,
) -> None:
    """Compare topics: scans and clouds topic by topic, all others in one pass.

    Parameters
    ----------
    meter
        Counts the pairs of scans or clouds.
    """
    others = []
    for one, other in pairs:
        entry = _entry(one, other, rules)
        result.topics.append(entry)
        kinds = [sorted({canonical_type(c.msgtype) for c in stream.connections}) for stream in (one, other)]
        if all(kinds) and (kinds[0] != kinds[1] or len(kinds[0]) > 1):
            entry.change("type", MessageTimes(None, 0), ", ".join(kinds[0]), ", ".join(kinds[1]))
        elif entry.msgtype in DECODED_TYPES:
            _compare_stream(one, other, entry, rules, meter)
        else:
            others.append(((one, other), entry))
    if others:
        _compare_others([pair for pair, _ in others], [entry for _, entry in others], rules)


def _entry(one: TopicStream, other: TopicStream, rules: Rules) -> TopicDifference:
    names = [stream.connections[0].topic if stream.connections else None for stream in (one, other)]
    connection = (*one.connections, *other.connections)[0]
    return TopicDifference(names[0], names[1], canonical_type(connection.msgtype), rules.allow_beams)


def _compare_stream(
    one: TopicStream,
    other: TopicStream,
    entry: TopicDifference,
    rules: Rules,
    meter: Meter | None,
) -> None:
    """Compare scans or clouds, pair by pair."""
    for pair in match_messages(one, other):
        if meter is not None:
            meter.messages += 1
            meter.add(1)
        entry.messages_a += pair.a is not None
        entry.messages_b += pair.b is not None
        if pair.a is not None and pair.b is not None:
            times = _times_of(pair.a)
            if pair.moved and "order" not in rules.ignore:
                entry.moved.add(times)
            entry.count_pair(times, compare_messages(pair.a, pair.b, rules))
        elif pair.a is not None:
            entry.missing.add(_times_of(pair.a))
        elif pair.b is not None:
            entry.extra.add(_times_of(pair.b))


def _times_of(message: RawMessage) -> MessageTimes:
    return MessageTimes(header_stamp_ns(message), message.log_time_ns)


# --- other messages ---

#: The messages of one log time, by the number of their topic.
_Group = dict[int, list["RawMessage"]]


def _compare_others(
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
    content = _ByteComparison(numbered="seq" not in rules.ignore)
    for log_time_ns, groups in _merge_by_log_time(
        *(_groups_by_log_time([pair[side] for pair in pairs]) for side in (0, 1))
    ):
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


def _groups_by_log_time(streams: Sequence[TopicStream]) -> Iterator[tuple[int, _Group]]:
    """Yield the messages of several topics of one recording, grouped by log time."""
    numbers = {connection.id: n for n, stream in enumerate(streams) for connection in stream.connections}
    connections = tuple(connection for stream in streams for connection in stream.connections)
    messages = TopicStream(streams[0].source, connections).messages()
    for log_time_ns, together in groupby(messages, lambda message: message.log_time_ns):
        group: _Group = {}
        for message in together:
            group.setdefault(numbers[message.connection.id], []).append(message)
        yield log_time_ns, group


def _merge_by_log_time(
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


class _ByteComparison:
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
                if self._ros1_bytes(a) == self._ros1_bytes(b):
                    return MessageDifference()
            except DecodeError as err:
                note = f"; not decoded: {err.message}"
        return MessageDifference(0, (Change("bytes", f"{len(a.data)} bytes", f"{len(b.data)} bytes{note}"),))

    def _ros1_bytes(self, message: RawMessage) -> Buffer:
        """Return the message in ROS 1's format, its headers without sequence numbers."""
        connection, data = message.connection, message.data
        for ros_version in (1,) if connection.ros_version == 2 else (2, 1):
            coding = transcoder(connection, ros_version)
            connection, data = coding.connection, coding.encode(data)
        return data
