"""What launch files of every kind have: nodes of pointcloud_to_laserscan, their parameters and remappings."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
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
        The fully qualified name; empty if it is not read.
    line
        Where it is.
    doubt
        Why it is not known whether the node is launched once: "under a condition"; empty if it is.
    values
        In the order of the file.
    hint
        What to type if it is in doubt; None: its name.
    """

    name: str
    line: int
    doubt: str
    direction: Direction = "pointcloud_to_laserscan"
    namespace: str = ""
    values: Collection[LaunchValue] = ()
    hint: str | None = None

    @classmethod
    def unclear(cls, err: UnreadError) -> LaunchNode:
        """Return what may be a node of pointcloud_to_laserscan."""
        return cls("", err.line, f"unclear: {err.problem}", hint=err.hint)

    def remaps(self, path: Path, overridden: Collection[str]) -> tuple[str, ...]:
        """Return the remappings of the node's topics, ``cloud_in:=/points``.

        Raises
        ------
        ParameterError
            If a new name is not read, and is not given elsewhere.
        """
        found = []
        for remap in self.values:
            topic = remap.name.strip("~/")
            if remap.kind != "remap" or topic not in _TOPICS[self.direction]:
                continue
            if isinstance(remap.value, str):
                found.append(f"{remap.name}:={qualified(self.namespace, remap.value)}")
            elif topic not in overridden:
                message = f"{remap.name}: {remap.value.problem} (from {path}, line {remap.value.line})"
                raise ParameterError(message, hint=remap.value.hint or f"give it: `remap={topic}:=/TOPIC`")
        return tuple(found)


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
    changing
        What changes nodes from outside of them.
    """

    nodes: list[LaunchNode] = field(default_factory=list)
    arguments: set[str] = field(default_factory=set)
    ignored: list[str] = field(default_factory=list)
    changing: list[UnreadError] = field(default_factory=list)


def values_of_words(words: str, line: int) -> Iterator[LaunchValue]:
    """Yield what arguments of roslaunch and ros2 say: _name:=value, -p name:=value, -r from:=to, from:=to."""
    if "--params-file" in words:
        yield LaunchValue("file", "arguments", UnreadError.of(words, line), line)
    for option, word in re.findall(r"(?:(-[pr]|--param|--remap)\s+)?(\S+:=\S*)", words):
        left, _, right = word.partition(":=")
        if option in {"-p", "--param"} or (left.startswith("_") and not left.startswith("__")):
            yield LaunchValue("value", left.lstrip("_"), right, line)
        elif not left.startswith("__"):
            yield LaunchValue("remap", left, right, line)


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
