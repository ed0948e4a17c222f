"""Reads the literals of Python launch files of ROS 2. Nothing in a file is executed, and its flow is not followed.

A name counts if the file binds it once and changes nothing in its value. A node counts if it gets into the launch
description through lists, actions and functions that are called once.
"""

from __future__ import annotations

import ast
import io
import posixpath
import tokenize
import warnings
from collections import defaultdict
from functools import partial
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError

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
    shortened,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

#: Maximum size of a file in characters, of expressions in tokens beside each other, and of nested brackets.
_MAX_CHARACTERS, _MAX_TOKENS, _MAX_BRACKETS = 200_000, 200, 30

_ENTRY = "generate_launch_description"

#: Where the functions and classes are from that are read.
_PACKAGES = frozenset({"launch", "launch_ros", "ament_index_python", "os"})

_NODES = frozenset({"Node", "LifecycleNode", "ComposableNode", "ComposableLifecycleNode"})
_PROGRAMS = ("pointcloud_to_laserscan_node", "laserscan_to_pointcloud_node", "pointcloud_to_laserscan::")

#: Actions that launch what is among their arguments, once; and methods that add actions to others.
_ACTIONS = frozenset(
    {"LaunchDescription", "GroupAction", "TimerAction", "OpaqueFunction", "ComposableNodeContainer"}
    | {"LoadComposableNodes"}
)
_ADDING = frozenset({"add_action", "add_entity", "append", "extend"})

#: Actions that change the nodes beside them, and that set arguments.
_CHANGING = frozenset({"PushRosNamespace", "PushROSNamespace", "SetRemap", "SetParameter", "SetParametersFromFile"})
_SETTING = frozenset({"DeclareLaunchArgument", "SetLaunchConfiguration", "UnsetLaunchConfiguration"})

#: What may change names unseen.
_UNSEEN = frozenset({"exec", "eval", "globals", "locals", "vars", "setattr"})

#: What is said of nodes in some syntax.
_DOUBTS: dict[type[ast.AST] | None, str] = {
    **dict.fromkeys((ast.If, ast.IfExp, ast.BoolOp, ast.match_case, ast.Try, ast.ExceptHandler), "under a condition"),
    **dict.fromkeys((ast.For, ast.While, ast.ListComp, ast.GeneratorExp), "in a loop"),
}


def python_nodes(text: str, path: Path, arguments: Mapping[str, str], overridden: Collection[str]) -> LaunchFile:
    """Read a Python launch file; see `pc2scan.pipeline.launch_file.launch_node`."""
    try:
        return _PythonReader(_parsed(text, path), path, arguments, overridden).read()
    except (RecursionError, MemoryError) as err:
        raise ParameterError(f"{path}: nested too deeply") from err


def _parsed(text: str, path: Path) -> ast.Module:
    """Return the syntax tree. Chains of operators are bounded first: Python's parser recurses for each level."""
    if len(text) > _MAX_CHARACTERS:
        raise ParameterError(f"{path}: has more than {_MAX_CHARACTERS:,} characters, which no launch file has")
    counts = [0]
    try:
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type in {tokenize.COMMENT, tokenize.NL}:
                continue
            if token.string in {"(", "[", "{"}:
                counts.append(0)
            elif token.string in {")", "]", "}"} and counts[1:]:
                counts.pop()
            counts[-1] = 0 if token.string == "," or token.type == tokenize.NEWLINE else counts[-1] + 1
            if counts[-1] > _MAX_TOKENS or len(counts) > _MAX_BRACKETS:
                raise ParameterError(f"{path}, line {token.start[0]}: nested too deeply")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ast.parse(text)
    except (SyntaxError, tokenize.TokenError, ValueError) as err:
        line = err.args[1][0] if isinstance(err, tokenize.TokenError) else getattr(err, "lineno", None)
        problem = getattr(err, "msg", None) or err.args[0]
        raise ParameterError(f"{path}{f', line {line}' if line else ''}: not valid Python: {problem}") from err


