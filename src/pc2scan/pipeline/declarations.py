"""The connections of a destination, collected and then declared all at once."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.bags.qos import merged_qos
from pc2scan.errors import MessageError
from pc2scan.model import Definition

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pc2scan.model import Connection, Writer

__all__ = ["Declarations"]

_COMMENT = re.compile(rb"#[^\n]*")


class Declarations:
    """What will be declared in a destination, in the order in which it is added."""

    def __init__(self) -> None:
        self._connections: list[Connection] = []

    def add(self, connection: Connection) -> int:
        """Take a connection; returns its place in the list that `declare` returns."""
        self._connections.append(connection)
        return len(self._connections) - 1

    def declare(self, writer: Writer, *, one_a_topic: bool) -> list[int]:
        """Declare everything, before anything is written.

        Parameters
        ----------
        writer
            Gets the connections.
        one_a_topic
            Whether the publishers of a topic share a connection, as in rosbag2's recordings: what reads these knows a
            topic by its name, and takes the first one that it finds.

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
            handle = writer.add_connection(_merged([self._connections[place] for place in group]))
            for place in group:
                handles[place] = handle
        return handles

    def _by_layout(self, places: Sequence[int]) -> Iterable[list[int]]:
        """Divide the publishers of a topic by what their messages consist of.

        Two definitions may have one name. The messages of one cannot be decoded by the other.
        """
        publishers = {place: self._connections[place] for place in places}
        if len({(each.digest, each.definition) for each in publishers.values()}) == 1:
            return [list(places)]
        digests: dict[Definition, str] = {}
        for each in publishers.values():
            if each.digest:
                digests.setdefault(each.definition, each.digest)
        # Of those that say nothing, all that is known is that they have the topic and the type of the others.
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
    """The type's hash, as ROS 2 computes it; if the definition cannot be read its text, without comments and space."""
    from pc2scan.messages import schema  # noqa: PLC0415  # only where publishers' definitions differ

    definition = connection.definition
    try:
        structs = schema.parse(definition, connection.msgtype)
        return schema.rihs01(schema.closure(schema.canonical(connection.msgtype), structs.get))
    except MessageError:
        return b" ".join(_COMMENT.sub(b"", definition.data).split()).decode("utf-8", "replace")


def _merged(publishers: Sequence[Connection]) -> Connection:
    """One connection for several publishers: the first one's, with the QoS profiles of all."""
    first = publishers[0]
    if len(publishers) == 1:
        return first
    return replace(
        first,
        definition=next((each.definition for each in publishers if each.definition.data), first.definition),
        digest=next((each.digest for each in publishers if each.digest), ""),
        latching=any(each.latching for each in publishers),
        qos=merged_qos([each.qos for each in publishers]),
    )
