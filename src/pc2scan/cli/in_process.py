"""Runs the command line within this process, for golden cases."""

from __future__ import annotations

import signal
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from itertools import chain
from typing import TYPE_CHECKING

import typer
from typer._click.exceptions import UsageError as TyperUsageError
from typer.core import TyperGroup
from typer.main import get_command

from pc2scan.errors import UsageError
from pc2scan.golden.check import CommandResult
from pc2scan.options.option import CALL_ONLY
from pc2scan.options.table import options_of

from .failures import in_our_words
from .render import say

if TYPE_CHECKING:
    from collections.abc import Sequence

#: The option of ``convert`` that decides where the output is written: a case does not have it.
_PLACE = {"to"}


def run_command(arguments: Sequence[str], chosen: Sequence[str] = ()) -> CommandResult:
    """Run ``pc2scan`` with arguments, and return what it prints. See `pc2scan.golden.check.Command`.

    Raises
    ------
    UsageError
        If ``chosen`` has more than options that decide what is converted.
    KeyboardInterrupt, SystemExit
        If it was interrupted or terminated; the signal was meant for the whole process.
    """
    from .app import application

    if chosen:
        _refuse_others(arguments[0], chosen)
    said = StringIO()
    status = 0
    with redirect_stdout(StringIO()), redirect_stderr(said):
        try:
            # Not the application itself: a call would set the process's hook for exceptions.
            get_command(application(*arguments[:1])).main([*arguments, *chosen], prog_name="pc2scan")
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
    from .app import application

    group = get_command(application(name))
    assert isinstance(group, TyperGroup)
    command = group.commands[name]
    outer = group.make_context("pc2scan", [name], resilient_parsing=True)
    try:
        values, rest, given = command.make_parser(typer.Context(command, parent=outer)).parse_args(list(chosen))
    except TyperUsageError as err:
        raise in_our_words(err, [name, *chosen]) from err
    arguments = {str(parameter.name) for parameter in given if parameter.param_type_name == "argument"}
    conversion = {key for key, option in options_of(name).items() if option.scope != CALL_ONLY} - _PLACE
    allowed = {*arguments, *conversion, "jobs"}
    # Named by the longest spelling, because those of --help come in any order.
    others = dict.fromkeys(max(parameter.opts, key=len) for parameter in given if parameter.name not in allowed)
    if others:
        raise UsageError(
            f"{', '.join(others)} may not be in a case",
            hint="a case decides what is converted, but not where the output is written or what is shown",
        )
    unnamed = [*chain.from_iterable(values[argument] or () for argument in arguments), *rest]
    if unnamed:
        raise UsageError(f"{unnamed[0]!r} is not an option", hint="a case names its recordings under 'input'")
