"""What launch files of every kind have: nodes of pointcloud_to_laserscan, their parameters and remappings."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

#: What gives the parameters of a node that is not read.
ELSEWHERE = "give its parameters without the launch file: `params_file=FILE` of YAML, or `param=NAME:=VALUE`"


class UnreadError(Exception):
    """A text of a launch file is not read: the problem, the line, and what to type if any use of it needs the same."""

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
    first = source.partition("\n")[0]
    return first if len(first) <= 60 else f"{first[:57]}..."


@dataclass(frozen=True, slots=True)
class LaunchValue:
    """A parameter or a remapping of a node.

    Attributes
    ----------
    kind
        ``value``; ``yaml``, a block of YAML; ``file``, the path of one; or ``remap``.
    name
        The name; of YAML what errors name.
    value
        The text, or why it is not read.
    line
        Its line.
    type
        ROS 1's type; empty if there is none.
    """

    kind: str
    name: str
    value: str | UnreadError
    line: int
    type: str = ""


@dataclass(frozen=True, slots=True)
class LaunchNode:
    """A node of pointcloud_to_laserscan in a launch file.

    Attributes
    ----------
    name
        The fully qualified name.
    line
        Where it is.
    doubt
        Why it is not known whether the node is launched once: "under a condition"; empty if it is.
    values
        In the order of the file.
    """

    name: str
    line: int
    doubt: str
    namespace: str = ""
    values: tuple[LaunchValue, ...] = ()


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
    unread
        What may be such a node, or changes nodes from outside of them.
    """

    nodes: list[LaunchNode] = field(default_factory=list)
    arguments: set[str] = field(default_factory=set)
    ignored: list[str] = field(default_factory=list)
    unread: list[UnreadError] = field(default_factory=list)

    def add_node(
        self, text: Callable[[str], str], values: Iterable[LaunchValue], line: int, doubt: str, above: str = ""
    ) -> None:
        """Add a node, if it is one of pointcloud_to_laserscan.

        Parameters
        ----------
        text
            Returns the package, program, arguments, namespace or name, if it is given.
        values
            Its parameters and remappings.
        line, doubt
            See `LaunchNode`.
        above
            The namespace around it.
        """
        try:
            program = text("program")
            said = program + text("arguments") if "nodelet" in program else program or text("package")
            if not re.search("pointcloud_?to_?laserscan", said, re.IGNORECASE):
                return
            words = text("arguments")
            if ":=" in words or "--params-file" in words:
                values = [LaunchValue("file", "arguments", UnreadError.of(words, line), line)]
            namespace = qualified(above, text("namespace"))
            name = qualified(namespace, text("name") or "pointcloud_to_laserscan")
            self.nodes.append(LaunchNode(name, line, doubt, namespace, tuple(values)))
        except UnreadError as err:
            self.unread.append(err)


def qualified(above: str, name: str) -> str:
    """Return a name inside a namespace."""
    return ("" if name.startswith("/") else above) + "/" * bool(name) + name.strip("/")


def package_folder(path: Path, name: str, line: int) -> str:
    """Return the folder of the package that a launch file is in; raise UnreadError if it is another package."""
    for folder in path.resolve().parents:
        if folder.name == name:
            return str(folder)
        if (folder / "package.xml").is_file():
            with (folder / "package.xml").open("rb") as file:
                if f"<name>{name}</name>".encode() in file.read(100_000):
                    return str(folder)
    raise UnreadError(f"the package {name!r} was not found", line)
