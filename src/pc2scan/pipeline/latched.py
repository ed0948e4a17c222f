"""What is latched at the beginning of a cut: the newest message of each latched topic, and all static transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.bags.latching import NewestItems, is_static
from pc2scan.bags.units import Unit
from pc2scan.errors import DecodeError
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable, Iterable

    from pc2scan.bags.units import Item
    from pc2scan.model import RawMessage


def latched_at(messages: Iterable[RawMessage], start_ns: int) -> Unit:
    """Return the messages that are valid when a cut begins, with its time.

    These are the newest message of each connection, and of static transforms the newest message with each child frame:
    publishers send frames one by one or all again. Several connections of a topic, which are publishers of their own,
    each have theirs.

    Parameters
    ----------
    messages
        Those of latched connections from before the cut, in their order.
    start_ns
        The beginning of the cut: at their own log times, they would make the recording begin when they were logged.
    """
    newest: NewestItems[RawMessage] = NewestItems()
    for message in messages:
        # A view would keep a whole chunk in memory.
        newest.add(_names(message), message._replace(data=bytes(message.data)))
    found = [message._replace(log_time_ns=start_ns, publish_time_ns=start_ns) for message in newest]

    def load(callback: Callable[[RawMessage], Item], *, whole: bool) -> list[Item]:  # noqa: ARG001  # no chunk
        return [callback(message) for message in found]

    size = sum(message.size for message in found)
    return Unit(start_ns, (), size, load, is_quick=True, is_in_memory=True)


def _names(message: RawMessage) -> Collection[Hashable]:
    """Return what a message is the newest one of."""
    connection = message.connection
    if not is_static(connection.topic):
        return [connection.id]
    try:
        if connection.ros_type in TF_TYPES:
            return {(connection.id, row[1]) for row in decode_transforms(message.data, connection.serialization)}
    except DecodeError:
        pass
    return [(connection.id, bytes(message.data))]
