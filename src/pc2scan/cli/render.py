"""Formats errors, tables and numbers, with text of untrusted recordings escaped for the terminal."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import typer

from pc2scan.shown import Table, count, duration, size, stamp

from .fitting import table_lines
from .screen import Screen
from .spelling import as_typed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pc2scan.errors import Pc2ScanError

__all__ = [
    "count",
    "duration",
    "error_text",
    "message",
    "print_json",
    "printable",
    "show_parts",
    "size",
    "stamp",
    "table",
    "warn",
]


#: Maximum number of characters of a text, and of a cell of a table. Names in ROS have at most 255.
_MAX_TEXT = 4_000
_MAX_CELL = 255


def printable(text: str) -> str:
    r"""Escape control characters, because names come from untrusted recordings; very long text is cut.

    >>> printable("/scan\x1b[2J"), printable("a" * 5000)[-20:]
    ('/scan\\x1b[2J', 'aaaa... (5000 chars)')
    """
    more = f"... ({len(text)} chars)" if len(text) > _MAX_TEXT else ""
    text = text[:_MAX_TEXT] if more else text
    ascii_only = _ascii_only()
    shown = (
        c if c.isprintable() and (c.isascii() or not ascii_only) else c.encode("unicode_escape").decode() for c in text
    )
    return "".join(shown) + more


def message(text: str) -> str:
    """Return a message of the library for the terminal, with options as they are typed there."""
    return printable(as_typed(text))


def _ascii_only() -> bool:
    """Whether the output file or terminal cannot show every character."""
    encodings = (getattr(stream, "encoding", None) or "ascii" for stream in (sys.stdout, sys.stderr))
    return any(not encoding.lower().startswith("utf") for encoding in encodings)


def _cut(cell: str) -> str:
    """Shorten a cell, because one long name would widen every line of its table."""
    return cell if len(cell) <= _MAX_CELL else f"{cell[:_MAX_CELL]}... ({len(cell)} chars)"


def error_text(err: Pc2ScanError) -> str:
    """Format an error: where, what was wrong, and what to do."""
    lines = [f"error: {message(str(err))}"]
    if err.hint:
        lines.append(f"hint: {message(err.hint)}")
    return "\n".join(lines)


def warn(text: str) -> None:
    """Show a warning on standard error."""
    typer.echo(f"warning: {message(text)}", err=True)


def print_json(document: object) -> None:
    """Print JSON on standard output."""
    import json

    text = json.dumps(document, indent=2)
    if isinstance(sys.stdout, Screen):
        sys.stdout.write_as_it_is(f"{text}\n")
        sys.stdout.flush()
    else:
        typer.echo(text)


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: Sequence[str] = ()) -> None:
    """Print a table on standard output, fitted to its width.

    Rich is not used, because to import it takes a third of the time in which a small recording is converted.

    Parameters
    ----------
    columns
        Headings.
    rows
        Cells as text, as many as there are headings.
    left
        The headings of columns aligned to the left; the others are numbers.
    """
    cells = [list(columns), *([printable(_cut(cell)) for cell in row] for row in rows)]
    for line in table_lines(cells, left, getattr(sys.stdout, "width", None)):
        typer.echo(line)


def show_parts(parts: Iterable[str | Table]) -> None:
    """Print the parts of a result."""
    for part in parts:
        if isinstance(part, Table):
            table(part.columns, [[as_typed(cell) for cell in row] for row in part.rows], left=part.left)
        else:
            typer.echo(message(part))
