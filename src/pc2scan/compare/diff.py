"""Compares two recordings, topic by topic, with one pair of messages in memory at a time.

Scans and clouds are matched by their header's stamp, which is the same in every container and every re-recording, and
compared field by field. Repeated stamps are matched in order; those that are 0 or cannot be read, by their log times.
All other messages are matched by log time, and compared by their bytes. If the wire formats differ (ROS 1 and ROS 2,
byte order and padding of CDR), both messages are re-encoded and compared again, so that only their content matters.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from contextlib import ExitStack, closing
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from pc2scan.bags.opening import open_recording
from pc2scan.bags.topics import by_topic
from pc2scan.errors import DecodeError, RecordingError, TopicError, UsageError, name_list
from pc2scan.files.urls import fetched
from pc2scan.messages.transcode import canonical_type
from pc2scan.messages.wire import Cursor
from pc2scan.progress import Meter
from pc2scan.text import did_you_mean

from .differences import Difference, MessageTimes, TopicDifference
from .rules import DECODED_TYPES, Rules, compare_bytes, compare_messages
from .scan_text import is_scan_text, open_scan_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, RawMessage
    from pc2scan.options.call import Options
    from pc2scan.progress import Progress

    from .scan_text import ScanText


#: What can be compared: a recording, or the text of scans.
OpenRecording: TypeAlias = "Reader | ScanText"


class TopicStream(NamedTuple):
    """The messages of some connections of a recording, in order; without connections there are none.

    ``stamped`` is whether they are matched by their stamps; otherwise by their log times.
    """

    source: OpenRecording
    connections: tuple[Connection, ...]
    stamped: bool = True

    def messages(self) -> Iterator[RawMessage]:
        """Read from the beginning."""
        return self.source.messages(self.connections) if self.connections else iter(())

    def at(self, log_time_ns: int, position: int) -> RawMessage:
        """Return one of the messages of a log time, found through the recording's index."""
        messages = self.source.messages(self.connections, log_time_ns, log_time_ns + 1)
        message = next(islice(messages, position, None), None)
        if message is None:
            raise RecordingError("has changed while it was read", path=self.source.path)
        return message

    def key(self, message: RawMessage) -> int:
        """Return the number by which a message is matched: even ones are from stamps, odd ones from log times."""
        stamp_ns = header_stamp_ns(message) if self.stamped else None
        return 2 * stamp_ns if stamp_ns else 2 * message.log_time_ns + 1


class Match(NamedTuple):
    """A message of each side that belong together; None if a side has none.

    ``moved`` is true if ``b`` comes before the partner of an earlier message.
    """

    a: RawMessage | None
    b: RawMessage | None
    moved: bool = False


def header_stamp_ns(message: RawMessage) -> int | None:
    """Return the stamp of the message's header, nanoseconds; None if it cannot be read."""
    try:
        return Cursor(message.data, message.connection.serialization).header()[1]
    except DecodeError:
        return None


def match_messages(a: TopicStream, b: TopicStream) -> Iterator[Match]:
    """Pair the messages of two streams.

    Yields
    ------
    Match
        Every message of either side once: those of ``a`` in its order, and each of ``b`` without a partner at its place
        between those that are in the same order.

    Notes
    -----
    As long as both sides have the same stamps in the same order, they are read once. From the first difference on, the
    stamps of both are read ahead (some 300 bytes of memory a message), so that gaps of any length are distinguished
    from messages moved over any distance.
    """
    left, right = a.messages(), b.messages()
    common = 0
    x, y = next(left, None), next(right, None)
    while x is not None and y is not None and a.key(x) == b.key(y):
        yield Match(x, y)
        common += 1
        x, y = next(left, None), next(right, None)
    if x is not None and y is not None:
        yield from _match_by_all_stamps(a, b, common)
    elif x is not None:
        yield Match(x, None)
        yield from (Match(other, None) for other in left)
    elif y is not None:
        yield Match(None, y)
        yield from (Match(None, other) for other in right)


def _match_by_all_stamps(a: TopicStream, b: TopicStream, common: int) -> Iterator[Match]:
    """Pair the messages after the first ``common`` ones by all their stamps."""
    times, mates = _find_mates(a, b, common)
    paired, last = set(mates), -1
    following = islice(enumerate(b.messages()), common, None)
    for mate, x in zip(mates, islice(a.messages(), common, None), strict=True):
        if mate < 0:
            yield Match(x, None)
        elif mate < last:
            yield Match(x, b.at(times[mate], mate - bisect_left(times, times[mate])), moved=True)
        else:
            last = mate
            for place, y in following:
                if place == mate:
                    yield Match(x, y)
                    break
                if place not in paired:
                    yield Match(None, y)
    yield from (Match(None, y) for place, y in following if place not in paired)


def _find_mates(a: TopicStream, b: TopicStream, common: int) -> tuple[Sequence[int], Sequence[int]]:
    """Return the log time of every message of ``b``, and for each of ``a`` its partner's place there, or -1."""
    times: list[int] = []
    keys: list[int] = []
    for message in b.messages():
        times.append(message.log_time_ns)
        keys.append(b.key(message))
    # The first place of each stamp, and for a place the next one of its stamp.
    first: dict[int, int] = {}
    again: dict[int, int] = {}
    for place in range(len(keys) - 1, common - 1, -1):
        key = keys[place]
        if key in first:
            again[place] = first[key]
        first[key] = place
    mates = array("q")
    for message in islice(a.messages(), common, None):
        key = a.key(message)
        place = first.pop(key, -1)
        mates.append(place)
        if place in again:
            first[key] = again[place]
    return times, mates


