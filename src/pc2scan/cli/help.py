"""The help: plain text in sections, as wide as the terminal."""

from __future__ import annotations

import sys
from inspect import cleandoc
from textwrap import wrap
from typing import TYPE_CHECKING

from pc2scan.options.option import Parameter
from pc2scan.options.table import options_of

from .commands import COMMANDS
from .render import as_typed, columns_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pc2scan.options.option import Option

    from .commands import Argument

ABOUT = "Recorded 3D lidar to the 2D laser scans that SLAM and navigation need, without a ROS installation."

_STATUSES = (
    "Exit status: 0 done, 1 failed and nothing written, 2 wrong usage or a missing file, 3 written but with messages "
    "skipped, from a damaged source, or without the report, 4 written but no scan has a return. "
    "batch: 3 if some have status 3 or 4, 1 if any failed, 5 if the disk is full. "
    "check, diff and golden: 0 accepted or the same, 1 not, 2 could not be judged."
)

#: If a command has more options than these, ``--help`` shows the common ones.
_FEW = 30

#: The width where it is unknown, the largest, and that of the column of options.
_WIDTH, _WIDEST, _COLUMN = 80, 120, 30

#: The options of ``pc2scan`` without a command.
_OPTIONS = (
    ("--version", "Show the version and exit."),
    ("--install-completion", "Install completion for the current shell."),
    ("--show-completion", "Show completion for the current shell, to copy it or customize the installation."),
    ("-h, --help", "Show this message and exit."),
)


def help_of(command: str, *, every: bool = False) -> Iterator[str]:
    """Yield the lines of the help of a command, or of all commands if there is none."""
    width = min(columns_of(sys.stdout) or _WIDTH, _WIDEST)
    if not command:
        yield "Usage: pc2scan [OPTIONS] COMMAND [ARGS]..."
        yield from _paragraphs(ABOUT, width)
        yield from _section("Options", _OPTIONS, width)
        lines = [(name, command.help.partition("\n")[0]) for name, command in COMMANDS.items()]
        yield from _section("Commands", lines, width)
        yield from _paragraphs(_STATUSES, width)
        return
    shown, known = COMMANDS[command], options_of(command).values()
    operands = [argument.metavar for argument in shown.arguments if not argument.spellings]
    yield from (" ".join(("Usage: pc2scan", command, "[OPTIONS]", *operands)), "")
    for words, comment in shown.examples.items():
        yield from (f"  # {comment}", f"  {words}")
    yield from _paragraphs(shown.help, width)
    has_more = len(known) > _FEW
    sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
    for argument in shown.arguments:
        sections["Options" if argument.spellings else "Arguments"].append(_row_of_own(argument))
    for option in known:
        if option.spelling and (option.common or every or not has_more):
            sections.setdefault(option.panel or "Options", []).append(_row(option))
    sections["Options"].append(("-h, --help", "Show this message and exit."))
    if has_more:
        sections["Options"].append(("--help-all", "Show all options, and exit."))
    for title, rows in sections.items():
        yield from _section(title, rows, width)
    if has_more and not every:
        yield from ("", f"pc2scan {command} --help-all shows all options.")


def _paragraphs(text: str, width: int) -> Iterator[str]:
    for paragraph in cleandoc(text).split("\n\n"):
        yield ""
        yield from wrap(paragraph, width, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)


def _section(title: str, rows: Sequence[tuple[str, str]], width: int) -> Iterator[str]:
    """Yield a title and two columns: what is typed, and what it does."""
    yield from ("", f"{title}:")
    column = min(max(len(words) for words, _ in rows), _COLUMN, width // 2) + 4
    for words, text in rows:
        lines = wrap(text, width - column, break_on_hyphens=False, break_long_words=False)
        if len(words) > column - 4:
            yield f"  {words}"
        else:
            yield f"  {words:{column - 2}}{lines.pop(0)}"
        yield from (" " * column + line for line in lines)


def _row_of_own(argument: Argument) -> tuple[str, str]:
    default = "required" if argument.required else argument.default_text and f"default: {argument.default_text}"
    usage = f"{', '.join(argument.spellings)} {argument.metavar}" if argument.spellings else argument.shown
    return usage, argument.help + (f"  [{default}]" if default else "")


def _row(option: Option) -> tuple[str, str]:
    """Return how an option is typed, and its help with its default."""
    value = option.value
    usage = ", ".join(filter(None, (option.short, option.spelling)))
    if value.kind != "bool":
        usage += f" {value.metavar or '|'.join(value.words) or 'X'}"
    elif isinstance(option, Parameter):
        usage += f" / {option.negation}"
    text = as_typed(option.help) + (" Repeatable." if value.repeats else "")
    return usage, text + (f"  [default: {option.default_text}]" if option.default_text else "")
