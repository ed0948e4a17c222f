"""Reads the parameters and remappings of pointcloud_to_laserscan nodes from launch files of ROS 1 and ROS 2.

A file is a tree of elements, with the names of XML; `pc2scan.pipeline.launch_python` makes this tree of a Python file.

Nothing is launched, and nothing in a file is executed.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from pc2scan.errors import ParameterError, SeveralNodesError, name_list
from pc2scan.text import did_you_mean

from .launch_tree import Element, NotLiteral, xml_tree

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from typing_extensions import Self

    from .parameters import Direction

#: Maximum number of substitutions in one text, including nested ones.
_MAX_SUBSTITUTIONS = 100

_SUBSTITUTION = re.compile(r"\$\(([a-z-]+)\s*([^()$]*)\)")

#: Topics whose remappings are read.
_TOPICS: dict[Direction, frozenset[str]] = {
    "pointcloud_to_laserscan": frozenset({"cloud_in", "scan", "tf", "tf_static"}),
    "laserscan_to_pointcloud": frozenset({"scan_in", "cloud", "tf", "tf_static"}),
}

_TRUE, _FALSE = frozenset({"1", "true", "True", "yes"}), frozenset({"0", "false", "False", "no", ""})


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
        ``value``; ``yaml``, a block of YAML; ``file``, the path of one; or ``unread``, a value that cannot be computed
        here, and is the reason.
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


def launch_node(
    text: str, path: Path, arguments: Mapping[str, str], node: str | None, overridden: Collection[str] = ()
) -> LaunchNode:
    """Read the node of a launch file.

    Parameters
    ----------
    text, path
        The file: Python if its name ends in ``.py``, otherwise XML.
    arguments
        Values of its arguments; the others have the defaults in the file.
    node
        Name of the node, with or without its namespace; None: the only node in the file.
    overridden
        Parameters, and topics in the node's names, whose values are given elsewhere.

    Raises
    ------
    ParameterError
        If the text is not a launch file, an argument has no value, a text cannot be computed, or there is no node of
        pointcloud_to_laserscan, or more than one.
    """
    reader = _LaunchReader(path, dict(arguments), overridden)
    if path.suffix == ".py":
        from .launch_python import python_tree  # noqa: PLC0415  # only for Python files

        root = python_tree(text, path)
    else:
        root = xml_tree(text, path)
    nodes = list(reader.nodes(root))
    if not nodes:
        hint = "includes are not followed: name the file that has the node" if reader.ignored else None
        if reader.unread:
            hint = f"not followed: {name_list(reader.unread)}; name the file that has the node"
        raise ParameterError(f"{path}: no node of pointcloud_to_laserscan in it", hint=hint)
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


@dataclass(frozen=True, slots=True)
class _Scope:
    """The namespace, parameters and remappings that apply to an element."""

    namespace: LaunchText = _NOTHING
    remaps: tuple[str, ...] = ()


_Found = tuple[LaunchText, Element, _Scope]


class _LaunchReader:
    """Walks through the elements of a file, with the values of its arguments."""

    def __init__(self, path: Path, arguments: dict[str, str], overridden: Collection[str]) -> None:
        self.path = path
        self.overridden = overridden
        self.given = arguments
        #: Arguments of the file, with a value or None.
        self.arguments: dict[LaunchText, LaunchText | None] = {}
        self.ignored: list[str] = []
        self.seen: set[int] = set()
        #: What a Python file does besides, which may launch nodes.
        self.unread: list[str] = []

    def nodes(self, parent: Element, scope: _Scope | None = None) -> Iterator[_Found]:
        """Yield the nodes of pointcloud_to_laserscan below an element."""
        scope = scope or _Scope()
        for element in parent.children:
            tag = element.tag
            if tag in {"arg", "let"}:
                if self._applies(element):
                    self._declare(element)
            elif tag == "include":
                self.ignored.append(f"{self._place(element)}, <include file={element.attributes.get('file', '')!r}>")
            elif tag == "unread":
                what = element.attributes["what"]
                assert isinstance(what, NotLiteral)
                self.unread.append(f"{what.shown} (line {element.line})")
                if "computed" in element.attributes:
                    self.ignored.append(f"{self._place(element)}, {what.shown}")
            elif tag in {"remap", "set_remap"} and self._applies(element):
                scope = _Scope(scope.namespace, (*scope.remaps, self._remap(element)))
            elif tag in {"push-ros-namespace", "push_ros_namespace"} and self._applies(element):
                scope = _Scope(_qualified_name(scope.namespace, self._read(element, "namespace")), scope.remaps)
            elif tag in {"group", "node_container", "load_composable_node"}:
                if _has_effect(element) and self._applies(element):
                    space = self._read(element, "ns" if tag == "group" else "")
                    yield from self.nodes(element, _Scope(_qualified_name(scope.namespace, space), scope.remaps))
            elif tag in {"node", "composable_node"} and _is_upstream_node(element) and self._applies(element):
                if id(element) in self.seen:  # a Python file may name an action several times
                    continue
                self.seen.add(id(element))
                for said in ("exec", "plugin"):
                    self._read(element, said)
                space = self._read(element, "ns") or self._read(element, "namespace")
                inner = _Scope(_qualified_name(scope.namespace, space), scope.remaps)
                own = self._read(element, "name") or LaunchText(_direction_of(element))
                yield _qualified_name(inner.namespace, own), element, inner

    def node(self, full: LaunchText, element: Element, scope: _Scope) -> LaunchNode:
        """Read a node."""
        remaps = list(scope.remaps)
        params: list[LaunchParam] = []
        for child in element.children:
            if child.tag in {"param", "rosparam", "remap"} and not self._applies(child):
                continue
            if child.tag == "remap":
                if self._needs(child, _TOPICS[_direction_of(element)]):
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

    def _params(self, element: Element, above: LaunchText = _NOTHING) -> Iterator[LaunchParam]:
        if "from" in element.attributes:
            if isinstance(file := element.attributes["from"], NotLiteral):
                yield LaunchParam(_NOTHING, LaunchText(f"`{file.shown}` is computed"), "unread", file.line)
            elif source := self._read(element, "from"):
                yield LaunchParam(_NOTHING, self._file(source), "file", element.line)
            return
        own = self._read(element, "name")
        name = LaunchText(above + own, above.shown + own.shown)
        if element.children:
            for child in element.children:
                yield from self._params(child, LaunchText(f"{name}.", f"{name.shown}."))
            return
        if "value" not in element.attributes:
            why = LaunchText("<param> has no value here")
            yield LaunchParam(name, why, "unread", element.line)
            return
        written = element.attributes["value"]
        if isinstance(written, NotLiteral):
            yield LaunchParam(name, LaunchText(f"`{written.shown}` is computed"), "unread", element.line)
            return
        value = self._read(element, "value")
        yield LaunchParam(name, value, "value", element.line, self._read(element, "type"))

    def _rosparam(self, element: Element) -> LaunchParam:
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

    def _declare(self, element: Element) -> None:
        name = self._read(element, "name")
        if element.tag == "let" or "value" in element.attributes:
            self.arguments[name] = self._read(element, "value")
        elif name in self.given:
            self.arguments[name] = LaunchText(self.given[name])
        elif "default" in element.attributes:
            try:
                self.arguments[name] = self._read(element, "default")
            except ParameterError:
                # Only an argument that is used needs a value: others have, say, files of packages that are not here.
                self.arguments.setdefault(name, None)
        else:
            self.arguments.setdefault(name, None)

    def _applies(self, element: Element) -> bool:
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

    def _needs(self, remap: Element, topics: frozenset[str]) -> bool:
        """Whether a remapping is read: not that of another topic, nor one that is given and cannot be read."""
        name = remap.attributes.get("from", "").strip("~/")
        if isinstance(remap.attributes.get("from"), NotLiteral) or "$(" in name:
            return True
        return name in topics and not (isinstance(remap.attributes.get("to"), NotLiteral) and name in self.overridden)

    def _remap(self, element: Element) -> str:
        left, to = self._read(element, "from"), element.attributes.get("to")
        if isinstance(to, NotLiteral):
            raise ParameterError(
                f"{left.shown}: `{to.shown}` is computed (from {self.path}, line {to.line})",
                hint=f"give it: `remap={left.strip('~/')}:=/TOPIC`" if left == left.shown else None,
            )
        return f"{left}:={self._read(element, 'to')}"

    def _place(self, element: Element) -> str:
        return f"{self.path}, line {element.line}"

    def _read(self, element: Element, attribute: str) -> LaunchText:
        return self._substituted(element.attributes.get(attribute, ""), element)

    def _substituted(self, written: str, element: Element) -> LaunchText:
        """Replace substitutions such as ``$(arg ...)``, the innermost first."""
        if isinstance(written, NotLiteral):
            self._refuse(written.shown, element, written.line)
        if written.startswith("$(python ") and written.endswith(")"):
            return self._evaluated(written, element)
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

    def _evaluated(self, written: str, element: Element) -> LaunchText:
        """Return the value of an expression of literals, after substitution."""
        from .launch_python import literal_expression  # noqa: PLC0415  # few launch files have expressions

        inner = self._substituted(written.removeprefix("$(python ")[:-1].strip(), element)
        found = literal_expression(inner)
        if isinstance(found, NotLiteral) or not isinstance(found, str | int | float):
            self._refuse(written, element)
        return LaunchText(str(found), written if inner.is_hidden else None)

    def _value(self, kind: str, rest: str, element: Element, shown: str) -> LaunchText:
        """Return the value of a substitution; errors have ``shown``, or its name if that is empty."""
        name, space, default = rest.partition(" ")
        name, default = name.strip("'\""), default.strip().strip("'\"")
        match kind:
            case "arg" | "var":
                key = LaunchText(name, shown or None)
                value = self.arguments.get(key)
                if value is None and name in self.given:
                    value = LaunchText(self.given[name])
                    self.arguments.setdefault(key, value)
                if value is None and space:
                    value = LaunchText(default)
                if value is None:
                    self.arguments.setdefault(key, None)
                    raise ParameterError(
                        f"{self.path}: needs a value for its argument {key.shown!r} (from {self._place(element)})",
                        hint=None if shown else f"`launch_args={name}:=VALUE`",
                    )
                return value
            case "env" | "optenv":
                found = os.environ.get(name, default if space or kind == "optenv" else None)
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

    def _package(self, name: str, element: Element, shown: str) -> Path:
        """Return the folder of the package that the file is in. Other packages would need a ROS installation."""
        for folder in self.path.resolve().parents:
            if folder.name == name:
                return folder
            if (folder / "package.xml").exists():
                if _package_name(folder / "package.xml") in {name, ""}:
                    return folder
                break
        raise ParameterError(
            f"{self.path}: the package {shown or name!r} was not found (from {self._place(element)})",
            hint="give the parameter file in it: `params_file=FILE`",
        )

    def _refuse(self, text: str, element: Element, line: int = 0) -> NoReturn:
        raise ParameterError(
            f"{text[:80]!r} cannot be computed without ROS (from {self.path}, line {line or element.line})",
            hint="write its value into a copy of the file",
        )


def _package_name(file: Path) -> str:
    """Return the name in a ``package.xml``; empty if it cannot be read."""
    try:
        with file.open("rb") as opened:
            text = opened.read(100_000)
    except OSError:
        return ""
    found = re.search(rb"<name>\s*([\w-]+)\s*</name>", text)
    return found[1].decode("ascii", "replace") if found else ""


def _is_upstream_node(element: Element) -> bool:
    programs = [element.attributes.get(name, "") for name in ("type", "exec", "plugin")]
    said = "".join(programs)
    if "nodelet" in said:
        said += element.attributes.get("args", "")
    if not said or "$(" in said:
        said += element.attributes.get("pkg", "")
    return "pointcloud_to_laserscan" in said or "laserscan_to_pointcloud" in said


def _has_effect(group: Element) -> bool:
    """Whether a group sets arguments, or has a node that is read. The condition of another one does not matter."""
    below = list(group.children)
    while below:
        element = below.pop()
        if element.tag in {"arg", "let", "include", "unread"} or _is_upstream_node(element):
            return True
        below += element.children
    return False


def _direction_of(element: Element) -> Direction:
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
