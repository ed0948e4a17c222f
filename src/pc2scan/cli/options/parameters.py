"""Options with parameters of the projection, and ROS's notation of parameters and remappings.

No ``from __future__ import annotations`` here: see `pc2scan.cli.groups.Group`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from inspect import Parameter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pc2scan.cli import completion
from pc2scan.cli.groups import Group
from pc2scan.cli.spelling import as_typed
from pc2scan.pipeline.parameters import PARAMETERS, Setting, default_in_words
from pc2scan.pipeline.parameters import Parameter as TableRow
from pc2scan.pipeline.ros_scalars import plain_scalar

from . import PARAMS, SLAM, TOPICS

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["ParameterOptions", "ProjectionGroup", "ros_arguments"]

#: The functions that read a parameter's number, by its kind.
_NUMBERS: Mapping[str, Callable[[str], float]] = {"int": int, "float": float}


class ParameterOptions(Group):
    """One option for each parameter of the projection.

    Attributes
    ----------
    settings
        The parameters that were typed, with their options; files may set the others.
    """

    settings: tuple[Setting, ...]

    @classmethod
    def parameters(cls) -> Iterator[Parameter]:
        """Yield the options of `PARAMETERS`."""
        for name, parameter in PARAMETERS.items():
            boolean = parameter.kind == "bool"
            default = default_in_words(parameter)
            # No default is shown where 0 means that another parameter is used.
            shown = default and name not in {"beams", "kth"}
            metavar = {"float": parameter.unit.upper(), "int": "N", "str": "NAME"}.get(parameter.kind)
            if name == "target_frame":
                metavar = "FRAME"
            elif parameter.words:
                metavar = "|".join((parameter.unit.upper(),) * (parameter.kind == "float") + parameter.words)
            option = typer.Option(
                None,
                f"{parameter.option}/{parameter.negation}" if boolean else parameter.option,
                help=as_typed(parameter.help) + (f"  [default: {default}]" if shown else ""),
                show_default=False,
                metavar=metavar,
                autocompletion=_completion(parameter),
                rich_help_panel=PARAMS if parameter.upstreams else SLAM,
            )
            # Typer gets numbers as text. They are read below, so that wrong ones are reported like those in a file.
            yield Parameter(name, Parameter.KEYWORD_ONLY, default=option, annotation=bool if boolean else str)

    @classmethod
    def gathered(cls, values: Mapping[str, Any]) -> "Self":
        """Collect the options that were typed."""
        settings = []
        for name, parameter in PARAMETERS.items():
            value = values[name]
            if value is not None:
                option = parameter.negation if value is False else parameter.option
                number = _NUMBERS.get(parameter.kind)
                settings.append(Setting(name, _read_number(number, value) if number else value, option))
        return cls(settings=tuple(settings))


def _completion(parameter: TableRow) -> Callable[..., list[str]] | None:
    """Return the function that completes a parameter's value in the shell."""
    if parameter.name == "target_frame":
        return completion.frames
    return completion.choices(parameter.words) if parameter.words else None


def _read_number(number: Callable[[str], float], text: str) -> object:
    """Read a number in Python's notation, otherwise in that of a parameter file."""
    try:
        return number(text)
    except ValueError:
        return plain_scalar(text)


class ProjectionGroup(Group):
    """Options with parameters of the projection."""

    scans: Annotated[
        Path | None,
        typer.Option(
            "--scans",
            metavar="FILE",
            help="A YAML file with several outputs, each with its own sources, parameters and filters. Parameters on "
            "the command line override those of all outputs.",
            rich_help_panel=TOPICS,
        ),
    ] = None
    params_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The file that the robot was run with: a ROS 2 parameter file, a ROS 1 YAML file, or an XML launch "
            "file of either, whose remappings are used too.",
            rich_help_panel=PARAMS,
        ),
    ] = None
    launch_args: Annotated[
        list[str],
        typer.Option(
            "--arg",
            metavar="NAME:=VALUE",
            help="An argument of the launch file. Repeatable.",
            rich_help_panel=PARAMS,
        ),
    ]
    node: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="The node whose parameters are read, if the parameter file or launch file has several nodes.",
            rich_help_panel=PARAMS,
        ),
    ] = None
    param: Annotated[
        list[str],
        typer.Option(
            "--param",
            "-p",
            metavar="NAME:=VALUE",
            help="A parameter in ROS's notation. Overrides the file; the options below override it. Repeatable.",
            rich_help_panel=PARAMS,
        ),
    ]
    remap: Annotated[
        list[str],
        typer.Option(
            "--remap",
            "-r",
            metavar="FROM:=TO",
            help="A remapping in ROS's notation: cloud_in:=/points with scan:=/scan is the same as "
            "--topic /points:=/scan. Repeatable.",
            rich_help_panel=TOPICS,
        ),
    ]
    ros_args: Annotated[
        bool, typer.Option("--ros-args", help="ROS 2's marker in front of -r and -p; changes nothing.", hidden=True)
    ] = False
    preset: Annotated[
        str | None,
        typer.Option(
            metavar="CONSUMER",
            autocompletion=completion.presets,
            help="Parameters for a consumer of the scans: slam_toolbox, cartographer, gmapping, amcl, nav2, mrpt. "
            "Parameters given here or in a file override them.",
            rich_help_panel=SLAM,
        ),
    ] = None
    given: ParameterOptions

    @property
    def is_given(self) -> bool:
        """Whether any parameter of the projection is given: as an option, by a preset or in a file."""
        return bool(self.given.settings or self.param or self.preset or self.params_file)


def ros_arguments(words: Iterable[Path]) -> tuple[list[Path], list[str], list[str]]:
    """Split the positional arguments into recordings, remappings and parameters, as ``rosrun`` reads them.

    >>> ros_arguments(map(Path, ["a.bag", "cloud_in:=/points", "_min_height:=0.1", "__name:=front"]))
    ([PosixPath('a.bag')], ['cloud_in:=/points'], ['_min_height:=0.1'])
    """
    sources, remaps, parameters = [], [], []
    for word in words:
        text = str(word)
        if ":=" not in text:
            sources.append(word)
        elif not text.startswith("_"):
            remaps.append(text)
        elif not text.startswith("__"):
            parameters.append(text)
    return sources, remaps, parameters
