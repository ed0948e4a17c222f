"""The table of options: which command takes which groups of them, and where they may stand.

An option is a field of a group; ``projection``, ``conversion``, ``running`` and ``commands`` have the groups. The
classes here are also the types of the functions' keywords (``**options: Unpack[Convert]``). A help text names other
options in backticks, by their names in Python; the command line shows them as they are typed.

No ``from __future__ import annotations`` in modules of groups: the annotations are read at each start, and text would
have to be compiled.
"""

from collections.abc import Mapping
from typing import Any

from pc2scan.core.params import ProjectionParams

from .commands import (
    BatchExport,
    BatchRun,
    BatchRunProgress,
    BatchScreen,
    CheckRules,
    CompareScreen,
    ComparisonRules,
    ExportFormat,
    FigureClouds,
    GoldenCases,
    GoldenScreen,
    InfoSamples,
    MapDrawing,
    PageClouds,
    Poses,
    RepairContainer,
    RepairScreen,
    ShownFiles,
)
from .conversion import (
    CloudCombination,
    CloudContent,
    CloudUnit,
    ConversionFrames,
    EchoChoice,
    FailureConditions,
    OtherTopics,
    PointSelection,
    Reversal,
    RobotMotion,
    SourceFrame,
    SourceTopics,
    StampCorrection,
    StaticTransforms,
    TimeRange,
    TransformInputs,
    TransformSources,
)
from .option import (
    BATCH,
    CALL_ONLY,
    CONVERSION,
    EXPORT,
    FRAMES,
    MOVING,
    NEW_CASE,
    ONE_OUTPUT,
    OUTPUT,
    PARAMS,
    POINTS,
    PYTHON,
    REPORT,
    REVERSE,
    RULES,
    RUN,
    SINGLE,
    TOPICS,
    Option,
    Parameter,
)
from .projection import ParameterSources, Projection, SeveralOutputs
from .running import (
    Container,
    DryRun,
    JsonOutput,
    Replacement,
    RunProgress,
    RunReport,
    Scratch,
    ScreenOutput,
    ThreadCount,
)
from .values import Instance

# Which command takes which groups; the order is that of the help's sections.


class _Clouds(
    ParameterSources,
    Projection,
    TimeRange,
    StampCorrection,
    CloudUnit,
    PointSelection,
    ConversionFrames,
    RobotMotion,
    total=False,
):
    """How a cloud becomes a scan, and what is read."""


class _Scans(_Clouds, CloudCombination, EchoChoice, total=False):
    """How clouds become scans, and what is read."""


class _Conversion(
    SourceTopics,
    _Scans,
    SeveralOutputs,
    CloudContent,
    OtherTopics,
    FailureConditions,
    Container,
    Replacement,
    DryRun,
    Scratch,
    total=False,
):
    """A conversion to a recording."""


class Convert(_Conversion, RunReport, ThreadCount, RunProgress, total=False):
    """``convert``."""


class Batch(BatchRun, BatchExport, Poses, _Conversion, BatchRunProgress, total=False):
    """``batch``."""


class Export(ExportFormat, Poses, SourceTopics, _Scans, ThreadCount, RunProgress, total=False):
    """``export``."""


class View(PageClouds, SourceTopics, _Clouds, SeveralOutputs, Reversal, total=False):
    """``view``."""


class Plot(FigureClouds, SourceTopics, _Clouds, SeveralOutputs, total=False):
    """``plot``."""


class Map(MapDrawing, SourceTopics, _Scans, SeveralOutputs, ThreadCount, RunProgress, total=False):
    """``map``."""


class Check(CheckRules, EchoChoice, StaticTransforms, TransformSources, total=False):
    """``check``."""


class Info(InfoSamples, CloudUnit, StaticTransforms, TransformSources, SourceFrame, total=False):
    """``info``."""


class Tf(TransformInputs, StaticTransforms, total=False):
    """``tf``."""


class Repair(RepairContainer, Replacement, RunReport, RunProgress, total=False):
    """``repair``."""


class Diff(ComparisonRules, total=False):
    """``diff``."""


class Golden(GoldenCases, total=False):
    """``golden``."""


class Scans(_Scans, ThreadCount, total=False):
    """``pc2scan.scans``."""


class Clouds(TimeRange, CloudUnit, total=False):
    """``pc2scan.clouds``."""


#: For each command, the groups that its function takes too, and those that only the command has; then the functions
#: without a command.
GROUPS: Mapping[str, tuple[Any, ...]] = {
    "convert": (Convert, ScreenOutput),
    "batch": (Batch, BatchScreen),
    "export": (Export, JsonOutput),
    "view": (View, ShownFiles),
    "plot": (Plot,),
    "map": (Map, ShownFiles, JsonOutput),
    "check": (Check, JsonOutput),
    "info": (Info, JsonOutput),
    "tf": (Tf, JsonOutput),
    "repair": (Repair, RepairScreen),
    "diff": (Diff, JsonOutput, CompareScreen),
    "golden": (Golden, JsonOutput, GoldenScreen),
    "scans": (Scans,),
    "clouds": (Clouds,),
}


