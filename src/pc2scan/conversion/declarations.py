"""The topics of a recording that is to be written: collected, and then declared together."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from pc2scan.bags.formats import FORMATS
from pc2scan.bags.qos import merge_qos
from pc2scan.bags.topics import unheard
from pc2scan.errors import MessageError, RecordingError
from pc2scan.messages.clouds import to_pointcloud2, written_as_pointcloud2
from pc2scan.messages.definitions import definition
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.model import LATCHED_QOS, NEW_ID, Connection, Definition

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from types import ModuleType

    from pc2scan.bags.destinations import Destination
    from pc2scan.model import Writer
    from pc2scan.request.options import ConvertOptions

    from .plan import Route
    from .report import TopicReport

#: Maximum number of fields that are compiled for re-encoding. Each takes about a millisecond and 7 kB; large robots
#: have thousands.
_MAX_COMPILED_FIELDS = 20_000

_COMMENT = rb"#[^\n]*"


def declare(writer: Writer, connections: Sequence[Connection], *, one_a_topic: bool) -> list[int]:
    """Declare connections, before the first message is written; return the writer's handle of each.

    Parameters
    ----------
    writer
        The writer of the destination.
    one_a_topic
        Whether the publishers of a topic share a connection, as in rosbag2's recordings: programs that read these
        find a topic by its name, and use the first connection of this name.
    """
    if not one_a_topic:
        return [writer.add_connection(connection) for connection in connections]
    topics: dict[tuple[str, str, str], list[int]] = {}
    for place, connection in enumerate(connections):
        plain = connection.in_utf8
        msgtype = plain.ros_type if plain.serialization == "cdr" else plain.msgtype
        topics.setdefault((plain.topic, msgtype, plain.serialization), []).append(place)
    handles = [-1] * len(connections)
    publishers = ({place: connections[place] for place in places} for places in topics.values())
    for group in sorted(group for each in publishers for group in _by_layout(each)):
        handle = writer.add_connection(_merge_connections([connections[place] for place in group]))
        for place in group:
            handles[place] = handle
    return handles


def _by_layout(publishers: Mapping[int, Connection]) -> Iterable[list[int]]:
    """Group the publishers of a topic by the layout of their messages.

    Two definitions may have the same name; messages of one cannot be decoded with the other.
    """
    if len({(publisher.digest, publisher.definition) for publisher in publishers.values()}) == 1:
        return [list(publishers)]
    digests: dict[Definition, str] = {}
    for publisher in publishers.values():
        if publisher.digest:
            digests.setdefault(publisher.definition, publisher.digest)
    # A connection without a definition has the same topic and type as the others, so it joins the first group.
    digests[Definition()] = ""
    groups: dict[str, list[int]] = {}
    for place, publisher in publishers.items():
        if publisher.definition not in digests:
            digests[publisher.definition] = _layout(publisher)
        groups.setdefault(publisher.digest or digests[publisher.definition], []).append(place)
    unknown = groups.pop("", [])
    if not groups:
        return [unknown]
    first = min(groups, key=lambda name: groups[name])
    groups[first] = sorted(groups[first] + unknown)
    return groups.values()


def _transcode() -> ModuleType:
    """Return the module for definitions that differ, are missing, or are of another ROS version; few recordings do."""
    from pc2scan.messages import transcode  # noqa: PLC0415

    return transcode


def _layout(connection: Connection) -> str:
    """Return the type's hash, as ROS 2 computes it; of an unreadable definition its text without comments and space."""
    try:
        return str(_transcode().ros2_hash(connection.msgtype, connection.definition))
    except MessageError:
        return b" ".join(re.sub(_COMMENT, b"", connection.definition.data).split()).decode("utf-8", "replace")


def _merge_connections(publishers: Sequence[Connection]) -> Connection:
    """Return one connection for several publishers: the first, with the QoS profiles of all."""
    first = publishers[0]
    if len(publishers) == 1:
        return first
    return replace(
        first,
        definition=next((each.definition for each in publishers if each.definition.data), first.definition),
        digest=next((each.digest for each in publishers if each.digest), ""),
        latching=any(each.latching for each in publishers),
        qos=merge_qos([each.qos for each in publishers]),
    )


def new_connection(
    target: Destination,
    topic: str,
    msgtype: str,
    declared: tuple[Definition, str] | None = None,
    *,
    callerid: str | None = "/pc2scan",
    latching: bool = False,
    qos: str = "",
) -> Connection:
    """Return a connection that a recording gets; ``declared`` has the definition and its digest, if they are known."""
    text, digest = declared or definition(msgtype, target.ros_version)
    if target.ros_version == 1:
        qos = ""
    else:
        callerid = None
    form = target.serialization
    return Connection(NEW_ID, topic, msgtype, form, text, digest, callerid=callerid, latching=latching, qos=qos)


