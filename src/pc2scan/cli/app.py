"""The application: its commands, and how errors become messages and exit statuses."""

from __future__ import annotations

import signal
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from pc2scan.errors import Pc2ScanError, UsageError, name_list
from pc2scan.options.table import options_of

from .interrupts import interruptible
from .options import described, typed_command
from .render import say
from .usage import NoArgsIsHelpError, TyperUsageError, in_our_words

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import FrameType

#: The commands in the order of the help; each is a function in the module of its name.
COMMANDS = ("convert", "batch", "export", "view", "plot", "map", "check", "info", "tf", "repair", "diff", "golden")

EPILOG = (
    "Exit status: 0 done, 1 failed and nothing written, 2 wrong usage or a missing file, "
    "3 written but with messages skipped, from a damaged source, or without the report, "
    "4 written but no scan has a return. "
    "batch: 0 all converted, 3 some with messages skipped, damage or empty scans, 1 any failed. "
    "check, diff and golden: 0 accepted or the same, 1 not, 2 could not be judged."
)

_INTERRUPTED = 128 + signal.SIGINT


#: Options after ``--ros-args`` that set what a ROS node logs: with a value, and without.
_ROS_LOGGING = ("--log-level", "--log-config-file")
_ROS_LOGS = tuple(
    f"--{verb}-{log}-logs" for verb in ("enable", "disable") for log in ("rosout", "stdout", "external-lib")
)


