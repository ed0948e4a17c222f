"""ROS's nodes: reads their remappings, ``cloud_in:=/points``, and makes one conversion from several nodes of a file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pc2scan.errors import UsageError
from pc2scan.options.table import PARAMETERS
from pc2scan.text import did_you_mean

from .options import TopicRequest

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from .options import ConvertOptions, ScanSpec

#: The nodes' names for the topic that they read and the topic that they write, by whether scans become clouds.
_NAMES = {False: ("cloud_in", "scan"), True: ("scan_in", "cloud")}

#: The topics of transforms, which may be remapped.
_TF = ("tf", "tf_static")


@dataclass(frozen=True, slots=True)
class Remappings:
    """The result of remappings: topics to convert, and the topics of the transforms."""

    topics: tuple[str, ...] = ()
    tf_topics: tuple[str, ...] = ()


def remaps_of_node(texts: Iterable[str], node: str) -> list[str]:
    """Return the remappings that apply to a node: those without a node's name in front, or with this one's.

    >>> remaps_of_node(["front:scan:=/a", "/rear:scan:=/b", "cloud_in:=/points"], "/robot/front")
    ['front:scan:=/a', 'cloud_in:=/points']
    """
    found = []
    for text in texts:
        own, colon, _ = text.partition(":=")[0].rpartition(":")
        if not colon or f"/{own.strip('/')}" == node or (not own.startswith("/") and node.endswith(f"/{own}")):
            found.append(text)
    return found


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
            hint = f"{did_you_mean(name, known)} its topics are {', '.join(known)}".strip()
            if name in PARAMETERS:
                hint = f"it is a parameter: `param={name}:={right}`"
            raise UsageError(f"{text!r}: {node} has no topic {name!r}", hint=hint)
        found[name] = right if right.startswith(("/", "~")) else f"/{right}"
    topics: tuple[str, ...] = ()
    if source_name in found or target_name in found:
        source, target = found.get(source_name, "*"), found.get(target_name)
        topics = (str(source) if target is None else f"{source}:={target}",)
        TopicRequest.parse(topics[0])
    # If only one of the two topics is remapped, the other one keeps its name.
    moved = [found[name] for name in _TF if name in found]
    tf_topics = tuple(found.get(name, f"/{name}") for name in _TF) if len(moved) == 1 else tuple(moved)
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


def options_of_nodes(nodes: Sequence[str], options: Sequence[ConvertOptions], file: Path) -> ConvertOptions:
    """Return the options of one conversion with the outputs of all nodes.

    Parameters
    ----------
    nodes
        Fully qualified names of the nodes.
    options
        The options of each node on its own.

    Returns
    -------
    ConvertOptions
        A node without a topic for its scans publishes ``scan`` in its namespace; if several nodes would do this, below
        its own name. A node without a source reads the only topic with clouds.

    Raises
    ------
    UsageError
        If two nodes write one topic.
    """
    requests = [next(iter(each.scan.topics), TopicRequest("*")) for each in options]
    usual = [f"{node.rpartition('/')[0]}/scan" for node in nodes]
    targets = [
        request.target or (own if usual.count(own) == 1 else f"{node}/scan")
        for node, request, own in zip(nodes, requests, usual, strict=True)
    ]
    twice = next((target for number, target in enumerate(targets) if target in targets[:number]), None)
    if twice is not None:
        one, *_, other = [node for node, target in zip(nodes, targets, strict=True) if target == twice]
        raise UsageError(
            f"{one} and {other} would both write {twice}",
            path=file,
            hint=f"`remap={other.lstrip('/')}:scan:={twice}_2` gives one of them another topic; "
            f"`node={one}` converts only one",
        )
    specs = [
        _rename_output(each.scan, target, f"{file}, {node}", request.source)
        for node, each, target, request in zip(nodes, options, targets, requests, strict=True)
    ]
    moved = dict.fromkeys(topic for each in options for topic in each.frames.tf_topics)
    frames = replace(options[0].frames, tf_topics=tuple(moved))
    notes = tuple(note for each in options for note in each.notes)
    return replace(options[0], scans=tuple(specs), frames=frames, notes=notes)


def _rename_output(spec: ScanSpec, target: str, place: str, source: str) -> ScanSpec:
    topics = () if source == "*" else (TopicRequest(source, target),)
    return replace(spec, name=target, place=place, topics=topics)
