"""Reads launch files of ROS 1 and ROS 2: nodes of pointcloud_to_laserscan, their parameters and remappings.

Files in Python are read as the XML that says the same; see `pc2scan.request.launch_python`.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import ParameterError, UsageError, visible
from pc2scan.options.table import PARAMETERS
from pc2scan.transforms.text_files import xml_tree

from .launch_python import python_tree

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from pc2scan.transforms.text_files import Element

#: What gives the parameters of a node that is not read.
ELSEWHERE = "give its parameters without the launch file: `params_file=FILE` of YAML, or `param=NAME:=VALUE`"

#: How many characters of an expression errors show.
_SHOWN = 60

#: Maximum number of characters of a text with its substitutions.
_MAX_TEXT = 10_000

_SUBSTITUTION = re.compile(r"\$\((arg|var|find|find-pkg-share) +([^()$\s]+) *\)")

_TRUE, _FALSE = {"1", "true", "True", "yes"}, {"0", "false", "False", "no", ""}

#: Elements that change the nodes beside them.
_CHANGING = {"push_ros_namespace", "set_remap", "set_parameter", "set_parameters_from_file"}


class UnreadError(Exception):
    """A text of a launch file is not read: the problem, the line, and what to type if any use of it needs the same."""

    def __init__(self, problem: str, line: int, hint: str | None = None) -> None:
        super().__init__(problem)
        self.problem, self.line, self.hint = problem, line, hint


class LaunchValue(NamedTuple):
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
    """

    kind: str
    name: str
    value: str | UnreadError
    line: int


class LaunchNode(NamedTuple):
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