class _Command(TyperCommand):
    """A command whose help is plain text in sections; Typer's own sections need rich, whose import is slow."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Make ``--dask`` without an address ``--dask=local``, because Typer has no options with optional values."""
        if self.name == "batch" and args:
            following = [*args[1:], ""]
            args = [
                "--dask=local" if word == "--dask" and "://" not in after else word
                for word, after in zip(args, following, strict=True)
            ]
        if "--ros-args" in args:
            args = _without_logging(args)
        if sum(word.startswith(("-o", "--output")) for word in args) > 1:
            self._refuse_second_output(ctx, args)
        return super().parse_args(ctx, args)

    def _refuse_second_output(self, ctx: Any, args: list[str]) -> None:
        """Raise if there are two destinations; Typer would silently take the last one."""
        given = self.make_parser(ctx).parse_args(args=list(args))[2]
        outputs = [each for each in given if "--output" in each.opts]
        if len(outputs) > 1:
            raise UsageError("-o is given twice, but there is only one destination", hint="type only one of them")

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write the examples, then the description."""
        from .examples import EXAMPLES

        examples = EXAMPLES.get(str(self.name), ())
        if examples:
            formatter.write_paragraph()
            beside = [f"  {typed}  # {what}\n" for typed, what in examples]
            if max(map(len, beside)) > formatter.width:
                beside = [f"  # {what}\n  {typed}\n" for typed, what in examples]
            formatter.write("".join(beside))
        super().format_help_text(ctx, formatter)

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, with ``--help-all`` if ``--help`` does not show all of them."""
        found = super().get_params(ctx)
        if not _has_more(str(self.name)):
            return found
        text = "Show all options, and exit."
        every = TyperOption(
            param_decls=["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all, help=text
        )
        return [*found, every]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options of each section, in the order in which the sections first occur."""
        sections: dict[str, list[tuple[str, str]]] = {}
        known = options_of(str(self.name))
        short = _has_more(str(self.name)) and not ctx.meta.get(_ALL)
        for parameter in self.get_params(ctx):
            option = known.get(parameter.name)
            if option is not None:
                if short and not option.common:
                    continue
                # Not made until it is shown.
                parameter.help = described(option)
            record = parameter.get_help_record(ctx)
            if record is not None:
                title = getattr(parameter, "rich_help_panel", None)
                default = "Arguments" if parameter.param_type_name == "argument" else "Options"
                sections.setdefault(title or default, []).append(record)
        for title, records in sections.items():
            with formatter.section(title):
                formatter.write_dl(records)
        if short:
            formatter.write_paragraph()
            formatter.write_text(f"pc2scan {self.name} --help-all shows all options.")


#: Where a context has whether all options are shown.
_ALL = "pc2scan.all_options"


def _has_more(command: str) -> bool:
    """Whether ``--help`` shows only the common options of a command: those with few have no others."""
    return len(options_of(command)) > _FEW


#: A command with more options than these shows the common ones.
_FEW = 30


def _show_all(ctx: Any, _parameter: Any, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        ctx.meta[_ALL] = True
        for line in ctx.get_help().split("\n"):
            say(line)
        ctx.exit()


def _without_logging(args: Sequence[str]) -> list[str]:
    """Return the words without the options after ``--ros-args`` that set what a node logs."""
    begin = args.index("--ros-args") + 1
    kept, words = list(args[:begin]), iter(args[begin:])
    for word in words:
        if word in _ROS_LOGGING:
            next(words, None)
        elif word not in _ROS_LOGS:
            kept.append(word)
    return kept


class _Group(TyperGroup):
    """The group of all commands; it handles errors itself, so that a test's CliRunner sees what a user sees."""

    def make_context(self, info_name: Any, args: list[str], *rest: Any, **extra: Any) -> Any:
        """Parse the options that precede the command."""
        with _usage_errors(args):
            return super().make_context(info_name, args, *rest, **extra)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; user errors become a message and an exit status, bugs keep their traceback."""
        # SIGTERM raises an exception, so that partial output is removed while the stack unwinds.
        previous = _handle_termination()
        words = [*ctx._protected_args, *ctx.args]  # noqa: SLF001  # as the base class reads them
        try:
            with interruptible(), _usage_errors(words):
                return super().invoke(ctx)
        except Pc2ScanError as err:
            from .failures import show_failure

            raise typer.Exit(show_failure(err, words)) from err
        except KeyboardInterrupt:
            say(f"interrupted: {_what_was_written()}", err=True)
            raise typer.Exit(_INTERRUPTED) from None
        finally:
            if previous is not None:
                signal.signal(signal.SIGTERM, previous)


@contextmanager
def _usage_errors(typed: Sequence[str]) -> Iterator[None]:
    """Show Typer's errors like all others."""
    # A copy, because Typer removes arguments from its list as it reads them.
    typed = tuple(typed)
    try:
        yield
    except NoArgsIsHelpError:
        raise
    except TyperUsageError as err:
        from .failures import show_failure

        raise typer.Exit(show_failure(in_our_words(err, typed), typed)) from err


def _what_was_written() -> str:
    """Return the end of the message of an interrupted command: which files it has written completely."""
    from pc2scan.files.staging import written_paths

    names = [str(path) for path in written_paths()]
    return f"{name_list(names)} {'is' if len(names) == 1 else 'are'} complete" if names else "nothing was written"


def _handle_termination() -> Any:
    def terminate(number: int, _frame: FrameType | None) -> None:
        say(f"terminated: {_what_was_written()}", err=True)
        raise SystemExit(128 + number)

    try:
        return signal.signal(signal.SIGTERM, terminate)
    except ValueError:
        # Only the main thread may set handlers. In another thread, the program around this handles signals.
        return None


def _show_version(value: bool) -> None:
    if value:
        from pc2scan.core.kernel import COMPILED
        from pc2scan.version import __version__

        slower = "" if COMPILED else " (slower than usual: installed without a C compiler)"
        say(f"pc2scan {__version__}{slower}")
        raise typer.Exit


def root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit."),
    ] = False,
) -> None:
    """Recorded 3D lidar to the 2D laser scans that SLAM and navigation need, without a ROS installation."""


def application(command: str | None = None) -> typer.Typer:
    """Make the application, with all `COMMANDS` or only with the one that is going to run.

    To load a command and build its options takes some milliseconds.
    """
    app = typer.Typer(
        cls=_Group,
        name="pc2scan",
        help="Recorded 3D lidar to the 2D laser scans that SLAM and navigation need, without a ROS installation.",
        epilog=EPILOG,
        no_args_is_help=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(root)
    for name in (command,) if command in COMMANDS else COMMANDS:
        command_function = getattr(import_module(f".{name}", __package__), name)
        app.command(name, cls=_Command)(typed_command(name, command_function))
    return app
