"""Reads the literals of Python launch files of ROS 2. Nothing in a file is executed, and its flow is not followed.

A name counts if the file binds it once, by a plain assignment at the top level of the module or of
generate_launch_description(), and its lists and dictionaries are used as arguments of nodes alone. A node counts if it
stands, directly or by such a name, in what generate_launch_description() returns or adds at its top level.
"""

from __future__ import annotations

import ast
import posixpath
import warnings
from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError

from .launch_node import (
    LaunchFile,
    LaunchNode,
    LaunchValue,
    UnreadError,
    direction_of,
    is_converter,
    package_folder,
    qualified,
    shortened,
    values_of_words,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

#: Maximum size of a file: it bounds how deeply Python's parser recurses.
_MAX_CHARACTERS = 40_000

_ENTRY = "generate_launch_description"

#: Where the functions and classes are from that are read.
_PACKAGES = frozenset({"launch", "launch_ros", "ament_index_python", "os"})

_NODES = frozenset({"Node", "ComposableNode"})
_PROGRAMS = ("pointcloud_to_laserscan_node", "laserscan_to_pointcloud_node", "pointcloud_to_laserscan::")

#: Actions that launch what is among their arguments, once.
_ACTIONS = frozenset(
    {"LaunchDescription", "GroupAction", "TimerAction", "ComposableNodeContainer", "LoadComposableNodes"}
)

#: What may be changed in place.
_CHANGEABLE = (ast.List, ast.Tuple, ast.Dict)

#: What changes the nodes beside it, what sets arguments, and what may change names unseen.
_CHANGING = frozenset({"PushRosNamespace", "PushROSNamespace", "SetRemap", "SetParameter", "SetParametersFromFile"})
_SETTING = frozenset({"SetLaunchConfiguration", "UnsetLaunchConfiguration", "launch_configurations", "forwarding"})
_UNSEEN = frozenset({"exec", "eval", "globals", "locals", "vars", "setattr"})


def python_nodes(text: str, path: Path, arguments: Mapping[str, str]) -> LaunchFile:
    """Read a Python launch file; see `pc2scan.request.launch_file.launch_node`."""
    if len(text) > _MAX_CHARACTERS:
        raise ParameterError(f"{path}: has more than {_MAX_CHARACTERS:,} characters, which no launch file has")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
    except (SyntaxError, ValueError) as err:
        line = getattr(err, "lineno", None)
        problem = getattr(err, "msg", None) or err.args[0]
        raise ParameterError(f"{path}{f', line {line}' if line else ''}: not valid Python: {problem}") from err
    return _PythonReader(tree, path, arguments).read()


class _PythonReader:
    def __init__(self, tree: ast.Module, path: Path, arguments: Mapping[str, str]) -> None:
        self._path, self._given = path, arguments
        self._tree = list(ast.walk(tree))
        self._parents = {child: node for node in self._tree for child in ast.iter_child_nodes(node)}
        bound = Counter(name for node in self._tree for name in _bound(node))
        entry = next((node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == _ENTRY), None)
        if entry is None or entry.decorator_list or bound[_ENTRY] > 1:
            raise ParameterError(f"{path}: is not a launch file: it has no function {_ENTRY}(), or several")
        self._body = entry.body
        self._foreign = bound.keys()
        self._words = set(map(_word, self._tree))
        self._uses: dict[str, list[ast.Name]] = defaultdict(list)
        for node in self._tree:
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
                self._uses[node.id].append(node)
        # What names are assigned that count.
        self._values: dict[str, ast.expr] = {}
        for statement in () if _UNSEEN & self._words or "*" in bound else (*tree.body, *self._body):
            name, value = _assigned(statement)
            users = map(self._user, self._uses[name]) if isinstance(value, _CHANGEABLE) else ()
            if value and bound[name] == 1 and {*users} <= _NODES | _ACTIONS:
                self._values[name] = value
        # By name of an argument, its declarations; an empty name: that is not read.
        self._declared: dict[str, list[ast.Call]] = defaultdict(list)
        for call in self._calls("DeclareLaunchArgument"):
            self._declared[self._argument(call)].append(call)

    def read(self) -> LaunchFile:
        """Return the nodes, in the order of the file."""
        used = map(self._argument, self._calls("LaunchConfiguration"))
        nodes = [self._node(call) for call in self._calls(*_NODES)]
        nodes += [
            LaunchNode.unclear(_unread(node))
            for node in self._tree
            if isinstance(node, ast.Constant)
            and str(node.value).startswith(_PROGRAMS)
            and self._user(node) not in _NODES
        ]
        included = self._calls("IncludeLaunchDescription")
        return LaunchFile(
            sorted((node for node in nodes if node), key=lambda node: node.line),
            {*self._declared, *used} - {""},
            [f"{self._path}, line {call.lineno}, {shortened(ast.unparse(call))}" for call in included],
            [
                UnreadError.of(code, getattr(node, "lineno", 1))
                for node in self._tree
                if _word(node) in _CHANGING and "'use_sim_time'" not in (code := ast.unparse(self._parents[node]))
            ],
        )

    def _node(self, call: ast.Call) -> LaunchNode | None:
        """Return a node, if it is one of pointcloud_to_laserscan."""
        given = {(keyword.arg or "").removeprefix("node_"): keyword.value for keyword in call.keywords}

        def text(name: str) -> str:
            return self._text(given[name]) if name in given else ""

        try:
            if call.args or "" in given:
                raise _unread(call)
            program = text("executable") + text("plugin")
            if not is_converter(text("package"), program, ""):
                return None
            direction, namespace = direction_of(program), qualified("", text("namespace"))
            name = qualified(namespace, text("name") or direction)
        except UnreadError as err:
            return LaunchNode.unclear(err)
        values = [*self._settings(given, call.lineno)]
        return LaunchNode(name, call.lineno, self._doubt(call), direction, namespace, values)

    def _settings(self, given: Mapping[str, ast.expr], line: int) -> Iterator[LaunchValue]:
        part, words = "", ""
        try:
            for part in ("remappings", "parameters", "arguments", "ros_arguments"):
                for item in self._items(given[part]) if part in given else ():
                    if part == "remappings":
                        source, target = self._items(item, 2)
                        yield LaunchValue("remap", self._text(source), self._read(target), item.lineno)
                    elif part == "parameters":
                        yield from self._params(item)
                    else:
                        words += f"{self._text(item)} "
            yield from values_of_words(words, line)
        except UnreadError as err:
            yield LaunchValue("file", part, err, err.line)

    def _params(self, item: ast.expr) -> Iterator[LaunchValue]:
        """Yield the parameters of a dictionary, or the file that has them."""
        found = self._value(item)
        if not isinstance(found, ast.Dict):
            yield LaunchValue("file", "parameters", str(self._path.parent / self._text(found)), item.lineno)
            return
        for key, value in zip(found.keys, found.values, strict=True):
            if key is None:
                raise _unread(value)
            yield LaunchValue("value", self._text(key), self._read(value), key.lineno)

    # Values.

    def _value(self, node: ast.expr) -> ast.expr:
        """Return what a name is assigned, or the expression itself."""
        if not isinstance(node, ast.Name):
            return node
        if node.id not in self._values:
            raise UnreadError(f"`{node.id}`, which is not assigned once and left as it is, is not read", node.lineno)
        return self._value(self._values[node.id])

    def _items(self, node: ast.expr, count: int | None = None) -> list[ast.expr]:
        found = self._value(node)
        if not isinstance(found, ast.List | ast.Tuple) or len(found.elts) != (count or len(found.elts)):
            raise _unread(node)
        return found.elts

    def _read(self, node: ast.expr) -> str | UnreadError:
        try:
            return self._text(node)
        except UnreadError as err:
            return err

    def _text(self, node: ast.expr) -> str:
        """Return the text of a literal; a list with substitutions is their concatenation, as in ROS."""
        match found := self._value(node):
            case ast.Constant(value=bool() | float() | str() as value):
                return str(value)
            case ast.Constant(value=int() as value) if value < 1 << 63:
                return str(value)
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float()) as operand):
                return f"-{self._text(operand)}"
            case ast.List(elts=items) if not all(isinstance(item, ast.Constant) for item in items):
                return "".join(map(self._text, items))
            case ast.Call():
                return self._called(found)
        raise _unread(node)

    def _called(self, call: ast.Call) -> str:
        first = _argument(call, 0, "variable_name", "package", "package_name", "substitutions")
        match self._function(call):
            case "LaunchConfiguration" if first is not None:
                return self._configuration(call, self._text(first))
            case "get_package_share_directory" | "FindPackageShare" if first is not None:
                return package_folder(self._path, self._text(first), call.lineno)
            case "PathJoinSubstitution" if first is not None:
                return posixpath.join("", *map(self._text, self._items(first)))
            case "join" if ast.unparse(call.func) == "os.path.join" and not call.keywords:
                return posixpath.join("", *map(self._text, call.args))
        raise _unread(call)

    def _configuration(self, call: ast.Call, name: str) -> str:
        """Return the value of an argument."""
        declared = self._declared.get(name, [])
        defaults = [_argument(call, 1, "default"), *(_argument(each, 1, "default_value") for each in declared)]
        literals = [default for default in defaults if default]
        if (
            _SETTING & self._words
            or "" in self._declared
            or len(literals) > 1
            or any(map(_is_conditional, (call, *declared)))
        ):
            raise _unread(call)
        if name in self._given:
            return self._given[name]
        if not literals:
            raise UnreadError.no_value(name, call.lineno)
        try:
            return self._text(literals[0])
        except UnreadError as err:
            raise UnreadError(err.problem, err.line, UnreadError.no_value(name, 0).hint) from None

    def _argument(self, call: ast.Call) -> str:
        """Return the name of the argument that a call is about; empty if that is not read."""
        name = _argument(call, 0, "name", "variable_name")
        found = self._read(name) if name else ""
        return found if isinstance(found, str) else ""

    def _calls(self, *names: str) -> Iterator[ast.Call]:
        return (node for node in self._tree if isinstance(node, ast.Call) and self._function(node) in names)

    def _function(self, call: ast.AST) -> str:
        """Return the name of a function or class of ROS or of ``os.path`` that is called; empty for others."""
        root = func = call.func if isinstance(call, ast.Call) else None
        while isinstance(root, ast.Attribute):
            root = root.value
        return _word(func) if isinstance(root, ast.Name) and root.id not in self._foreign else ""

    def _user(self, node: ast.AST) -> str:
        """Return the function that something is an argument of, also inside lists; empty: it is used otherwise."""
        while isinstance(node := self._parents[node], (*_CHANGEABLE, ast.keyword)):
            pass
        return self._function(node)

    # What is launched.

    def _doubt(self, node: ast.AST) -> str:
        """Return why it is not known whether something is launched once; empty: it is."""
        if isinstance(node, ast.Call) and _is_conditional(node):
            return "under a condition"
        parent = self._parents[node]
        match parent:
            case ast.Return() if parent is self._body[-1] and not any(map(_returns, self._body[:-1])):
                return ""
            case ast.List() | ast.keyword(arg="actions" | "initial_entities" | "composable_node_descriptions"):
                return self._doubt(parent)
            case ast.Call() if self._function(parent) in _ACTIONS:
                return self._doubt(parent)
            case ast.Assign(targets=[ast.Name(id=name)]) if self._values.get(name) is node:
                return self._doubt_of(name)
            case ast.Call(func=ast.Attribute(value=ast.Name(id=name), attr="add_action")):
                if self._parents[parent] in self._body:
                    return self._doubt_of(name)
                parent = self._parents[self._parents[parent]]
        return f"in `{shortened(ast.unparse(parent))}`"

    def _doubt_of(self, name: str) -> str:
        """Return the doubt about what a name is assigned, beside additions to it."""
        uses = [use for use in self._uses[name] if _word(self._parents[use]) != "add_action"]
        if name not in self._values or len(uses) != 1:
            return f"in `{name}`, which is not assigned and used once"
        return self._doubt(uses[0])


