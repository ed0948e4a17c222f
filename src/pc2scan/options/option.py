"""An option: how it is declared, the types of values in Python, and the sections of the help.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime, timedelta
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeAlias, TypeVar, get_args, get_origin

from pc2scan.core.params import ProjectionParams

from .values import FLAG, MOMENT, Value, in_words, number, path, text

if TYPE_CHECKING:
    import numpy as np

    from pc2scan.core.unproject import UnprojectParams
    from pc2scan.transforms.static import StaticTransform

    Quantity: TypeAlias = str | float | np.floating[Any] | np.integer[Any]
    Time: TypeAlias = str | float | datetime | timedelta | np.datetime64 | np.timedelta64 | np.number[Any]
    Transforms: TypeAlias = str | PathLike[str] | StaticTransform | Iterable[str | PathLike[str] | StaticTransform]
    Channels: TypeAlias = str | Iterable[str] | UnprojectParams
else:
    Quantity = str | float
    Time = str | float | datetime | timedelta
    Transforms = str | PathLike[str] | Iterable[str | PathLike[str]]
    Channels = str | Iterable[str]

Path: TypeAlias = str | PathLike[str]
Paths: TypeAlias = Path | Iterable[Path]
Names: TypeAlias = str | Iterable[str]
Period: TypeAlias = str | float | timedelta
Tolerance: TypeAlias = float | Mapping[str, float]
Progress: TypeAlias = Callable[..., object]
Preset: TypeAlias = Literal["slam_toolbox", "cartographer", "gmapping", "amcl", "nav2", "mrpt"]
Reduce: TypeAlias = Literal[
    "min", "max", "mean", "median", "surface", "kth=2", "kth=3", "kth=4", "kth=5", "kth=6", "kth=7", "kth=8", "kth=9"
]
Storage: TypeAlias = Literal["mcap", "sqlite3"]
Compression: TypeAlias = Literal["none", "lz4", "zstd", "bz2"]
FileFormat: TypeAlias = Literal["npz", "csv", "tum", "pcd", "kitti"]

# Types that several options have, with how their values are read.
Metres: TypeAlias = Annotated[Quantity, number("M", unit="m")]
Radians: TypeAlias = Annotated[Quantity, number("RAD", unit="rad")]
Seconds: TypeAlias = Annotated[Quantity, number("S", unit="s")]
SecondsOrAuto: TypeAlias = Annotated[Quantity, number("S|auto", unit="s", words=("auto",))]
Frame: TypeAlias = Annotated[str, text("FRAME", offers=("frames",))]
File: TypeAlias = Annotated[Path | None, path("FILE")]
When: TypeAlias = Annotated[Time | None, MOMENT]


class Section:
    """Sections of the help."""

    PARAMS = "Parameters of pointcloud_to_laserscan"
    SLAM = "Beyond pointcloud_to_laserscan (ready for SLAM)"
    TOPICS = "Topics and time"
    POINTS = "Which points"
    FRAMES = "Frames"
    MOVING = "Robots that move"
    REVERSE = "LaserScan to PointCloud2"
    RUN = "Run"
    OUTPUT = "Output"
    REPORT = "Report"
    BATCH = "Batch"
    EXPORT = "Export"
    RULES = "Tolerances"
    NEW_CASE = "A new case"
    PYTHON = "Python"


class Scope:
    """Where an option may stand.

    In the description of one output (scans files, and dataset files); in that of a conversion with a single output; in
    that of any conversion (dataset files); or only in the call.
    """

    ONE_OUTPUT, SINGLE, CONVERSION, CALL_ONLY = "output", "single", "conversion", "call"


#: The options that ``--help`` has of a command with many.
_MAIN = {
    *("topics", "start", "end", "keep", "params_file", "target_frame", "min_height", "max_height", "angle_min"),
    *("angle_max", "range_min", "range_max", "preset", "reduce", "remove", "exclude_box", "static_tf", "odom_topic"),
    *("deskew", "fixed_frame", "overwrite", "dry_run", "jobs", "report", "as_json", "format", "pose_frame"),
    *("base_frame", "odom_frame", "resolution", "clouds", "at", "dataset", "dask", "again"),
}


class How(NamedTuple):
    """What does not follow from an option's name, its type and its group.

    Attributes
    ----------
    short, typed
        How it is typed: ``-t``, ``--topic``; of a flag that is on by default, what switches it off. With an empty
        ``typed``, only Python has it.
    panel, scope
        The section of the help, and where it may stand, if they are not those of its group.
    default
        The value of a call that does not have it. Usually False for a flag, the first of a few words, and nothing for
        what may be given several times.
    default_text
        The default for users.
    command_only
        Whether only the command has it.
    """

    short: str = ""
    typed: str = "--"
    panel: str | None = None
    scope: str | None = None
    default: Any = None
    default_text: str | None = None
    command_only: bool = False


class Option:
    """An option, by its name and its declaration: ``Annotated[type in Python, type of values, help, How(...)]``.

    Without a type of values, it is true or false, or one of the words of the type in Python.

    Attributes
    ----------
    name
        Its name in Python and in files.
    value
        The type of its values.
    help
        One or two sentences, without the default.
    spelling, negation
        How it is typed: ``--min-height``; empty: only Python has it. How a parameter is set to false: ``--no-use-inf``.
    panel, scope, default, short, command_only
        See `How`.
    """

    def __init__(self, name: str, declared: Any, panel: str, scope: str) -> None:
        self.name, kind = name, declared.__origin__
        parts = {type(part): part for part in declared.__metadata__}
        how: How = parts.pop(How, How())
        self.help: str = parts.pop(str)
        words = [word for part in (kind, *get_args(kind)) if get_origin(part) is Literal for word in get_args(part)]
        self.value: Value = next(iter(parts.values()), text(words=tuple(filter(None, words))) if words else FLAG)
        self.spelling = f"--{name.replace('_', '-')}" if how.typed == "--" else how.typed
        self.negation = f"--no-{name.replace('_', '-')}"
        self.panel = panel if how.panel is None else how.panel
        self.scope = how.scope or scope
        self.short, self.command_only = how.short, how.command_only
        self.default, self._default_text = how.default, how.default_text
        if isinstance(self, Parameter):
            self.default = ProjectionParams.__dataclass_fields__[name].default
        elif self.default is None:
            # A flag is off, a text is empty, and a word is the first one.
            usual = {bool: False, str: ""}.get(kind, words[0] if get_origin(kind) is Literal else None)
            self.default = () if self.value.repeats else usual

    @property
    def common(self) -> bool:
        """Whether ``--help`` has it; ``--help-all`` has all."""
        return self.name in _MAIN

    @property
    def default_text(self) -> str:
        """The default for users; empty: there is none to show."""
        if self._default_text is not None:
            return self._default_text
        return str(self.default) if self.default and self.default is not True else ""

    def __repr__(self) -> str:
        return f"<option {self.name}>"


class Parameter(Option):
    """A parameter of the projection, upstream's or pc2scan's own; its default is that of `ProjectionParams`."""

    @property
    def default_text(self) -> str:
        """The default for users, with its unit: ``pi/180 rad, 1 degree``; empty: there is none to show."""
        known = {-math.pi: "-pi", math.pi: "pi", math.pi / 180: "pi/180", 1 / 30: "1/30"}
        text = known.get(self.default) if isinstance(self.default, float) else None
        text = text or in_words(self.default)
        # 0 beams: another parameter is used.
        if not text or text == "no limit" or self.name == "beams":
            return "" if self.name == "beams" else text
        return f"{text} {self.value.unit}".rstrip() + (", 1 degree" if self.name == "angle_increment" else "")


_Group = TypeVar("_Group", bound=type)

#: Every option that is in use, by its name and its declaration: groups that inherit one share it.
_KNOWN: dict[tuple[Any, ...], Option] = {}


def group(panel: str, scope: str, kind: type[Option] = Option) -> Callable[[_Group], _Group]:
    """Decorate a group of options: their section of the help, and where they may stand, unless they say otherwise."""

    def declare(declared: _Group) -> _Group:
        options_in(declared, panel, scope, kind)
        return declared

    return declare


def options_in(
    declared: type, panel: str = "", scope: str = Scope.CALL_ONLY, kind: type[Option] = Option
) -> dict[str, Any]:
    """Return the options of a group, by name."""
    options = {}
    for name, annotation in declared.__annotations__.items():
        key = name, annotation
        if key not in _KNOWN:
            _KNOWN[key] = kind(name, annotation, panel, scope)
        options[name] = _KNOWN[key]
    return options