class _PythonReader:
    def __init__(self, tree: ast.Module, path: Path, arguments: Mapping[str, str], overridden: Collection[str]) -> None:
        self._path, self._given, self._overridden = path, arguments, overridden
        self._file = LaunchFile()
        self._nodes = list(ast.walk(tree))
        self._parents = {child: node for node in self._nodes for child in ast.iter_child_nodes(node)}
        # By name: what it is assigned, None where it is bound otherwise; and where it is used.
        self._bound: dict[str, list[ast.expr | None]] = defaultdict(list)
        self._uses: dict[str, list[ast.Name]] = defaultdict(list)
        # By name: whether nothing changes its value; and whether the default of an argument is read.
        self._kept: dict[str, bool] = {}
        self._is_default = False
        for node in self._nodes:
            self._bind(node)
        calls = [node for node in self._nodes if isinstance(node, ast.Call)]
        self._calls = sorted(calls, key=lambda call: (call.lineno, call.col_offset))
        # By name of an argument, what sets it.
        self._setting: dict[str, list[ast.Call]] = defaultdict(list)
        for call in self._calls:
            if self._function(call) in _SETTING:
                self._setting[self._name_of(call)].append(call)

    def _bind(self, node: ast.AST) -> None:
        match node:
            case (
                ast.Assign(targets=[ast.Name(id=name)], value=value)
                | ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value)
            ):
                self._bound[name].append(value)
            case ast.Name(id=name, ctx=ast.Load()):
                self._uses[name].append(node)
            case ast.Name(id=name) if not isinstance(self._parents[node], ast.Assign | ast.AnnAssign):
                self._bound[name].append(None)
            case ast.Assign(targets=targets):
                for name in (target.id for target in targets if isinstance(target, ast.Name)):
                    self._bound[name].append(None)
            case ast.Import(names=aliases) | ast.ImportFrom(names=aliases):
                for alias in aliases:
                    module = getattr(node, "module", None) or alias.name
                    if alias.asname or module.partition(".")[0] not in _PACKAGES:
                        self._bound[alias.asname or alias.name.partition(".")[0]].append(None)
            case ast.Global(names=names) | ast.Nonlocal(names=names):
                for name in names:
                    self._bound[name].append(None)
            case ast.alias() | ast.keyword():
                pass
            case _:
                # Functions, classes, arguments, exceptions that are caught, and patterns.
                for found in (getattr(node, attribute, None) for attribute in ("name", "arg", "rest")):
                    if isinstance(found, str):
                        self._bound[found].append(None)

    def read(self) -> LaunchFile:
        """Return the nodes, in the order of the file."""
        if self._bound.get(_ENTRY) != [None]:
            raise ParameterError(f"{self._path}: is not a launch file: it has no function {_ENTRY}(), or several")
        for call in self._calls:
            name = self._function(call)
            if name in _NODES:
                self._add_node(call)
            elif name == "IncludeLaunchDescription":
                self._file.ignored.append(f"{self._path}, line {call.lineno}, {shortened(ast.unparse(call))}")
            elif name in {"DeclareLaunchArgument", "LaunchConfiguration"} and (argument := self._name_of(call)):
                self._file.arguments.add(argument)
        for node in self._nodes:
            if not (isinstance(node, ast.Constant) and str(node.value).startswith(_PROGRAMS)):
                continue
            if not any(map(self._is_node, self._above(node))):
                self._add_unclear(_unread(node))
        for call in self._calls if self._file.nodes else ():
            if self._function(call) in _CHANGING and "'use_sim_time'" not in ast.unparse(call):
                raise self._refusal("what changes nodes", _unread(call))
        return self._file

    def _add_node(self, call: ast.Call) -> None:
        given = {(keyword.arg or "").removeprefix("node_"): keyword.value for keyword in call.keywords}
        try:
            if call.args or "" in given:
                raise _unread(call)
            package, *programs = (self._optional(given.get(name)) for name in ("package", "executable", "plugin"))
            if not is_converter(package, "".join(programs), ""):
                return
            namespace = qualified("", self._optional(given.get("namespace")))
            direction = direction_of("".join(programs))
            name = qualified(namespace, self._optional(given.get("name")) or direction)
        except UnreadError as err:
            self._add_unclear(err)
            return
        doubt = "under a condition" if _is_conditional(call) else self._doubt(call, set())
        content = NodeContent(self._path, direction, namespace, self._overridden)
        read = partial(self._content, given, content, call.lineno)
        self._file.nodes.append(LaunchNode(name, call.lineno, doubt, direction, read))

    def _add_unclear(self, err: UnreadError) -> None:
        """Add what may be a node of pointcloud_to_laserscan."""
        content = NodeContent(self._path, "pointcloud_to_laserscan", "", ())
        self._file.nodes.append(LaunchNode("", err.line, f"unclear: {err.problem}", content.direction, lambda: content))

    def _content(self, given: Mapping[str, ast.expr], content: NodeContent, line: int) -> NodeContent:
        part, words = "", []
        try:
            for part in ("remappings", "parameters", "arguments", "ros_arguments"):
                for item in self._items(given[part]) if part in given else ():
                    if part == "parameters":
                        self._add_params(item, content)
                    elif part == "remappings":
                        source, target = self._items(item, 2)
                        content.add_remap(self._text(source), partial(self._text, target))
                    else:
                        words.append(self._text(item))
            content.add_words(" ".join(words), line)
        except UnreadError as err:
            raise self._refusal(part, err) from None
        return content

    def _add_params(self, item: ast.expr, content: NodeContent, above: str = "") -> None:
        """Add the parameters of a dictionary, or the file that has them."""
        found = self._value(item)
        if not isinstance(found, ast.Dict):
            content.add_param("", lambda: str(self._path.parent / self._text(found)), item.lineno, "file")
            return
        for key, value in zip(found.keys, found.values, strict=True):
            if key is None:
                raise _unread(value)
            name = above + self._text(key)
            if isinstance(value, ast.Dict):
                self._add_params(value, content, f"{name}.")
            else:
                content.add_param(name, partial(self._text, value, is_joined=False), key.lineno)

    # Values.

    def _value(self, node: ast.expr) -> ast.expr:
        """Return what a name is assigned, or the expression itself."""
        if not isinstance(node, ast.Name):
            return node
        value = self._assigned(node.id)
        if value is None or "*" in self._bound or _UNSEEN & self._uses.keys():
            raise UnreadError(f"`{node.id}`, which is not assigned once, is not read", node.lineno)
        if node.id not in self._kept:
            is_literal = not isinstance(value, ast.List | ast.Tuple | ast.Dict)
            self._kept[node.id] = is_literal or all(map(self._is_kept, self._uses[node.id]))
        if not self._kept[node.id]:
            raise UnreadError(f"`{node.id}`, which may be changed, is not read", node.lineno)
        return self._value(value)

    def _assigned(self, name: str) -> ast.expr | None:
        """Return what a name is assigned; None if it is not bound once."""
        values = self._bound.get(name, [])
        return values[0] if len(values) == 1 else None

    def _is_kept(self, node: ast.AST) -> bool:
        """Whether a use of a list or a dictionary leaves it as it is: it is an argument of a node."""
        parts = (ast.List, ast.Tuple, ast.Dict, ast.Starred, ast.keyword)
        return self._is_node(next(above for above in self._above(node) if not isinstance(above, parts)))

    def _items(self, node: ast.expr, count: int | None = None) -> list[ast.expr]:
        found = self._value(node)
        if not isinstance(found, ast.List | ast.Tuple) or len(found.elts) != (count or len(found.elts)):
            raise _unread(node)
        return found.elts

    def _optional(self, node: ast.expr | None) -> str:
        return "" if node is None or ast.unparse(node) == "None" else self._text(node)

    def _text(self, node: ast.expr, *, is_joined: bool = True) -> str:
        """Return the text of a literal; a list is a concatenation, as ROS joins substitutions."""
        match found := self._value(node):
            case ast.Constant(value=bool() | float() | str() as value):
                return str(value)
            case ast.Constant(value=int() as value) if value < 1 << 63:
                return str(value)
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float()) as operand):
                return f"-{self._text(operand)}"
            case ast.List(elts=items) if is_joined:
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
            case "join" if not call.keywords:
                return posixpath.join("", *map(self._text, call.args))
        raise _unread(call)

    def _configuration(self, call: ast.Call, name: str) -> str:
        """Return the value of an argument."""
        setting = self._setting.get(name, []) + self._setting.get("", [])
        is_set_otherwise = len(setting) > 1 or any(self._function(each) != "DeclareLaunchArgument" for each in setting)
        if is_set_otherwise or self._is_default or any(map(_is_conditional, (call, *setting))):
            raise _unread(call)
        if name in self._given:
            return self._given[name]
        defaults = [_argument(call, 1, "default"), *(_argument(each, 1, "default_value") for each in setting)]
        found = [default for default in defaults if default is not None]
        if not found:
            raise UnreadError.no_value(name, call.lineno)
        self._is_default = True
        try:
            if len(found) > 1 or "" in self._setting:
                raise _unread(call)
            return self._text(found[0])
        except UnreadError as err:
            raise UnreadError(err.problem, err.line, UnreadError.no_value(name, 0).hint) from None
        finally:
            self._is_default = False

    def _name_of(self, call: ast.Call) -> str:
        """Return which argument a call is about; empty if that is not read."""
        node = _argument(call, 0, "name", "variable_name")
        try:
            found = node and self._value(node)
        except UnreadError:
            return ""
        return found.value if isinstance(found, ast.Constant) and isinstance(found.value, str) else ""

    def _function(self, call: ast.AST) -> str:
        """Return the name of a function or class of ROS or of ``os.path`` that is called; empty for others."""
        names: list[str] = []
        func = call.func if isinstance(call, ast.Call) else None
        while isinstance(func, ast.Attribute):
            names.append(func.attr)
            func = func.value
        if not isinstance(func, ast.Name) or self._bound.get(func.id):
            return ""
        name = [*names, func.id][0]
        return "" if name == "join" and [*names, func.id] != ["join", "path", "os"] else name

    # What is launched.

    def _above(self, node: ast.AST) -> Iterator[ast.AST]:
        while node in self._parents:
            node = self._parents[node]
            yield node

    def _is_node(self, node: ast.AST) -> bool:
        return self._function(node) in _NODES

    def _doubt(self, node: ast.AST, met: set[str]) -> str:
        """Return why it is not known whether something is launched once; empty: it is."""
        is_added = False
        for parent in self._above(node):
            match parent:
                case ast.List() | ast.Tuple() | ast.Starred() | ast.keyword() | ast.Return() | ast.BinOp(op=ast.Add()):
                    pass
                case ast.Expr() if is_added:
                    pass
                case ast.Assign(targets=[ast.Name(id=name)]) if not is_added:
                    return self._doubt_of(name, met)
                case ast.Call(func=ast.Attribute(value=ast.Name(id=name), attr=method)) if method in _ADDING:
                    if doubt := self._doubt_of(name, met):
                        return doubt
                    is_added = True
                case ast.Call() if parent.func is node or self._function(parent) in _ACTIONS:
                    if _is_conditional(parent):
                        return "under a condition"
                case ast.FunctionDef(name=name, decorator_list=[], body=body) if node in body and self._ends_once(
                    parent
                ):
                    uses = self._uses[name]
                    if name == _ENTRY:
                        return ""
                    if name in met or self._bound[name] != [None] or len(uses) != 1:
                        return "in a function that is not called once"
                    return self._doubt(uses[0], met | {name})
                case _:
                    return _DOUBTS.get(type(parent), "used in a way that is not read")
            node = parent
        return "" if is_added else "in no launch description"

    def _doubt_of(self, name: str, met: set[str]) -> str:
        """Return the doubt about what a name is assigned."""
        if name in met or self._assigned(name) is None:
            return f"in `{name}`, which is not assigned once, or used more than once"
        met.add(name)
        uses = [use for use in self._uses[name] if getattr(self._parents[use], "attr", "") not in _ADDING]
        if len(uses) != 1:
            return f"in `{name}`, which is used {len(uses)} times"
        return self._doubt(uses[0], met)

    def _ends_once(self, function: ast.FunctionDef) -> bool:
        """Whether a function has no return before its end."""
        below: list[ast.AST] = list(function.body)
        returns = 0
        while below:
            node = below.pop()
            returns += isinstance(node, ast.Return)
            below += () if isinstance(node, ast.FunctionDef | ast.Lambda) else ast.iter_child_nodes(node)
        return returns == isinstance(function.body[-1], ast.Return)

    def _refusal(self, what: str, err: UnreadError) -> ParameterError:
        return ParameterError(f"{what}: {err.problem} (from {self._path}, line {err.line})", hint=err.hint or ELSEWHERE)


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