def _bound(node: ast.AST) -> list[str]:
    """Return the names that a part of the tree binds, but for those that are imported from ROS."""
    match node:
        case ast.Name(id=name, ctx=context):
            return [] if isinstance(context, ast.Load) else [name]
        case ast.ImportFrom(module=str() as module, level=0, names=names) if module.partition(".")[0] in _PACKAGES:
            return [alias.asname for alias in names if alias.asname]
        case ast.ImportFrom(names=names):
            return [alias.asname or alias.name for alias in names]
        case ast.Import(names=names):
            roots = [(alias.asname, alias.name.partition(".")[0]) for alias in names]
            return [asname or root for asname, root in roots if asname or root not in _PACKAGES]
        case ast.Global(names=names) | ast.Nonlocal(names=names):
            return names
        case ast.alias() | ast.keyword():
            return []
    # Functions, classes, arguments, exceptions that are caught, and patterns.
    found = (getattr(node, attribute, None) for attribute in ("name", "arg", "rest"))
    return [name for name in found if isinstance(name, str)]


def _assigned(statement: ast.stmt) -> tuple[str, ast.expr | None]:
    """Return the name that a plain assignment binds, and its value."""
    match statement:
        case ast.Assign(targets=[ast.Name(id=name)], value=value) | ast.AnnAssign(ast.Name(id=name), value=value):
            return name, value
    return "", None


def _word(node: ast.AST | None) -> str:
    """Return the name that a part of the tree uses."""
    match node:
        case ast.Name(id=word) | ast.Attribute(attr=word) | ast.keyword(arg=str(word)) | ast.alias(word, asname=str()):
            return word
    return ""


def _returns(statement: ast.stmt) -> bool:
    is_function = isinstance(statement, ast.FunctionDef)
    return not is_function and any(isinstance(node, ast.Return) for node in ast.walk(statement))


def _unread(node: ast.expr) -> UnreadError:
    return UnreadError.of(ast.unparse(node), node.lineno)


def _is_conditional(call: ast.Call) -> bool:
    """Whether what a call makes depends on a condition, or on arguments that are not read."""
    return any(keyword.arg in {"condition", None} for keyword in call.keywords)


def _argument(call: ast.Call, position: int, *names: str) -> ast.expr | None:
    """Return an argument by its position or one of its names; None if it is not given."""
    if position < len(call.args):
        return call.args[position]
    return next((keyword.value for keyword in call.keywords if keyword.arg in names), None)
