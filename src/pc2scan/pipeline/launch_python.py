"""Reads Python launch files of ROS 2 as the elements that an XML launch file has. Nothing in a file is executed.

The syntax tree is followed as far as it says what is launched: literals, names, lists and dictionaries, functions of
the file, paths, substitutions and actions. Everything else is a `NotLiteral`, which is an error only where a node needs
it. Files are untrusted: nesting, lengths, and the number of steps are bounded.
"""

from __future__ import annotations

import ast
import io
import math
import operator
import tokenize
import warnings
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from pc2scan.errors import ParameterError

from .launch_tree import MAX_DEPTH, Element, NotLiteral

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

#: Maximum size of a file, in characters. The largest launch files in public packages have a fifth of it.
_MAX_CHARACTERS = 200_000

#: Maximum number of tokens in an expression that could each be a level of its syntax tree: parts between commas are
#: beside each other.
_MAX_LEVELS = 500

#: Maximum number of steps. A step is a node of the syntax tree, an item of a list, or an action.
_MAX_STEPS = 100_000

#: Maximum number of characters of one text, and of nested calls of the file's functions.
_MAX_TEXT, _MAX_CALLS = 5_000, 20

_ENTRY = "generate_launch_description"

#: The attributes of a node, by the names of its arguments; the first ROS 2 versions had ``node_executable``.
_NODE_ATTRIBUTES = {
    "package": "pkg",
    "executable": "exec",
    "plugin": "plugin",
    "name": "name",
    "namespace": "namespace",
}

#: Elements of actions, by the name of their class. Any other class is a group of the actions among its arguments.
_TAGS = {
    "Node": "node",
    "LifecycleNode": "node",
    "ComposableNode": "composable_node",
    "ComposableLifecycleNode": "composable_node",
    "DeclareLaunchArgument": "arg",
    "SetLaunchConfiguration": "let",
    "PushRosNamespace": "push-ros-namespace",
    "PushROSNamespace": "push-ros-namespace",
    "SetRemap": "set_remap",
}

#: Arguments of actions that may be given by position, and their attributes.
_POSITIONS = {
    "arg": (("name", "name"), ("default_value", "default")),
    "let": (("name", "name"), ("value", "value")),
    "push-ros-namespace": (("namespace", "namespace"),),
    "set_remap": (("src", "from"), ("dst", "to")),
}

#: Classes whose arguments are lists of actions. What is computed among those may be a node.
_LISTS = frozenset({"LaunchDescription", "GroupAction", "OpaqueFunction"})

_OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}

_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda one, other: one in other,
    ast.NotIn: lambda one, other: one not in other,
    ast.Is: lambda one, other: one is other,
    ast.IsNot: lambda one, other: one is not other,
}

#: Functions and substitutions that return their first argument, as far as a launch file needs it.
_SAME = frozenset({"str", "Path", "PurePath", "fspath", "abspath", "realpath", "normpath", "TextSubstitution"})

#: Methods of texts and paths that return the same text.
_SAME_METHODS = frozenset({"perform", "as_posix", "resolve", "absolute", "find", "expanduser"})

_CONSTANTS = {"math.pi": math.pi, "np.pi": math.pi, "numpy.pi": math.pi, "math.inf": math.inf, "np.inf": math.inf}


@dataclass(frozen=True, slots=True)
class _Condition:
    """The attribute ``if`` or ``unless``, and what it tests."""

    attribute: str
    text: str
    test: ast.expr | None = None


@dataclass(frozen=True, slots=True)
class _Function:
    definition: ast.FunctionDef | ast.Lambda
    names: dict[str, Any]


class _Return(Exception):  # noqa: N818  # it ends a function, and is no error
    def __init__(self, value: Any) -> None:
        self.value = value


def python_tree(text: str, path: Path) -> Element:
    """Return what a Python launch file launches, as the root element of an XML launch file that launches the same.

    Raises
    ------
    ParameterError
        If the text is not Python, has no ``generate_launch_description``, or exceeds a bound.
    """
    try:
        root = _Program(path, text).launched()
        _refuse_many(root, path)
    except (RecursionError, MemoryError) as err:
        raise ParameterError(f"{path}: nested too deeply") from err
    return root


def literal_expression(text: str) -> object:
    """Return the value of an expression of literals, as in ``'true' == 'false' or 1 > 2``; `NotLiteral` for others."""
    from pathlib import Path  # noqa: PLC0415  # few launch files have expressions

    try:
        return _Program(Path(), text, mode="eval").value(None)
    except (ParameterError, RecursionError, MemoryError):
        return NotLiteral(0, lambda: text)


