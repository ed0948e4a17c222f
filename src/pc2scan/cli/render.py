"""Prints lines, errors, tables and JSON. All text of the commands is printed here, so that it is safe to show."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import typer

from pc2scan.errors import visible
from pc2scan.text import Table, cells

from .fitting import table_lines
from .screen import Screen
from .spelling import as_typed

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pc2scan.errors import Pc2ScanError


def say(text: str = "", *, err: bool = False) -> None:
    """Print one line, with whatever a terminal or a CI system would obey made visible. All commands print with it."""
    typer.echo(visible(text, ascii_only=_ascii_only()), err=err)


def _ascii_only() -> bool:
    """Whether the output file or terminal cannot show every character."""
    encodings = (getattr(stream, "encoding", None) or "ascii" for stream in (sys.stdout, sys.stderr))
    return any(not encoding.lower().startswith("utf") for encoding in encodings)


def show_error(err: Pc2ScanError) -> None:
    """Show an error on standard error: where, what was wrong, and what to do."""
    say(as_typed(f"error: {err}"), err=True)
    if err.hint:
        say(as_typed(f"hint: {err.hint}"), err=True)


def warn(text: str) -> None:
    """Show a warning on standard error."""
    say(as_typed(f"warning: {text}"), err=True)


def print_json(document: object) -> None:
    """Print JSON on standard output."""
    import json

    # Everything else that is not text for a terminal or a CI system is escaped in JSON anyway.
    text = json.dumps(document, indent=2).replace("##", r"\u0023\u0023")
    if isinstance(sys.stdout, Screen):
        sys.stdout.write_as_it_is(f"{text}\n")
        sys.stdout.flush()
    else:
        typer.echo(text)


def show_table(shown: Table) -> None:
    """Print a table on standard output, fitted to its width.

    Rich is not used, because to import it takes a third of the time in which a small recording is converted.
    """
    for line in table_lines(cells(shown, ascii_only=_ascii_only()), shown.left, getattr(sys.stdout, "width", None)):
        say(line)


def show_parts(parts: Iterable[str | Table]) -> None:
    """Print the parts of a result, with options as they are typed."""
    for part in parts:
        if isinstance(part, Table):
            show_table(part._replace(rows=[[as_typed(cell) for cell in row] for row in part.rows]))
        else:
            say(as_typed(part))
