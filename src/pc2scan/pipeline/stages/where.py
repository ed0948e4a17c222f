"""A filter by the values of fields: ``ring in (3, 4, 5) and intensity > 10``.

The grammar::

    condition   = conjunction {"or" conjunction}
    conjunction = negation {"and" negation}
    negation    = "not" negation | comparison
    comparison  = sum (("<" | "<=" | ">" | ">=" | "==" | "!=") sum)+
                | sum ["not"] "in" "(" number {"," number} [","] ")"
                | "(" condition ")"
    sum         = product {("+" | "-") product}
    product     = factor {("*" | "/" | "%") factor}
    factor      = "-" factor | number | field | "abs" "(" sum ")" | "(" sum ")"

Nothing is executed: a condition becomes a tree of the nodes below, and these call NumPy.
"""

from __future__ import annotations

import operator
import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.errors import UsageError

from .filters import Frame

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.points import Points

_EXAMPLE = "such as `where='ring in (3, 4, 5) and intensity > 10'`"

#: The longest condition, and the deepest nesting: deeper ones could overflow the stack.
_LONGEST = 2_000
_DEEPEST = 50

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<sign><=|>=|==|!=|[<>()+\-*/%,]))"
)
_WORDS = {"and", "or", "not", "in", "abs"}

#: Operators of other languages, and what to write instead.
_INSTEAD = {"=": "for equality write ==", "&": "write and", "|": "write or", "!": "write not"}

_COMPARISONS: Mapping[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_ARITHMETIC: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": np.divide,
    "%": np.mod,
}


@dataclass(frozen=True, slots=True)
class Where:
    """Keeps the points for which a condition holds.

    Fields have their values as the cloud has them, ``x``, ``y`` and ``z`` in the cloud's own frame. Numbers are
    computed and compared as float64; a field of float32 is compared with a number as float32, so that ``== 0.1`` is
    true for a float32 of 0.1. NaN fulfils no comparison except ``!=``.

    Parameters
    ----------
    condition
        See the grammar of this module.

    Raises
    ------
    UsageError
        If the condition cannot be read, with the column.
    """

    condition: str
    _names: tuple[str, ...] = field(init=False, repr=False, compare=False)
    _holds: Callable[[Points], NDArray[np.bool_]] = field(init=False, repr=False, compare=False)

    name = "where"
    explanation = "rejected by `where`"
    frame = Frame.SOURCE

    @property
    def text(self) -> str:
        """The condition."""
        return self.condition

    def __post_init__(self) -> None:
        parser = _Parser(self.condition)
        object.__setattr__(self, "_holds", parser.whole())
        object.__setattr__(self, "_names", tuple(parser.fields))

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields in the condition, in its order."""
        return self._names

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return for which points the condition holds; see `pc2scan.pipeline.stages.filters.Filter`."""
        return self._holds(points)


@dataclass(frozen=True, slots=True)
class _Expression:
    """A part of a condition: a field, a number, or a function of other parts; ``column`` is where it begins."""

    column: int
    function: Callable[..., Any] | None = None
    parts: tuple[_Expression, ...] = ()
    is_condition: bool = False
    field: str = ""
    number: float | None = None

    def __call__(self, points: Points) -> Any:
        """Return its value for every point: float64, or bool for a condition."""
        if self.function is not None:
            return self.function(*(part(points) for part in self.parts))
        return np.float64(self.number) if self.number is not None else points.field(self.field).astype(np.float64)


@dataclass(frozen=True, slots=True)
class _Comparison(_Expression):
    """A comparison of two parts."""

    def __call__(self, points: Points) -> Any:
        left, right = (_operand(part, other, points) for part, other in (self.parts, self.parts[::-1]))
        return self.function(left, right)  # type: ignore[misc]  # a comparison has one


def _operand(part: _Expression, other: _Expression, points: Points) -> Any:
    """Return the values of a side of a comparison: float32 if a field of float32 is compared with a number."""
    named, number = (part, other) if part.field else (other, part)
    if named.field and number.number is not None:
        values = points.field(named.field)
        if values.dtype.kind == "f" and values.dtype.itemsize == 4:
            return values if named is part else np.float32(number.number)
    return part(points)


def _join_conditions(function: Callable[..., Any], conditions: Sequence[_Expression]) -> _Expression:
    """Return one condition that joins several."""
    first, *others = conditions
    for other in others:
        first = _Expression(first.column, function, (first, other), True)
    return first


class _Token(NamedTuple):
    """A word, number or sign of a condition; ``kind`` is one of `_TOKEN`'s groups, or end."""

    kind: str
    text: str
    column: int


