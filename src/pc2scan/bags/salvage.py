"""The messages recovered from a damaged chunk, and the note of its damage."""

from __future__ import annotations

from array import array
from functools import partial
from itertools import islice
from operator import le
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.loading import LazyItems

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from pc2scan.bags.damage import DamageLog
    from pc2scan.errors import DamageError
    from pc2scan.model import RawMessage

    from .chunks import Segment


class SalvagedMessages(NamedTuple):
    """The messages recovered from a chunk.

    Attributes
    ----------
    messages
        In the order of the chunk.
    bytes_lost
        Uncompressed bytes that are in no record.
    unknown_channel
        Messages of unknown channels (connections).
    """

    messages: list[RawMessage] | LazyItems[RawMessage]
    bytes_lost: int
    unknown_channel: int

    def select(
        self, ids: Container[int], start_ns: int | None, stop_ns: int | None
    ) -> list[RawMessage] | LazyItems[RawMessage]:
        """Return the messages of some connections, with log times from ``start_ns`` on and before ``stop_ns``."""

        def is_wanted(message: RawMessage) -> bool:
            return (
                message.connection.id in ids
                and (start_ns is None or start_ns <= message.log_time_ns)
                and (stop_ns is None or message.log_time_ns < stop_ns)
            )

        found = self.messages
        return found.filter(is_wanted) if isinstance(found, LazyItems) else list(filter(is_wanted, found))


def clamp_times(
    messages: list[RawMessage] | LazyItems[RawMessage], span: tuple[int, int]
) -> list[RawMessage] | LazyItems[RawMessage]:
    """Replace log times outside the range that the chunk declares by the nearest time in the range.

    If there are several of them, and all messages are in order by their own times, the declared times are wrong and
    no message is changed. Nor is one if all of several are outside: they belong to another chunk.

    Parameters
    ----------
    messages
        All messages of a chunk, in its order.
    span
        The declared first and last log time.
    """
    low, high = span
    times = _times_of(messages)
    outside = _outside(times, span)
    if outside == 0 or (outside > 1 and (outside == len(times) or all(map(le, times, islice(times, 1, None))))):
        return messages
    if isinstance(messages, LazyItems):
        nearest = array("Q", (max(low, min(time_ns, high)) for time_ns in times))
        return messages.map(partial(_clamp, span), nearest)
    return [_clamp(span, message) for message in messages]


def _times_of(messages: list[RawMessage] | LazyItems[RawMessage]) -> Sequence[int]:
    return messages.times if isinstance(messages, LazyItems) else [message.log_time_ns for message in messages]


def _outside(times: Sequence[int], span: tuple[int, int]) -> int:
    return sum(not span[0] <= time_ns <= span[1] for time_ns in times)


def _clamp(span: tuple[int, int], message: RawMessage) -> RawMessage:
    """Set a message's log time to the nearest in a span, and its publish time too if the two are the same."""
    if span[0] <= message.log_time_ns <= span[1]:
        return message
    nearest = max(span[0], min(message.log_time_ns, span[1]))
    publish_time_ns = nearest if message.publish_time_ns == message.log_time_ns else message.publish_time_ns
    return message._replace(log_time_ns=nearest, publish_time_ns=publish_time_ns)


def note_salvaged(
    log: DamageLog,
    problem: DamageError,
    segment: Segment,
    offset: int,
    size: int,
    left: SalvagedMessages,
    indexed: int | None,
    *,
    counted: bool,
) -> None:
    """Note a damaged chunk with recovered messages.

    Parameters
    ----------
    offset
        The reported place of the damage, bytes.
    size
        Number of bytes that could be decompressed.
    left
        The messages found in these.
    indexed
        How many messages the index has for the chunk; None if that is unknown.
    counted
        Whether the file declares how many messages it has, which is compared at the end.
    """
    cut = max(segment.uncompressed_size - size, 0)
    missing = cut + left.bytes_lost
    times = _times_of(left.messages)
    # These may be the messages of another chunk, and those of this one are not here.
    is_another = segment.end_ns and _outside(times, (segment.start_ns, segment.end_ns)) > 1
    is_known = counted or (indexed is not None and indexed >= len(times))
    unread = max(left.unknown_channel, (indexed or 0) - len(times))
    log.note(
        problem,
        offset=offset,
        bytes_lost=missing,
        messages_lost=None if missing or is_another or not (unread or is_known) else unread,
        first_ns=left.messages[-1].log_time_ns if left.messages and cut else segment.start_ns,
        last_ns=segment.end_ns,
    )
