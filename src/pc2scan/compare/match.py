"""Matches the messages of two topics, with one pair in memory at a time.

Messages are matched by their header's stamp, which is the same in every container and every re-recording. Repeated
stamps are matched in order. Messages whose stamp is 0 or cannot be read are matched by their log time, and so are
those of types that are compared by their bytes.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from pc2scan.errors import DecodeError, RecordingError
from pc2scan.messages.wire import Cursor

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, RawMessage

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