class _Parser:
    """Reads one condition, from left to right."""

    def __init__(self, text: str) -> None:
        self._text = text
        if len(text) > _LONGEST:
            raise UsageError(f"`where` has {len(text):,} characters, at most {_LONGEST:,} are allowed")
        self._tokens = self._split()
        self._place = 0
        self._depth = 0
        self.fields: dict[str, None] = {}

    def whole(self) -> _Expression:
        """Read the whole condition."""
        condition = self._condition(self._either())
        if self._next.kind != "end":
            raise self._error(self._next.column, f"expected and, or, or the end, not {self._shown}")
        if not self.fields:
            raise self._error(1, "it names no field")
        return condition

    def _split(self) -> list[_Token]:
        tokens = []
        place, end = 0, len(self._text.rstrip())
        while place < end:
            found = _TOKEN.match(self._text, place)
            if found is None:
                column = end - len(self._text[place:end].lstrip()) + 1
                character = self._text[column - 1]
                raise self._error(column, f"unexpected {character!r}", _INSTEAD.get(character))
            kind = found.lastgroup or ""
            tokens.append(_Token(kind, found[kind], found.start(kind) + 1))
            place = found.end()
        return [*tokens, _Token("end", "the end", end + 1)]

    @property
    def _next(self) -> _Token:
        return self._tokens[self._place]

    @property
    def _shown(self) -> str:
        return self._next.text if self._next.kind == "end" else repr(self._next.text)

    def _take(self, *texts: str) -> str:
        """Take the next token if it is one of these; empty if not."""
        token = self._next
        if token.kind == "end" or token.text not in texts:
            return ""
        self._place += 1
        return token.text

    def _expect(self, text: str) -> None:
        if not self._take(text):
            raise self._error(self._next.column, f"expected {text!r}, not {self._shown}")

    def _error(self, column: int, what: str, hint: str | None = None) -> UsageError:
        return UsageError(f"`where`: column {column} of {self._text!r}: {what}", hint=hint or _EXAMPLE)

    def _condition(self, node: _Expression) -> _Expression:
        if not node.is_condition:
            raise self._error(node.column, "expected a comparison; this is a number", "compare it: ring == 3")
        return node

    def _value(self, node: _Expression) -> _Expression:
        if node.is_condition:
            raise self._error(node.column, "expected a number; this is a condition")
        return node

    def _either(self) -> _Expression:
        node = self._both()
        while self._take("or"):
            node = _Expression(node.column, np.logical_or, (self._condition(node), self._condition(self._both())), True)
        return node

    def _both(self) -> _Expression:
        node = self._negation()
        while self._take("and"):
            node = _Expression(
                node.column, np.logical_and, (self._condition(node), self._condition(self._negation())), True
            )
        return node

    def _negation(self) -> _Expression:
        column = self._next.column
        if self._take("not"):
            return _Expression(column, np.logical_not, (self._condition(self._deeper(self._negation)),), True)
        return self._comparison()

    def _comparison(self) -> _Expression:
        left = self._sum()
        column = left.column
        checks: list[_Expression] = []
        while sign := self._take(*_COMPARISONS):
            right = self._value(self._sum())
            checks.append(_Comparison(column, _COMPARISONS[sign], (self._value(left), right), True))
            left = right
        if checks:
            return _join_conditions(np.logical_and, checks)
        is_negated = self._next.text == "not" and self._tokens[self._place + 1].text == "in"
        self._place += is_negated
        if not self._take("in"):
            return left
        value = self._value(left)
        equal = [_Comparison(column, operator.eq, (value, number), True) for number in self._numbers()]
        found = _join_conditions(np.logical_or, equal)
        return _Expression(column, np.logical_not, (found,), True) if is_negated else found

    def _numbers(self) -> list[_Expression]:
        """Return the numbers in parentheses after ``in``."""
        self._expect("(")
        numbers = [self._literal()]
        while self._take(",") and self._next.text != ")":
            numbers.append(self._literal())
        self._expect(")")
        return numbers

    def _literal(self) -> _Expression:
        column, sign = self._next.column, -1 if self._take("-") else 1
        token = self._next
        if token.kind != "number":
            raise self._error(token.column, f"expected a number, not {self._shown}")
        self._place += 1
        return _Expression(column, number=sign * float(token.text))

    def _sum(self) -> _Expression:
        node = self._product()
        while sign := self._take("+", "-"):
            node = _Expression(node.column, _ARITHMETIC[sign], (self._value(node), self._value(self._product())))
        return node

    def _product(self) -> _Expression:
        node = self._factor()
        while sign := self._take("*", "/", "%"):
            node = _Expression(node.column, _ARITHMETIC[sign], (self._value(node), self._value(self._factor())))
        return node

    def _factor(self) -> _Expression:
        token = self._next
        if token.kind == "number" or (token.text == "-" and self._tokens[self._place + 1].kind == "number"):
            return self._literal()
        if token.kind == "name" and token.text not in _WORDS:
            self._place += 1
            self.fields[token.text] = None
            return _Expression(token.column, field=token.text)
        if self._take("-"):
            return _Expression(token.column, operator.neg, (self._value(self._deeper(self._factor)),))
        function = self._take("abs")
        if not function and self._next.text != "(":
            raise self._error(token.column, f"expected a field or a number, not {self._shown}")
        self._expect("(")
        node = self._deeper(self._either)
        self._expect(")")
        if function:
            return _Expression(token.column, np.abs, (self._value(node),))
        return replace(node, column=token.column)

    def _deeper(self, read: Callable[[], _Expression]) -> _Expression:
        """Read a nested part; raise if it is too deep."""
        if self._depth >= _DEEPEST:
            raise self._error(self._next.column, f"more than {_DEEPEST} levels of parentheses, signs and nots")
        self._depth += 1
        node = read()
        self._depth -= 1
        return node
