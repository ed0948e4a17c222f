"""The command line within this process: what golden cases run their conversions with."""

from __future__ import annotations

import signal
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import TYPE_CHECKING

import typer

from pc2scan.golden.check import Ended

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["run_command"]


def run_command(arguments: Sequence[str]) -> Ended:
    """Run ``pc2scan`` with arguments; what it prints is returned instead.

    Raises
    ------
    KeyboardInterrupt, SystemExit
        If it was interrupted or terminated: that was meant for the whole process.
    """
    from .app import application

    said = StringIO()
    status = 0
    with redirect_stdout(StringIO()), redirect_stderr(said):
        try:
            application(*arguments[:1])(list(arguments), prog_name="pc2scan")
        except SystemExit as err:
            status = err.code if isinstance(err.code, int) else 1
    if status == 128 + signal.SIGINT:
        raise KeyboardInterrupt
    if status > 128:
        typer.echo(said.getvalue(), err=True, nl=False)
        raise SystemExit(status)
    return Ended(status, said.getvalue())
