"""Reads the literals of Python launch files of ROS 2. Nothing in a file is executed, and its flow is not followed.

A name counts if the file binds it once, by a plain assignment at the top level of the module or of
generate_launch_description(), and its lists and dictionaries are used as arguments of nodes alone. A node counts if it
stands, directly or by such a name, in what generate_launch_description() returns or adds at its top level.
"""

from __future__ import annotations

import ast
import posixpath
import warnings
from collections import Counter
from operator import attrgetter
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError

from .launch_node import LaunchFile, LaunchValue, UnreadError, package_folder, shortened

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

#: Maximum size of a file, which bounds how deeply Python's parser recurses, and of texts that are read one for another.
_MAX_CHARACTERS, _MAX_TEXTS = 40_000, 10_000

_ENTRY = "generate_launch_description"

_NODES = {"Node", "ComposableNode"}

#: Actions that launch what is among their arguments, once; and the names of such arguments.
_ACTIONS = {"LaunchDescription", "GroupAction", "TimerAction", "ComposableNodeContainer", "LoadComposableNodes"}
_LAUNCHED = {"actions", "initial_entities", "composable_node_descriptions"}
_READ = _NODES | _ACTIONS

#: What changes nodes or arguments beside it.
_CHANGING = {"PushRosNamespace", "PushROSNamespace", "SetRemap", "SetParameter", "SetParametersFromFile"}
_CHANGING |= {"SetLaunchConfiguration", "UnsetLaunchConfiguration", "launch_configurations", "forwarding"}

#: What may be changed in place.
_CHANGEABLE = ast.List | ast.Tuple | ast.Dict


def python_nodes(text: str, path: Path, arguments: Mapping[str, str]) -> LaunchFile:
    """Read a Python launch file; see `pc2scan.request.params_file.launch_node`."""
    if len(text) > _MAX_CHARACTERS:
        raise ParameterError(f"{path}: has more than {_MAX_CHARACTERS:,} characters, which no launch file has")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
    except (SyntaxError, ValueError) as err:
        line, problem = getattr(err, "lineno", None), getattr(err, "msg", None) or err.args[0]
        raise ParameterError(f"{path}{f', line {line}' if line else ''}: not valid Python: {problem}") from err
    return _PythonReader(tree, path, arguments).read()


