"""The table of options: which command takes which groups of them, and where they may stand.

An option is a field of a group; ``projection``, ``processing``, ``running`` and ``per_command`` have the groups. The
classes here are the types of the functions' keywords, too (``**options: Unpack[ConvertKeywords]``). A help text names
other options in backticks, by their names in Python; the command line shows them as they are typed.

No ``from __future__ import annotations`` in modules of groups: the annotations are read at each start, and text would
have to be compiled.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any

from . import per_command, processing, projection, running
from .option import Option, Parameter, Scope, options_in

# Which command takes which groups; the order is that of the help's sections.


class _Clouds(
    projection.ParameterSources,
    projection.Projection,
    processing.TimeRange,
    processing.StampCorrection,
    processing.CloudUnit,
    processing.PointSelection,
    processing.ConversionFrames,
    processing.RobotMotion,
    total=False,
):
    """How a cloud becomes a scan, and what is read."""


class _Scans(_Clouds, processing.CloudCombination, processing.EchoChoice, total=False):
    """How clouds become scans, and what is read."""


class _Conversion(
    processing.SourceTopics,
    _Scans,
    projection.SeveralOutputs,
    processing.CloudContent,
    processing.OtherTopics,
    processing.FailureConditions,
    running.Container,
    running.Replacement,
    total=False,
):
    """A conversion to a recording."""


class ConvertKeywords(_Conversion, running.RunReport, running.ThreadCount, running.RunProgress, total=False):
    """``convert``."""


class BatchKeywords(
    per_command.BatchRun,
    per_command.BatchExport,
    per_command.Poses,
    _Conversion,
    per_command.BatchRunProgress,
    total=False,
):
    """``batch``."""


class ExportKeywords(
    per_command.ExportFormat,
    per_command.Poses,
    processing.SourceTopics,
    _Scans,
    running.ThreadCount,
    running.RunProgress,
    total=False,
):
    """``export``."""


class ViewKeywords(
    per_command.PageClouds,
    processing.SourceTopics,
    _Clouds,
    projection.SeveralOutputs,
    processing.Reversal,
    total=False,
):
    """``view``."""


class PlotKeywords(per_command.FigureClouds, processing.SourceTopics, _Clouds, projection.SeveralOutputs, total=False):
    """``plot``."""


class MapKeywords(
    per_command.MapDrawing,
    processing.SourceTopics,
    _Scans,
    projection.SeveralOutputs,
    running.ThreadCount,
    running.RunProgress,
    total=False,
):
    """``map``."""


class CheckKeywords(
    per_command.CheckRules, processing.EchoChoice, processing.StaticTransforms, processing.TransformSources, total=False
):
    """``check``."""


class InfoKeywords(
    per_command.InfoSamples,
    processing.CloudUnit,
    processing.StaticTransforms,
    processing.TransformSources,
    processing.SourceFrame,
    total=False,
):
    """``info``."""


class TfKeywords(processing.TransformInputs, processing.StaticTransforms, total=False):
    """``tf``."""


class RepairKeywords(
    per_command.RepairContainer, running.Replacement, running.RunReport, running.RunProgress, total=False
):
    """``repair``."""


class DiffKeywords(per_command.ComparisonRules, total=False):
    """``diff``."""


class GoldenKeywords(per_command.GoldenCases, total=False):
    """``golden``."""


class ScansKeywords(_Scans, running.ThreadCount, total=False):
    """``pc2scan.scans``."""


class CloudsKeywords(processing.TimeRange, processing.CloudUnit, total=False):
    """``pc2scan.clouds``."""


#: For each command, the groups that its function takes too, and those that only the command has; then the functions
#: without a command.
GROUPS: Mapping[str, tuple[Any, ...]] = {
    "convert": (ConvertKeywords, running.ScreenOutput),
    "batch": (BatchKeywords, per_command.BatchScreen),
    "export": (ExportKeywords, running.JsonOutput),
    "view": (ViewKeywords, per_command.ShownFiles),
    "plot": (PlotKeywords,),
    "map": (MapKeywords, per_command.ShownFiles, running.JsonOutput),
    "check": (CheckKeywords, running.JsonOutput),
    "info": (InfoKeywords, running.JsonOutput),
    "tf": (TfKeywords, running.JsonOutput),
    "repair": (RepairKeywords, running.Quiet, running.JsonOutput),
    "diff": (DiffKeywords, running.JsonOutput, per_command.CompareScreen),
    "golden": (GoldenKeywords, running.JsonOutput, per_command.GoldenScreen),
    "scans": (ScansKeywords,),
    "clouds": (CloudsKeywords,),
}


@cache
def options_of(command: str) -> Mapping[str, Option]:
    """Return the options of a command or function, by name."""
    return {name: option for group in GROUPS[command] for name, option in options_in(group).items()}


#: Every parameter of the projection by its ROS name: upstream's in upstream's order, then pc2scan's own.
PARAMETERS: Mapping[str, Parameter] = options_in(projection.Projection)


@cache
def spellings() -> Mapping[str, str]:
    """Return how options are typed, by their names in Python."""
    options = [option for command in GROUPS for option in options_of(command).values()]
    return {option.name: option.spelling for option in options if option.spelling} | {"destination": "-o"}


def instead_of(command: str, name: str) -> str:
    """Return what to use instead of an option that a command does not have; empty if nothing is known."""
    if name in options_of(command):
        return ""
    others = [other for other in GROUPS if name in options_of(other) and not options_of(other)[name].command_only]
    if not others:
        return ""
    if command in ("view", "plot") and name in processing.CloudCombination.__annotations__:
        return "pages and figures make each scan of one cloud; convert with this option, and use what it writes"
    return f"only {', '.join(others[:3])} {'has' if len(others) == 1 else 'have'} it"


def options_about_scans() -> set[str]:
    """Return the options of a conversion that say which scans are made, and how."""
    of_outputs = (Scope.ONE_OUTPUT, Scope.SINGLE)
    names = {name for name, option in options_of("convert").items() if option.scope in of_outputs}
    return names | {"scans", "param", "min_used", "only_scans"}


def conversion_options() -> Mapping[str, Option]:
    """Return the options of a conversion as a batch has it: all that a dataset file may have, and ``overwrite``."""
    return {
        name: option
        for name, option in options_of("batch").items()
        if option.scope != Scope.CALL_ONLY or name == "overwrite"
    }


def dataset_options() -> Mapping[str, Option]:
    """Return the options that a dataset file may have."""
    return {
        name: option
        for name, option in conversion_options().items()
        if name != "overwrite" and option.value.kind != "object"
    }


def output_options() -> Mapping[str, Option]:
    """Return the options of one output that are no parameters of the projection, as scans files have them."""
    return {
        name: option
        for name, option in options_of("convert").items()
        if option.scope == Scope.ONE_OUTPUT and not isinstance(option, Parameter)
    }
