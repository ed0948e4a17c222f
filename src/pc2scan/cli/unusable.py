"""The exit status of commands that compare: 1 says that something differs, so whatever cannot be compared is 2."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from pc2scan.errors import DamageError, Pc2ScanError

from .render import error_text

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["exit_status_2"]


@contextmanager
def exit_status_2() -> Iterator[None]:
    """Show an error of the body as any command does, but end with 2."""
    try:
        yield
    except Pc2ScanError as err:
        if isinstance(err, DamageError):
            err.hint = "pc2scan repair makes a sound recording of what is left of it"
        typer.echo(error_text(err), err=True)
        raise typer.Exit(2) from err
