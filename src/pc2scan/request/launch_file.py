"""Reads the parameters and remappings of pointcloud_to_laserscan nodes from launch files of ROS 1 and ROS 2.

Nothing is launched, and nothing in a file is executed.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError, name_list
from pc2scan.text import did_you_mean

from .launch_node import ELSEWHERE
from .launch_python import python_nodes
from .launch_xml import xml_nodes

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from .launch_node import LaunchFile, LaunchNode


def is_launch_xml(text: str) -> bool:
    """Whether the text of a parameter file is XML: no YAML file of parameters begins with ``<``."""
    return re.match(r"\s*<[?!a-zA-Z]", text) is not None


def launch_node(text: str, path: Path, arguments: Mapping[str, str], node: str | None) -> tuple[LaunchNode, LaunchFile]:
    """Find the node of a launch file.

    Parameters
    ----------
    text, path
        The file: Python if its name ends in ``.py``, otherwise XML.
    arguments
        Values of its arguments; the others have the defaults in the file.
    node
        Name of the node, with or without its namespace; None: the only node in the file.

    Raises
    ------
    ParameterError
        If the text is not a launch file, a text that it needs is not read, there is no node of
        pointcloud_to_laserscan, or more than one.
    """
    try:
        file = (python_nodes if path.suffix == ".py" else xml_nodes)(text, path, arguments)
    except (RecursionError, MemoryError) as err:
        raise ParameterError(f"{path}: nested too deeply") from err
    for unused in sorted(arguments.keys() - file.arguments):
        known = f"{did_you_mean(unused, file.arguments)} its arguments are {name_list(sorted(file.arguments))}"
        raise ParameterError(f"{path}: it has no argument {unused!r}", hint=known.strip())
    if not file.nodes and (file.ignored or not file.unread):
        hint = f"not followed: {name_list(file.ignored)}; name the file that has the node" if file.ignored else None
        raise ParameterError(f"{path}: no node of pointcloud_to_laserscan in it", hint=hint)
    for unread in file.unread:
        message = f"what may be the node or change it: {unread.problem} (from {path}, line {unread.line})"
        raise ParameterError(message, hint=unread.hint or ELSEWHERE)
    names = [candidate.name for candidate in file.nodes]
    chosen = [each for each in file.nodes if node is None or f"{each.name}/".endswith(f"/{node.strip('/')}/")]
    if not chosen:
        message = f"{path}: no node {node!r} (from `node`); found {name_list(names)}"
        raise ParameterError(message, hint=did_you_mean(str(node), names) or None)
    for candidate in chosen if node is None else ():
        if candidate.doubt:
            message = f"{path}, line {candidate.line}: {candidate.name} is {candidate.doubt}"
            raise ParameterError(f"{message}, and read only if `node` names it", hint=f"`node={candidate.name}`")
    if len(chosen) > 1:
        nodes = [candidate.name for candidate in chosen]
        hint = f"choose one, for example `node={nodes[0]}`" if len({*nodes}) == len(nodes) else ELSEWHERE
        raise ParameterError(f"{path}: several nodes match: {name_list(nodes)}", hint=hint)
    return chosen[0], file
