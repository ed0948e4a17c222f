"""Makes one conversion from several nodes of a parameter or launch file; each node becomes an output."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.errors import UsageError

from .scan_spec import TopicRequest

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .options import ConvertOptions
    from .scan_spec import ScanSpec


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
    """
    requests = [next(iter(each.scan.topics), TopicRequest("*")) for each in options]
    usual = [f"{node.rpartition('/')[0]}/scan" for node in nodes]
    targets = [
        request.target or (own if usual.count(own) == 1 else f"{node}/scan")
        for node, request, own in zip(nodes, requests, usual, strict=True)
    ]
    specs = [
        _renamed(each.scan, target, f"{file}, {node}", request.source)
        for node, each, target, request in zip(nodes, options, targets, requests, strict=True)
    ]
    moved = dict.fromkeys(topic for each in options for topic in each.frames.tf_topics)
    frames = replace(options[0].frames, tf_topics=tuple(moved))
    return replace(options[0], scans=tuple(specs), frames=frames)


def _renamed(spec: ScanSpec, target: str, place: str, source: str) -> ScanSpec:
    topics = () if source == "*" else (TopicRequest(source, target),)
    return replace(spec, name=target, place=place, topics=topics)