def diff(a: Path, b: Path | None, options: Options, *, progress: Progress | None = None) -> Difference:
    """Compare two recordings; see `pc2scan.diff`.

    Parameters
    ----------
    progress
        Called regularly with the pairs of messages that are compared, the pairs in all, and those again.

    Raises
    ------
    TopicError
        If a topic does not exist, or there is nothing to compare.
    RecordingError
        If one cannot be read to its end: damaged recordings are not compared.
    """
    topics, rules = list(map(_pair_of, options.topics)), Rules.of(options)
    if b is None and not (topics and all(one != other for one, other in topics)):
        raise UsageError(
            "to compare a recording with itself, two topics are needed",
            path=a,
            hint="give a second recording, or two topics: `topics=/scan:=/scan2`",
        )
    meter = Meter(progress)
    with ExitStack() as stack:
        paths = stack.enter_context(fetched((a, a if b is None else b)))
        sources = [stack.enter_context(closing(open_source(path))) for path in paths]
        result = Difference(str(sources[0].path), str(sources[1].path))
        compared, result.left_aside = _streams(sources, topics, all_topics=options.all_topics)
        # A recording that does not count its messages has 0.
        counts = [[sum(c.message_count or 0 for c in stream.connections) for stream in pair] for pair in compared]
        meter.expect(sum(map(max, counts)))
        for pair in compared:
            result.topics.append(_compare(pair[0], pair[1], rules, meter))
        meter.finish()
    if not result.topics:
        raise TopicError(
            "nothing to compare: neither recording has a topic of scans or clouds",
            path=a,
            hint="`all_topics=True` compares the other topics too, `topics` one of them",
        )
    return result


def _pair_of(text: str) -> tuple[str, str]:
    """Return a topic of A, and that of B to compare it with, of ``/scan``, or ``/scan:=/scan2``."""
    a, renamed, b = text.partition(":=")
    if not a or (renamed and not b):
        raise UsageError(f"{text!r} is not a topic", hint="write /scan, or /scan:=/scan2 if B has another name")
    return a, b or a


def open_source(path: Path) -> OpenRecording:
    """Open a recording, or a text file of scans.

    Raises
    ------
    RecordingError
        If it cannot be read, also while messages are read: damaged recordings are not compared.
    """
    return open_scan_text(path) if is_scan_text(path) else open_recording(path, strict=True)


def _streams(
    sources: Sequence[OpenRecording], topics: Sequence[tuple[str, str]], *, all_topics: bool
) -> tuple[list[list[TopicStream]], int]:
    """Return the topics to compare, of both sides, and how many others there are."""
    topics_of = [by_topic(source.connections) for source in sources]
    for pair in topics:
        for topic, known, source in zip(pair, topics_of, sources, strict=True):
            if topic not in known:
                hint = f"{did_you_mean(topic, sorted(known))} the recording's topics are: {name_list(sorted(known))}"
                raise TopicError("there is no such topic", path=source.path, topic=topic, hint=hint.strip())
    rest = {*topics_of[0], *topics_of[1]} - {name for pair in topics for name in pair}
    named, others = [], []
    for pair in (*topics, *((name, name) for name in sorted(rest))):
        sides = [tuple(known.get(topic, ())) for topic, known in zip(pair, topics_of, strict=True)]
        stamped = any(connection.ros_type in DECODED_TYPES for side in sides for connection in side)
        streams = [TopicStream(source, side, stamped) for source, side in zip(sources, sides, strict=True)]
        if pair in topics or (stamped and not topics):
            named.append(streams)
        elif not stamped and (all_topics or not topics):
            others.append(streams)
    return (named + others, 0) if all_topics else (named, len(others))


def _compare(one: TopicStream, other: TopicStream, rules: Rules, meter: Meter) -> TopicDifference:
    """Compare the messages of a topic, pair by pair."""
    names = [stream.connections[0].topic if stream.connections else None for stream in (one, other)]
    kinds = [sorted({canonical_type(c.msgtype) for c in stream.connections}) for stream in (one, other)]
    entry = TopicDifference(names[0], names[1], (kinds[0] or kinds[1])[0], rules.allow_beams)
    if all(kinds) and (kinds[0] != kinds[1] or len(kinds[0]) > 1):
        entry.change("type", MessageTimes(None, 0), ", ".join(kinds[0]), ", ".join(kinds[1]))
        return entry
    compare = compare_messages if one.stamped else compare_bytes
    for pair in match_messages(one, other):
        meter.messages += 1
        meter.add(1)
        entry.messages_a += pair.a is not None
        entry.messages_b += pair.b is not None
        either = pair.a or pair.b
        assert either is not None
        times = MessageTimes(header_stamp_ns(either) if one.stamped else None, either.log_time_ns)
        if pair.b is None:
            entry.missing.add(times)
        elif pair.a is None:
            entry.extra.add(times)
        else:
            if pair.moved and "order" not in rules.ignore:
                entry.moved.add(times)
            entry.count_pair(times, compare(pair.a, pair.b, rules))
    return entry
