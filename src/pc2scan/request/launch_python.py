"""Reads the literals of Python launch files of ROS 2. Nothing in a file is executed, and its flow is not followed.

A name counts if the file binds it once, by a plain assignment at the top level of the module or of
generate_launch_description(), and not to a list or a dictionary, which other lines may change. A node counts if it
stands, directly or by such a name, in what generate_launch_description() returns or adds at its top level.
"""

from __future__ import annotations

import ast
import posixpath
import warnings
from collections import Counter
from typing import TYPE_CHECKING

from pc2scan.errors import UsageError
from pc2scan.transforms.text_files import Element

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Maximum size of a file, which bounds how deeply Python's parser recurses, and of texts that are read one for another.
_MAX_CHARACTERS, _MAX_TEXTS = 40_000, 10_000

_ENTRY = "generate_launch_description"

_NODES = {"Node", "ComposableNode"}

#: Arguments of nodes, and what XML calls them.
_ATTRIBUTES = {"package": "pkg", "executable": "exec", "plugin": "plugin", "namespace": "namespace", "name": "name"}

#: Actions that launch what is among their arguments, once; and the names of such arguments.
_ACTIONS = {"LaunchDescription", "GroupAction", "TimerAction", "ComposableNodeContainer", "LoadComposableNodes"}
_LAUNCHED = {"actions", "initial_entities", "composable_node_descriptions"}

#: Actions and arguments that change other nodes or arguments.
_CHANGING = {"PushRosNamespace", "PushROSNamespace", "SetRemap", "SetParameter", "SetParametersFromFile"}
_CHANGING |= {"SetLaunchConfiguration", "UnsetLaunchConfiguration", "launch_configurations", "forwarding"}


def python_tree(text: str) -> Element:
    """Return the XML that says the same as a Python launch file; what is not read, is `_unread` there.

    Raises
    ------
    UsageError
        If it is not Python, or no launch file; the message begins with the line.
    """
    if len(text) > _MAX_CHARACTERS:
        raise UsageError(f"line 1: it has more than {_MAX_CHARACTERS:,} characters, which no launch file has")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
    except (SyntaxError, ValueError) as err:
        raise UsageError(f"line {getattr(err, 'lineno', 1)}: not valid Python: {err.args[0]}") from err
    entry = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == _ENTRY]
    if len(entry) != 1 or entry[0].decorator_list:
        raise UsageError(f"line 1: is not a launch file: it has no function {_ENTRY}(), or several")
    return Element("launch", {}, 0, [*_PythonFile(tree, entry[0]).elements()])


