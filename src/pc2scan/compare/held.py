"""Holds a recording's messages in memory, if many topics are compared one after the other."""

from __future__ import annotations

import heapq
from operator import itemgetter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from pathlib import Path

    from pc2scan.model import Connection, RawMessage

    from .match import OpenRecording

#: Limit of the bytes held; each message takes some 300 more than its data.
_MAX_BYTES = 32 << 20
_MESSAGE_BYTES = 300


class _Held:
    """The messages of some connections; see `pc2scan.compare.match.OpenRecording`."""

    def __init__(
        self, path: Path, connections: Sequence[Connection], messages: dict[int, list[tuple[int, RawMessage]]]
    ) -> None:
        self.path = path
        self.connections = connections
        #: By connection, each message with its number in the recording.
        self._messages = messages

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[RawMessage]:
        """Messages in the order of log time, ``start_ns <= log_time_ns < stop_ns``."""
        chosen = self.connections if connections is None else connections
        streams = [self._messages.get(connection.id, []) for connection in chosen]
        for _, message in heapq.merge(*streams, key=itemgetter(0)):
            if (start_ns is None or start_ns <= message.log_time_ns) and (
                stop_ns is None or message.log_time_ns < stop_ns
            ):
                yield message

    def close(self) -> None:
        """Do nothing: the caller closes the recording."""


def held(source: OpenRecording, connections: Sequence[Connection]) -> OpenRecording:
    """Return the recording with the messages of these connections in memory, or unchanged if they take too much.

    Reading a topic reads every chunk with a message of it, so ten thousand topics would read the file as often.
    """
    found: dict[int, list[tuple[int, RawMessage]]] = {}
    size = 0
    for place, message in enumerate(source.messages(connections)):
        size += len(message.data) + _MESSAGE_BYTES
        if size > _MAX_BYTES:
            return source
        # A view would keep the whole chunk in memory.
        own = message._replace(data=bytes(message.data))
        found.setdefault(message.connection.id, []).append((place, own))
    return _Held(source.path, connections, found)
