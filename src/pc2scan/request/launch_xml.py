"""Reads XML launch files of ROS 1 and ROS 2."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.parsers import expat

from pc2scan.errors import ParameterError
from pc2scan.options.table import PARAMETERS

from .launch_node import (
    LaunchFile,
    LaunchNode,
    LaunchValue,
    UnreadError,
    direction_of,
    is_converter,
    package_folder,
    qualified,
    values_of_words,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

#: Maximum number of characters of a text with its substitutions.
_MAX_TEXT = 10_000

_SUBSTITUTION = re.compile(r"\$\((arg|var|find|find-pkg-share) +([^()$\s]+) *\)")

_TRUE, _FALSE = frozenset({"1", "true", "True", "yes"}), frozenset({"0", "false", "False", "no", ""})

#: Elements that change the nodes beside them.
_CHANGING = frozenset({"push_ros_namespace", "set_remap", "set_parameter", "set_parameters_from_file"})


@dataclass(slots=True)
class _Element:
    tag: str
    attributes: dict[str, str]
    line: int
    children: list[_Element] = field(default_factory=list)
    text: str = ""


def _tree(text: str, path: Path) -> _Element:
    """Return the root element. ElementTree has no line numbers, and always expands entities."""
    root = _Element("", {}, 0)
    stack = [root]
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = _Element(tag.replace("-", "_"), attributes, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def characters(data: str) -> None:
        stack[-1].text += data

    def refuse(*_declared: object) -> None:
        raise ParameterError(
            f"{path}, line {parser.CurrentLineNumber}: it declares a document type, which is not supported",
            hint="remove the <!DOCTYPE ...>; launch files need none",
        )

    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _tag: stack.pop()
    parser.CharacterDataHandler = characters
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as err:
        raise ParameterError(f"{path}, line {err.lineno}: not valid XML: {expat.ErrorString(err.code)}") from err
    if root.children[0].tag != "launch":
        raise ParameterError(f"{path}: is not a launch file: its root is <{root.children[0].tag}>, not <launch>")
    return root.children[0]


def xml_nodes(text: str, path: Path, arguments: Mapping[str, str]) -> LaunchFile:
    """Read an XML launch file; see `pc2scan.request.launch_file.launch_node`."""
    reader = _XmlReader(path, arguments)
    reader.read(_tree(text, path), "", "", [])
    return reader.file


class _XmlReader:
    def __init__(self, path: Path, arguments: Mapping[str, str]) -> None:
        self.file = LaunchFile()
        self._path, self._given = path, arguments
        self._arguments: dict[str, str | UnreadError] = {}

    def read(self, parent: _Element, namespace: str, doubt: str, remaps: list[LaunchValue]) -> None:
        """Read the elements of a group, in their order; the rest is what applies to its nodes."""
        try:
            namespace, remaps = qualified(namespace, self._text(parent, "ns")), list(remaps)
        except UnreadError as err:
            self.file.changing.append(err)
        for element in parent.children:
            unsure, place = doubt, f"{self._path}, line {element.line}, <{element.tag}"
            try:
                if not self._applies(element):
                    continue
            except UnreadError as err:
                unsure = f"under a condition ({err.problem}, line {err.line})"
            name = element.attributes.get("name", "").rpartition("/")[2]
            match element.tag:
                case "include":
                    self.file.ignored.append(f"{place} file={element.attributes.get('file', '')!r}>")
                case "arg" | "let":
                    self._declare(element, unsure)
                case "remap" if parent.tag in {"launch", "group"}:
                    remaps += self._values(element)
                case "node" | "composable_node":
                    self._add_node(element, namespace, unsure, remaps)
                case "param" | "rosparam" if not name or name in PARAMETERS:
                    self.file.ignored.append(f"{place}> outside of a node")
                case tag if tag in _CHANGING:
                    if name != "use_sim_time":
                        self.file.changing.append(UnreadError(f"<{tag}> is not read", element.line))
                case _:
                    self.read(element, namespace, unsure, remaps)

    def _declare(self, element: _Element, doubt: str) -> None:
        name, given = element.attributes.get("name", ""), element.attributes.get("value")
        value: str | UnreadError
        try:
            if element.tag == "let" or doubt or name in self._arguments:
                problem = f"the argument {name!r}, which <let> sets, or which depends on a condition, is not read"
                raise UnreadError(problem, element.line)
            if given is None and name in self._given:
                value = self._given[name]
            elif given is None and "default" not in element.attributes:
                raise UnreadError.no_value(name, element.line)
            else:
                value = self._text(element, "default" if given is None else "value")
        except UnreadError as err:
            value = err
        self._arguments[name] = value

    def _add_node(self, element: _Element, namespace: str, doubt: str, remaps: list[LaunchValue]) -> None:
        words = element.attributes.get("args", "")
        try:
            programs = "".join(self._text(element, name) for name in ("type", "exec", "plugin"))
            if not is_converter(self._text(element, "pkg"), programs, words):
                return
            direction = direction_of(programs + words)
            for attribute in ("ns", "namespace"):
                namespace = qualified(namespace, self._text(element, attribute))
            name = qualified(namespace, self._text(element, "name") or direction)
        except UnreadError as err:
            self.file.nodes.append(LaunchNode.unclear(err))
            return
        values = [*remaps, *(value for child in element.children for value in self._values(child))]
        try:
            values += values_of_words(self._text(element, "args"), element.line)
        except UnreadError as err:
            values.append(LaunchValue("file", "args", err, err.line))
        self.file.nodes.append(LaunchNode(name, element.line, doubt, direction, namespace, values))

    def _values(self, element: _Element) -> Iterator[LaunchValue]:
        """Yield the parameter or remapping of an element, if it applies."""
        get = element.attributes.get
        text: str | None
        match element.tag:
            case "remap":
                kind, name, text = "remap", get("from", ""), get("to")
            case "param" if "from" not in element.attributes:
                kind, name, text = "value", get("name", ""), get("value")
            case "rosparam" if get("command", "load") != "load" or "ns" in element.attributes:
                kind, name, text = "file", "parameters", None
            case "param" | "rosparam" if file := get("from", get("file")):
                kind, name, text = "file", "parameters", str(self._path.parent / file)
            case "rosparam":
                kind, name = "value" if get("param") else "yaml", get("param", "parameters")
                is_plain = "$(" not in element.text or get("subst_value", "").lower() in {"1", "true"}
                text = element.text if is_plain else None
            case _:
                return
        value: str | UnreadError
        try:
            if not self._applies(element):
                return
            if text is None:
                raise UnreadError(f"<{element.tag}> has no value here", element.line)
            name, value = self._expanded(name, element.line), self._expanded(text, element.line)
        except UnreadError as err:
            kind, value = "file" if "$(" in name else kind, err
        yield LaunchValue(kind, name, value, element.line, get("type", ""))

    def _applies(self, element: _Element) -> bool:
        for attribute, wanted in (("if", _TRUE), ("unless", _FALSE)):
            if attribute in element.attributes:
                text = self._text(element, attribute).strip()
                if text not in _TRUE | _FALSE:
                    raise UnreadError(f"{attribute}={text!r} is neither true nor false", element.line)
                if text not in wanted:
                    return False
        return True

    def _text(self, element: _Element, attribute: str) -> str:
        return self._expanded(element.attributes.get(attribute, ""), element.line)

    def _expanded(self, text: str, line: int) -> str:
        """Replace substitutions such as ``$(arg ...)``."""

        def value(found: re.Match[str]) -> str:
            kind, name = found.groups()
            if kind.startswith("find"):
                return package_folder(self._path, name, line)
            self.file.arguments.add(name)
            known = self._arguments.get(name, self._given.get(name, UnreadError.no_value(name, line)))
            if isinstance(known, UnreadError):
                raise known
            return known

        text = _SUBSTITUTION.sub(value, text)
        if "$(" in text or len(text) > _MAX_TEXT:
            raise UnreadError.of(text[max(text.find("$("), 0) :], line)
        return text
