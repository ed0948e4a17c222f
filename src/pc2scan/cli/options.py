"""The options of a command: Typer's parameters from the table, and what was typed as the options of a call."""

from __future__ import annotations

from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer
from typer.models import ParameterInfo, TyperPath

from pc2scan.files.urls import local_path, path_or_url
from pc2scan.options import values
from pc2scan.options.call import Options
from pc2scan.options.option import Parameter as ProjectionParameter
from pc2scan.options.table import options_of
from pc2scan.pipeline.ros_scalars import plain_scalar

from . import completion
from .spelling import as_typed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.options.option import Option

#: The functions that read a parameter's number, by its kind.
_NUMBERS: Mapping[str, Callable[[str], float]] = {"int": int, "float": float}


class PathType(TyperPath):
    """The type of options that are paths: a ``file:`` URL is read before Path joins its slashes."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Convert what was typed."""
        return super().convert(local_path(value) if isinstance(value, str) else value, param, ctx)


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


def typed_command(name: str, command: Callable[..., None]) -> Callable[..., None]:
    """Return the function that Typer reads: with a parameter for each option of the command ``name``.

    It calls ``command`` with its own arguments, and with the options that were typed as the argument ``options``.
    """
    # Not typing.get_type_hints: up to Python 3.10 it makes parameters optional whose default is None.
    taken = [each for each in signature(command, eval_str=True).parameters.values() if each.name != "options"]
    for parameter in taken:
        _read_urls(parameter.annotation)
    own = {parameter.name for parameter in taken}
    known = options_of(name)

    @wraps(command)
    def run(**typed: Any) -> None:
        typed = {key: _paths(value) for key, value in typed.items()}
        options = _options(name, {key: value for key, value in typed.items() if key not in own})
        # A failed conversion has a report, so `convert` checks them itself.
        if name != "convert":
            options.check()
        command(**{key: value for key, value in typed.items() if key in own}, options=options)

    further = [_parameter(option) for option in known.values() if option.spelling]
    run.__signature__ = Signature([*taken, *further])  # type: ignore[attr-defined]
    # Typer reads only the signature.
    run.__annotations__ = {}
    return run


def _paths(value: Any) -> Any:
    """Return a typed value, with URLs as such; Typer makes ordinary paths of them."""
    if isinstance(value, list):
        return list(map(_paths, value))
    return path_or_url(value) if isinstance(value, Path) else value


def _read_urls(annotation: Any) -> None:
    """Let an argument whose values are paths take ``file:`` URLs."""
    kind, *further = get_args(annotation) or (annotation,)
    if Path in (kind, *get_args(kind)):
        for info in further:
            if isinstance(info, ParameterInfo) and info.click_type is None:
                info.click_type = PathType()


def _parameter(option: Option) -> Parameter:
    """Return Typer's parameter for an option; an option that is not typed is None, or an empty list."""
    value = option.value
    is_parameter = isinstance(option, ProjectionParameter)
    kind: Any = str
    further: dict[str, Any] = {}
    spellings = [option.spelling]
    if isinstance(value, values.Flag):
        kind = bool
        if isinstance(option, ProjectionParameter):
            spellings = [f"{option.spelling}/{option.negation}"]
    elif isinstance(value, values.PathName):
        kind = list[Path] if value.repeats else Path
        further["click_type"] = PathType()
    elif value.repeats:
        kind = list[str]
    elif is_parameter:
        # As text. It is read below, so that wrong numbers are reported like those in a file.
        further["autocompletion"] = completion.choices(value.words) if value.words else None
    elif isinstance(value, values.Count):
        kind = int
        further["min"] = value.low
        further["max"] = value.high if value.metavar == "8|9" else None
    elif type(value) is values.Number and not value.unit:
        kind = float
    elif value.words and value.metavar is None:
        kind = Literal[value.words]
    if option.offers:
        further["autocompletion"] = _offered(option.offers)
    if option.short:
        spellings.append(option.short)
    metavar = value.metavar or ("|".join(value.words) if is_parameter and value.words else None)
    info = typer.Option(
        [] if value.repeats else None,
        *spellings,
        metavar=None if kind is bool else metavar,
        show_default=False,
        rich_help_panel=option.panel or None,
        hidden=option.name == "ros_args",
        **further,
    )
    return Parameter(option.name, Parameter.KEYWORD_ONLY, default=info, annotation=kind)


def _offered(offers: tuple[str, ...]) -> Callable[..., list[str]]:
    """Return the function that completes a value in the shell."""
    kind, *ends = offers
    if kind == "topics":
        return completion.topics(*ends)
    return completion.presets if kind == "presets" else completion.frames


def described(option: Option) -> str:
    """Return an option's help, with its default."""
    text = as_typed(option.help) + (" Repeatable." if option.value.repeats else "")
    return text + (f"  [default: {option.default_text}]" if option.default_text else "")


def _options(name: str, typed: Mapping[str, Any]) -> Options:
    """Return what was typed as the options of a call."""
    known = options_of(name)
    words: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for key, value in typed.items():
        # `ros_args` is ROS's marker, which changes nothing.
        if value is None or value == [] or key == "ros_args":
            continue
        option = known[key]
        if isinstance(option, ProjectionParameter):
            number = _NUMBERS.get(option.kind)
            words[key] = _read_number(number, value) if number else value
            origins[key] = option.negation if value is False else option.spelling
        elif option.default is True:
            words[key] = not value
        elif isinstance(option.value, values.Switch):
            words[key] = value == "local" or value
        else:
            words[key] = value
    return Options(name, words, origins, later=True)


def _read_number(number: Callable[[str], float], text: str) -> object:
    """Read a number in Python's notation, otherwise in that of a parameter file."""
    try:
        return number(text)
    except ValueError:
        return plain_scalar(text)
