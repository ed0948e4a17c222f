"""Runs what was typed: Typer parses it, a command does it, and errors become messages and exit statuses."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from functools import cache
from importlib import import_module
from inspect import Parameter as Keyword
from inspect import Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand
from typer.main import get_command

from pc2scan.core.kernel import COMPILED
from pc2scan.errors import OutputError, Pc2ScanError
from pc2scan.options.option import Parameter
from pc2scan.options.table import options_of
from pc2scan.options.values import Flag
from pc2scan.version import __version__

from . import completion
from .commands import COMMANDS
from .failures import in_our_words, show_failure
from .help import ABOUT, help_of
from .interrupts import interruptible
from .options import arguments_of, call_options
from .render import say

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import FrameType

    from pc2scan.options.option import Option

    from .commands import Argument

_INTERRUPTED = 128 + signal.SIGINT


class Typed(NamedTuple):
    """A command, and what was typed for its arguments and options: texts, lists of texts, and flags, by name."""

    command: str
    values: dict[str, Any]


def run(words: Sequence[str]) -> int:
    """Run the command that was typed after ``pc2scan``, and return its exit status.

    User errors become a message and an exit status; bugs keep their traceback.
    """
    if not words and "_PC2SCAN_COMPLETE" not in os.environ:
        for line in help_of(""):
            say(line, err=True)
        return 2
    try:
        with interruptible(_terminate):
            if lines := _about(words):
                for line in lines:
                    say(line)
                return 0
            typed = parse(words)
            options = call_options(typed.command, typed.values)
            command = getattr(import_module(f".{typed.command}", __package__), typed.command)
            status: int = command(**arguments_of(typed.command, typed.values), options=options)
            return status
    except Pc2ScanError as err:
        return show_failure(err, words)
    except KeyboardInterrupt as err:
        say("interrupted: what was not complete was removed", err=True)
        if err.args:
            say(f"hint: {err}", err=True)
        return _INTERRUPTED
    except MemoryError:
        error = OutputError("memory ran out", hint="fewer threads take less: `jobs=1`")
        return show_failure(error, words)
    except FileNotFoundError:
        try:
            Path.cwd()
        except FileNotFoundError:
            return show_failure(OutputError("the current folder was deleted", hint="cd to another one"), words)
        raise


def _about(words: Sequence[str]) -> list[str]:
    """Return the lines that ``--help`` and ``--version`` show; empty if none of them is typed."""
    typed = list(words[: words.index("--")] if "--" in words else words)
    command = typed[0] if typed and typed[0] in COMMANDS else ""
    if typed[:1] == ["--version"]:
        slower = "" if COMPILED else " (slower than usual: installed without a C compiler)"
        return [f"pc2scan {__version__}{slower}"]
    if (command and "--help-all" in typed) or {"-h", "--help"} & set(typed if command else typed[:1]):
        return [*help_of(command, every="--help-all" in typed)]
    return []


def parse(words: Sequence[str]) -> Typed:
    """Return what was typed.

    Raises
    ------
    UsageError
        If there is no such command or option, or if a value is missing.
    """
    try:
        command = words[0] if words and words[0] in COMMANDS else ""
        typed: Typed = application(command)(_prepared(words), prog_name="pc2scan", standalone_mode=False)
    except typer.TyperException as err:
        raise in_our_words(err.format_message(), words) from err
    return typed


@cache
def application(command: str) -> Any:
    """Make the parser, of all commands or only of the one that is going to run: to build its options takes a while."""
    names = [command] if command else [*COMMANDS]
    completes = len(names) > 1
    app = typer.Typer(
        name="pc2scan", help=ABOUT, add_help_option=False, rich_markup_mode=None, add_completion=completes
    )
    app.callback()(_root)
    for name in names:
        text = COMMANDS[name].help.partition("\n")[0]
        app.command(name, help=text, add_help_option=False, no_args_is_help=False, cls=_Command)(_parser_of(name))
    return get_command(app)


class _Command(TyperCommand):
    """A command whose values stay text.

    Typer converts each with an adapter of pydantic: 13 MB, and as much time as all imports together.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if ctx.resilient_parsing:
            # A shell completes the words.
            return super().parse_args(ctx, args)
        values, rest, _ = self.make_parser(ctx).parse_args(args=args)
        if rest:
            ctx.fail(f"Got unexpected extra argument(s) ({' '.join(rest)})")
        # Those that are not typed, too: Typer would remember what an earlier call had.
        ctx.params = {parameter.name: values.get(parameter.name) for parameter in self.params}
        return rest


def _root() -> None:
    """Without this, Typer makes an application of one command."""


def _parser_of(name: str) -> Callable[..., Typed]:
    """Return the function that Typer calls with what was typed; its signature is made from the table of options.

    All values are text, and an option that is not typed is None: `pc2scan.options` reads and checks them.
    """

    def parsed(**values: Any) -> Typed:
        return Typed(name, {key: value for key, value in values.items() if value not in (None, [])})

    keywords = {argument.name: _annotation_of_own(argument) for argument in COMMANDS[name].arguments}
    keywords |= {key: _annotation(option) for key, option in options_of(name).items() if option.spelling}
    parameters = [Keyword(key, Keyword.KEYWORD_ONLY, default=None, annotation=each) for key, each in keywords.items()]
    parsed.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    parsed.__annotations__ = {}
    return parsed


def _annotation_of_own(argument: Argument) -> Any:
    """Return the annotation of an argument that is not in the table."""
    if not argument.spellings:
        several = argument.metavar.endswith("...")
        return Annotated[(list[str] if several else str) | None, typer.Argument(metavar=argument.metavar)]
    if argument.name == "lookup":
        return Annotated[tuple[str, str] | None, typer.Option("--lookup", autocompletion=completion.frames)]
    return Annotated[list[str] | None, typer.Option(*argument.spellings)]


def _annotation(option: Option) -> Any:
    """Return the annotation of an option of the table."""
    value = option.value
    spellings = [option.spelling, *filter(None, [option.short])]
    if isinstance(value, Flag):
        if isinstance(option, Parameter):
            spellings[0] += f"/{option.negation}"
        return Annotated[bool | None, typer.Option(*spellings)]
    offers = value.offers

    def offered(incomplete: str) -> list[str]:
        return completion.offered(offers, incomplete)

    return Annotated[
        (list[str] if value.repeats else str) | None,
        typer.Option(*spellings, autocompletion=offered if offers else None),
    ]


def _prepared(words: Sequence[str]) -> list[str]:
    """Return the words in the forms that Typer knows: no value is optional, and ROS 2's marker is left out."""
    prepared = []
    for word, after in zip(words, [*words[1:], ""], strict=False):
        if word == "--dask" and "://" not in after:
            prepared.append("--dask=local")
        elif word != "--ros-args":
            prepared.append(word)
    return prepared


def _terminate(number: int, _frame: FrameType | None) -> None:
    """End a command by an exception, so that partial output is removed while the stack unwinds."""
    # The terminal may be gone.
    with suppress(OSError):
        say("terminated: what was not complete was removed", err=True)
    raise SystemExit(128 + number)
