"""The application: its commands, and how errors become messages and exit statuses."""

from __future__ import annotations

import signal
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

# Typer has no public place for these; pyproject.toml allows only versions in which they are here.
from typer._click.exceptions import NoArgsIsHelpError
from typer._click.exceptions import UsageError as TyperUsageError
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.models import TyperPath

from pc2scan.errors import OutputError, Pc2ScanError, UsageError, name_list
from pc2scan.options.table import options_of

from .interrupts import interruptible
from .options import PathType, call_options, described, hide_options, typed_option
from .render import say

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from types import FrameType

    from pc2scan.options.option import Option

#: The commands in the order of the help; each is a function in the module of its name.
COMMANDS = ("convert", "batch", "export", "view", "plot", "map", "check", "info", "tf", "repair", "diff", "golden")

EPILOG = (
    "Exit status: 0 done, 1 failed and nothing written, 2 wrong usage or a missing file, "
    "3 written but with messages skipped, from a damaged source, or without the report, "
    "4 written but no scan has a return. "
    "batch: 0 all converted, 3 some with messages skipped, damage or empty scans, 1 any failed, "
    "5 ended early because the disk is full. "
    "check, diff and golden: 0 accepted or the same, 1 not, 2 could not be judged."
)

_INTERRUPTED = 128 + signal.SIGINT


#: Options after ``--ros-args`` that set what a ROS node logs: with a value, and without.
_ROS_LOGGING = ("--log-level", "--log-config-file")
_ROS_LOGS = tuple(
    f"--{verb}-{log}-logs" for verb in ("enable", "disable") for log in ("rosout", "stdout", "external-lib")
)


class _Command(TyperCommand):
    """A command with the options of the table, and help as plain text in sections.

    Typer's own sections need rich, whose import is slow.
    """

    def __init__(self, name: str, **settings: Any) -> None:
        super().__init__(name, **settings)
        for own in self.params:
            if type(own.type) is TyperPath:
                own.type = PathType()
        self._known: Mapping[str, Option] = {}

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words of a command; what was typed of the table's options becomes the argument ``options``."""
        # Typer has no options with optional values: `--dask` without an address is `--dask=local`.
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
        rest = super().parse_args(ctx, args)
        if not ctx.resilient_parsing:
            typed = {name: ctx.params.pop(name) for name in self._known if name in ctx.params}
            ctx.params["options"] = options = call_options(str(self.name), typed)
            # A failed conversion has a report, so `convert` raises it itself.
            if options.wrong is not None and self.name != "convert":
                raise options.wrong
        return rest

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
        """Return the parameters, with ``--help-all`` if ``--help`` shows only the common options.

        Those of the table are made here, because the help of all commands, which shows none, would wait for them.
        """
        if not self._known:
            self._known = options_of(str(self.name))
            self.params += [typed_option(option) for option in self._known.values() if option.spelling]
        found = super().get_params(ctx)
        if len(self._known) <= _FEW:
            return found
        text = "Show all options, and exit."
        every = TyperOption(
            param_decls=["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all, help=text
        )
        return [*found, every]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options of each section, in the order in which the sections first occur."""
        sections: dict[str, list[tuple[str, str]]] = {}
        parameters = self.get_params(ctx)
        short = len(self._known) > _FEW and not ctx.meta.get(_ALL)
        for parameter in parameters:
            option = self._known.get(parameter.name)
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


#: Of a command with more options than these, ``--help`` shows the common ones.
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
        # A copy, because Typer removes arguments from its list as it reads them.
        words = tuple(args)
        try:
            return super().make_context(info_name, args, *rest, **extra)
        except TyperUsageError as err:
            raise _as_exit(err, words) from err

    def invoke(self, ctx: Any) -> Any:
        """Run the command; user errors become a message and an exit status, bugs keep their traceback."""
        words = (*ctx._protected_args, *ctx.args)  # noqa: SLF001  # as the base class reads them
        try:
            with interruptible(_terminate):
                return super().invoke(ctx)
        except (Pc2ScanError, TyperUsageError) as err:
            raise _as_exit(err, words) from err
        except KeyboardInterrupt:
            say(f"interrupted: {_what_was_written()}", err=True)
            raise typer.Exit(_INTERRUPTED) from None
        except MemoryError as err:
            error = OutputError(f"memory ran out: {_what_was_written()}", hint="fewer threads take less: `jobs=1`")
            raise _as_exit(error, words) from err
        except FileNotFoundError as err:
            try:
                Path.cwd()
            except FileNotFoundError:
                raise _as_exit(OutputError("the current folder was deleted", hint="cd to another one"), words) from err
            raise


def _as_exit(err: Pc2ScanError | TyperUsageError, words: Sequence[str]) -> Exception:
    """Show an error, and return what ends the command with its exit status; the group's own help is no error."""
    if isinstance(err, NoArgsIsHelpError):
        return err
    from .failures import show_failure

    return typer.Exit(show_failure(err, words))


def _what_was_written() -> str:
    """Return the end of the message of an interrupted command: which files it has written completely."""
    from pc2scan.files.staging import written_paths

    names = [str(path) for path in written_paths()]
    return f"{name_list(names)} {'is' if len(names) == 1 else 'are'} complete" if names else "nothing was written"


def _terminate(number: int, _frame: FrameType | None) -> None:
    """End a command by an exception, so that partial output is removed while the stack unwinds."""
    # The terminal may be gone.
    with suppress(OSError):
        say(f"terminated: {_what_was_written()}", err=True)
    raise SystemExit(128 + number)


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
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
    )
    app.callback()(root)
    for name in (command,) if command in COMMANDS else COMMANDS:
        command_function = getattr(import_module(f".{name}", __package__), name)
        app.command(name, cls=_Command)(hide_options(command_function))
    return app
