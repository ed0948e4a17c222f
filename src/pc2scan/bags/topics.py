"""Topics of a recording: found by the names that users give, how many messages they have, and whose stay valid."""

from __future__ import annotations

import re
from collections import Counter
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from pc2scan.errors import TopicError, UsageError, name_list
from pc2scan.model import declared_counts
from pc2scan.text import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pc2scan.model import Connection

    from .reader import Reader

#: Begins with a word that is found as such: profiles may be many, and long.
_TRANSIENT_LOCAL = r"""durability(?<!\wdurability)["']?[ \t]*:[ \t]*["']?(?:1|transient_local)\b"""


def find_topic(requested: str, types: dict[str, set[str]], candidates: list[str], *kinds: str) -> str:
    """Return the topic of a type by its name, with or without the leading slash.

    Parameters
    ----------
    requested
        The name.
    types
        The types that each topic of the recording has.
    candidates
        The topics of the type.
    kinds
        The type, in ROS 2's spelling, or several that are possible.

    Raises
    ------
    TopicError
        If there is no such topic, or it has another type.
    """
    listing = f"{short_types(kinds)} topics: {name_list(candidates)}"
    for name in (requested, f"/{requested}", requested.removeprefix("/")):
        if name in types:
            if not types[name].isdisjoint(kinds):
                return name
            wanted = " or ".join(usual_types(kinds))
            raise TopicError(f"topic {name} is {', '.join(sorted(types[name]))}, not {wanted}", hint=listing)
    near = did_you_mean(requested, candidates)
    raise TopicError(f"no topic {requested} in the recording", hint=f"{near} {listing}".strip())


def find_topics(requested: str, types: dict[str, set[str]], candidates: list[str], *kinds: str) -> list[str]:
    """Return the topics that a name or a glob (``/lidar*``) means; see `find_topic`.

    Raises
    ------
    TopicError
        As `find_topic` does, and if a glob matches no topic of the type.
    """
    if requested in types or not is_glob(requested):
        return [find_topic(requested, types, candidates, *kinds)]
    topics = [topic for topic in candidates if matches(topic, (requested,))]
    if not topics:
        listing = f"{short_types(kinds)} topics: {name_list(candidates)}"
        near = did_you_mean(re.sub(r"[*?\[\]]", "", requested), candidates)
        raise TopicError(f"no {short_types(kinds)} topic matches {requested}", hint=f"{near} {listing}".strip())
    return topics


def is_glob(name: str) -> bool:
    """Return whether a name has characters of a glob, which ROS topics cannot have."""
    return any(character in name for character in "*?[")


def matches(topic: str, patterns: Sequence[str]) -> bool:
    """Return whether a topic matches one of the names or globs; a leading slash is ignored."""
    return any(
        topic == pattern or fnmatchcase(topic.removeprefix("/"), pattern.removeprefix("/")) for pattern in patterns
    )


def new_topic(requested: str, option: str) -> str:
    """Return a topic that is going to be written, with its leading slash.

    Parameters
    ----------
    requested
        The name; a ``*`` in it stands for what one on the other side matches.
    option
        What names it, for errors.

    Raises
    ------
    UsageError
        If it is not a name that ROS can have.
    """
    if not re.fullmatch(r"/?[A-Za-z_*][\w*]*(/[\w*]+)*", requested, re.ASCII):
        raise UsageError(
            f"{option}: {requested!r} is not a name that a topic can have",
            hint="a name has letters, digits and _, with / between its parts: /robot/scan",
        )
    return requested if requested.startswith("/") else f"/{requested}"


def fill_glob(topic: str, pattern: str, target: str) -> str:
    """Return ``target`` with each ``*`` in it replaced by what the ``*`` in ``pattern`` matched, in their order.

    >>> fill_glob("/lidar_left/points", "/lidar_*/points", "/scan_*")
    '/scan_left'

    Raises
    ------
    TopicError
        If ``target`` has more of them.
    """
    count = target.count("*")
    if not count:
        return target
    parts = [re.escape(part).replace(r"\?", ".") for part in pattern.removeprefix("/").split("*")]
    match = re.fullmatch("(.*)".join(parts), topic.removeprefix("/"))
    if match is None or len(match.groups()) < count:
        raise TopicError(
            f"{pattern}:={target} has more * on the right than on the left",
            hint="each * on the right is what one on the left matches: '/lidar_*/points:=/scan_*'",
        )
    pieces = target.split("*")
    return pieces[0] + "".join(text + piece for text, piece in zip(match.groups(), pieces[1:], strict=False))


#: The types of most clouds and scans.
_USUAL_TYPES = ("sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan")


def short_types(kinds: Iterable[str]) -> str:
    """Return types without their packages, for a message; see `usual_types`."""
    return " or ".join(dict.fromkeys(kind.rsplit("/", 1)[-1] for kind in usual_types(kinds)))


def usual_types(kinds: Iterable[str]) -> list[str]:
    """Return the usual types, or all if there are none: messages would be long with all kinds of clouds."""
    kinds = list(kinds)
    return [kind for kind in kinds if kind in _USUAL_TYPES] or kinds


def by_topic(connections: Iterable[Connection]) -> dict[str, list[Connection]]:
    """Return the connections of each topic, in the order of the first ones."""
    topics: dict[str, list[Connection]] = {}
    for connection in connections:
        topics.setdefault(connection.topic, []).append(connection)
    return topics


def types_by_topic(connections: Iterable[Connection]) -> dict[str, set[str]]:
    """Return the types of each topic, in ROS 2's spelling."""
    return {topic: {connection.ros_type for connection in own} for topic, own in by_topic(connections).items()}


# --- Messages that stay valid: those of latched topics, and static transforms ---


def latches(qos: str) -> bool:
    r"""Whether any of rosbag2's ``offered_qos_profiles`` has the durability transient local.

    Only this key is read, because profiles may lack other keys. Its value is rmw's number (1) or, from ROS 2 Jazzy on,
    its name.

    >>> latches("- history: 1\n  durability: 1"), latches("- durability: volatile")
    (True, False)
    """
    return re.search(_TRANSIENT_LOCAL, qos.lower()) is not None


def unheard(connections: Iterable[Connection]) -> list[tuple[str, str]]:
    """Return what is wrong with topics of static transforms that nobody receives in ROS 2, and what to do.

    tf2 asks for the durability transient local.
    """
    topics = dict.fromkeys(
        connection.topic
        for connection in connections
        if connection.ros_version == 2
        and connection.is_static
        and not connection.latching
        and connection.message_count != 0
    )
    what = "its QoS is volatile or not recorded, so ROS 2 plays it as volatile, and tf2 does not receive it"
    cure = "play it with --qos-profile-overrides-path qos.yaml, a file with the line"
    return [
        (f"{topic}: {what}", f"{cure} '{topic}: {{durability: transient_local, history: keep_all}}'")
        for topic in topics
    ]


def message_counts(reader: Reader) -> tuple[Counter[int], int | None, int | None]:
    """Return messages by connection, and the first and the last log time; the messages are read only if necessary."""
    summary, counts = reader.summary, Counter[int]()
    if summary.end_ns is not None and not reader.damage:
        known = Counter(declared_counts(reader.connections))
        if len(known) == len(reader.connections):
            return known, summary.start_ns, summary.end_ns
    start_ns = end_ns = None
    for message in reader.messages():
        counts[message.connection.id] += 1
        end_ns = message.log_time_ns
        start_ns = end_ns if start_ns is None else start_ns
    return counts, start_ns, end_ns