class _PythonFile:
    def __init__(self, tree: ast.Module, entry: ast.FunctionDef) -> None:
        self._texts = 0
        self._tree = list(ast.walk(tree))
        self._parents = {child: node for node in self._tree for child in ast.iter_child_nodes(node)}
        self._bound = Counter(name for node in self._tree for name in _bound(node))
        # What names are assigned that count.
        self._values: dict[str, ast.expr] = {}
        for statement in (*tree.body, *entry.body):
            match statement:
                case ast.Assign([ast.Name(name)], value) | ast.AnnAssign(ast.Name(name), _, value):
                    if value and self._bound[name] == 1 and not isinstance(value, ast.List | ast.Tuple | ast.Dict):
                        self._values[name] = value
        # What is launched once, and under no condition.
        self._launched: set[ast.AST] = set()
        for statement in entry.body:
            match statement:
                case ast.Return(ast.expr() as value) | ast.Expr(ast.Call(ast.Attribute(attr="add_action"), [value])):
                    self._launch(value)

    def _launch(self, node: ast.expr) -> None:
        """Collect what a description launches."""
        value = self._value(node)
        arguments = _keywords(value)
        if value in self._launched or {"condition", ""} & arguments.keys():
            return
        self._launched.add(value)
        parts = value.elts if isinstance(value, ast.List | ast.Tuple) else []
        if isinstance(value, ast.Call) and self._function(value) in _ACTIONS:
            parts = [*value.args, *(arguments[name] for name in _LAUNCHED & arguments.keys())]
        for part in parts:
            self._launch(part)

    def elements(self) -> Iterator[Element]:
        """Yield the arguments, the nodes, and what is not followed."""
        calls = [node for node in self._tree if isinstance(node, ast.Call)]
        declared: list[dict[str, str]] = []
        # The arguments of all nodes first.
        for call in sorted(calls, key=lambda call: (self._function(call) in _NODES, call.lineno, call.col_offset)):
            match self._function(call):
                case "DeclareLaunchArgument" | "LaunchConfiguration" as function:
                    attributes = self._argument(call)
                    if attributes not in declared and (function[0] == "D" or "default" in attributes):
                        yield Element("arg", attributes, call.lineno)
                        declared.append(attributes)
                case "IncludeLaunchDescription":
                    yield Element("include", {"file": "IncludeLaunchDescription(...)"}, call.lineno)
                case function if function in _NODES:
                    yield self._node(call, _keywords(call))
        for node in self._tree:
            match node:
                case ast.Name(word) | ast.Attribute(_, word) | ast.keyword(str() as word) | ast.alias(word, str()):
                    if word in _CHANGING and "'use_sim_time'" not in (code := ast.unparse(self._parents[node])):
                        yield Element("set_parameter", {"source": code}, node.lineno)

    def _argument(self, call: ast.Call) -> dict[str, str]:
        """Return the attributes of an argument."""
        given = dict(zip(("name", "default"), call.args, strict=False)) | _keywords(call)
        names = {"variable_name": "name", "default_value": "default", "condition": "if", "": "if"}
        return {names.get(name, name): self._text(value) for name, value in given.items()}

    def _node(self, call: ast.Call, given: dict[str, ast.expr]) -> Element:
        """Return a node with its remappings and parameters."""
        attributes = {name: self._text(given[key]) for key, name in _ATTRIBUTES.items() if key in given}
        words = [*self._items(given, "arguments"), *self._items(given, "ros_arguments")]
        attributes["args"] = " ".join(map(self._text, words))
        if call.args or "" in given:
            attributes = {"exec": _unread(call)}
        if call not in self._launched:
            attributes["doubt"] = "under a condition, or not plainly launched once"
        node = Element("node", attributes, call.lineno)
        for item in self._items(given, "remappings"):
            match self._value(item):
                case ast.Tuple([source, target]) | ast.List([source, target]):
                    attributes = {"from": self._text(source), "to": self._text(target)}
                    node.children.append(Element("remap", attributes, item.lineno))
                case _:
                    node.children.append(Element("param", {"from": _unread(item)}, item.lineno))
        for item in self._items(given, "parameters"):
            match self._value(item):
                case ast.Dict(keys, values):
                    for key, value in zip(keys, values, strict=True):
                        attributes = {"name": self._text(key or value), "value": self._text(value)}
                        node.children.append(Element("param", attributes, value.lineno))
                case _:
                    node.children.append(Element("param", {"from": self._text(item)}, item.lineno))
        return node

    def _value(self, node: ast.expr) -> ast.expr:
        """Return what a name is assigned, or the expression itself."""
        if isinstance(node, ast.Name) and node.id in self._values:
            return self._value(self._values[node.id])
        return node

    def _items(self, given: dict[str, ast.expr], name: str) -> list[ast.expr]:
        """Return the items of an argument; the argument itself, if it is no list."""
        value = self._value(given.get(name, ast.List([])))
        return value.elts if isinstance(value, ast.List | ast.Tuple) else [value]

    def _text(self, node: ast.expr) -> str:
        """Return the text of a literal; a list with substitutions is their concatenation, as in ROS."""
        self._texts += 1
        match value := self._value(node):
            case ast.Constant(str() as text) if "$(" not in text:
                return text
            case ast.Constant(int() | float() as number) if number < 1 << 63:
                return str(number)
            case ast.UnaryOp(ast.USub(), ast.Constant(int() | float()) as operand):
                return f"-{self._text(operand)}"
            case ast.List(items) if not all(isinstance(item, ast.Constant) for item in items):
                return "".join(map(self._text, items))
            case ast.Call(_, arguments, keywords) if self._texts < _MAX_TEXTS:
                given = [*arguments, *(keyword.value for keyword in keywords)]
                match self._function(value):
                    case "LaunchConfiguration":
                        return f"$(var {self._argument(value).get('name', '')})"
                    case "get_package_share_directory" | "FindPackageShare" if given:
                        return f"$(find-pkg-share {self._text(given[0])})"
                    case "PathJoinSubstitution" if given:
                        return posixpath.join("", *map(self._text, self._items({"": given[0]}, "")))
                    case "join" if ast.unparse(value.func) == "os.path.join":
                        return posixpath.join("", *map(self._text, given))
        return _unread(node)

    def _function(self, call: ast.AST) -> str:
        """Return the name of a function or class of ROS or of ``os.path`` that is called; empty for others."""
        words = ast.unparse(call.func).split(".") if isinstance(call, ast.Call) else [""]
        return words[-1] if words[0].isidentifier() and words[0] not in self._bound else ""


def _bound(node: ast.AST) -> list[str]:
    """Return the names that a part of the tree binds, but for those that it imports."""
    if isinstance(node, ast.keyword | ast.alias) or isinstance(getattr(node, "ctx", None), ast.Load):
        return []
    # Names, functions, classes, arguments, exceptions that are caught, and patterns.
    candidates = [getattr(node, attribute, None) for attribute in ("id", "name", "arg", "rest")]
    return [name for name in (*candidates, *getattr(node, "names", ())) if isinstance(name, str)]


def _keywords(node: ast.AST) -> dict[str, ast.expr]:
    """Return the keyword arguments of a call, by names without ``node_``; ``**`` is at the empty name."""
    keywords = node.keywords if isinstance(node, ast.Call) else []
    return {(keyword.arg or "").removeprefix("node_"): keyword.value for keyword in keywords}


def _unread(node: ast.expr) -> str:
    """Return an expression as a substitution that there is not."""
    return f"$({ast.unparse(node)})"
