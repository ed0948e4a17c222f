"""Reads XML with the lines of its elements, which ElementTree does not have; it also always expands entities."""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.parsers import expat

from pc2scan.errors import UsageError

#: Elements of a file, which is untrusted; each takes some 300 bytes.
_MOST_ELEMENTS = 100_000


@dataclass(slots=True)
class Element:
    """An element of XML, and the line that it begins in."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)
    text: str = ""


def xml_tree(text: str) -> Element:
    """Return the root element.

    Raises
    ------
    UsageError
        If it is not XML, or declares a document type: these can declare entities.
    """
    stack, left = [Element("", {}, 0)], _MOST_ELEMENTS
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise UsageError(f"line {parser.CurrentLineNumber}: it has more than {_MOST_ELEMENTS:,} elements")
        element = Element(tag, attributes, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def characters(data: str) -> None:
        stack[-1].text += data

    def refuse(*_declared: object) -> None:
        message = f"line {parser.CurrentLineNumber}: it declares a document type, which is not supported"
        raise UsageError(message, hint="remove the <!DOCTYPE ...>; nothing in the file needs it")

    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _tag: stack.pop()
    parser.CharacterDataHandler = characters
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text.encode("utf-8", "surrogateescape"), True)
    except expat.ExpatError as err:
        raise UsageError(f"line {err.lineno}: not valid XML: {expat.ErrorString(err.code)}") from err
    except (UnicodeDecodeError, UnicodeEncodeError) as err:
        raise UsageError(f"not valid XML: {err.reason}") from err
    return stack[0].children[0]