class HasHandle(Protocol):
    """Whatever writes to a topic by the writer's handle: a route, an output, added transforms."""

    handle: int


class RecordingTopics:
    """The topics of a recording that is to be written, collected before they are declared.

    Parameters
    ----------
    target
        The recording.
    same_kind
        Whether the source is in the same kind of container.
    options
        The options of the conversion.

    Attributes
    ----------
    as_pointcloud2
        Whether clouds of other types that pass are written as PointCloud2.

    Notes
    -----
    Whoever adds a topic has its ``handle``. Until `declare` is called, that is a place among the topics.
    """

    def __init__(self, target: Destination, options: ConvertOptions, *, same_kind: bool) -> None:
        self.target = target
        self.as_pointcloud2 = options.clouds_as == "pointcloud2"
        self._same_kind = same_kind
        self._options = options
        self._added: list[tuple[Connection, tuple[HasHandle, ...]]] = []
        #: The fields of all types that were compiled for re-encoding; their number is bounded.
        self._compiled: dict[tuple[str, Definition], int] = {}

    def add(self, connection: Connection, *owners: HasHandle) -> None:
        """Add a connection, and set the handle of its owners."""
        for owner in owners:
            owner.handle = len(self._added)
        self._added.append((connection, owners))

    def add_like(self, source: Connection, topic: str, msgtype: str, owner: HasHandle) -> None:
        """Add a topic with the QoS profile, latching and caller id of a source's, and set the handle of its owner."""
        same, latched = source.ros_version == self.target.ros_version, source.is_latched
        qos = source.qos if same else LATCHED_QOS if latched else ""
        new = new_connection(self.target, topic, msgtype, callerid=source.callerid, latching=latched, qos=qos)
        self.add(new, owner)

    def add_passing(self, route: Route, entry: TopicReport) -> None:
        """Add a connection that passes through, re-encoded if the destination is of the other ROS version.

        The entry of the report says if its messages are re-encoded, or cannot pass.
        """
        target, options, connection = self.target, self._options, route.connection
        if self.as_pointcloud2 and written_as_pointcloud2(connection):
            entry.action, entry.note = "re-encoded", "as PointCloud2"
            route.reencode = to_pointcloud2(connection, target.serialization)
            self.add_like(connection, connection.topic, POINTCLOUD2, route)
            return
        foreign = connection.ros_version is None
        # The same kind of container can store the message as it is, even if its type is unknown.
        as_it_is = (self._same_kind and (foreign or options.repair)) or (foreign and bool(target.format.profiles))
        defined_already = connection.definition.data or options.repair
        if as_it_is or (connection.ros_version == target.ros_version and defined_already):
            self.add(connection, route)
            return
        if connection.ros_version == target.ros_version:
            self.add(_transcode().with_definition(connection), route)
            return
        try:
            if foreign:
                holding = " or ".join(each.suffix for each in FORMATS.values() if each.profiles)
                form = connection.serialization or "unspecified"
                raise MessageError(f"{form} messages can only be stored in an {holding} file")
            transcoding = _transcode().transcoder(connection, target.ros_version)
        except MessageError as err:
            if options.strict and connection.message_count != 0:
                err.topic = connection.topic
                raise
            entry.note, entry.lost, entry.action, entry.target = err.message, True, "skipped", None
            return
        self._compiled[connection.msgtype, connection.definition] = transcoding.fields
        if sum(self._compiled.values()) > _MAX_COMPILED_FIELDS:
            raise RecordingError(
                f"its types have more than {_MAX_COMPILED_FIELDS} fields in all, too many to re-encode",
                hint="`drop` or `keep` chooses among the topics",
            )
        entry.action, entry.note = "re-encoded", "; ".join(transcoding.notes)
        route.reencode = transcoding.encode
        self.add(transcoding.connection, route)

    @property
    def warnings(self) -> list[str]:
        """What programs will not receive of the recording when it is played."""
        return [f"{what}; {cure}" for what, cure in unheard([connection for connection, _ in self._added])]

    def declare(self, writer: Writer) -> None:
        """Declare all topics, and set the writer's handles."""
        handles = declare(writer, [each for each, _ in self._added], one_a_topic=self.target.format.is_directory)
        for (_, owners), handle in zip(self._added, handles, strict=True):
            for owner in owners:
                owner.handle = handle
