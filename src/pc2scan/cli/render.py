"""Formats errors, tables and numbers, with text of untrusted recordings escaped for the terminal."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import typer

from pc2scan.errors import stamp_text
from pc2scan.shown import Table

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


#: Characters of a text, and of a cell of a table. ROS's own names have at most 255.
_MAX_TEXT = 4_000
_MAX_CELL = 255

#: Seconds since 1970 that are dates: from 1980 to 2100.
_FIRST_DATE, _LAST_DATE = 315_532_800, 4_102_444_800


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
    """Return a message of the library for the terminal, with options as they are typed."""
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


def count(number: int) -> str:
    """Format a count; zero is a dash."""
    return f"{number:,}" if number else "-"


def size(number: float) -> str:
    """Format a number of bytes: ``680.5 kB``."""
    for unit in ("B", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.0f} {unit}" if unit == "B" else f"{number:.1f} {unit}"
        number /= 1000
    return f"{number:.1f} TB"


def duration(seconds: float) -> str:
    """Render a duration.

    >>> duration(0.0004), duration(0.0354), duration(9.96), duration(75), duration(7384)
    ('under 1 ms', '35 ms', '10.0 s', '1 min 15 s', '2 h 3 min')
    """
    if seconds < 0.001:
        return "under 1 ms"
    if seconds < 0.9995:
        return f"{seconds * 1000:.0f} ms"
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def stamp(stamp_ns: int) -> str:
    """Render a stamp, with its date where it has one: simulated time begins at 0.

    >>> stamp(1604515190231374463), stamp(5_000_000_000)
    ('1604515190.231374463 (2020-11-04 18:39:50 UTC)', '5.000000000')
    """
    seconds = stamp_ns // 1_000_000_000
    if not _FIRST_DATE <= seconds <= _LAST_DATE:
        return stamp_text(stamp_ns)
    from datetime import UTC, datetime

    return f"{stamp_text(stamp_ns)} ({datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC)"


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: Sequence[str] = ()) -> None:
    """Print a table on standard output, as wide as that allows.

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
    for line in table_lines(cells, left, getattr(sys.stdout, "width", None)):
        typer.echo(line)


def show_parts(parts: Iterable[str | Table]) -> None:
    """Print the parts of a result."""
    for part in parts:
        if isinstance(part, Table):
            table(part.columns, part.rows, left=part.left)
        else:
            typer.echo(message(part))
