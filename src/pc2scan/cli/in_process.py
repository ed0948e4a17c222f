"""Runs the command line within this process, for golden cases."""

from __future__ import annotations

import signal
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import TYPE_CHECKING

from pc2scan.compare.golden.check import CommandResult
from pc2scan.errors import UsageError
from pc2scan.options.option import Scope
from pc2scan.options.table import options_of

from .app import parse, run
from .render import say

if TYPE_CHECKING:
    from collections.abc import Sequence

#: The option of ``convert`` that decides where the output is written: a case does not have it.
_PLACE = {"to"}


def run_command(arguments: Sequence[str], chosen: Sequence[str] = ()) -> CommandResult:
    """Run ``pc2scan`` with arguments, and return what it prints. See `pc2scan.compare.golden.check.Command`.

    Raises
    ------
    UsageError
        If ``chosen`` has more than options that decide what is converted.
    KeyboardInterrupt, SystemExit
        If it was interrupted or terminated; the signal was meant for the whole process.
    """
    if chosen:
        _refuse_others(arguments[0], chosen)
    said = StringIO()
    with redirect_stdout(StringIO()), redirect_stderr(said):
        try:
            status = run([*arguments, *chosen])
        except SystemExit as err:
            status = err.code if isinstance(err.code, int) else 1
    if status == 128 + signal.SIGINT:
        raise KeyboardInterrupt
    if status > 128:
        for line in said.getvalue().splitlines():
            say(line, err=True)
        raise SystemExit(status)
    return CommandResult(status, said.getvalue())


def _refuse_others(name: str, chosen: Sequence[str]) -> None:
    """Raise if any of these options decides something else than what is converted."""
    typed = parse([name, *chosen])
    unnamed = typed.values.pop("sources", None)
    known = options_of(name)
    allowed = {key for key, option in known.items() if option.scope != Scope.CALL_ONLY} - _PLACE | {"jobs"}
    others = [known[key].spelling if key in known else "--output" for key in typed.values if key not in allowed]
    if others:
        raise UsageError(
            f"{', '.join(others)} may not be in a case",
            hint="a case decides what is converted, but not where the output is written or what is shown",
        )
    if unnamed:
        raise UsageError(f"{unnamed[0]!r} is not an option", hint="a case names its recordings under 'input'")
