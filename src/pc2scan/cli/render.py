"""What is shown: errors, tables and numbers, safe for a terminal whatever a recording holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.errors import Pc2ScanError

__all__ = ["count", "error_text", "printable", "size", "table"]


def printable(text: str) -> str:
    r"""Escape what a terminal would act upon; names come from recordings, and recordings from strangers.

    >>> printable("/scan\x1b[2J")
    '/scan\\x1b[2J'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "backslashreplace").decode() for c in text)


def error_text(err: Pc2ScanError) -> str:
    """Render an error: where, what was wrong, and what to do."""
    lines = [f"error: {printable(str(err))}"]
    if err.hint:
        lines.append(f"hint: {printable(err.hint)}")
    return "\n".join(lines)


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
    cells = [list(columns), *([printable(cell) for cell in row] for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    for number, line in enumerate(cells):
        aligned = (
            cell.ljust(width) if heading in left else cell.rjust(width)
            for heading, cell, width in zip(columns, line, widths, strict=True)
        )
        typer.echo("   ".join(aligned).rstrip())
        if number == 0:
            typer.echo("-" * (sum(widths) + 3 * (len(widths) - 1)))
