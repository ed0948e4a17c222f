"""Compares two recordings, topic by topic."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.bags.opening import open_recording
from pc2scan.errors import TopicError, UsageError, name_list
from pc2scan.messages.schema import canonical
from pc2scan.text import did_you_mean

from .held import held
from .match import OpenRecording, TopicStream, header_stamp_ns, matched
from .messages import DECODED, compare_messages
from .others import compare_others
from .progress import Counted
from .result import Difference
from .rules import Rules
from .scan_text import is_scan_text, open_scan_text
from .topic_difference import MessageTimes, TopicDifference

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from pc2scan.model import Connection, RawMessage

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
    progress: Callable[[int, int, int], None] | None = None,
) -> Difference:
    """Compare two recordings; see `pc2scan.diff`.

    Parameters
    ----------
    progress
        Called regularly; see `pc2scan.compare.progress`.
    """
    if b is None and not (topics and all(pair.a != pair.b for pair in topics)):
        raise UsageError(
            "to compare a recording with itself, two topics are needed",
            path=a,
            hint="give a second recording, or two topics: `topics=/scan:=/scan2`",
        )
    with ExitStack() as stack:
        sources = []
        for path in (a, a if b is None else b):
            source = open_source(path)
            stack.callback(source.close)
            sources.append(source)
        counted = Counted(progress, sources)
        return diff_sources(sources[0], sources[1], topics=topics, all_topics=all_topics, rules=rules, counted=counted)


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
    counted: Counted | None = None,
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
    asked = paired_streams(a, b, topics)
    others = [] if topics and not all_topics else _sides(a, b, decoded=False, without=topics)
    counted = counted or Counted(None, ())
    for number, pair in enumerate(_held(asked) if len(asked) > _MANY_TOPICS else asked):
        counted.begin(number, len(asked))
        _compare([pair], rules, result, counted)
    if all_topics:
        _compare(others, rules, result, counted)
    else:
        result.left_aside = len(others)
    if not result.topics:
        raise TopicError(
            "nothing to compare: neither recording has a LaserScan or PointCloud2 topic",
            path=a.path,
            hint="`all_topics=True` compares the other topics too, `topics` one of them",
        )
    return result


def paired_streams(
    a: OpenRecording, b: OpenRecording, topics: Sequence[TopicPair] = ()
) -> list[tuple[TopicStream, TopicStream]]:
    """Pair the requested topics, or all that have scans or clouds on either side.

    Raises
    ------
    TopicError
        If a requested topic does not exist.
    """
    return _asked_streams(a, b, topics) if topics else _sides(a, b, decoded=True)


def _held(pairs: Sequence[tuple[TopicStream, TopicStream]]) -> list[tuple[TopicStream, TopicStream]]:
    """Return the same streams, from memory if their messages are few enough."""
    sides = []
    for streams in zip(*pairs, strict=True):
        source = held(streams[0].source, [connection for stream in streams for connection in stream.connections])
        sides.append([stream._replace(source=source) for stream in streams])
    return list(zip(*sides, strict=True))


def _by_topic(source: OpenRecording) -> dict[str, tuple[Connection, ...]]:
    topics: dict[str, tuple[Connection, ...]] = {}
    for connection in source.connections:
        topics[connection.topic] = (*topics.get(connection.topic, ()), connection)
    return topics


def _asked_streams(
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


def _sides(
    a: OpenRecording, b: OpenRecording, *, decoded: bool, without: Sequence[TopicPair] = ()
) -> list[tuple[TopicStream, TopicStream]]:
    """Return the topics that have scans or clouds (or have none) on either side, with the same topic of the other."""
    of_a, of_b = _by_topic(a), _by_topic(b)
    taken = {name for pair in without for name in (pair.a, pair.b)}
    pairs = []
    for topic in sorted({*of_a, *of_b} - taken):
        one, other = of_a.get(topic, ()), of_b.get(topic, ())
        if any(c.ros_type in DECODED for c in (*one, *other)) == decoded:
            pairs.append((TopicStream(a, one), TopicStream(b, other)))
    return pairs


def _compare(
    pairs: Sequence[tuple[TopicStream, TopicStream]],
    rules: Rules,
    result: Difference,
    counted: Counted,
) -> None:
    """Compare topics: scans and clouds topic by topic, all others in one pass."""
    others = []
    for one, other in pairs:
        entry = _entry(one, other, rules)
        result.topics.append(entry)
        kinds = [sorted({canonical(c.msgtype) for c in stream.connections}) for stream in (one, other)]
        if all(kinds) and (kinds[0] != kinds[1] or len(kinds[0]) > 1):
            entry.change("type", MessageTimes(None, 0), ", ".join(kinds[0]), ", ".join(kinds[1]))
        elif entry.msgtype in DECODED:
            _compare_decoded(one, other, entry, rules, counted)
        else:
            others.append(((one, other), entry))
    if others:
        compare_others([pair for pair, _ in others], [entry for _, entry in others], rules)


def _entry(one: TopicStream, other: TopicStream, rules: Rules) -> TopicDifference:
    names = [stream.connections[0].topic if stream.connections else None for stream in (one, other)]
    connection = (*one.connections, *other.connections)[0]
    return TopicDifference(names[0], names[1], canonical(connection.msgtype), rules.allow_beams)


def _compare_decoded(
    one: TopicStream,
    other: TopicStream,
    entry: TopicDifference,
    rules: Rules,
    counted: Counted,
) -> None:
    """Compare scans or clouds, pair by pair."""
    for pair in matched(one, other):
        counted.count()
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
