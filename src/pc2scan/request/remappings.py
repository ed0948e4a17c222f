"""Reads remappings of a node's topics, ``cloud_in:=/points``."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import UsageError
from pc2scan.options.table import PARAMETERS
from pc2scan.text import did_you_mean

from .options import TopicRequest

if TYPE_CHECKING:
    from collections.abc import Iterable

#: The nodes' names for the topic that they read and the topic that they write, by whether scans become clouds.
_NAMES = {False: ("cloud_in", "scan"), True: ("scan_in", "cloud")}

#: The topics of transforms, which may be remapped.
_TF = ("tf", "tf_static")


class Remappings(NamedTuple):
    """The result of remappings: topics to convert, and the topics of the transforms."""

    topics: tuple[str, ...] = ()
    tf_topics: tuple[str, ...] = ()


def read_remaps(texts: Iterable[str], *, reverse: bool = False) -> Remappings:
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
    Remappings
        A remapping of ``scan`` alone applies to the only PointCloud2 topic.

    Raises
    ------
    UsageError
        If a text is not a remapping, or the node has no such topic.
    """
    source_name, target_name = _NAMES[reverse]
    remaps: dict[str, str] = {}
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
            hint = f"{did_you_mean(name, known)} its topics are {', '.join(known)}".strip()
            if name in PARAMETERS:
                hint = f"it is a parameter: `param={name}:={right}`"
            raise UsageError(f"{text!r}: {node} has no topic {name!r}", hint=hint)
        remaps[name] = right if right.startswith(("/", "~")) else f"/{right}"
    topics: tuple[str, ...] = ()
    if source_name in remaps or target_name in remaps:
        source, target = remaps.get(source_name, "*"), remaps.get(target_name)
        topics = (str(source) if target is None else f"{source}:={target}",)
        TopicRequest.parse(topics[0])
    # If only one of the two topics is remapped, the other one keeps its name.
    moved = [remaps[name] for name in _TF if name in remaps]
    tf_topics = tuple(remaps.get(name, f"/{name}") for name in _TF) if len(moved) == 1 else tuple(moved)
    return Remappings(topics, tf_topics)