#: Where the options of a group stand in the help, and where they may stand, unless they say otherwise.
_SECTIONS: Mapping[Any, tuple[str, str]] = {
    Projection: (PARAMS, ONE_OUTPUT),
    ParameterSources: (PARAMS, ONE_OUTPUT),
    SeveralOutputs: (TOPICS, CONVERSION),
    SourceTopics: (TOPICS, SINGLE),
    TimeRange: (TOPICS, CONVERSION),
    StampCorrection: (TOPICS, CONVERSION),
    CloudUnit: (TOPICS, CONVERSION),
    PointSelection: (POINTS, ONE_OUTPUT),
    ConversionFrames: (FRAMES, CONVERSION),
    SourceFrame: (FRAMES, CONVERSION),
    RobotMotion: (MOVING, ONE_OUTPUT),
    CloudCombination: (MOVING, ONE_OUTPUT),
    CloudContent: (REVERSE, SINGLE),
    EchoChoice: (TOPICS, ONE_OUTPUT),
    OtherTopics: (TOPICS, CONVERSION),
    FailureConditions: (RUN, CONVERSION),
    Container: (OUTPUT, CONVERSION),
    Replacement: (OUTPUT, CALL_ONLY),
    DryRun: (OUTPUT, CALL_ONLY),
    Scratch: (OUTPUT, CALL_ONLY),
    RunReport: (REPORT, CALL_ONLY),
    ThreadCount: (RUN, CALL_ONLY),
    RunProgress: (PYTHON, CALL_ONLY),
    ScreenOutput: (REPORT, CALL_ONLY),
    ExportFormat: (EXPORT, CALL_ONLY),
    BatchExport: (EXPORT, CONVERSION),
    Poses: (EXPORT, CONVERSION),
    BatchRun: (BATCH, CALL_ONLY),
    BatchScreen: (BATCH, CALL_ONLY),
    BatchRunProgress: (PYTHON, CALL_ONLY),
    ComparisonRules: (RULES, CALL_ONLY),
    GoldenCases: (NEW_CASE, CALL_ONLY),
}


# Each option gets its name and spelling, and the place of its group if it has none of its own.
for _group in (*_SECTIONS, *(group for groups in GROUPS.values() for group in groups)):
    for _name, _annotation in _group.__annotations__.items():
        _option = _annotation.__metadata__[0]
        if not _option.name:
            if isinstance(_option, Parameter):
                _option.default = ProjectionParams.__dataclass_fields__[_name].default
            _option.complete(_name, _annotation.__origin__, *_SECTIONS.get(_group, ("", CALL_ONLY)))


def options_of(command: str) -> Mapping[str, Option]:
    """Return the options of a command or function, by name."""
    if command not in _FOUND:
        _FOUND[command] = {
            name: annotation.__metadata__[0]
            for group in GROUPS[command]
            for name, annotation in group.__annotations__.items()
        }
    return _FOUND[command]


_FOUND: dict[str, Mapping[str, Option]] = {}

#: Every parameter of the projection by its ROS name: upstream's in upstream's order, then pc2scan's own.
PARAMETERS: Mapping[str, Parameter] = {
    name: annotation.__metadata__[0] for name, annotation in Projection.__annotations__.items()
}


def spelling_of(name: str) -> str | None:
    """Return how an option is typed, by its name in Python; None if no command has it."""
    if not _SPELLINGS:
        for command in GROUPS:
            _SPELLINGS.update((key, option.spelling) for key, option in options_of(command).items() if option.spelling)
        _SPELLINGS["destination"] = "-o"
    return _SPELLINGS.get(name)


_SPELLINGS: dict[str, str] = {}


def instead_of(command: str, name: str) -> str:
    """Return what to use instead of an option that a command does not have; empty if nothing is known."""
    if name in options_of(command):
        return ""
    others = [other for other in GROUPS if name in options_of(other) and not options_of(other)[name].command_only]
    if not others:
        return ""
    if command in ("view", "plot") and name in CloudCombination.__annotations__:
        return "pages and figures make each scan of one cloud; convert with this option, and use what it writes"
    if "convert" in others and command in ("export", "map", "plot", "scans", "view"):
        of_recordings = any(name in group.__annotations__ for group in _OF_RECORDINGS)
        why = f"because {command} writes no recording" if of_recordings else "here"
        return f"it would have no effect{',' if of_recordings else ''} {why}; convert has it"
    return f"only {', '.join(others[:3])} {'has' if len(others) == 1 else 'have'} it"


#: What is about a recording that is written.
_OF_RECORDINGS: tuple[Any, ...] = (OtherTopics, FailureConditions, Container, CloudContent, DryRun, RunReport)


def options_about_scans() -> set[str]:
    """Return the options of a conversion that say which scans are made, and how."""
    groups = (SourceTopics, ParameterSources, SeveralOutputs, Projection, PointSelection, RobotMotion, CloudCombination)
    names = {name for group in (*groups, CloudContent) for name in group.__annotations__}
    return names | {"keep_used", "min_used", "only_scans"}


def conversion_options() -> Mapping[str, Option]:
    """Return the options of a conversion as a batch has it: all that may stand in a dataset file, and ``overwrite``."""
    return {
        name: option for name, option in options_of("batch").items() if option.scope != CALL_ONLY or name == "overwrite"
    }


def dataset_options() -> Mapping[str, Option]:
    """Return the options that a dataset file may have."""
    return {
        name: option
        for name, option in conversion_options().items()
        if name != "overwrite" and not isinstance(option.value, Instance)
    }


def output_options() -> Mapping[str, Option]:
    """Return the options of one output that are no parameters of the projection, as scans files have them."""
    return {
        name: option
        for name, option in options_of("convert").items()
        if option.scope == ONE_OUTPUT and not isinstance(option, Parameter)
    }
