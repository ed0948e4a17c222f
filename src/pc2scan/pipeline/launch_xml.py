"""Reads XML launch files of ROS 1 and ROS 2."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError
from pc2scan.options.table import PARAMETERS

from .launch_node import (
    ELSEWHERE,
    LaunchFile,
    LaunchNode,
    NodeContent,
    UnreadError,
    direction_of,
    is_converter,
    package_folder,
    qualified,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

#: Maximum number of levels of nested elements, of substitutions in one text, and of its characters.
_MAX_DEPTH, _MAX_SUBSTITUTIONS, _MAX_TEXT = 50, 100, 10_000

_SUBSTITUTION = re.compile(r"\$\((arg|var|find|find-pkg-share)\s+'?([^()$'\s]*)'?\s*\)")

_TRUE, _FALSE = frozenset({"1", "true", "True", "yes"}), frozenset({"0", "false", "False", "no", ""})

_NODES = frozenset({"node", "composable_node"})

#: Elements outside of a node that may set its parameters.
_SETTERS = frozenset({"param", "rosparam", "set_parameter", "set_parameters_from_file"})


@dataclass(slots=True)
class _Element:
    tag: str
    attributes: dict[str, str]
    line: int
    children: list[_Element] = field(default_factory=list)
    text: str = ""

    def below(self) -> Iterator[_Element]:
        for child in self.children:
            yield child
            yield from child.below()

    @property
    def is_converter(self) -> bool:
        programs = "" if "$(" in self.programs else self.programs
        words = self.attributes.get("args", "")
        return self.tag in _NODES and is_converter(self.attributes.get("pkg", ""), programs, words)

    @property
    def programs(self) -> str:
        return "".join(self.attributes.get(name, "") for name in ("type", "exec", "plugin"))


def _tree(text: str, path: Path) -> _Element:
    """Return the root element. ElementTree has no line numbers, and always expands entities."""
    from xml.parsers import expat  # noqa: PLC0415  # only for launch files

    root = _Element("", {}, 0)
    stack = [root]
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > _MAX_DEPTH:
            raise ParameterError(f"{path}, line {parser.CurrentLineNumber}: nested more than {_MAX_DEPTH} levels deep")
        element = _Element(tag.replace("-", "_"), attributes, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def end(_tag: str) -> None:
        stack.pop()

    def characters(data: str) -> None:
        stack[-1].text += data

    def refuse(*_declared: object) -> None:
        raise ParameterError(
            f"{path}, line {parser.CurrentLineNumber}: it declares a document type, which is not supported",
            hint="remove the <!DOCTYPE ...>; launch files need none",
        )

    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = characters
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as err:
        raise ParameterError(f"{path}, line {err.lineno}: not valid XML: {expat.ErrorString(err.code)}") from err
    if root.children[0].tag != "launch":
        raise ParameterError(f"{path}: is not a launch file: its root is <{root.children[0].tag}>, not <launch>")
    return root.children[0]


@dataclass(slots=True)
class _Scope:
    """What applies to the elements of a group.

    Attributes
    ----------
    arguments
        Their values; `UnreadError` if they have none that is read.
    remaps
        Elements, and the scopes that they are in.
    """

    namespace: str
    doubt: str
    arguments: dict[str, str | UnreadError]
    remaps: list[tuple[_Element, _Scope]]

    def inner(self, doubt: str) -> _Scope:
        return _Scope(self.namespace, doubt or self.doubt, dict(self.arguments), list(self.remaps))


def xml_nodes(text: str, path: Path, arguments: Mapping[str, str], overridden: Collection[str]) -> LaunchFile:
    """Read an XML launch file; see `pc2scan.pipeline.launch_file.launch_node`."""
    return _XmlReader(path, arguments, overridden).read(_tree(text, path))


class _XmlReader:
    def __init__(self, path: Path, arguments: Mapping[str, str], overridden: Collection[str]) -> None:
        self._path = path
        self._given = arguments
        self._overridden = overridden
        self._file = LaunchFile()

    def read(self, root: _Element) -> LaunchFile:
        for element in root.below():
            if element.tag == "include":
                self._ignore(element, f"<include file={element.attributes.get('file', '')!r}>")
        self._read_group(root, _Scope("", "", {}, []))
        return self._file

    def _read_group(self, parent: _Element, scope: _Scope) -> None:
        for element in parent.children:
            is_open = element.attributes.get("scoped", "true").lower() == "false"
            has_converter = element.is_converter or any(each.is_converter for each in element.below())
            if element.tag in {"arg", "let"}:
                self._declare(element, scope)
            elif element.tag in {"remap", "set_remap"}:
                scope.remaps.append((element, scope.inner("")))
            elif element.tag in _SETTERS:
                self._ignore_setter(element)
            elif element.tag == "push_ros_namespace" and self._applies(element, scope):
                scope.namespace = qualified(scope.namespace, self._needed(element, "namespace", scope))
            elif element.tag == "group" and is_open:
                if self._applies(element, scope):
                    self._read_group(element, scope)
            elif has_converter:
                try:
                    if not self._condition(element, scope):
                        continue
                    doubt = ""
                except UnreadError as err:
                    doubt = f"under a condition ({err.problem}, line {err.line})"
                inner = scope.inner(doubt)
                if element.is_converter:
                    self._add_node(element, inner)
                    continue
                if element.tag == "group":
                    inner.namespace = qualified(scope.namespace, self._needed(element, "ns", scope))
                self._read_group(element, inner)

    def _add_node(self, element: _Element, scope: _Scope) -> None:
        programs = "".join(self._needed(element, name, scope) for name in ("type", "exec", "plugin"))
        direction = direction_of(programs + element.attributes.get("args", ""))
        space = self._needed(element, "ns", scope) or self._needed(element, "namespace", scope)
        scope.namespace = qualified(scope.namespace, space)
        name = qualified(scope.namespace, self._needed(element, "name", scope) or direction)
        read = partial(
            self._content, element, scope, NodeContent(self._path, direction, scope.namespace, self._overridden)
        )
        self._file.nodes.append(LaunchNode(name, element.line, scope.doubt, direction, read))

    def _content(self, element: _Element, scope: _Scope, content: NodeContent) -> NodeContent:
        own = [(child, scope) for child in element.children if child.tag == "remap"]
        for remap, outer in [*scope.remaps, *own]:
            if self._applies(remap, outer):
                content.add_remap(
                    self._needed(remap, "from", outer),
                    partial(self._text, remap.attributes.get("to", ""), remap, outer),
                )
        for child in element.children:
            if child.tag == "param" and self._applies(child, scope):
                self._add_params(child, scope, content)
            elif child.tag == "rosparam" and self._applies(child, scope):
                self._add_rosparam(child, scope, content)
        try:
            content.add_words(self._text(element.attributes.get("args", ""), element, scope), element.line)
        except UnreadError as err:
            raise self._refusal(f"args: {err.problem}", err) from None
        return content

    def _add_params(self, element: _Element, scope: _Scope, content: NodeContent, above: str = "") -> None:
        if "from" in element.attributes:
            content.add_param("", partial(self._path_of, "from", element, scope), element.line, "file")
            return
        name = above + self._needed(element, "name", scope)
        for child in element.children:
            self._add_params(child, scope, content, f"{name}.")

        def value() -> str:
            if "value" not in element.attributes:
                raise UnreadError("<param> has no value here", element.line)
            return self._text(element.attributes["value"], element, scope)

        if not element.children:
            content.add_param(name, value, element.line, of_type=element.attributes.get("type", ""))

    def _add_rosparam(self, element: _Element, scope: _Scope, content: NodeContent) -> None:
        if element.attributes.get("command", "load") != "load" or "ns" in element.attributes:
            unread = UnreadError("<rosparam> with `command` or `ns` is not read", element.line)
            raise self._refusal(unread.problem, unread)
        if "file" in element.attributes:
            content.add_param("", partial(self._path_of, "file", element, scope), element.line, "file")
            return
        substituted = element.attributes.get("subst_value", "").lower() in {"1", "true"}
        name = self._needed(element, "param", scope)
        read = partial(self._text, element.text, element, scope) if substituted else lambda: element.text
        content.add_param(name, read, element.line, "value" if name else "yaml")

    def _path_of(self, attribute: str, element: _Element, scope: _Scope) -> str:
        return str(self._path.parent / self._text(element.attributes[attribute], element, scope))

    def _declare(self, element: _Element, scope: _Scope) -> None:
        name = self._needed(element, "name", scope)
        self._file.arguments.add(name)
        try:
            if not self._condition(element, scope):
                return
            written = element.attributes.get("value", element.attributes.get("default"))
            if element.tag == "arg" and "value" not in element.attributes and name in self._given:
                scope.arguments[name] = self._given[name]
            elif written is not None:
                scope.arguments[name] = self._text(written, element, scope)
        except UnreadError as err:
            # Only an argument that is used needs a value: others have, say, files of packages that are not here.
            scope.arguments[name] = err

    def _condition(self, element: _Element, scope: _Scope) -> bool:
        for attribute, wanted in (("if", True), ("unless", False)):
            if attribute in element.attributes:
                text = self._text(element.attributes[attribute], element, scope).strip()
                if text not in _TRUE | _FALSE:
                    raise UnreadError(f"{attribute}={text!r} is neither true nor false", element.line)
                if (text in _TRUE) is not wanted:
                    return False
        return True

    def _applies(self, element: _Element, scope: _Scope) -> bool:
        """Return whether what a node needs is there."""
        try:
            return self._condition(element, scope)
        except UnreadError as err:
            name = element.attributes.get("name") or element.attributes.get("from") or f"<{element.tag}>"
            raise self._refusal(f"{name}: {err.problem}", err) from None

    def _needed(self, element: _Element, attribute: str, scope: _Scope) -> str:
        try:
            return self._text(element.attributes.get(attribute, ""), element, scope)
        except UnreadError as err:
            raise self._refusal(f"{attribute}: {err.problem}", err) from None

    def _text(self, text: str, element: _Element, scope: _Scope) -> str:
        """Replace substitutions such as ``$(arg ...)``, the innermost first."""
        for _ in range(_MAX_SUBSTITUTIONS):
            found = _SUBSTITUTION.search(text)
            if found is None:
                if "$(" in text:
                    raise UnreadError.of(text[text.index("$(") :], element.line)
                return text
            text = text[: found.start()] + self._value(found[1], found[2], element, scope) + text[found.end() :]
            if len(text) > _MAX_TEXT:
                break
        raise UnreadError("a text with too many substitutions is not read", element.line)

    def _value(self, kind: str, name: str, element: _Element, scope: _Scope) -> str:
        if kind.startswith("find"):
            return package_folder(self._path, name, element.line)
        self._file.arguments.add(name)
        value = scope.arguments.get(name, self._given.get(name))
        if isinstance(value, UnreadError):
            raise value
        if value is None:
            raise UnreadError.no_value(name, element.line)
        return value

    def _refusal(self, message: str, err: UnreadError) -> ParameterError:
        return ParameterError(f"{message} (from {self._path}, line {err.line})", hint=err.hint or ELSEWHERE)

    def _ignore_setter(self, element: _Element) -> None:
        """Add an element outside of nodes that may set a parameter of one."""
        name = element.attributes.get("name", "").rpartition("/")[2]
        if name in PARAMETERS or "name" not in element.attributes:
            self._ignore(element, f"<{element.tag}> outside of a node")

    def _ignore(self, element: _Element, what: str) -> None:
        self._file.ignored.append(f"{self._path}, line {element.line}, {what}")