class LaunchFile:
    """What is read of a launch file.

    Parameters
    ----------
    text, path
        The file: Python if its name ends in ``.py``, otherwise XML.
    given
        Values of its arguments; the others have the defaults in the file.

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

    def __init__(self, text: str, path: Path, given: Mapping[str, str]) -> None:
        self._path, self._given, self._is_python = path, given, path.suffix == ".py"
        self._values: dict[str, str | UnreadError] = {}
        self.nodes: list[LaunchNode] = []
        self.arguments: set[str] = set()
        self.ignored: list[str] = []
        self.unread: list[UnreadError] = []
        try:
            root = python_tree(text) if self._is_python else xml_tree(text)
        except UsageError as err:
            raise ParameterError(f"{path}, {err.message}", hint=err.hint) from err
        if root.tag != "launch":
            raise ParameterError(f"{path}: is not a launch file: its root is <{root.tag}>, not <launch>")
        self._read(root, "", "", ())

    def _read(self, parent: Element, namespace: str, doubt: str, remaps: tuple[LaunchValue, ...]) -> None:
        """Read the elements of a group, in their order; the rest is what applies to its nodes."""
        try:
            namespace = qualified(namespace, self._expanded(parent.attributes.get("ns", ""), parent))
        except UnreadError as err:
            self.unread.append(err)
        for element in parent.children:
            get, place = element.attributes.get, f"{self._path}, line {element.line}, <{element.tag}"
            unsure = get("doubt", doubt)
            try:
                if not self._applies(element):
                    continue
            except UnreadError as err:
                unsure = f"under a condition ({err.problem}, line {err.line})"
            match element.tag.replace("-", "_"):
                case "include":
                    self.ignored.append(f"{place} file={get('file', '')!r}>")
                case "arg" | "let":
                    self._declare(element, unsure)
                case "remap" if parent.tag in {"launch", "group"}:
                    remaps = (*remaps, *self._settings(element))
                case "node" | "composable_node":
                    try:
                        self._add_node(element, namespace, unsure, remaps)
                    except UnreadError as err:
                        self.unread.append(err)
                case "param" | "rosparam" if get("name", "").rpartition("/")[2] in {"", *PARAMETERS}:
                    self.ignored.append(f"{place}> outside of a node")
                case tag if tag in _CHANGING and get("name") != "use_sim_time":
                    self.unread.append(_unread(get("source", f"<{tag}>"), element.line))
                case _:
                    self._read(element, namespace, unsure, remaps)

    def _declare(self, element: Element, doubt: str) -> None:
        get, name = element.attributes.get, element.attributes.get("name", "")
        text = get("value", get("default"))
        self.arguments.add(name)
        if "$(" in name:
            self.unread.append(UnreadError("the name of an argument is not read", element.line))
        try:
            if element.tag == "let" or doubt or name in self._values:
                problem = f"the argument {name!r}, which <let> sets, or which depends on a condition, is not read"
                self._values[name] = UnreadError(problem, element.line)
            elif name in self._given and "value" not in element.attributes:
                self._values[name] = self._given[name]
            elif text is not None:
                self._values[name] = self._expanded(text, element)
        except UnreadError as err:
            self._values[name] = err

    def _add_node(self, element: Element, above: str, doubt: str, remaps: tuple[LaunchValue, ...]) -> None:
        """Add a node, if it is one of pointcloud_to_laserscan."""

        def text(*names: str) -> str:
            return self._expanded("".join(element.attributes.get(name, "") for name in names), element)

        program = text("type", "exec", "plugin")
        named = program + text("args") if "nodelet" in program else program or text("pkg")
        if not re.search("pointcloud_?to_?laserscan", named, re.IGNORECASE):
            return
        values = (*remaps, *(value for child in element.children for value in self._settings(child)))
        words = text("args")
        if ":=" in words or "--params-file" in words:
            values = (LaunchValue("file", "arguments", _unread(words, element.line), element.line),)
        namespace = qualified(above, text("ns", "namespace"))
        name = qualified(namespace, text("name") or "pointcloud_to_laserscan")
        self.nodes.append(LaunchNode(name, element.line, doubt, namespace, values))

    def _settings(self, element: Element) -> Iterator[LaunchValue]:
        """Yield the parameter or remapping of an element, if it applies."""
        get = element.attributes.get
        kind, name, text = "value", get("name", get("param", "")), get("value")
        file = get("from", get("file"))
        match element.tag:
            case "remap":
                kind, name, text = "remap", get("from", ""), get("to")
            case "param" | "rosparam" if file:
                kind, name, text = "file", "parameters", file
            case "rosparam":
                kind, name = "value" if name else "yaml", name or "parameters"
                text = element.text if "$(" not in element.text or get("subst_value") == "true" else None
            case tag if tag != "param":
                return
        value: str | UnreadError
        try:
            if not self._applies(element):
                return
            if text is None or get("command", "load") != "load" or "ns" in element.attributes:
                raise UnreadError(f"<{element.tag}> has no value here", element.line)
            name, value = self._expanded(name, element), self._expanded(text, element)
        except UnreadError as err:
            kind, name = ("file", "parameters") if "$(" in name else (kind, name)
            value = err
        yield LaunchValue(kind, name, value, element.line)

    def _applies(self, element: Element) -> bool:
        for attribute, words in (("if", _TRUE), ("unless", _FALSE)):
            if attribute in element.attributes:
                text = self._expanded(element.attributes[attribute], element).strip()
                if text not in _TRUE | _FALSE:
                    raise UnreadError(f"{attribute}={text!r} is neither true nor false", element.line)
                if text not in words:
                    return False
        return True

    def _expanded(self, text: str, element: Element) -> str:
        """Replace substitutions such as ``$(arg ...)``."""

        def value(match: re.Match[str]) -> str:
            kind, name = match.groups()
            if kind.startswith("find"):
                return _package_folder(self._path, name, element.line)
            self.arguments.add(name)
            known = self._values.get(name, self._given.get(name))
            if isinstance(known, str):
                return known
            raise known or UnreadError(
                f"the argument {name!r} has no value", element.line, f"`launch_args={name}:=VALUE`"
            )

        text = _SUBSTITUTION.sub(value, text)
        if "$(" in text or len(text) > _MAX_TEXT:
            unread = text[max(text.find("$("), 0) :]
            raise _unread(unread[2:].rpartition(")")[0] if self._is_python else unread, element.line)
        return text


def _unread(source: str, line: int) -> UnreadError:
    return UnreadError(f"`{visible(source, _SHOWN)}` is not read", line)


def qualified(above: str, name: str) -> str:
    """Return a name inside a namespace."""
    return ("" if name.startswith("/") else above) + "/" * bool(name) + name.strip("/")


def _package_folder(path: Path, name: str, line: int) -> str:
    """Return the folder of the package that a launch file is in; raise UnreadError if it is another package."""
    for folder in path.resolve().parents:
        if folder.name == name:
            return str(folder)
        if (folder / "package.xml").is_file():
            with (folder / "package.xml").open("rb") as file:
                if f"<name>{name}</name>".encode() in file.read(100_000):
                    return str(folder)
    raise UnreadError(f"the package {name!r} was not found", line)
