"""Runs the command line within this process, for golden cases."""

from __future__ import annotations

import signal
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import TYPE_CHECKING

from pc2scan.compare.golden import CommandResult
from pc2scan.errors import UsageError
from pc2scan.options.option import Scope
from pc2scan.options.table import options_of

from .app import parse, run

if TYPE_CHECKING:
    from collections.abc import Sequence


def run_command(arguments: Sequence[str], chosen: Sequence[str] = ()) -> CommandResult:
    """Run ``pc2scan`` with arguments, and return what it prints. See `pc2scan.compare.golden.Command`.

    Raises
    ------
    UsageError
        If ``chosen`` has more than options that decide what is converted.
    KeyboardInterrupt, SystemExit
        If it was interrupted or terminated; the signal was meant for the whole process.
    """
    if chosen:
        _refuse_others(arguments[0], chosen)
    output = StringIO()
    with redirect_stdout(StringIO()), redirect_stderr(output):
        status = run([*arguments, *chosen])
    if status == 128 + signal.SIGINT:
        raise KeyboardInterrupt
    return CommandResult(status, output.getvalue())


def _refuse_others(name: str, chosen: Sequence[str]) -> None:
    """Raise if any of these options decides something else than what is converted."""
    known = options_of(name)
    for key, value in parse([name, *chosen]).items():
        if key == "sources":
            raise UsageError(f"{value[0]!r} is not an option", hint="a case names its recordings under 'input'")
        option = known.get(key)
        if option is None or key == "to" or (option.scope == Scope.CALL_ONLY and key != "jobs"):
            raise UsageError(
                f"{option.spelling if option else '--output'} may not be in a case",
                hint="a case decides what is converted, but not where the output is written or what is shown",
            )
