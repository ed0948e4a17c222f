"""Runs what was typed: Typer parses it, a command does it, and errors become messages and exit statuses."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager, nullcontext, suppress
from functools import cache, partial
from importlib import import_module
from inspect import Parameter as Keyword
from inspect import Signature, signature
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

from pc2scan.core.kernel import COMPILED
from pc2scan.errors import OutputError, Pc2ScanError, UsageError
from pc2scan.files.paths import local_path, path_or_url
from pc2scan.options.call import Options
from pc2scan.options.option import Parameter
from pc2scan.options.table import options_of
from pc2scan.request.precedence import plain_scalar
from pc2scan.text import did_you_mean, shell_word
from pc2scan.version import __version__

from .commands import COMMANDS, Argument
from .completion import offered
from .failures import in_our_words, show_failure
from .help import ABOUT, help_of
from .render import LiveWarnings, progress_bar, say, show

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from types import FrameType

    from pc2scan.options.option import Option

_INTERRUPTED = 128 + signal.SIGINT

#: What shows a text, and runs nothing.
_ABOUT = {"-h", "--help", "--help-all", "--version"}


def run(words: Sequence[str]) -> int:
    """Run the command that was typed after ``pc2scan``, and return its exit status.

    User errors become a message and an exit status; bugs keep their traceback.
    """
    is_question = not words and "_PC2SCAN_COMPLETE" not in os.environ
    try:
        with _interruptible():
            lines = help_of("") if is_question else _about(words) if _ABOUT & {*words} else ()
            if lines:
                for line in lines:
                    say(line, err=is_question)
                return 2 if is_question else 0
            typed, name = parse(words), words[0]
            module, _, function = COMMANDS[name].door.partition(":")
            door: Callable[..., Any] = getattr(import_module(f"pc2scan.{module}"), function)
            command = door if module.startswith("cli.") else partial(_show_result, door)
            status: int = command(**_arguments_of(name, typed), options=_call_options(name, typed))
            return status
    except Pc2ScanError as err:
        return show_failure(err, words)
    except KeyboardInterrupt as err:
        say("interrupted: what was not complete was removed", err=True)
        if err.args:
            say(f"hint: {err}", err=True)
        return _INTERRUPTED
    except SystemExit as err:
        # The terminal may be gone.
        with suppress(OSError):
            if isinstance(err.code, int) and err.code > _INTERRUPTED:
                say("terminated: what was not complete was removed", err=True)
        raise
    except MemoryError:
        return show_failure(OutputError("memory ran out", hint="fewer threads take less: `jobs=1`"), words)
    except FileNotFoundError as err:
        if err.filename is not None:
            raise
        return show_failure(OutputError("the current folder was deleted", hint="cd to another one"), words)


def _show_result(door: Callable[..., Any], *, options: Options, **arguments: Any) -> int:
    """Call a function of the library, show its result, and return the exit status."""
    warn = LiveWarnings()
    keywords = signature(door).parameters
    with progress_bar(options) if "progress" in keywords else nullcontext() as progress:
        callbacks = {"warn": warn, "progress": progress}
        result = door(**arguments, options=options, **{name: callbacks[name] for name in callbacks if name in keywords})
    return show(result, options, known=warn)


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let signals that end a command raise, so that partial output is removed while the stack unwinds."""
    handlers: dict[int, Any] = {signal.SIGTERM: _terminate}
    # Windows has no terminals that are closed; under nohup, that is ignored.
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        handlers[signal.SIGHUP] = _terminate
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        handlers[signal.SIGINT] = signal.default_int_handler
    previous = {}
    # Only the main thread may set handlers. In another thread, the program around this handles signals.
    with suppress(ValueError):
        previous = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _terminate(number: int, _frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


def _about(words: Sequence[str]) -> Iterable[str]:
    """Return the lines that ``--help`` and ``--version`` show; empty if none of them is typed."""
    typed = list(words[: words.index("--")] if "--" in words else words)
    command = typed[0] if typed and typed[0] in COMMANDS else ""
    if typed[:1] == ["--version"]:
        slower = "" if COMPILED else " (slower than usual: installed without a C compiler)"
        return [f"pc2scan {__version__}{slower}"]
    if (command and "--help-all" in typed) or {"-h", "--help"} & set(typed if command else typed[:1]):
        return help_of(command, every="--help-all" in typed)
    return ()


def parse(words: Sequence[str]) -> dict[str, Any]:
    """Return what was typed for a command's arguments and options: texts, lists of texts, and flags, by name.

    Raises
    ------
    UsageError
        If there is no such command or option, or if a value is missing.
    """
    name = words[0] if words and words[0] in COMMANDS else ""
    if words and not name and not words[0].startswith("-"):
        hint = did_you_mean(words[0], COMMANDS) or "pc2scan --help shows what it takes"
        if os.path.lexists(words[0]):
            hint = f"the command comes first: pc2scan info {shell_word(words[0])}"
        raise UsageError(f"no such command {words[0]!r}", hint=hint)
    prepared = []
    # In the forms that Typer knows: no value is optional, and ROS 2's marker is left out.
    for word, after in zip(words, [*words[1:], ""], strict=False):
        if word != "--ros-args":
            prepared.append("--dask=local" if word == "--dask" and "://" not in after else word)
    try:
        typed: dict[str, Any] = application(name)(prepared[bool(name) :], prog_name="pc2scan", standalone_mode=False)
    except typer.TyperException as err:
        raise in_our_words(err.format_message(), name) from err
    return typed


def _arguments_of(command: str, typed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a command's function that are not in the table of options.

    Sources are paths and URLs. The destination stays text, because a slash at its end makes it a folder.

    Raises
    ------
    UsageError
        If one is missing or empty, or if an option is typed twice.
    """
    arguments: dict[str, Any] = {}
    for argument in COMMANDS[command].arguments:
        value, shown = typed.get(argument.name), argument.shown
        if value is None and argument.required:
            raise UsageError(f"{shown} is missing", hint=f"pc2scan {command} --help shows what it takes")
        if argument.spellings and isinstance(value, list):
            if len(value) > 1:
                raise UsageError(f"{shown} is given twice, but has only one value", hint="type only one of them")
            value = value[0]
        if value is not None and argument.is_path:
            name = shown.removesuffix("...")
            texts = [local_path(text, name) for text in (value if isinstance(value, list) else [value])]
            paths = texts if argument.spellings else list(map(path_or_url, texts))
            value = paths if isinstance(value, list) else paths[0]
        arguments[argument.name] = value
    return arguments


def _call_options(name: str, typed: Mapping[str, Any]) -> Options:
    """Return what was typed as the options of a call."""
    words: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for key, option in options_of(name).items():
        if key not in typed:
            continue
        words[key] = text = typed[key]
        if isinstance(option, Parameter):
            if number := {"int": int, "float": float}.get(option.value.kind):
                try:
                    words[key] = number(text)
                except ValueError:
                    # In the notation of a parameter file.
                    words[key] = plain_scalar(text)
            origins[key] = option.negation if text is False else option.spelling
        elif option.value.kind == "switch":
            words[key] = text == "local" or text
    return Options(name, words, origins)


@cache
def application(command: str) -> Any:
    """Make the parser, of all commands or only of the one that is going to run: to build its options takes a while."""
    app = typer.Typer(
        name="pc2scan", help=ABOUT, add_help_option=False, rich_markup_mode=None, add_completion=not command
    )
    for name in [command] if command else COMMANDS:
        text = COMMANDS[name].help.partition("\n")[0]
        parser = _parser_of(name, completes=not command)
        app.command(name, help=text, add_help_option=False, no_args_is_help=False, cls=_Command)(parser)
    return get_command(app)


class _Command(TyperCommand):
    """A command whose values stay text.

    Typer converts each with an adapter of pydantic: 13 MB, and as much time as all imports together.
    """

    _parser: Any = None

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if ctx.resilient_parsing:
            # A shell completes the words.
            return super().parse_args(ctx, args)
        # A process that runs many commands, as for golden cases, makes it once.
        self._parser = self._parser or self.make_parser(ctx)
        values, rest, _ = self._parser.parse_args(args=args)
        if rest:
            ctx.fail(f"Got unexpected extra argument(s) ({' '.join(rest)})")
        # Those that are not typed, too: Typer would remember what an earlier call had.
        ctx.params = {parameter.name: values.get(parameter.name) for parameter in self.params}
        return list(rest)


def _parser_of(name: str, *, completes: bool) -> Callable[..., dict[str, Any]]:
    """Return the function that Typer calls with what was typed; its signature is made from the table of options.

    With ``completes``, it also has what a shell completes.

    All values are text, and an option that is not typed is None: `pc2scan.options` reads and checks them.
    """

    def parsed(**values: Any) -> dict[str, Any]:
        return {key: value for key, value in values.items() if value not in (None, [])}

    keywords = {argument.name: _annotation(argument) for argument in COMMANDS[name].arguments}
    known, offers = options_of(name), dict[str, Any]()
    for key, option in known.items() if completes else ():
        if words := option.value.offers or (option.value.words and ("words", *option.value.words)):
            offers[key] = _offering(words)
    keywords |= {key: _annotation(option, offers.get(key)) for key, option in known.items() if option.spelling}
    parameters = [
        Keyword(key, Keyword.KEYWORD_ONLY, default=None, annotation=annotation) for key, annotation in keywords.items()
    ]
    parsed.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    parsed.__annotations__ = {}
    return parsed


def _annotation(entry: Argument | Option, offers: Callable[[str], list[str]] | None = None) -> Any:
    """Return the annotation of an argument, or of an option of the table."""
    if isinstance(entry, Argument):
        if not entry.spellings:
            kind = list[str] if entry.metavar.endswith("...") else str
            return Annotated[kind | None, typer.Argument(metavar=entry.metavar)]
        if entry.name == "lookup":
            return Annotated[tuple[str, str] | None, typer.Option("--lookup", autocompletion=_offering(("frames",)))]
        return Annotated[list[str] | None, typer.Option(*entry.spellings)]
    spellings = [entry.spelling, *filter(None, [entry.short])]
    if entry.value.kind == "bool":
        if isinstance(entry, Parameter):
            spellings[0] += f"/{entry.negation}"
        return Annotated[bool | None, typer.Option(*spellings)]
    kind = list[str] if entry.value.repeats else str
    return Annotated[kind | None, typer.Option(*spellings, autocompletion=offers)]


def _offering(offers: Sequence[str]) -> Callable[[str], list[str]]:
    return lambda incomplete: offered(offers, incomplete)
