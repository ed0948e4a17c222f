"""What is shown: errors, tables and numbers, safe for a terminal whatever a recording holds."""

from __future__ import annotations

import shutil
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.errors import Pc2ScanError

__all__ = ["count", "error_text", "printable", "size", "table"]

#: Output that is not on a terminal is not cut to one's width.
_PIPE_WIDTH = 10_000


def printable(text: str) -> str:
    r"""Escape what a terminal would act upon; names come from recordings, and recordings from strangers.

    >>> printable("/scan\x1b[2J")
    '/scan\\x1b[2J'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "backslashreplace").decode() for c in text)


def error_text(err: Pc2ScanError) -> str:
    """Render an error: what was wrong, where, and what to do."""
    lines = [f"error: {printable(err.message)}"]
    if err.where:
        lines.append(f"where: {printable(err.where)}")
    if err.hint:
        lines.append(f"hint:  {printable(err.hint)}")
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
    """Print a table on standard output.

    Parameters
    ----------
    columns
        Headings.
    rows
        Cells as text, as many as there are headings.
    left
        The headings of columns aligned to the left; the others are numbers.
    """
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    terminal = sys.stdout.isatty()
    width = shutil.get_terminal_size().columns if terminal else _PIPE_WIDTH
    console = Console(file=sys.stdout, width=width, highlight=False, soft_wrap=not terminal)
    grid = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, header_style="bold")
    for heading in columns:
        grid.add_column(heading, justify="left" if heading in left else "right", overflow="fold")
    for row in rows:
        grid.add_row(*(Text(printable(cell)) for cell in row))
    console.print(grid)
