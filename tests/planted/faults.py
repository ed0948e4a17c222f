"""Faults to plant in the source: small changes that a test should notice.

Each fault changes one expression or statement, as people do by mistake: an operator, a bound, the order of arguments, a
unit; or it drops a call or a check. `faults_in` finds all that a module can have, and `sample` draws some of the whole
package, in proportion to the code of each room and to the harm that its faults do to users.
"""

from __future__ import annotations

import ast
import random
import re
from bisect import bisect
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

#: How much more often a fault is drawn where it harms users than its code's size says: wrong numbers, lost messages,
#: lost files.
HARM = {
    "core": 2.0,
    "core/loops": 3.0,
    "transforms": 1.5,
    "messages": 1.5,
    "bags": 1.5,
    "files": 2.0,
    "conversion/combine": 3.0,
    "datasets": 1.5,
    "cli": 0.5,
    "show": 0.7,
}

#: Units: a factor that turns one into another, and its neighbour.
_UNITS = {1e9: 1e6, 1e6: 1e3, 1e-9: 1e-6, 1e-6: 1e-3, 1e3: 1e6}

_COMPARED = {
    ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==",
    ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in",
}  # fmt: skip
_COMPUTED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "*", ast.Mod: "+"}
_CALLED = {"min": "max", "max": "min", "any": "all", "all": "any", "floor": "ceil", "ceil": "floor"}

#: What a comparison in C becomes; whole words of code, never in comments, strings or directives.
_IN_C = ((r" < ", " <= "), (r" <= ", " < "), (r" > ", " >= "), (r" >= ", " > "), (r" && ", " || "), (r" \+ ", " - "))


class Fault(NamedTuple):
    """A piece of source text, and what takes its place."""

    path: str
    line: int
    #: Where the piece is in the text, in characters.
    start: int
    end: int
    old: str
    new: str
    kind: str

    @property
    def room(self) -> str:
        """The package that it is in, and the one in that if it has one of its own in `HARM`."""
        parts = Path(self.path).parts[2:]
        inner = "/".join(parts[:2])
        return inner if inner in HARM else parts[0].removesuffix(".py")

    def __str__(self) -> str:
        """Return where it is and what it changes."""
        old, new = (" ".join(text.split()) for text in (self.old, self.new))
        return f"{self.path}:{self.line}: {self.kind}: {old[:60]} -> {new[:60]}"


def plant(text: str, fault: Fault) -> str:
    """Return a module's text with a fault.

    Raises
    ------
    ValueError
        If the text is not the one in which the fault was found.
    """
    if text[fault.start : fault.end] != fault.old:
        raise ValueError(f"{fault}: the source has changed")
    return text[: fault.start] + fault.new + text[fault.end :]


def faults_in(path: str, text: str) -> Iterator[Fault]:
    """Find every fault that can be planted in a module, Python's or C's."""
    if path.endswith(".c"):
        yield from _faults_in_c(path, text)
        return
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    # ast counts columns in bytes.
    lines = [line.encode() for line in text.splitlines(keepends=True)]

    def place(line: int, column: int) -> int:
        return starts[line - 1] + len(lines[line - 1][:column].decode())

    def span(node: ast.AST) -> tuple[int, int]:
        located: ast.expr = node  # type: ignore[assignment]
        return place(located.lineno, located.col_offset), place(located.end_lineno or 0, located.end_col_offset or 0)

    def fault(kind: str, node: ast.AST, new: str, between: tuple[int, int] | None = None) -> Fault:
        start, end = between or span(node)
        return Fault(path, bisect(starts, start), start, end, text[start:end], new, kind)

    for node in _code(ast.parse(text)):
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            between = span(node.left)[1], span(node.comparators[0])[0]
            yield fault("operator", node, f" {_COMPARED[type(node.ops[0])]} ", _without_brackets(text, between))
        elif isinstance(node, ast.BinOp) and type(node.op) in _COMPUTED and not isinstance(node.left, ast.Constant):
            between = _without_brackets(text, (span(node.left)[1], span(node.right)[0]))
            yield fault("operator", node, f" {_COMPUTED[type(node.op)]} ", between)
        elif isinstance(node, ast.BoolOp):
            between = _without_brackets(text, (span(node.values[0])[1], span(node.values[1])[0]))
            yield fault("operator", node, " or " if isinstance(node.op, ast.And) else " and ", between)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield fault("operator", node, f"bool({ast.unparse(node.operand)})")
        elif (
            isinstance(node, ast.Constant) and isinstance(node.value, (int, float)) and not isinstance(node.value, bool)
        ):
            unit = _UNITS.get(node.value)
            if unit is not None:
                yield fault("unit", node, repr(type(node.value)(unit)))
            elif isinstance(node.value, int) and node.value < 1 << 32:
                yield fault("bound", node, repr(node.value + 1))
        elif isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else ""
            if name in _CALLED:
                yield fault("call", node.func, _CALLED[name])
            plain = [each for each in node.args if not isinstance(each, ast.Starred)]
            if len(plain) == len(node.args) > 1 and name not in {"isinstance", "issubclass", "getattr", "cast"}:
                first, second = node.args[:2]
                new = f"{ast.unparse(second)}, {ast.unparse(first)}"
                if ast.unparse(first) != ast.unparse(second):
                    yield fault("arguments", node, new, (span(first)[0], span(second)[1]))
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            yield fault("missing call", node, "pass")
        elif isinstance(node, ast.If) and not node.orelse and isinstance(node.body[-1], ast.Raise):
            yield fault("dropped check", node.test, "False")
        elif isinstance(node, ast.If) and isinstance(node.body[-1], (ast.Return, ast.Continue)):
            yield fault("condition", node.test, "False")


