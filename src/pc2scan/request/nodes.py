"""ROS's nodes: reads their remappings, ``cloud_in:=/points``, and makes one conversion from several nodes of a file."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import UsageError
from pc2scan.options.table import PARAMETERS
from pc2scan.text import did_you_mean

from .options import TopicRequest

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from .options import ScanSpec

#: The nodes' names for the topic that they read and the topic that they write, by whether scans become clouds.
_NAMES = {False: ("cloud_in", "scan"), True: ("scan_in", "cloud")}

#: The topics of transforms, which may be remapped.
_TF = ("tf", "tf_static")


class Remappings(NamedTuple):
    """The result of remappings: topics to convert, and the topics of the transforms."""

    topics: tuple[str, ...] = ()
    tf_topics: tuple[str, ...] = ()


def remaps_of_node(texts: Iterable[str], node: str) -> list[str]:
    """Return the remappings that apply to a node: those without a node's name in front, or with this one's.

    >>> remaps_of_node(["front:scan:=/a", "/rear:scan:=/b", "cloud_in:=/points"], "/robot/front")
    ['front:scan:=/a', 'cloud_in:=/points']
    """
    remaps = []
    for text in texts:
        own, colon, _ = text.partition(":=")[0].rpartition(":")
        if not colon or f"/{own.strip('/')}" == node or (not own.startswith("/") and node.endswith(f"/{own}")):
            remaps.append(text)
    return remaps


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


def refuse_topics(topics: object, nodes: Sequence[str], file: Path) -> None:
    """Raise if topics are given, because it is not clear which node they are for.

    Raises
    ------
    UsageError
        If topics are given.
    """
    if topics:
        raise UsageError(
            f"`topics` does not name a node, and there are several: {', '.join(nodes)}",
            path=file,
            hint=f"choose a node, `node={nodes[0]}`, or name the topics of each: "
            f"`remap={nodes[0].lstrip('/')}:cloud_in:=/points`",
        )


def name_outputs(nodes: Sequence[str], specs: Sequence[ScanSpec], file: Path) -> list[ScanSpec]:
    """Return the outputs of several nodes of a file, each with its own topic.

    Parameters
    ----------
    nodes, specs
        Fully qualified names of the nodes, and the output of each.

    Returns
    -------
    list of ScanSpec
        A node without a topic for its scans publishes ``scan`` in its namespace; if several nodes would do this, below
        its own name. A node without a source reads the only topic with clouds.

    Raises
    ------
    UsageError
        If two nodes write one topic.
    """
    usual = [f"{node.rpartition('/')[0]}/scan" for node in nodes]
    named: dict[str, ScanSpec] = {}
    for node, spec, own in zip(nodes, specs, usual, strict=True):
        source, target = next(iter(spec.topics), TopicRequest("*"))
        target = target or (own if usual.count(own) == 1 else f"{node}/scan")
        if target in named:
            one = nodes[list(named).index(target)]
            raise UsageError(
                f"{one} and {node} would both write {target}",
                path=file,
                hint=f"`remap={node.lstrip('/')}:scan:={target}_2` gives one of them another topic; "
                f"`node={one}` converts only one",
            )
        topics = () if source == "*" else (TopicRequest(source, target),)
        named[target] = replace(spec, name=target, place=f"{file}, {node}", topics=topics)
    return list(named.values())
