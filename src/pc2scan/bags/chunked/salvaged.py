"""What is left of a damaged chunk, and the note of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Container

    from pc2scan.bags.damage import DamageLog
    from pc2scan.errors import DamageError
    from pc2scan.model import RawMessage

    from .segments import Segment

__all__ = ["Salvaged", "note_salvaged", "settled"]


class Salvaged(NamedTuple):
    """What is left of a chunk.

    Attributes
    ----------
    messages
        In the order of the chunk.
    bytes_lost
        Uncompressed bytes that no record accounts for.
    strangers
        Messages of channels (connections) that nothing describes.
    """

    messages: list[RawMessage]
    bytes_lost: int
    strangers: int

    def selected(self, ids: Container[int], start_ns: int | None, stop_ns: int | None) -> list[RawMessage]:
        """Return the messages of some connections, with log times from ``start_ns`` on and before ``stop_ns``."""
        return [
            message
            for message in self.messages
            if message.connection.id in ids
            and (start_ns is None or start_ns <= message.log_time_ns)
            and (stop_ns is None or message.log_time_ns < stop_ns)
        ]


def settled(messages: list[RawMessage], span: tuple[int, int]) -> list[RawMessage]:
    """Give messages whose log times lie outside of their chunk's declared ones the nearest of these.

    If there are several of them, and all messages are in order by their own times, it is the declared times that are
    wrong: all keep theirs.

    Parameters
    ----------
    messages
        All of a chunk, in its order.
    span
        The first and the last log time that are declared.
    """
    low, high = span
    times = [message.log_time_ns for message in messages]
    outside = sum(not low <= time_ns <= high for time_ns in times)
    if outside == 0 or (outside > 1 and times == sorted(times)):
        return messages
    return [message if low <= message.log_time_ns <= high else _moved(message, span) for message in messages]


def _moved(message: RawMessage, span: tuple[int, int]) -> RawMessage:
    """Give a message the nearest log time in a span; where it is the time of publishing too, that as well."""
    nearest = max(span[0], min(message.log_time_ns, span[1]))
    publish_time_ns = nearest if message.publish_time_ns == message.log_time_ns else message.publish_time_ns
    return message._replace(log_time_ns=nearest, publish_time_ns=publish_time_ns)


def note_salvaged(
    log: DamageLog, problem: DamageError, segment: Segment, offset: int, size: int, left: Salvaged
) -> None:
    """Take note of a damaged chunk of which something was salvaged.

    Parameters
    ----------
    offset
        Where the damage is said to be, bytes of the file.
    size
        How many bytes of it could be decompressed.
    left
        What was found in these.
    """
    cut = max(segment.uncompressed_size - size, 0)
    missing = cut + left.bytes_lost
    log.note(
        problem,
        offset=offset,
        bytes_lost=missing,
        messages_lost=None if missing else left.strangers,
        first_ns=left.messages[-1].log_time_ns if left.messages and cut else segment.start_ns,
        last_ns=segment.end_ns,
    )