class _PythonReader:
    def __init__(self, tree: ast.Module, path: Path, arguments: Mapping[str, str]) -> None:
        self._path, self._given, self._texts = path, arguments, 0
        self._tree = list(ast.walk(tree))
        self._parents = {child: node for node in self._tree for child in ast.iter_child_nodes(node)}
        self._bound = Counter(name for node in self._tree for name in _bound(node))
        entry = next((node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == _ENTRY), None)
        if entry is None or entry.decorator_list or self._bound[_ENTRY] > 1:
            raise ParameterError(f"{path}: is not a launch file: it has no function {_ENTRY}(), or several")
        used = (node for node in self._tree if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load))
        changed = {node.id for node in used if self._user(node) not in _READ}
        imported = (node.asname or node.name for node in self._tree if isinstance(node, ast.alias))
        bound = self._bound + Counter(imported)
        # What names are assigned that count.
        self._values: dict[str, ast.expr] = {}
        for statement in (*tree.body, *entry.body):
            match statement:
                case ast.Assign([ast.Name(name)], value) | ast.AnnAssign(ast.Name(name), _, value):
                    if value and bound[name] == 1 and not (isinstance(value, _CHANGEABLE) and name in changed):
                        self._values[name] = value
        self._declared = self._calls("DeclareLaunchArgument")
        # What is launched once, and under no condition.
        self._launched: set[ast.AST] = set()
        for statement in entry.body:
            match statement:
                case ast.Return(value) | ast.Expr(ast.Call(ast.Attribute(attr="add_action"), [value])):
                    self._launch(value)

    def _launch(self, node: ast.AST | None) -> None:
        """Collect what a description launches."""
        if node is None or node in self._launched or _is_conditional(node):
            return
        self._launched.add(node)
        match node:
            case ast.Name(name):
                self._launch(self._values.get(name))
            case ast.List(items) | ast.Tuple(items):
                for item in items:
                    self._launch(item)
            case ast.Call(_, arguments, keywords) if self._function(node) in _ACTIONS:
                for item in (*arguments, *(keyword.value for keyword in keywords if keyword.arg in _LAUNCHED)):
                    self._launch(item)

    def read(self) -> LaunchFile:
        """Return the nodes, in the order of the file."""
        calls = [*self._declared, *self._calls("LaunchConfiguration")]
        included = self._calls("IncludeLaunchDescription")
        file = LaunchFile(
            arguments={*map(self._argument, calls)} - {""},
            ignored=[f"{self._path}, line {call.lineno}, {shortened(ast.unparse(call))}" for call in included],
        )
        for call in self._calls(*_NODES):
            self._add_node(call, file)
        for node in self._tree:
            match node:
                case ast.Name(word) | ast.Attribute(_, word) | ast.keyword(str() as word) | ast.alias(word, str()):
                    if word in _CHANGING and "'use_sim_time'" not in (code := ast.unparse(self._parents[node])):
                        file.unread.append(UnreadError.of(code, node.lineno))
        file.nodes.sort(key=attrgetter("line"))
        return file

    def _add_node(self, call: ast.Call, file: LaunchFile) -> None:
        given = {(keyword.arg or "").removeprefix("node_"): keyword.value for keyword in call.keywords}

        def text(name: str) -> str:
            if call.args or "" in given:
                raise _unread(call)
            if name == "arguments":
                return " ".join(
                    self._text(item) for part in (name, "ros_arguments") for item in self._items(given.get(part))
                )
            parts = ("executable", "plugin") if name == "program" else (name,)
            return "".join(self._text(given[part]) for part in parts if part in given)

        doubt = "" if call in self._launched else "under a condition, or not plainly launched once"
        file.add_node(text, self._settings(given), call.lineno, doubt)

    def _settings(self, given: Mapping[str, ast.expr]) -> Iterator[LaunchValue]:
        """Yield the remappings and parameters of a node."""
        part = ""
        try:
            for part in ("remappings", "parameters"):
                for item in self._items(given.get(part)):
                    match setting := self._value(item):
                        case ast.Tuple([source, target]) | ast.List([source, target]) if part == "remappings":
                            yield LaunchValue("remap", self._text(source), self._read(target), item.lineno)
                        case ast.Dict(keys, values) if part == "parameters":
                            for key, value in zip(keys, values, strict=True):
                                yield LaunchValue("value", self._text(key or value), self._read(value), value.lineno)
                        case ast.expr() if part == "parameters":
                            yield LaunchValue("file", part, str(self._path.parent / self._text(setting)), item.lineno)
                        case _:
                            raise _unread(item)
        except UnreadError as err:
            yield LaunchValue("file", part, err, err.line)

    def _value(self, node: ast.expr) -> ast.expr:
        """Return what a name is assigned, or the expression itself."""
        if not isinstance(node, ast.Name):
            return node
        if node.id not in self._values:
            raise UnreadError(f"`{node.id}`, which is not assigned once and left as it is, is not read", node.lineno)
        return self._value(self._values[node.id])

    def _items(self, node: ast.expr | None) -> list[ast.expr]:
        value = ast.List([]) if node is None else self._value(node)
        if isinstance(value, ast.List | ast.Tuple):
            return value.elts
        raise _unread(value)

    def _read(self, node: ast.expr) -> str | UnreadError:
        try:
            return self._text(node)
        except UnreadError as err:
            return err

    def _text(self, node: ast.expr) -> str:
        """Return the text of a literal; a list with substitutions is their concatenation, as in ROS."""
        self._texts += 1
        match value := self._value(node):
            case ast.Constant(str() as text):
                return text
            case ast.Constant(int() | float() as number) if number < 1 << 63:
                return str(number)
            case ast.UnaryOp(ast.USub(), ast.Constant(int() | float()) as operand):
                return f"-{self._text(operand)}"
            case ast.List(items) if not all(isinstance(item, ast.Constant) for item in items):
                return "".join(map(self._text, items))
            case ast.Call() if self._texts < _MAX_TEXTS:
                return self._called(value)
        raise _unread(value)

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
        calls = [call, *(declared for declared in self._declared if self._argument(declared) in {name, ""})]
        defaults = [default for each in calls if (default := _argument(each, 1, "default", "default_value"))]
        if len(defaults) > 1 or any(map(_is_conditional, calls)):
            raise _unread(call)
        if name in self._given:
            return self._given[name]
        if not defaults:
            raise UnreadError.no_value(name, call.lineno)
        return self._text(defaults[0])

    def _argument(self, call: ast.Call) -> str:
        """Return the name of the argument that a call is about; empty if that is not read."""
        name = _argument(call, 0, "name", "variable_name")
        text = self._read(name) if name else ""
        return text if isinstance(text, str) else ""

    def _calls(self, *names: str) -> list[ast.Call]:
        return [node for node in self._tree if isinstance(node, ast.Call) and self._function(node) in names]

    def _function(self, call: ast.AST) -> str:
        """Return the name of a function or class of ROS or of ``os.path`` that is called; empty for others."""
        words = ast.unparse(call.func).split(".") if isinstance(call, ast.Call) else [""]
        return words[-1] if words[0].isidentifier() and words[0] not in self._bound else ""

    def _user(self, node: ast.AST) -> str:
        """Return the function that something is an argument of, also inside lists; empty: it is used otherwise."""
        while isinstance(node := self._parents[node], _CHANGEABLE | ast.keyword):
            pass
        return self._function(node)


def _bound(node: ast.AST) -> list[str]:
    """Return the names that a part of the tree binds, but for those that it imports."""
    if isinstance(node, ast.keyword | ast.alias) or isinstance(getattr(node, "ctx", None), ast.Load):
        return []
    # Names, functions, classes, arguments, exceptions that are caught, and patterns.
    candidates = [getattr(node, attribute, None) for attribute in ("id", "name", "arg", "rest")]
    return [name for name in (*candidates, *getattr(node, "names", ())) if isinstance(name, str)]


def _unread(node: ast.expr) -> UnreadError:
    return UnreadError.of(ast.unparse(node), node.lineno)


def _is_conditional(node: ast.AST) -> bool:
    """Whether what a call makes depends on a condition, or on arguments that are not read."""
    return isinstance(node, ast.Call) and any(keyword.arg in {"condition", None} for keyword in node.keywords)


def _argument(call: ast.Call, position: int, *names: str) -> ast.expr | None:
    """Return an argument by its position or one of its names; None if it is not given."""
    if position < len(call.args):
        return call.args[position]
    return next((keyword.value for keyword in call.keywords if keyword.arg in names), None)