def _refuse_many(root: Element, path: Path) -> None:
    """Raise if an element is too deep, or there are too many; one that is in several lists is counted in each."""
    stack, count = [(root, 0)], 0
    while stack:
        element, depth = stack.pop()
        count += 1
        if depth > MAX_DEPTH:
            raise ParameterError(f"{path}, line {element.line}: nested more than {MAX_DEPTH} levels deep")
        if count > _MAX_STEPS:
            raise ParameterError(f"{path}: launches more than {_MAX_STEPS:,} actions")
        stack += [(child, depth + 1) for child in element.children]


def _parsed(text: str, path: Path, mode: str) -> Any:
    """Return the syntax tree. Chains of operators are bounded first: Python's parser recurses for each level."""
    if len(text) > _MAX_CHARACTERS:
        raise ParameterError(f"{path}: has more than {_MAX_CHARACTERS:,} characters, which no launch file has")
    # For each open bracket: the levels of the longest part before the last comma, and those of the part after it.
    parts = [(0, 0)]
    try:
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type in {tokenize.COMMENT, tokenize.NL}:
                continue
            deepest, levels = parts[-1]
            if levels > _MAX_LEVELS:
                raise ParameterError(f"{path}, line {token.start[0]}: an expression of more than {_MAX_LEVELS} parts")
            parts[-1] = (deepest, levels + 1)
            if token.string in {"(", "[", "{"}:
                parts.append((0, 0))
            elif token.string in {")", "]", "}"} and parts[1:]:
                parts.pop()
                parts[-1] = (parts[-1][0], parts[-1][1] + max(deepest, levels))
            elif token.type == tokenize.NEWLINE:
                parts[-1] = (0, 0)
            elif token.string == ",":
                parts[-1] = (max(deepest, levels), 0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ast.parse(text, mode=mode)
    except (SyntaxError, tokenize.TokenError, ValueError) as err:
        line = err.lineno if isinstance(err, SyntaxError) else None
        if isinstance(err, tokenize.TokenError):
            line = err.args[1][0]
        place = f"{path}, line {line}" if line else f"{path}"
        problem = getattr(err, "msg", None) or str(err.args[0] if err.args else err)
        raise ParameterError(f"{place}: not valid Python: {problem}") from err


class _Program:
    """Follows the syntax tree of a file."""

    def __init__(self, path: Path, text: str, mode: str = "exec") -> None:
        self.path = path
        self.tree = _parsed(text, path, mode)
        self.names: dict[str, Any] = {"__file__": f"$(dirname)/{path.name}", "__name__": "launch"}
        self.steps = self.calls = 0
        #: The conditions of the branches that are followed without knowing whether they are taken.
        self.doubts: tuple[_Condition, ...] = ()
        #: The actions that functions return in such branches.
        self.perhaps: list[Element] = []

    def launched(self) -> Element:
        """Return the root element."""
        self._run(self.tree.body, self.names)
        entry = self.names.get(_ENTRY)
        if not isinstance(entry, _Function):
            raise ParameterError(f"{self.path}: is not a launch file: it has no function {_ENTRY}()")
        returned = self._call_function(entry, [], {}, entry.definition)
        children = [*self._elements(returned), *self.perhaps]
        return Element("launch", {}, entry.definition.lineno, children)

    # Statements.

    def _run(self, body: Iterable[ast.stmt], names: dict[str, Any]) -> None:
        for statement in body:
            self._step(statement)
            match statement:
                case ast.FunctionDef():
                    names[statement.name] = _Function(statement, names)
                case ast.Assign():
                    value = self.value(statement.value, names)
                    for target in statement.targets:
                        self._assign(target, value, names)
                case ast.AnnAssign(value=ast.expr()):
                    self._assign(statement.target, self.value(statement.value, names), names)
                case ast.AugAssign(op=ast.Add()):
                    added = self.value(statement.value, names)
                    target = self.value(statement.target, names)
                    if isinstance(target, list) and isinstance(added, list | tuple):
                        self._extend(target, added)
                    else:
                        self._assign(statement.target, self._sum(target, added, statement), names)
                case ast.Expr():
                    self.value(statement.value, names)
                case ast.Return():
                    value = None if statement.value is None else self.value(statement.value, names)
                    if not self.doubts:
                        raise _Return(value)
                    self.perhaps += self._doubtful(self._elements(value))
                case ast.If():
                    self._branch(statement, names)
                case ast.For():
                    self._loop(statement, names)
                case ast.With() | ast.AsyncWith() | ast.Try():
                    self._run(statement.body, names)
                    self._run(getattr(statement, "orelse", ()), names)
                    self._run(getattr(statement, "finalbody", ()), names)
                case ast.While():
                    self._in_doubt(statement.body, statement.test, names)
                case _:
                    pass

    def _branch(self, statement: ast.If, names: dict[str, Any]) -> None:
        value = self.value(statement.test, names)
        test = self._truth(value)
        if test is None:
            text = value if isinstance(value, str) and value.startswith("$(python ") else None
            self._in_doubt(statement.body, statement.test, names, text)
            self._in_doubt(statement.orelse, statement.test, names, text, attribute="unless")
        else:
            self._run(statement.body if test else statement.orelse, names)

    def _loop(self, statement: ast.For, names: dict[str, Any]) -> None:
        over = self.value(statement.iter, names)
        if isinstance(over, list | tuple):
            for item in list(over):
                self._assign(statement.target, item, names)
                self._run(statement.body, names)
        else:
            self._in_doubt(statement.body, statement.iter, names)

    def _in_doubt(
        self,
        body: Iterable[ast.stmt],
        test: ast.expr,
        names: dict[str, Any],
        text: str | None = None,
        attribute: str = "if",
    ) -> None:
        """Follow a branch that is perhaps not taken: names that it changes have no value, its actions a condition."""
        outer = self.doubts
        self.doubts = (*outer, _Condition(attribute, self._not_literal(test) if text is None else text, test))
        try:
            self._run(body, names)
        finally:
            self.doubts = outer

    def _assign(self, target: ast.expr, value: Any, names: dict[str, Any]) -> None:
        match target:
            case ast.Name():
                names[target.id] = self._perhaps(value) if target.id in names else value
            case ast.Tuple() | ast.List():
                whole = isinstance(value, list | tuple) and len(value) == len(target.elts)
                for index, one in enumerate(target.elts):
                    self._assign(one, value[index] if whole else self._not_literal(target), names)
            case ast.Subscript():
                mapping, key = self.value(target.value, names), self.value(target.slice, names)
                if isinstance(mapping, dict) and isinstance(key, str) and not isinstance(key, NotLiteral):
                    mapping[key] = self._perhaps(value)
            case _:
                pass

    # Expressions.

    def value(self, node: ast.expr | None, names: dict[str, Any] | None = None) -> Any:
        """Return the value of an expression: a literal, a text with substitutions, an `Element` or a `NotLiteral`."""
        if names is None:
            node, names = self.tree.body, self.names
        self._step(node)
        match node:
            case ast.Constant(value=bool() | int() | float() | None as literal):
                return literal
            case ast.Constant(value=str() as literal):
                return self._not_literal(node) if "$(" in literal else literal
            case ast.Name():
                return names[node.id] if node.id in names else self._constant(node)
            case ast.List() | ast.Tuple() | ast.Set():
                items: list[Any] = []
                for one in node.elts:
                    if isinstance(one, ast.Starred):
                        more = self.value(one.value, names)
                        items += more if isinstance(more, list | tuple) else [self._not_literal(one)]
                    else:
                        items.append(self.value(one, names))
                self._charge(len(items))
                return tuple(items) if isinstance(node, ast.Tuple) else items
            case ast.Dict():
                return self._dictionary(node, names)
            case ast.JoinedStr():
                texts = [self.text(self.value(part, names), part) for part in node.values]
                return self._joined(texts, node)
            case ast.FormattedValue(format_spec=None):
                return self.value(node.value, names)
            case ast.BinOp():
                return self._binary(node, names)
            case ast.UnaryOp():
                return self._unary(node, self.value(node.operand, names))
            case ast.BoolOp():
                return self._either(node, names)
            case ast.Compare(ops=[op], comparators=[other]):
                return self._compared(node, op, self.value(node.left, names), self.value(other, names))
            case ast.ListComp(generators=[each]) | ast.GeneratorExp(generators=[each]):
                return self._comprehension(node, each, names)
            case ast.IfExp():
                test = self._truth(self.value(node.test, names))
                if test is None:
                    return self._not_literal(node)
                return self.value(node.body if test else node.orelse, names)
            case ast.Subscript():
                return self._item(node, self.value(node.value, names), self.value(node.slice, names))
            case ast.Attribute():
                return self._attribute(node, names)
            case ast.Call():
                return self._call(node, names)
            case ast.Lambda():
                return _Function(node, names)
            case _:
                return self._not_literal(node)

    def _comprehension(
        self, node: ast.ListComp | ast.GeneratorExp, each: ast.comprehension, names: dict[str, Any]
    ) -> Any:
        over = self.value(each.iter, names)
        if not isinstance(over, list | tuple):
            return self._not_literal(node)
        found, own = [], dict(names)
        for item in list(over):
            self._assign(each.target, item, own)
            tests = [self._truth(self.value(test, own)) for test in each.ifs]
            if None in tests:
                return self._not_literal(node)
            if all(tests):
                found.append(self.value(node.elt, own))
        return found

    def text(self, value: Any, node: ast.AST, depth: int = 0) -> str:
        """Return a value as text; a list is a concatenation, as ROS joins substitutions."""
        if isinstance(value, str):
            return value
        if isinstance(value, bool | int | float):
            return str(value)
        if value is None:
            return ""
        if isinstance(value, list | tuple) and depth < MAX_DEPTH:
            self._charge(len(value))
            return self._joined([self.text(one, node, depth + 1) for one in value], node)
        return self._not_literal(node)

    def _dictionary(self, node: ast.Dict, names: dict[str, Any]) -> dict[Any, Any]:
        made = _Lines()
        for key, value in zip(node.keys, node.values, strict=True):
            found = self.value(value, names)
            if key is None:
                if isinstance(found, dict):
                    made.update(found)
                    made.lines |= getattr(found, "lines", {})
                else:
                    made[self._not_literal(value)] = self._not_literal(value)
                continue
            name = self.value(key, names)
            name = name if isinstance(name, str | int | float) else self.text(name, key)
            made[name] = found
            made.lines[name] = key.lineno
        self._charge(len(made))
        return made

    def _binary(self, node: ast.BinOp, names: dict[str, Any]) -> Any:
        left, right = self.value(node.left, names), self.value(node.right, names)
        if isinstance(node.op, ast.Add):
            return self._sum(left, right, node)
        if isinstance(node.op, ast.Div) and isinstance(left, str):
            return self._path([left, right], node)
        apply = _OPERATORS.get(type(node.op))
        return self._number(apply, left, right, node) if apply else self._not_literal(node)

    def _sum(self, left: Any, right: Any, node: ast.AST) -> Any:
        if isinstance(left, NotLiteral) or isinstance(right, NotLiteral):
            if isinstance(left, list) or isinstance(right, list):
                return [*(left if isinstance(left, list) else [left]), *(right if isinstance(right, list) else [right])]
            return self._not_literal(node)
        if isinstance(left, str) and isinstance(right, str):
            return self._joined([left, right], node)
        if isinstance(left, list | tuple) and type(left) is type(right):
            self._charge(len(left) + len(right))
            return type(left)((*left, *right))
        return self._number(operator.add, left, right, node)

    def _number(self, apply: Callable[[Any, Any], Any], left: Any, right: Any, node: ast.AST) -> Any:
        if not (isinstance(left, int | float) and isinstance(right, int | float)):
            return self._not_literal(node)
        try:
            found = apply(left, right)
        except ArithmeticError:
            return self._not_literal(node)
        return found if abs(found) < 1e18 or isinstance(found, float) else self._not_literal(node)

    def _unary(self, node: ast.UnaryOp, value: Any) -> Any:
        match node.op:
            case ast.USub() if isinstance(value, int | float):
                return -value
            case ast.UAdd() if isinstance(value, int | float):
                return value
            case ast.Not():
                test = self._truth(value)
                return self._not_literal(node) if test is None else not test
            case _:
                return self._not_literal(node)

    def _either(self, node: ast.BoolOp, names: dict[str, Any]) -> Any:
        wanted = isinstance(node.op, ast.Or)
        value: Any = None
        for one in node.values:
            value = self.value(one, names)
            test = self._truth(value)
            if test is None:
                return self._not_literal(node)
            if test is wanted:
                return value
        return value

    def _compared(self, node: ast.Compare, op: ast.cmpop, left: Any, right: Any) -> Any:
        sides = (
            *(left if isinstance(left, list | tuple) else [left]),
            *(right if isinstance(right, list | tuple) else [right]),
        )
        known = all(
            one is None or isinstance(one, bool | int | float) or (isinstance(one, str) and self._is_plain(one))
            for one in sides
        )
        if not known:
            return self._later(node, op, left, right)
        try:
            return _COMPARISONS[type(op)](left, right)
        except TypeError:
            return self._not_literal(node)

    def _later(self, node: ast.Compare, op: ast.cmpop, left: Any, right: Any) -> str:
        """Return a comparison of texts with substitutions, which has a value when these have one."""
        sign = {ast.Eq: "==", ast.NotEq: "!="}.get(type(op))
        if sign is None or not isinstance(left, str) or not isinstance(right, str):
            return self._not_literal(node)
        return self._joined(["$(python '", left, f"' {sign} '", right, "')"], node)

    def _item(self, node: ast.Subscript, value: Any, key: Any) -> Any:
        if isinstance(value, dict) and isinstance(key, str | int) and not isinstance(key, NotLiteral):
            return value.get(key, self._not_literal(node))
        if isinstance(value, list | tuple) and isinstance(key, int) and -len(value) <= key < len(value):
            return value[key]
        if _dotted(node.value).endswith("environ") and isinstance(key, str) and self._is_plain(key):
            return f"$(env {key})"
        return self._not_literal(node)

    def _attribute(self, node: ast.Attribute, names: dict[str, Any]) -> Any:
        if (known := self._constant(node)) is not None and not isinstance(known, NotLiteral):
            return known
        value = self.value(node.value, names)
        if isinstance(value, str) and not isinstance(value, NotLiteral) and node.attr == "parent":
            return _folder_of(value)
        return self._not_literal(node)

    def _constant(self, node: ast.expr) -> Any:
        return _CONSTANTS.get(_dotted(node), self._not_literal(node))

    # Calls.

    def _call(self, node: ast.Call, names: dict[str, Any]) -> Any:
        args: list[Any] = []
        for one in node.args:
            value = self.value(one.value if isinstance(one, ast.Starred) else one, names)
            args += value if isinstance(one, ast.Starred) and isinstance(value, list | tuple) else [value]
        keywords: dict[str, Any] = {}
        unread: NotLiteral | None = None
        for keyword in node.keywords:
            value = self.value(keyword.value, names)
            if keyword.arg is not None:
                keywords[keyword.arg] = value
            elif isinstance(value, dict) and all(isinstance(name, str) for name in value):
                keywords |= value
            else:
                unread = self._not_literal(keyword.value)
        dotted = _dotted(node.func)
        if dotted and dotted.partition(".")[0] not in names:
            found = self._library(node, dotted.rpartition(".")[2], dotted, args, keywords)
            if unread is not None and isinstance(found, Element):
                found.attributes["if"] = unread
            return found
        if isinstance(node.func, ast.Attribute):
            return self._method(node, self.value(node.func.value, names), node.func.attr, args)
        function = self.value(node.func, names)
        if isinstance(function, _Function):
            return self._call_function(function, args, keywords, node)
        return self._not_literal(node)

    def _call_function(self, function: _Function, args: list[Any], keywords: dict[str, Any], node: ast.AST) -> Any:
        if self.calls >= _MAX_CALLS:
            return self._not_literal(node)
        definition, own = function.definition, dict(function.names)
        spec = definition.args
        parameters = [*spec.posonlyargs, *spec.args]
        defaults = dict(zip(parameters[len(parameters) - len(spec.defaults) :], spec.defaults, strict=True))
        defaults |= {one: value for one, value in zip(spec.kwonlyargs, spec.kw_defaults, strict=True) if value}
        for index, parameter in enumerate([*parameters, *spec.kwonlyargs]):
            if index < min(len(args), len(parameters)):
                own[parameter.arg] = args[index]
            elif parameter.arg in keywords:
                own[parameter.arg] = keywords[parameter.arg]
            elif parameter in defaults:
                own[parameter.arg] = self.value(defaults[parameter], function.names)
            else:
                own[parameter.arg] = self._not_literal(parameter)
        if spec.vararg is not None:
            own[spec.vararg.arg] = tuple(args[len(parameters) :])
        if spec.kwarg is not None:
            named = {parameter.arg for parameter in (*parameters, *spec.kwonlyargs)}
            own[spec.kwarg.arg] = {key: value for key, value in keywords.items() if key not in named}
        self.calls += 1
        try:
            if isinstance(definition, ast.Lambda):
                return self.value(definition.body, own)
            self._run(definition.body, own)
        except _Return as found:
            return found.value
        finally:
            self.calls -= 1
        return None

    def _library(self, node: ast.Call, name: str, dotted: str, args: list[Any], keywords: dict[str, Any]) -> Any:
        """Return the value of a call of a function or class that is not in the file."""
        first = args[0] if args else next(iter(keywords.values()), None)
        if name in _SAME:
            return self.text(first, node) if not isinstance(first, Element) else self._not_literal(node)
        match name:
            case "join" if dotted in {"os.path.join", "path.join", "join", "osp.join"}:
                return self._path(args, node)
            case "PathJoinSubstitution":
                return self._path(first if isinstance(first, list | tuple) else [first], node)
            case "dirname":
                text = self.text(first, node)
                return self._not_literal(node) if isinstance(text, NotLiteral) else _folder_of(text)
            case "get_package_share_directory" | "get_package_share_path" | "FindPackageShare":
                return self._substitution("find-pkg-share", [first], node)
            case "LaunchConfiguration":
                default = keywords.get("default", args[1] if args[1:] else None)
                variable = keywords.get("variable_name", first)
                return self._substitution("var", [variable] if default is None else [variable, default], node)
            case "EnvironmentVariable" | "getenv" | "get":
                if name == "get" and not dotted.endswith("environ.get"):
                    return self._not_literal(node)
                default = keywords.get("default_value", args[1] if args[1:] else None)
                return self._substitution("env", [first] if default is None else [first, default], node)
            case "ThisLaunchFileDir":
                return "$(dirname)"
            case "PythonExpression":
                return self._joined(["$(python ", self.text(first, node), ")"], node)
            case "LaunchConfigurationEquals" | "LaunchConfigurationNotEquals":
                sign = "==" if name.endswith("nEquals") else "!="
                name, *other = [self.text(one, node) for one in (*args, *keywords.values())][:2] or [""]
                condition = self._joined(["$(python '", f"$(var {name})", f"' {sign} '", *other, "')"], node)
                return _Condition("if", condition)
            case "IfCondition" | "UnlessCondition":
                return _Condition(name.removesuffix("Condition").lower(), self.text(first, node))
            case "ParameterValue" | "ParameterFile":
                return first
            case "float" | "int" | "bool":
                return self._converted(name, first, node)
            case "radians" | "deg2rad" if isinstance(first, int | float):
                return math.radians(first)
            case "dict":
                return _Lines(keywords)
            case "list" | "tuple" if isinstance(first, list | tuple):
                return list(first)
            case _ if name[:1].isupper():
                return self._action(node, name, args, keywords)
            case _:
                return self._not_literal(node)

    def _converted(self, name: str, value: Any, node: ast.AST) -> Any:
        """Return a number of a text; a text with substitutions stays one, and is read when these are known."""
        if isinstance(value, NotLiteral):
            return value
        if isinstance(value, str) and not self._is_plain(value):
            return value
        try:
            if isinstance(value, str | int | float) and name != "bool":
                return float(value) if name == "float" else int(value)
        except (ValueError, ArithmeticError):
            pass
        return self._not_literal(node)

    def _method(self, node: ast.Call, value: Any, name: str, args: list[Any]) -> Any:
        """Return the value of a call of a method."""
        match value:
            case Element() if name in {"add_action", "add_entity"} and args:
                value.children += self._doubtful(self._elements(args[0]))
                return None
            case list() if name == "append" and args:
                self._extend(value, args)
                return None
            case list() if name == "extend" and args and isinstance(args[0], list | tuple):
                self._extend(value, args[0])
                return None
            case list() if name == "insert" and args[1:]:
                self._extend(value, args[1:2])
                return None
            case dict() if name == "update" and args and isinstance(args[0], dict):
                for key, one in args[0].items():
                    value[key] = self._perhaps(one)
                return None
            case dict() if name == "get" and args and isinstance(args[0], str | int):
                return value.get(args[0], args[1] if args[1:] else None)
            case dict() if name in {"items", "keys", "values"}:
                self._charge(len(value))
                return list(getattr(value, name)())
            case dict() | list() if name == "copy":
                return value.copy()
            case NotLiteral():
                return self._not_literal(node)
            case str() if name in _SAME_METHODS:
                return value
            case str() if name == "joinpath":
                return self._path([value, *args], node)
            case str() if name == "join" and args and isinstance(args[0], list | tuple):
                texts = [self.text(one, node) for one in args[0]]
                return self._joined([part for text in texts for part in (value, text)][1:], node)
            case str() if name in {"lower", "upper", "strip"} and not args and self._is_plain(value):
                return getattr(value, name)()
            case str() if name in {"startswith", "endswith"} and len(args) == 1 and self._is_plain(value):
                return getattr(value, name)(self.text(args[0], node))
            case _:
                return self._not_literal(node)

    # Actions.

    def _action(self, node: ast.Call, name: str, args: list[Any], keywords: dict[str, Any]) -> Element:
        tag = _TAGS.get(name)
        if name == "IncludeLaunchDescription":
            return Element("unread", {"what": self._not_literal(node)}, node.lineno)
        if tag is None:
            if name == "OpaqueFunction":
                args, keywords = [self._opaque(node, args, keywords)], {"condition": keywords.get("condition")}
            if name == "RewrittenYaml":
                return self._rewritten(node, args, keywords)
            children = [each for one in (*args, *keywords.values()) for each in self._elements(one)]
            if name not in _LISTS:
                children = [child for child in children if child.tag != "unread"]
            element = Element("group", {}, node.lineno, children)
        elif tag in {"node", "composable_node"}:
            element = self._node(node, tag, keywords)
        else:
            given = dict(zip((own for own, _ in _POSITIONS[tag]), args, strict=False)) | keywords
            attributes = {
                attribute: self.text(given[own], node)
                for own, attribute in _POSITIONS[tag]
                if given.get(own) is not None
            }
            element = Element(tag, attributes, node.lineno)
        match keywords.get("condition"):
            case _Condition() as condition:
                element.attributes[condition.attribute] = condition.text
            case None:
                pass
            case _:
                element.attributes["if"] = self._not_literal(node)
        return element

    def _opaque(self, node: ast.Call, args: list[Any], keywords: dict[str, Any]) -> Any:
        """Return the actions that a function returns when it is called with a context."""
        function = keywords.get("function", args[0] if args else None)
        if not isinstance(function, _Function):
            return self._not_literal(node)
        named = keywords.get("kwargs")
        given = [self._not_literal(node), *_listed(keywords.get("args"))]
        return self._call_function(function, given, named if isinstance(named, dict) else {}, node)

    def _node(self, node: ast.Call, tag: str, keywords: dict[str, Any]) -> Element:
        keywords = {key.removeprefix("node_"): value for key, value in keywords.items()}
        attributes = {
            attribute: self.text(keywords[own], node)
            for own, attribute in _NODE_ATTRIBUTES.items()
            if keywords.get(own) is not None
        }
        words = [one for own in ("arguments", "ros_arguments") for one in _listed(keywords.get(own))]
        attributes["args"] = self._joined([part for one in words for part in (" ", self.text(one, node))], node)
        element = Element(tag, attributes, node.lineno)
        lines = {keyword.arg: keyword.value for keyword in node.keywords}
        source = lines.get("parameters", node)
        for one in _listed(keywords.get("parameters")):
            element.children += self._parameters(one, source)
        source = lines.get("remappings", node)
        for one in _listed(keywords.get("remappings")):
            pair = one if isinstance(one, list | tuple) and len(one) == 2 else (self._not_literal(source),) * 2
            sides = dict(zip(("from", "to"), (self.text(side, source) for side in pair), strict=True))
            element.children.append(Element("remap", sides, getattr(source, "lineno", node.lineno)))
        return element

    def _parameters(self, value: Any, node: ast.AST, depth: int = 0) -> Iterator[Element]:
        """Yield parameters of a dictionary, or the file that has them."""
        line = getattr(node, "lineno", 0)
        if isinstance(value, Element) and value.tag == "parameters":
            yield from value.children
        elif isinstance(value, dict) and depth < MAX_DEPTH:
            for name, one in value.items():
                place = getattr(value, "lines", {}).get(name, line)
                attributes = {"name": self.text(name, node)}
                if isinstance(one, dict):
                    yield Element("param", attributes, place, list(self._parameters(one, node, depth + 1)))
                    continue
                is_array = isinstance(one, list | tuple) and all(
                    not isinstance(part, str) or self._is_plain(part) for part in one
                )
                attributes["value"] = str(list(one)) if is_array and len(one) < 100 else self.text(one, node)
                yield Element("param", attributes, place)
        else:
            yield Element("param", {"from": self.text(value, node)}, line)

    def _rewritten(self, node: ast.Call, args: list[Any], keywords: dict[str, Any]) -> Element:
        """Return the parameters of a file in which Nav2's RewrittenYaml replaces some."""
        given = dict(zip(("source_file", "param_rewrites"), args, strict=False)) | keywords
        children = [
            *self._parameters(given.get("source_file"), node),
            *self._parameters(given.get("param_rewrites", {}), node),
        ]
        return Element("parameters", {}, node.lineno, children)

    def _elements(self, value: Any, depth: int = 0) -> list[Element]:
        """Return the actions in a value."""
        if isinstance(value, Element):
            return [value]
        if isinstance(value, NotLiteral):
            return [Element("unread", {"what": value, "computed": "true"}, value.line)]
        if isinstance(value, list | tuple) and depth < MAX_DEPTH:
            self._charge(len(value))
            return [element for one in value for element in self._elements(one, depth + 1)]
        return []

    def _extend(self, target: list[Any], added: Iterable[Any]) -> None:
        items = list(added)
        self._charge(len(items))
        target += [self._doubtful([one])[0] if isinstance(one, Element) else self._perhaps(one) for one in items]

    def _perhaps(self, value: Any) -> Any:
        """Return a value, or none in a branch that is perhaps not taken."""
        return self._not_literal(self.doubts[-1].test) if self.doubts else value

    def _doubtful(self, elements: list[Element]) -> list[Element]:
        """Return actions with the condition of the branch that they are in."""
        for doubt in self.doubts:
            attributes = {doubt.attribute: doubt.text}
            elements = [Element("group", dict(attributes), element.line, [element]) for element in elements]
        return elements

    # Texts.

    def _substitution(self, kind: str, parts: list[Any], node: ast.AST) -> str:
        texts = [self.text(part, node) for part in parts]
        if not texts or any(isinstance(text, NotLiteral) for text in texts):
            return self._not_literal(node)
        return self._joined([f"$({kind} ", " ".join(texts), ")"], node)

    def _path(self, parts: Iterable[Any], node: ast.AST) -> str:
        """Return a path as ``os.path.join`` does: an absolute part begins anew."""
        joined: list[str] = []
        for part in parts:
            text = self.text(part, node)
            joined = [text] if text.startswith("/") or isinstance(text, NotLiteral) else [*joined, text]
            if isinstance(text, NotLiteral):
                return self._not_literal(node)
        return self._joined(
            [part for text in joined for part in ("/", text.rstrip("/") if joined[1:] else text)][1:], node
        )

    def _joined(self, texts: list[str], node: ast.AST) -> str:
        if any(isinstance(text, NotLiteral) for text in texts):
            return self._not_literal(node)
        return "".join(texts) if sum(map(len, texts)) <= _MAX_TEXT else self._not_literal(node)

    def _not_literal(self, node: ast.AST | None) -> NotLiteral:
        self._charge(1)
        return NotLiteral(getattr(node, "lineno", 0), partial(_source, node))

    @staticmethod
    def _is_plain(text: str) -> bool:
        return not isinstance(text, NotLiteral) and "$(" not in text

    def _truth(self, value: Any) -> bool | None:
        """Return whether a value is true; None if it is not known."""
        if isinstance(value, str) and not self._is_plain(value):
            return None
        return None if isinstance(value, Element | _Condition | _Function) else bool(value)

    def _step(self, node: ast.AST | None) -> None:
        self._charge(1, node)

    def _charge(self, steps: int, node: ast.AST | None = None) -> None:
        self.steps += steps
        if self.steps > _MAX_STEPS:
            place = f", line {line}" if (line := getattr(node, "lineno", 0)) else ""
            raise ParameterError(f"{self.path}{place}: takes more than {_MAX_STEPS:,} steps to read")


class _Lines(dict[Any, Any]):
    """A dictionary that knows the lines of its keys."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.lines: dict[Any, int] = {}

    def copy(self) -> _Lines:
        made = _Lines(self)
        made.lines = dict(self.lines)
        return made


def _listed(value: Any) -> list[Any] | tuple[Any, ...]:
    if value is None:
        return ()
    return value if isinstance(value, list | tuple) else (value,)


def _dotted(node: ast.AST) -> str:
    """Return the name of an expression such as ``os.path.join``; empty if it is another."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.append(node.attr)
        node = node.value
    return ".".join([node.id, *reversed(names)]) if isinstance(node, ast.Name) else ""


def _folder_of(path: str) -> str:
    above, slash, last = path.rpartition("/")
    return above if slash and ")" not in last else f"{path}/.."


def _source(node: ast.AST | None) -> str:
    """Return the text of an expression for errors."""
    return "it" if node is None else ast.unparse(node)
