"""Reads ROS's remappings, ``cloud_in:=/points``, as the topics of a conversion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.errors import UsageError
from pc2scan.text import did_you_mean

from .scan_spec import TopicRequest

if TYPE_CHECKING:
    from collections.abc import Iterable

#: The nodes' names for the topic that they read and the topic that they write, by whether scans become clouds.
_NAMES = {False: ("cloud_in", "scan"), True: ("scan_in", "cloud")}

#: The topics of transforms, which may be remapped.
_TF = ("tf", "tf_static")


@dataclass(frozen=True, slots=True)
class Remapped:
    """The result of remappings: topics to convert, and the topics of the transforms."""

    topics: tuple[str, ...] = ()
    tf_topics: tuple[str, ...] = ()


def meant_for(texts: Iterable[str], node: str) -> list[str]:
    """Return the remappings that apply to a node: those without a node's name in front, or with this one's.

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
        ``cloud_in:=/points``, ``scan:=/front/scan``, ``/tf:=/robot/tf``; a node's name in front is ignored. The names
        of ``laserscan_to_pointcloud`` are ``scan_in`` and ``cloud``.
    reverse
        Whether scans become clouds.

    Returns
    -------
    Remapped
        A remapping of ``scan`` alone applies to the only PointCloud2 topic.

    Raises
    ------
    UsageError
        If a text is not a remapping, or the node has no such topic.
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
    # If only one of the two topics is remapped, the other one keeps its name.
    moved = [found[name] for name in _TF if name in found]
    tf_topics = tuple(found.get(name, f"/{name}") for name in _TF) if len(moved) == 1 else tuple(moved)
    return Remapped(topics, tf_topics)
