"""Finds the messages among the records of an MCAP file, in a chunk or outside."""

from __future__ import annotations

from array import array
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.lazy_items import MAX_LISTED_ITEMS, LazyItems
from pc2scan.model import RawMessage, own_data

from .records import MESSAGE, OP_MESSAGE, RECORD

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.model import Connection

    Messages = list[RawMessage] | LazyItems[RawMessage]

#: The first and the last log time that a message can have.
ANY_TIME = (0, (1 << 64) - 1)


class MessageScan(NamedTuple):
    """The result of scanning records for messages.

    Attributes
    ----------
    messages
        The wanted messages, in the order of the file.
    others
        Other channels with messages.
    size
        Number of sound bytes.
    astray
        Log time of a wanted message outside of the declared times.
    """

    messages: Messages
    others: set[int]
    size: int
    astray: int | None


def scan_messages(
    data: memoryview,
    wanted: Mapping[int, Connection],
    start_ns: int,
    stop_ns: int,
    span: tuple[int, int] = ANY_TIME,
    further: Callable[[int], None] | None = None,
) -> MessageScan:
    """Scan records for messages; those outside of ``span``, the declared log times, are skipped.

    ``further`` is called with the offset of every other record.
    """
    messages: list[RawMessage] = []
    others: set[int] = set()
    astray: int | None = None
    count = position = 0
    while True:
        more = _scan_stretch(data, wanted, start_ns, stop_ns, span, further, position)
        others |= more.others
        astray = more.astray if astray is None else astray
        count += len(more.messages)
        messages = [*messages, *more.messages] if count <= MAX_LISTED_ITEMS else []
        if more.size == position:
            break
        position = more.size
    if count <= MAX_LISTED_ITEMS:
        return MessageScan(messages, others, position, astray)
    start_ns, stop_ns = max(start_ns, span[0]), min(stop_ns, span[1] + 1)
    return MessageScan(_lazy_messages(data[:position], wanted, start_ns, stop_ns), others, position, astray)


def _lazy_messages(
    data: memoryview, wanted: Mapping[int, Connection], start_ns: int, stop_ns: int
) -> LazyItems[RawMessage]:
    """Return the messages among sound records, each created when it is needed."""
    times, places = array("Q"), array("Q")
    position, last = 0, len(data) - MESSAGE.size
    while position <= last:
        opcode, length, channel_id, _, log_time_ns, _ = MESSAGE.unpack_from(data, position)
        if opcode == OP_MESSAGE and channel_id in wanted and start_ns <= log_time_ns < stop_ns:
            times.append(log_time_ns)
            places.append(position)
        position += RECORD.size + length
    return LazyItems(times, places, partial(message_at, memoryview(own_data(data)), wanted), len(data))


def _scan_stretch(
    data: memoryview,
    wanted: Mapping[int, Connection],
    start_ns: int,
    stop_ns: int,
    span: tuple[int, int],
    further: Callable[[int], None] | None,
    position: int,
) -> MessageScan:
    """Scan records from an offset on, so few bytes that they have at most `MAX_LISTED_ITEMS` messages."""
    astray: int | None = None
    first_ns, last_ns = span
    # One comparison for cut and span; only if it fails, the two are distinguished.
    start_ns, stop_ns = max(start_ns, first_ns), min(stop_ns, last_ns + 1)
    found: list[RawMessage] = []
    others: set[int] = set()
    append, unpack = found.append, MESSAGE.unpack_from
    # The class's constructor takes twice as long, which matters for small messages.
    new: Callable[[type[RawMessage], tuple[object, ...]], RawMessage] = tuple.__new__
    size = len(data)
    last = min(size, position + MAX_LISTED_ITEMS * MESSAGE.size) - MESSAGE.size
    while position <= last:
        opcode, length, channel_id, sequence, log_time_ns, publish_time_ns = unpack(data, position)
        following = position + 9 + length
        if following > size:
            return MessageScan(found, others, position, astray)
        if opcode == OP_MESSAGE:
            if length < 22:
                return MessageScan(found, others, position, astray)
            connection = wanted.get(channel_id)
            if connection is None:
                others.add(channel_id)
            elif start_ns <= log_time_ns < stop_ns:
                data_view = data[position + 31 : following]
                append(new(RawMessage, (connection, log_time_ns, data_view, publish_time_ns, sequence)))
            elif not first_ns <= log_time_ns <= last_ns:
                astray = log_time_ns
        elif further is not None:
            further(position)
        position = following
    # The rest is too short for a message, but may be another record.
    while position + 9 <= size and data[position] != OP_MESSAGE:
        following = position + 9 + RECORD.unpack_from(data, position)[1]
        if following > size:
            break
        if further is not None:
            further(position)
        position = following
    return MessageScan(found, others, position, astray)


def message_at(data: memoryview, known: Mapping[int, Connection], place: int) -> RawMessage:
    """Return the message of a known channel that begins at a place."""
    _, length, channel_id, sequence, log_time_ns, publish_time_ns = MESSAGE.unpack_from(data, place)
    content = data[place + MESSAGE.size : place + RECORD.size + length]
    return RawMessage(known[channel_id], log_time_ns, content, publish_time_ns, sequence)
