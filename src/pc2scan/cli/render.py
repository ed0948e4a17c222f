"""What is shown: errors, tables and numbers, safe for a terminal whatever a recording holds."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import typer

from pc2scan.shown import Table

from .spelling import as_typed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pc2scan.errors import Pc2ScanError

__all__ = ["count", "error_text", "message", "print_json", "printable", "show_parts", "size", "table", "warn"]


#: Characters of a text, and of a cell of a table. ROS's own names have at most 255.
_MAX_TEXT = 4_000
_MAX_CELL = 255


def printable(text: str) -> str:
    r"""Escape what a terminal would act upon; names come from recordings, which are untrusted.

    What no line of a screen could show is cut.

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
    """A message of the library, for a terminal: its options as they are typed."""
    return printable(as_typed(text))


def _ascii_only() -> bool:
    """Whether the text may go to a file or terminal that cannot show everything."""
    encodings = (getattr(stream, "encoding", None) or "ascii" for stream in (sys.stdout, sys.stderr))
    return any(not encoding.lower().startswith("utf") for encoding in encodings)


def _cut(cell: str) -> str:
    """Shorten a cell; one long name would otherwise make every line of its table as long."""
    return cell if len(cell) <= _MAX_CELL else f"{cell[:_MAX_CELL]}... ({len(cell)} chars)"


def error_text(err: Pc2ScanError) -> str:
    """Render an error: where, what was wrong, and what to do."""
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

    typer.echo(json.dumps(document, indent=2))


def count(number: int) -> str:
    """Render a count; a zero is a dash, so that what is there catches the eye."""
    return f"{number:,}" if number else "-"


def size(number: float) -> str:
    """Render a number of bytes: ``680.5 kB``."""
    for unit in ("B", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.0f} {unit}" if unit == "B" else f"{number:.1f} {unit}"
        number /= 1000
    return f"{number:.1f} TB"


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: Sequence[str] = ()) -> None:
    """Print a table on standard output, one line a row whatever the width of the terminal.

    Not with rich: importing it takes a third of the time that converting a small recording takes.

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
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    for number, line in enumerate(cells):
        aligned = (
            cell.ljust(width) if heading in left else cell.rjust(width)
            for heading, cell, width in zip(columns, line, widths, strict=True)
        )
        typer.echo("   ".join(aligned).rstrip())
        if number == 0:
            typer.echo("-" * (sum(widths) + 3 * (len(widths) - 1)))


def show_parts(parts: Iterable[str | Table]) -> None:
    """Print what a result shows of itself."""
    for part in parts:
        if isinstance(part, Table):
            table(part.columns, part.rows, left=part.left)
        else:
            typer.echo(message(part))
