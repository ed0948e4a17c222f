"""Reads the parameters and remappings of pointcloud_to_laserscan nodes from XML launch files of ROS 1 and ROS 2.

Nothing is launched, and nothing in a file is executed. Files are untrusted: their size and depth are bounded, and
document types are refused, because they can declare entities.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from pc2scan.errors import ParameterError, SeveralNodesError, name_list
from pc2scan.text import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from typing_extensions import Self

    from .parameters import Direction

#: Maximum number of levels of nested elements.
_MAX_DEPTH = 50

#: Maximum number of substitutions in one text, including nested ones.
_MAX_SUBSTITUTIONS = 100

_SUBSTITUTION = re.compile(r"\$\(([a-z-]+)\s*([^()$]*)\)")

#: Topics whose remappings are read.
_TOPICS: dict[Direction, frozenset[str]] = {
    "pointcloud_to_laserscan": frozenset({"cloud_in", "scan", "tf", "tf_static"}),
    "laserscan_to_pointcloud": frozenset({"scan_in", "cloud", "tf", "tf_static"}),
}

_TRUE, _FALSE = frozenset({"1", "true", "True", "yes"}), frozenset({"0", "false", "False", "no", ""})


@dataclass(slots=True)
class _Element:
    tag: str
    attributes: dict[str, str]
    line: int
    children: list[_Element] = field(default_factory=list)
    text: str = ""


class LaunchText(str):
    """A text of a launch file, after substitution.

    Attributes
    ----------
    shown
        The text for errors. If the value of an environment variable is in the text, it is the text as written, which
        names the variable.
    """

    __slots__ = ("shown",)
    shown: str

    def __new__(cls, value: str, shown: str | None = None) -> Self:
        """Make a text from its value and what errors show."""
        made = super().__new__(cls, value)
        made.shown = value if shown is None else shown
        return made

    @property
    def is_hidden(self) -> bool:
        """Whether errors must not show the text."""
        return self.shown != str(self)


_NOTHING = LaunchText("")


@dataclass(frozen=True, slots=True)
class LaunchParam:
    """One parameter element of a node.

    Attributes
    ----------
    name
        The name; empty for a file or a block of YAML.
    value
        The text.
    kind
        ``value``; ``yaml``, a block of YAML; or ``file``, the path of one.
    line
        The line of the element.
    type
        ROS 1's type; empty if there is none.
    """

    name: LaunchText
    value: LaunchText
    kind: str
    line: int
    type: str = ""


@dataclass(frozen=True, slots=True)
class LaunchNode:
    """A node of a launch file.

    Attributes
    ----------
    name
        The fully qualified name.
    direction
        Which of the two nodes it is.
    params
        In the order of the file.
    remaps
        ``cloud_in:=/points``, as they apply to the node.
    ignored
        ``include`` elements, with their places. They are not read, but may set parameters.
    """

    name: LaunchText
    direction: Direction
    params: tuple[LaunchParam, ...]
    remaps: tuple[str, ...]
    ignored: tuple[str, ...] = ()


def is_launch_xml(text: str) -> bool:
    """Whether the text of a parameter file is XML: no YAML file of parameters begins with ``<``."""
    return re.match(r"\s*<[?!a-zA-Z]", text) is not None


def launch_node(text: str, path: Path, arguments: Mapping[str, str], node: str | None) -> LaunchNode:
    """Read the node of a launch file.

    Parameters
    ----------
    text, path
        The file.
    arguments
        Values of its arguments; the others have the defaults in the file.
    node
        Name of the node, with or without its namespace; None: the only node in the file.

    Raises
    ------
    ParameterError
        If the text is not a launch file, an argument has no value, or there is no node of pointcloud_to_laserscan, or
        more than one.
    """
    reader = _LaunchReader(path, dict(arguments))
    nodes = list(reader.nodes(_parse(text, path)))
    if not nodes:
        raise ParameterError(
            f"{path}: no node of pointcloud_to_laserscan in it",
            hint="includes are not followed: name the file that has the node" if reader.ignored else None,
        )
    names = [name.shown for name, *_ in nodes]
    if node is not None:
        chosen = [entry for entry in nodes if entry[0] == "/" + node.strip("/") or entry[0].endswith(f"/{node}")]
        if not chosen:
            near = did_you_mean(node, names) or None
            raise ParameterError(f"{path}: no node {node!r} (from `node`); found {name_list(names)}", hint=near)
    else:
        chosen = nodes
    if len(chosen) > 1:
        names = [name.shown for name, *_ in chosen]
        message, hint = (
            f"{path}: several nodes match: {name_list(names)}",
            f"choose one, for example `node={names[0]}`",
        )
        others = any(_direction_of(element) == "laserscan_to_pointcloud" for _, element, _ in chosen)
        if others or len(set(names)) < len(names):
            raise ParameterError(message, hint=hint)
        raise SeveralNodesError(message, nodes=tuple(name for name, *_ in chosen), hint=hint)
    ((name, element, scope),) = chosen
    found = reader.node(name, element, scope)
    if unused := sorted(arguments.keys() - reader.arguments.keys()):
        declared = sorted(name.shown for name in reader.arguments)
        raise ParameterError(
            f"{path}: it has no argument {unused[0]!r}",
            hint=f"{did_you_mean(unused[0], declared)} its arguments are {name_list(declared)}".strip(),
        )
    return found


def _parse(text: str, path: Path) -> _Element:
    """Return the root element. ElementTree is not used: it has no line numbers, and always expands entities."""
    from xml.parsers import expat  # noqa: PLC0415  # only for launch files

    root = _Element("", {}, 0)
    stack = [root]
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > _MAX_DEPTH:
            raise ParameterError(f"{path}, line {parser.CurrentLineNumber}: nested more than {_MAX_DEPTH} levels deep")
        element = _Element(tag, attributes, parser.CurrentLineNumber)
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


@dataclass(frozen=True, slots=True)
class _Scope:
    """The namespace, parameters and remappings that apply to an element."""

    namespace: LaunchText = _NOTHING
    remaps: tuple[str, ...] = ()


_Found = tuple[LaunchText, _Element, _Scope]


class _LaunchReader:
    """Walks through the elements of a file, with the values of its arguments."""

    def __init__(self, path: Path, arguments: dict[str, str]) -> None:
        self.path = path
        self.given = arguments
        #: Arguments of the file, with a value or None.
        self.arguments: dict[LaunchText, LaunchText | None] = {}
        self.ignored: list[str] = []

    def nodes(self, parent: _Element, scope: _Scope | None = None) -> Iterator[_Found]:
        """Yield the nodes of pointcloud_to_laserscan below an element."""
        scope = scope or _Scope()
        for element in parent.children:
            tag = element.tag
            if tag in {"arg", "let"}:
                if self._applies(element):
                    self._declare(element)
            elif tag == "include":
                self.ignored.append(f"{self._place(element)}, <include file={element.attributes.get('file', '')!r}>")
            elif tag in {"remap", "set_remap"} and self._applies(element):
                scope = _Scope(scope.namespace, (*scope.remaps, self._remap(element)))
            elif tag in {"push-ros-namespace", "push_ros_namespace"} and self._applies(element):
                scope = _Scope(_qualified_name(scope.namespace, self._read(element, "namespace")), scope.remaps)
            elif tag in {"group", "node_container", "load_composable_node"}:
                if self._applies(element):
                    space = self._read(element, "ns" if tag == "group" else "")
                    yield from self.nodes(element, _Scope(_qualified_name(scope.namespace, space), scope.remaps))
            elif tag in {"node", "composable_node"} and _is_upstream_node(element) and self._applies(element):
                space = self._read(element, "ns") or self._read(element, "namespace")
                inner = _Scope(_qualified_name(scope.namespace, space), scope.remaps)
                own = self._read(element, "name") or LaunchText(_direction_of(element))
                yield _qualified_name(inner.namespace, own), element, inner

    def node(self, full: LaunchText, element: _Element, scope: _Scope) -> LaunchNode:
        """Read a node."""
        remaps = list(scope.remaps)
        params: list[LaunchParam] = []
        for child in element.children:
            if child.tag in {"param", "rosparam", "remap"} and not self._applies(child):
                continue
            if child.tag == "remap":
                remaps.append(self._remap(child))
            elif child.tag == "param":
                params += self._params(child)
            elif child.tag == "rosparam":
                params.append(self._rosparam(child))
        # Arguments of roslaunch and ros2: _name:=value, -p name:=value, -r from:=to, from:=to.
        args = self._read(element, "args")
        words = re.findall(r"(?:(-[pr]|--param|--remap)\s+)?(\S+:=\S*)", args)
        for option, word in words:
            left, _, right = word.partition(":=")
            if option in {"-p", "--param"} or (left.startswith("_") and not left.startswith("__")):
                name, value = (
                    LaunchText(each, args.shown if args.is_hidden else None) for each in (left.lstrip("_"), right)
                )
                params.append(LaunchParam(name, value, "value", element.line))
            elif not left.startswith("__"):
                remaps.append(word)
        own = _TOPICS[_direction_of(element)]
        resolved = tuple(
            _qualified_remap(remap, scope.namespace) for remap in remaps if remap.partition(":=")[0].strip("~/") in own
        )
        return LaunchNode(full, _direction_of(element), tuple(params), resolved, tuple(self.ignored))

    def _params(self, element: _Element, above: LaunchText = _NOTHING) -> Iterator[LaunchParam]:
        source = self._read(element, "from")
        if source:
            yield LaunchParam(_NOTHING, self._file(source), "file", element.line)
            return
        own = self._read(element, "name")
        name = LaunchText(above + own, above.shown + own.shown)
        if element.children:
            for child in element.children:
                yield from self._params(child, LaunchText(f"{name}.", f"{name.shown}."))
            return
        if "value" not in element.attributes:
            raise ParameterError(
                f"{name.shown}: <param> has no value here (from {self._place(element)})",
                name=name.shown,
                hint=f"textfile, binfile and command are not supported; give its value: `{name}=...`"
                if name.shown.isidentifier()
                else None,
            )
        value = self._read(element, "value")
        yield LaunchParam(name, value, "value", element.line, self._read(element, "type"))

    def _rosparam(self, element: _Element) -> LaunchParam:
        command = element.attributes.get("command", "load")
        if command != "load":
            raise ParameterError(f"<rosparam command={command!r}> is not supported (from {self._place(element)})")
        if "file" in element.attributes:
            return LaunchParam(_NOTHING, self._file(self._read(element, "file")), "file", element.line)
        substituted = element.attributes.get("subst_value", "").lower() in {"1", "true"}
        text = self._substituted(element.text, element) if substituted else LaunchText(element.text)
        name = self._read(element, "param")
        return LaunchParam(name, text, "value" if name else "yaml", element.line)

    def _file(self, text: LaunchText) -> LaunchText:
        if Path(text).is_absolute():
            return text
        return LaunchText(str(self.path.parent / text), str(self.path.parent / text.shown))

    def _declare(self, element: _Element) -> None:
        name = self._read(element, "name")
        if element.tag == "let" or "value" in element.attributes:
            self.arguments[name] = self._read(element, "value")
        elif name in self.given:
            self.arguments[name] = LaunchText(self.given[name])
        elif "default" in element.attributes:
            self.arguments[name] = self._read(element, "default")
        else:
            self.arguments.setdefault(name, None)

    def _applies(self, element: _Element) -> bool:
        for attribute, wanted in (("if", True), ("unless", False)):
            if attribute in element.attributes:
                text = self._read(element, attribute)
                if text.strip() not in _TRUE | _FALSE:
                    raise ParameterError(
                        f"{attribute}={text.shown!r} is neither true nor false (from {self._place(element)})"
                    )
                if (text.strip() in _TRUE) is not wanted:
                    return False
        return True

    def _remap(self, element: _Element) -> str:
        return f"{self._read(element, 'from')}:={self._read(element, 'to')}"

    def _place(self, element: _Element) -> str:
        return f"{self.path}, line {element.line}"

    def _read(self, element: _Element, attribute: str) -> LaunchText:
        return self._substituted(element.attributes.get(attribute, ""), element)

    def _substituted(self, written: str, element: _Element) -> LaunchText:
        """Replace substitutions such as ``$(arg ...)``, the innermost first."""
        text = LaunchText(written)
        for _ in range(_MAX_SUBSTITUTIONS):
            found = _SUBSTITUTION.search(text)
            if found is None:
                if "$(" in text:
                    self._refuse(text.shown[text.shown.index("$(") :], element)
                return text
            # Once the value of a variable is in the text, a substitution that fails is shown as it is written.
            shown = text.shown if text.is_hidden else ""
            value = self._value(found[1], found[2].strip(), element, shown)
            made = text[: found.start()] + value + text[found.end() :]
            text = LaunchText(made, written if shown or value.is_hidden else None)
            if len(text) > 10_000:
                break
        raise ParameterError(f"too many substitutions (from {self._place(element)})")

    def _value(self, kind: str, rest: str, element: _Element, shown: str) -> LaunchText:
        """Return the value of a substitution; errors have ``shown``, or its name if that is empty."""
        name, *more = rest.split()[:2] or [""]
        name, default = name.strip("'\""), " ".join(more).strip("'\"")
        match kind:
            case "arg" | "var":
                key = LaunchText(name, shown or None)
                value = self.arguments.get(key)
                if value is None and name in self.given:
                    value = LaunchText(self.given[name])
                if value is None:
                    self.arguments.setdefault(key, None)
                    raise ParameterError(
                        f"{self.path}: needs a value for its argument {key.shown!r} (from {self._place(element)})",
                        hint=None if shown else f"`launch_args={name}:=VALUE`",
                    )
                return value
            case "env" | "optenv":
                found = os.environ.get(name, default if more or kind == "optenv" else None)
                if found is None:
                    raise ParameterError(
                        f"{self.path}: needs the environment variable {shown or name} (from {self._place(element)})",
                        hint=None if shown else f"{name}=VALUE pc2scan ...",
                    )
                return LaunchText(found, f"$({kind} {rest})" if name in os.environ else None)
            case "dirname":
                return LaunchText(str(self.path.parent))
            case "find" | "find-pkg-share":
                return LaunchText(str(self._package(name, element, shown)))
            case "anon":
                return LaunchText(name)
        return self._refuse(shown or f"$({kind} {rest})", element)

    def _package(self, name: str, element: _Element, shown: str) -> Path:
        """Return the folder of the package that the file is in. Other packages would need a ROS installation."""
        for folder in self.path.resolve().parents:
            if folder.name == name or (folder / "package.xml").exists():
                return folder
        raise ParameterError(
            f"{self.path}: the package {shown or name!r} was not found (from {self._place(element)})",
            hint="give the parameter file in it: `params_file=FILE`",
        )

    def _refuse(self, text: str, element: _Element) -> NoReturn:
        raise ParameterError(
            f"{text[:80]!r} cannot be computed without ROS (from {self._place(element)})",
            hint="write its value into a copy of the file",
        )


def _is_upstream_node(element: _Element) -> bool:
    said = [element.attributes.get(name, "") for name in ("pkg", "type", "exec", "plugin", "args")]
    return any("pointcloud_to_laserscan" in text or "laserscan_to_pointcloud" in text for text in said)


def _direction_of(element: _Element) -> Direction:
    said = "".join(element.attributes.get(name, "") for name in ("type", "exec", "plugin", "args"))
    said = said.lower().replace("_", "").replace("pointcloudtolaserscan/", "").replace("pointcloudtolaserscan::", "")
    return "laserscan_to_pointcloud" if "laserscantopointcloud" in said else "pointcloud_to_laserscan"


def _qualified_name(above: LaunchText, name: LaunchText) -> LaunchText:
    """Return a name inside a namespace."""
    return LaunchText(_qualified(above, name), _qualified(above.shown, name.shown))


def _qualified(above: str, name: str) -> str:
    if name.startswith("/"):
        return name.rstrip("/")
    return "/".join(filter(None, (above, name.strip("/")))) if above else f"/{name}".rstrip("/")


def _qualified_remap(remap: str, namespace: str) -> str:
    """Return a remapping with the fully qualified name on its right side."""
    left, _, right = remap.partition(":=")
    return f"{left}:={_qualified(namespace, right)}"
