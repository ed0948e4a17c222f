"""What launch files of every kind have: nodes of pointcloud_to_laserscan, their parameters and remappings."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from .parameters import Direction

#: Topics whose remappings are read.
_TOPICS: dict[Direction, frozenset[str]] = {
    "pointcloud_to_laserscan": frozenset({"cloud_in", "scan", "tf", "tf_static"}),
    "laserscan_to_pointcloud": frozenset({"scan_in", "cloud", "tf", "tf_static"}),
}

#: What gives the parameters of a node that is not read.
ELSEWHERE = "give its parameters without the launch file: `params_file=FILE` of YAML, or `param=NAME:=VALUE`"


class UnreadError(Exception):
    """A text of a launch file is not read.

    Attributes
    ----------
    problem, line
        What is not read, and where.
    hint
        What to type instead; None: that depends on what the text is for.
    """

    def __init__(self, problem: str, line: int, hint: str | None = None) -> None:
        super().__init__(problem)
        self.problem, self.line, self.hint = problem, line, hint

    @classmethod
    def of(cls, source: str, line: int) -> UnreadError:
        """Return the error about an expression."""
        return cls(f"`{shortened(source)}` is not read", line)

    @classmethod
    def no_value(cls, argument: str, line: int) -> UnreadError:
        """Return the error about an argument without a value."""
        return cls(f"the argument {argument!r} has no value", line, f"`launch_args={argument}:=VALUE`")


def shortened(source: str) -> str:
    """Return the beginning of an expression, for errors."""
    return source if len(source) <= 60 else f"{source[:57]}..."


@dataclass(frozen=True, slots=True)
class LaunchParam:
    """One parameter of a node.

    Attributes
    ----------
    name
        The name; empty for a file or a block of YAML.
    value
        The text, or why it is not read.
    kind
        ``value``; ``yaml``, a block of YAML; or ``file``, the path of one.
    line
        The line of the parameter.
    type
        ROS 1's type; empty if there is none.
    """

    name: str
    value: str | UnreadError
    kind: str
    line: int
    type: str = ""


@dataclass(slots=True)
class NodeContent:
    """What is read of a node.

    Attributes
    ----------
    params
        In the order of the file.
    remaps
        ``cloud_in:=/points``, as they apply to the node.
    """

    path: Path
    direction: Direction
    namespace: str
    overridden: Collection[str]
    params: list[LaunchParam] = field(default_factory=list)
    remaps: list[str] = field(default_factory=list)

    def add_param(self, name: str, read: Callable[[], str], line: int, kind: str = "value", of_type: str = "") -> None:
        """Add a parameter, whose text ``read`` returns."""
        value: str | UnreadError
        try:
            value = read()
        except UnreadError as err:
            value, line = err, err.line
        self.params.append(LaunchParam(name, value, kind, line, of_type))

    def add_remap(self, source: str, read: Callable[[], str]) -> None:
        """Add a remapping, if it is one of the node's topics; ``read`` returns the new name.

        Raises
        ------
        ParameterError
            If the name is not read, and is not given elsewhere.
        """
        topic = source.strip("~/")
        if topic not in _TOPICS[self.direction]:
            return
        try:
            self.remaps.append(f"{source}:={qualified(self.namespace, read())}")
        except UnreadError as err:
            if topic not in self.overridden:
                message = f"{source}: {err.problem} (from {self.path}, line {err.line})"
                raise ParameterError(message, hint=err.hint or f"give it: `remap={topic}:=/TOPIC`") from None

    def add_words(self, words: str, line: int) -> None:
        """Add what the arguments of roslaunch and ros2 say: _name:=value, -p name:=value, -r from:=to, from:=to.

        Raises
        ------
        UnreadError
            If they name a file of parameters.
        """
        if "--params-file" in words:
            raise UnreadError.of(words, line)
        for option, word in re.findall(r"(?:(-[pr]|--param|--remap)\s+)?(\S+:=\S*)", words):
            left, _, right = word.partition(":=")
            if option in {"-p", "--param"} or (left.startswith("_") and not left.startswith("__")):
                self.params.append(LaunchParam(left.lstrip("_"), right, "value", line))
            elif not left.startswith("__"):
                self.add_remap(left, partial(str, right))


@dataclass(frozen=True, slots=True)
class LaunchNode:
    """A node of pointcloud_to_laserscan in a launch file.

    Attributes
    ----------
    name
        The fully qualified name; empty if it is not read.
    line
        Where it is.
    doubt
        Why it is not known whether the node is launched once: "under a condition"; empty if it is.
    read
        Returns its parameters and remappings.
    """

    name: str
    line: int
    doubt: str
    direction: Direction
    read: Callable[[], NodeContent]


@dataclass(slots=True)
class LaunchFile:
    """What is read of a launch file.

    Attributes
    ----------
    nodes
        The nodes of pointcloud_to_laserscan.
    arguments
        The names of its arguments.
    ignored
        What may set parameters or launch nodes, and is not followed, with its place.
    """

    nodes: list[LaunchNode] = field(default_factory=list)
    arguments: set[str] = field(default_factory=set)
    ignored: list[str] = field(default_factory=list)


def is_converter(package: str, programs: str, words: str) -> bool:
    """Whether a node is one of pointcloud_to_laserscan, by its package, executable or plugin, and arguments."""
    said = programs + words if "nodelet" in programs else programs or package
    return "pointcloud_to_laserscan" in said or "laserscan_to_pointcloud" in said


def direction_of(programs: str) -> Direction:
    """Return which of the two nodes it is, by its executable or plugin."""
    said = (
        programs.lower().replace("_", "").replace("pointcloudtolaserscan/", "").replace("pointcloudtolaserscan::", "")
    )
    return "laserscan_to_pointcloud" if "laserscantopointcloud" in said else "pointcloud_to_laserscan"


def qualified(above: str, name: str) -> str:
    """Return a name inside a namespace."""
    if name.startswith("/"):
        return name.rstrip("/")
    return "/".join(filter(None, (above, name.strip("/")))) if above else f"/{name}".rstrip("/")


def package_folder(path: Path, name: str, line: int) -> str:
    """Return the folder of the package that a launch file is in. Other packages would need a ROS installation.

    Raises
    ------
    UnreadError
        If it is another package.
    """
    for folder in path.resolve().parents:
        if folder.name == name:
            return str(folder)
        if (folder / "package.xml").exists():
            if _package_name(folder / "package.xml") in {name, ""}:
                return str(folder)
            break
    raise UnreadError(f"the package {name!r} was not found", line)


def _package_name(file: Path) -> str:
    """Return the name in a ``package.xml``; empty if it cannot be read."""
    try:
        with file.open("rb") as opened:
            text = opened.read(100_000)
    except OSError:
        return ""
    found = re.search(rb"<name>\s*([\w-]+)\s*</name>", text)
    return found[1].decode("ascii", "replace") if found else ""
