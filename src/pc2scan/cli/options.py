"""The options of a command: Typer's parameters from the table, and what was typed as the options of a call."""

from __future__ import annotations

from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

# Typer has no public place for these; pyproject.toml allows only versions in which they are here.
from typer._click.types import IntRange
from typer._types import TyperChoice
from typer.core import TyperOption
from typer.models import TyperPath

from pc2scan.files.urls import local_path, path_or_url
from pc2scan.options import values
from pc2scan.options.call import Options
from pc2scan.options.option import Parameter
from pc2scan.options.table import options_of

from .render import as_typed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.options.option import Option

#: The functions that read a parameter's number, by its kind.
_NUMBERS: Mapping[str, Callable[[str], float]] = {"int": int, "float": float}


class PathType(TyperPath):
    """The type of options that are paths: a URL is read before Path joins its slashes; an empty path is refused."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Convert what was typed."""
        if isinstance(value, str):
            is_option = param.param_type_name == "option"
            value = local_path(value, f"`{param.name}`" if is_option else param.human_readable_name.strip("[]."))
        path: Any = super().convert(value, param, ctx)
        return path if self.type is str else path_or_url(path)


#: DST as typed, because a slash at its end makes it a folder.
Destination = Annotated[
    str | None,
    typer.Option(
        "--output",
        "-o",
        metavar="DST",
        help="*.bag: ROS 1 bag; *.mcap: MCAP file; DIR/: a file in this folder, named after SRC; any other name: "
        "rosbag2 directory.  [default: next to SRC, in SRC's format, with _scan (repair: _repaired) in its name]",
        show_default=False,
        click_type=PathType(path_type=str),
    ),
]


def hide_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command of which Typer reads only its own arguments.

    ``options`` are those of the table; `pc2scan.cli.app` passes them to the command when it has parsed what was typed.
    """
    # Evaluated here: up to Python 3.10, typing.get_type_hints makes parameters optional whose default is None.
    read = signature(command, eval_str=True)
    own = [each for each in read.parameters.values() if each.name != "options"]
    command.__signature__ = read.replace(parameters=own)  # type: ignore[attr-defined]
    command.__annotations__ = {}
    return command


def typed_option(option: Option) -> TyperOption:
    """Return Typer's parameter for an option; an option that is not typed is None, or an empty list."""
    value = option.value
    is_parameter = isinstance(option, Parameter)
    is_flag = isinstance(value, values.Flag)
    kind: Any = None if is_flag else str
    if isinstance(value, values.PathName):
        kind = PathType(path_type=Path)
    elif value.repeats or is_parameter:
        # Parameters are read below, so that wrong numbers are reported like those in a file.
        pass
    elif isinstance(value, values.Count):
        kind = IntRange(value.low, value.high if value.metavar == "8|9" else None)
    elif type(value) is values.Number and not value.unit:
        kind = float
    elif value.words and value.metavar is None:
        kind = TyperChoice(value.words)
    spelling = f"{option.spelling}/{option.negation}" if is_flag and isinstance(option, Parameter) else option.spelling
    metavar = value.metavar or ("|".join(value.words) if is_parameter and value.words else None)
    return TyperOption(
        param_decls=[option.name, *filter(None, (spelling, option.short))],
        type=kind,
        default=[] if value.repeats else None,
        is_flag=is_flag,
        multiple=value.repeats,
        metavar=None if is_flag else metavar,
        rich_help_panel=option.panel or None,
        hidden=option.name == "ros_args",
        autocompletion=partial(_offered, option) if option.offers or (is_parameter and value.words) else None,
    )


def _offered(option: Option, _context: Any, _words: list[str], incomplete: str) -> list[str]:
    """Return what the shell offers for an option's value."""
    from .completion import offered

    return offered(option.offers or ("words", *option.value.words), incomplete)


def described(option: Option) -> str:
    """Return an option's help, with its default."""
    text = as_typed(option.help) + (" Repeatable." if option.value.repeats else "")
    return text + (f"  [default: {option.default_text}]" if option.default_text else "")


def call_options(name: str, typed: Mapping[str, Any]) -> Options:
    """Return what was typed as the options of a call."""
    known = options_of(name)
    words: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for key, value in typed.items():
        # `ros_args` is ROS's marker, which changes nothing.
        if value is None or value == [] or key == "ros_args":
            continue
        option = known[key]
        if isinstance(option, Parameter):
            number = _NUMBERS.get(option.value.kind)
            try:
                words[key] = number(value) if number else value
            except ValueError:
                from pc2scan.pipeline.parameters import plain_scalar

                # In the notation of a parameter file.
                words[key] = plain_scalar(value)
            origins[key] = option.negation if value is False else option.spelling
        elif option.default is True:
            words[key] = not value
        elif isinstance(option.value, values.Switch):
            words[key] = value == "local" or value
        else:
            words[key] = value
    return Options(name, words, origins, later=True)
