"""ROS's remappings, ``cloud_in:=/points``, as the topics of a conversion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.errors import UsageError
from pc2scan.names import did_you_mean

from .options import TopicRequest

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["Remapped", "meant_for", "remapped"]

#: What the nodes call the topic that they read and the one that they write, by whether scans become clouds.
_NAMES = {False: ("cloud_in", "scan"), True: ("scan_in", "cloud")}

#: Where transforms may be moved.
_TF = ("tf", "tf_static")


@dataclass(frozen=True, slots=True)
class Remapped:
    """What remappings ask for: topics to convert, and the topics of the transforms."""

    topics: tuple[str, ...] = ()
    tf_topics: tuple[str, ...] = ()


def meant_for(texts: Iterable[str], node: str) -> list[str]:
    """Return those remappings that are for a node: without a node in front, or with this one.

    >>> meant_for(["front:scan:=/a", "/rear:scan:=/b", "cloud_in:=/points"], "/robot/front")
    ['front:scan:=/a', 'cloud_in:=/points']
    """
    found = []
    for text in texts:
        own, colon, _ = text.partition(":=")[0].rpartition(":")
        if not colon or f"/{own.strip('/')}" == node or (not own.startswith("/") and node.endswith(f"/{own}")):
            found.append(text)
    return found


def remapped(texts: Iterable[str], *, reverse: bool = False) -> Remapped:
    """Read remappings of the nodes' topics.

    Parameters
    ----------
    texts
        ``cloud_in:=/points``, ``scan:=/front/scan``, ``/tf:=/robot/tf``; a node's name in front is ignored. Of
        ``laserscan_to_pointcloud`` the names are ``scan_in`` and ``cloud``.
    reverse
        Whether scans become clouds.

    Returns
    -------
    Remapped
        With ``scan`` alone every PointCloud2 topic is meant, of which there must then be one.

    Raises
    ------
    UsageError
        If one is no remapping, or of a topic that the node does not have.
    """
    source_name, target_name = _NAMES[reverse]
    found: dict[str, str] = {}
    for text in texts:
        left, assigned, right = text.partition(":=")
        name = left.rpartition(":")[2].strip().lstrip("~/")
        right = right.strip()
        if not assigned or not name or not right:
            raise UsageError(
                f"{text!r} is not a remapping", hint=f"write {source_name}:=/points or {target_name}:=/scan"
            )
        if name not in (source_name, target_name, *_TF):
            node = "laserscan_to_pointcloud" if reverse else "pointcloud_to_laserscan"
            known = (source_name, target_name, *_TF)
            raise UsageError(
                f"{text!r}: {node} has no topic {name!r}",
                hint=f"{did_you_mean(name, known)} its topics are {', '.join(known)}".strip(),
            )
        found[name] = right if right.startswith(("/", "~")) else f"/{right}"
    topics: tuple[str, ...] = ()
    if source_name in found or target_name in found:
        source, target = found.get(source_name, "*"), found.get(target_name)
        topics = (str(source) if target is None else f"{source}:={target}",)
        TopicRequest.parse(topics[0])
    # Whoever moves one of the two still means the other.
    moved = [found[name] for name in _TF if name in found]
    tf_topics = tuple(found.get(name, f"/{name}") for name in _TF) if len(moved) == 1 else tuple(moved)
    return Remapped(topics, tf_topics)
