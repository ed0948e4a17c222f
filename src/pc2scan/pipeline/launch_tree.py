"""The elements of launch files, and how they are read from XML."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from typing_extensions import Self

#: Maximum number of levels of nested elements.
MAX_DEPTH = 50


class NotLiteral(str):
    """A text of a Python launch file that only its execution could give; it is empty.

    Attributes
    ----------
    line
        Where it is.
    source
        Returns its expression.
    """

    __slots__ = ("line", "source")
    line: int
    source: Callable[[], str]

    def __new__(cls, line: int, source: Callable[[], str]) -> Self:
        """Make a text of a line and what returns the expression in it."""
        made = super().__new__(cls)
        made.line, made.source = line, source
        return made

    def __bool__(self) -> bool:
        """Return true: it is no empty text."""
        return True

    @property
    def shown(self) -> str:
        """The beginning of the expression, for errors."""
        try:
            text = self.source()
        except RecursionError:
            text = "an expression"
        return f"{text[:57]}..." if len(text) > 60 else text


@dataclass(slots=True)
class Element:
    """An element of a launch file, with the names of XML.

    Attributes
    ----------
    attributes
        Texts with substitutions, such as ``$(arg x)``, or `NotLiteral`.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)
    text: str = ""


def xml_tree(text: str, path: Path) -> Element:
    """Return the root element of an XML launch file.

    Raises
    ------
    ParameterError
        If the text is not XML, is no launch file, is nested too deeply, or declares a document type.
    """
    # ElementTree is not used: it has no line numbers, and always expands entities.
    from xml.parsers import expat  # noqa: PLC0415  # only for launch files

    root = Element("", {}, 0)
    stack = [root]
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > MAX_DEPTH:
            raise ParameterError(f"{path}, line {parser.CurrentLineNumber}: nested more than {MAX_DEPTH} levels deep")
        element = Element(tag, attributes, parser.CurrentLineNumber)
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