def _code(tree: ast.AST) -> Iterator[ast.AST]:
    """Walk through everything that runs: no annotations, no code for type checkers, no texts with fields."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for field in node._fields:
            if field in _NOT_RUN:
                continue
            value = getattr(node, field, None)
            waiting += [
                each
                for each in (value if isinstance(value, list) else [value])
                if isinstance(each, ast.AST) and not isinstance(each, _PASSED_OVER) and not _for_types(each)
            ]


#: Fields of nodes that do not run, or run when a module is loaded; nodes that hold texts for people.
_NOT_RUN = frozenset({"annotation", "returns", "decorator_list", "type_params", "ctx", "ops", "op"})
_PASSED_OVER = (ast.JoinedStr, ast.Raise, ast.Assert)


def _for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _without_brackets(text: str, between: tuple[int, int]) -> tuple[int, int]:
    """Return the part of the text between two operands that is the operator: their brackets are not in their spans."""
    start, end = between
    while text[start:end].lstrip().startswith(")"):
        start = text.index(")", start) + 1
    while text[start:end].rstrip().endswith("("):
        end = text.rindex("(", start, end)
    return start, end


def _faults_in_c(path: str, text: str) -> Iterator[Fault]:
    no_code = r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"|^#[^\n]*'
    code = re.sub(no_code, lambda found: " " * len(found[0]), text, flags=re.DOTALL | re.MULTILINE)
    found = [
        Fault(path, text.count("\n", 0, match.start()) + 1, *match.span(), match[0], new, "operator")
        for old, new in _IN_C
        for match in re.finditer(old, code)
    ]
    yield from sorted(found, key=lambda each: each.start)


def sample(root: Path, count: int, seed: int) -> list[Fault]:
    """Draw faults from all modules below ``src``, each room by its code's size and `HARM`, each kind alike.

    The draw is the same for the same source and seed.
    """
    rooms: dict[str, list[Fault]] = {}
    for path in sorted([*root.glob("src/pc2scan/**/*.py"), *root.glob("src/pc2scan/**/*.c")]):
        faults = sorted(faults_in(path.relative_to(root).as_posix(), path.read_text("utf-8")))
        if faults:
            rooms.setdefault(faults[0].room, []).extend(faults)
    weights = {room: len(faults) * HARM.get(room, 1.0) for room, faults in rooms.items()}
    draw = random.Random(seed)
    drawn: list[Fault] = []
    for room, weight in sorted(weights.items()):
        number = count * weight / sum(weights.values())
        kinds: dict[str, list[Fault]] = {}
        for fault in rooms[room]:
            kinds.setdefault(fault.kind, []).append(fault)
        turns = draw.sample(sorted(kinds), len(kinds))
        wanted = int(number) + (draw.random() < number % 1)
        drawn += [draw.choice(kinds[turns[index % len(turns)]]) for index in range(wanted)]
    return sorted(set(drawn))
