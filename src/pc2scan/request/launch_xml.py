"""Reads XML launch files of ROS 1 and ROS 2."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError, UsageError
from pc2scan.options.table import PARAMETERS
from pc2scan.transforms.text_files import xml_tree

from .launch_node import LaunchFile, LaunchValue, UnreadError, package_folder, qualified

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from pc2scan.transforms.text_files import Element

#: Maximum number of characters of a text with its substitutions.
_MAX_TEXT = 10_000

_SUBSTITUTION = re.compile(r"\$\((arg|var|find|find-pkg-share) +([^()$\s]+) *\)")

_TRUE, _FALSE = {"1", "true", "True", "yes"}, {"0", "false", "False", "no", ""}

#: Elements that change the nodes beside them.
_CHANGING = {"push_ros_namespace", "set_remap", "set_parameter", "set_parameters_from_file"}

#: What nodes have in attributes of ROS 1 and ROS 2.
_ATTRIBUTES = {
    "package": ("pkg",),
    "program": ("type", "exec", "plugin"),
    "arguments": ("args",),
    "namespace": ("ns", "namespace"),
    "name": ("name",),
}


def xml_nodes(text: str, path: Path, arguments: Mapping[str, str]) -> LaunchFile:
    """Read an XML launch file; see `pc2scan.request.params_file.launch_node`."""
    reader = _XmlReader(path, arguments)
    try:
        root = xml_tree(text)
    except UsageError as err:
        raise ParameterError(f"{path}, {err.message}", hint=err.hint) from err
    if root.tag != "launch":
        raise ParameterError(f"{path}: is not a launch file: its root is <{root.tag}>, not <launch>")
    reader.read(root, "", "", ())
    return reader.file


class _XmlReader:
    def __init__(self, path: Path, arguments: Mapping[str, str]) -> None:
        self.file = LaunchFile()
        self._path, self._given = path, arguments
        self._arguments: dict[str, str | UnreadError] = {}

    def read(self, parent: Element, namespace: str, doubt: str, remaps: tuple[LaunchValue, ...]) -> None:
        """Read the elements of a group, in their order; the rest is what applies to its nodes."""
        try:
            namespace = qualified(namespace, self._expanded(parent.attributes.get("ns", ""), parent))
        except UnreadError as err:
            self.file.unread.append(err)
        for element in parent.children:
            get, unsure, place = element.attributes.get, doubt, f"{self._path}, line {element.line}, <{element.tag}"
            try:
                if not self._applies(element):
                    continue
            except UnreadError as err:
                unsure = f"under a condition ({err.problem}, line {err.line})"
            match element.tag.replace("-", "_"):
                case "include":
                    self.file.ignored.append(f"{place} file={get('file', '')!r}>")
                case "arg" | "let":
                    self._declare(element, unsure)
                case "remap" if parent.tag in {"launch", "group"}:
                    remaps = (*remaps, *self._values(element))
                case "node" | "composable_node":
                    self._add_node(element, namespace, unsure, remaps)
                case "param" | "rosparam" if get("name", "").rpartition("/")[2] in {"", *PARAMETERS}:
                    self.file.ignored.append(f"{place}> outside of a node")
                case tag if tag in _CHANGING and get("name") != "use_sim_time":
                    self.file.unread.append(UnreadError(f"<{tag}> is not read", element.line))
                case _:
                    self.read(element, namespace, unsure, remaps)

    def _declare(self, element: Element, doubt: str) -> None:
        get, name = element.attributes.get, element.attributes.get("name", "")
        text = get("value", get("default"))
        try:
            if element.tag == "let" or doubt or name in self._arguments:
                problem = f"the argument {name!r}, which <let> sets, or which depends on a condition, is not read"
                self._arguments[name] = UnreadError(problem, element.line)
            elif name in self._given and "value" not in element.attributes:
                self._arguments[name] = self._given[name]
            elif text is not None:
                self._arguments[name] = self._expanded(text, element)
        except UnreadError as err:
            self._arguments[name] = err

    def _add_node(self, element: Element, above: str, doubt: str, remaps: tuple[LaunchValue, ...]) -> None:
        def text(name: str) -> str:
            given = (element.attributes.get(attribute, "") for attribute in _ATTRIBUTES[name])
            return self._expanded("".join(given), element)

        values = [*remaps, *(value for child in element.children for value in self._values(child))]
        self.file.add_node(text, values, element.line, doubt, above)

    def _values(self, element: Element) -> Iterator[LaunchValue]:
        """Yield the parameter or remapping of an element, if it applies."""
        get = element.attributes.get
        kind, name, text = "value", get("name", get("param", "")), get("value")
        file = get("from", get("file"))
        match element.tag:
            case "remap":
                kind, name, text = "remap", get("from", ""), get("to")
            case "param" | "rosparam" if file:
                kind, name, text = "file", "parameters", str(self._path.parent / file)
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
            kind, value = "file" if "$(" in name else kind, err
        yield LaunchValue(kind, name, value, element.line, get("type", ""))

    def _applies(self, element: Element) -> bool:
        for attribute, wanted in (("if", _TRUE), ("unless", _FALSE)):
            if attribute in element.attributes:
                text = self._expanded(element.attributes[attribute], element).strip()
                if text not in _TRUE | _FALSE:
                    raise UnreadError(f"{attribute}={text!r} is neither true nor false", element.line)
                if text not in wanted:
                    return False
        return True

    def _expanded(self, text: str, element: Element) -> str:
        """Replace substitutions such as ``$(arg ...)``."""

        def value(found: re.Match[str]) -> str:
            kind, name = found.groups()
            if kind.startswith("find"):
                return package_folder(self._path, name, element.line)
            self.file.arguments.add(name)
            known = self._arguments.get(name, self._given.get(name))
            if isinstance(known, str):
                return known
            raise known or UnreadError.no_value(name, element.line)

        text = _SUBSTITUTION.sub(value, text)
        if "$(" in text or len(text) > _MAX_TEXT:
            raise UnreadError.of(text[max(text.find("$("), 0) :], element.line)
        return text
