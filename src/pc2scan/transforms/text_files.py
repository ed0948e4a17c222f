"""Reads text files of transforms and of options, which are untrusted: their size is bounded; and XML with its lines."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.parsers import expat

from pc2scan.errors import UsageError
from pc2scan.files.source_file import missing_hint, open_text

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import TextIO

#: Elements of a file, which is untrusted; each takes some 300 bytes.
_MOST_ELEMENTS = 100_000


def text_of(path: Path, most: int, what: str) -> str:
    """Return the text of a file; see `open_bounded`."""
    with open_bounded(path, most, what) as file:
        return file.read(most)


@contextmanager
def open_bounded(path: Path, most: int, what: str) -> Iterator[TextIO]:
    """Open a text file.

    Parameters
    ----------
    path
        The file.
    most
        The largest size, bytes.
    what
        What the file is, for errors: ``a trajectory``.

    Raises
    ------
    UsageError
        If the file cannot be read, is too large, or is not text in UTF-8.
    """
    try:
        if (size := path.stat().st_size) > most:
            raise UsageError(f"has {size:,} bytes; {what} has at most {most:,}", path=path)
        with open_text(path) as file:
            yield file
    except FileNotFoundError as err:
        raise UsageError("does not exist", path=path, hint=missing_hint(path)) from err
    except OSError as err:
        raise UsageError(f"cannot be read: {err.strerror}", path=path) from err
    except UnicodeDecodeError as err:
        raise UsageError(f"is not {what}: it is not text in UTF-8", path=path) from err


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
