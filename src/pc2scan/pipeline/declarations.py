"""The connections of a destination, collected and then declared together."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.errors import MessageError
from pc2scan.model import Definition

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pc2scan.model import Connection, Writer

_COMMENT = rb"#[^\n]*"


class Declarations:
    """The connections to declare in a destination, in the order in which they are added."""

    def __init__(self) -> None:
        self._connections: list[Connection] = []

    def add(self, connection: Connection) -> int:
        """Add a connection; return its index in the list that `declare` returns."""
        self._connections.append(connection)
        return len(self._connections) - 1

    def declare(self, writer: Writer, *, one_a_topic: bool) -> list[int]:
        """Declare all connections, before the first message is written.

        Parameters
        ----------
        writer
            The writer of the destination.
        one_a_topic
            Whether the publishers of a topic share a connection, as in rosbag2's recordings: programs that read these
            find a topic by its name, and use the first connection of this name.

        Returns
        -------
        list of int
            The writer's handle of each connection that was added.
        """
        if not one_a_topic:
            return [writer.add_connection(connection) for connection in self._connections]
        topics: dict[tuple[str, str, str], list[int]] = {}
        for place, connection in enumerate(self._connections):
            plain = connection.in_utf8
            msgtype = plain.ros_type if plain.serialization == "cdr" else plain.msgtype
            topics.setdefault((plain.topic, msgtype, plain.serialization), []).append(place)
        handles = [-1] * len(self._connections)
        for group in sorted(group for places in topics.values() for group in self._by_layout(places)):
            handle = writer.add_connection(_merge_connections([self._connections[place] for place in group]))
            for place in group:
                handles[place] = handle
        return handles

    def _by_layout(self, places: Sequence[int]) -> Iterable[list[int]]:
        """Group the publishers of a topic by the layout of their messages.

        Two definitions may have the same name; messages of one cannot be decoded with the other.
        """
        publishers = {place: self._connections[place] for place in places}
        if len({(each.digest, each.definition) for each in publishers.values()}) == 1:
            return [list(places)]
        digests: dict[Definition, str] = {}
        for each in publishers.values():
            if each.digest:
                digests.setdefault(each.definition, each.digest)
        # A connection without a definition has the same topic and type as the others, so it joins the first group.
        digests[Definition()] = ""
        groups: dict[str, list[int]] = {}
        for place, each in publishers.items():
            if each.definition not in digests:
                digests[each.definition] = _layout(each)
            groups.setdefault(each.digest or digests[each.definition], []).append(place)
        unknown = groups.pop("", [])
        if not groups:
            return [unknown]
        first = min(groups, key=lambda name: groups[name])
        groups[first] = sorted(groups[first] + unknown)
        return groups.values()


def _layout(connection: Connection) -> str:
    """Return the type's hash, as ROS 2 computes it; of an unreadable definition its text without comments and space."""
    from pc2scan.messages import schema  # noqa: PLC0415  # only where publishers' definitions differ

    definition = connection.definition
    try:
        structs = schema.parse(definition, connection.msgtype)
        return schema.rihs01(schema.closure(schema.canonical_type(connection.msgtype), structs.get))
    except MessageError:
        return b" ".join(re.sub(_COMMENT, b"", definition.data).split()).decode("utf-8", "replace")


def _merge_connections(publishers: Sequence[Connection]) -> Connection:
    """Return one connection for several publishers: the first, with the QoS profiles of all."""
    first = publishers[0]
    if len(publishers) == 1:
        return first
    from pc2scan.bags.qos import merge_qos  # noqa: PLC0415  # few topics have several publishers

    return replace(
        first,
        definition=next((each.definition for each in publishers if each.definition.data), first.definition),
        digest=next((each.digest for each in publishers if each.digest), ""),
        latching=any(each.latching for each in publishers),
        qos=merge_qos([each.qos for each in publishers]),
    )
