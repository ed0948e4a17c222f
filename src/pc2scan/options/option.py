"""An option: its attributes, the types of values in Python, and the sections of the help.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime, timedelta
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args, get_origin

from .values import Flag, Text, Value, in_words

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
    "min",
    "max",
    "mean",
    "median",
    "surface",
    "kth=2",
    "kth=3",
    "kth=4",
    "kth=5",
    "kth=6",
    "kth=7",
    "kth=8",
    "kth=9",
]
Storage: TypeAlias = Literal["mcap", "sqlite3"]
Compression: TypeAlias = Literal["none", "lz4", "zstd", "bz2"]
FileFormat: TypeAlias = Literal["npz", "csv", "tum", "carmen", "flaser", "pcd", "kitti"]

# Sections of the help.
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

# Where an option may stand: in the description of one output (scans files, and dataset files); in that of a conversion
# with a single output; in that of any conversion (dataset files); or only in the call.
ONE_OUTPUT, SINGLE, CONVERSION, CALL_ONLY = "output", "single", "conversion", "call"


#: The options that ``--help`` has of a command with many.
_MAIN = {
    *("topics", "start", "end", "keep", "params_file", "target_frame", "min_height", "max_height", "angle_min"),
    *("angle_max", "range_min", "range_max", "preset", "reduce", "remove", "exclude_box", "static_tf", "odom_topic"),
    *("deskew", "fixed_frame", "overwrite", "dry_run", "jobs", "report", "as_json", "format", "pose_frame"),
    *("base_frame", "odom_frame", "resolution", "clouds", "at", "dataset", "dask", "again"),
}


class Option:
    """An option: what its values mean, and how it is shown and typed.

    Attributes
    ----------
    name
        Its name in Python and in files.
    value
        The type of its values; None: true or false, or one of the words of its type in Python.
    help
        One or two sentences, without the default.
    default
        The value of a call that does not have it. Usually False for a flag, the first of a few words, and nothing for
        what may be given several times.
    panel
        The section of the help. Usually that of its group in `_SECTIONS`, like ``scope``.
    scope
        Where it may stand.
    spelling, short
        How it is typed: ``--min-height``, ``-t``; of a flag that is on by default, what switches it off. An empty
        ``spelling``: only Python has it.
    offers
        What the shell completes: ``frames``, ``presets``, or ``topics`` and the ends of their types (none: all topics).
    command_only
        Whether only the command has it.
    makes
        The class of the filters that it asks for: ``regions:ExcludeBox`` in `pc2scan.conversion.stages`; see its
        `filters.filters_of`.
    """

    __slots__ = (
        *("_default_text", "_is_open", "command_only", "default", "help", "makes", "name", "offers", "panel", "scope"),
        *("short", "spelling", "value"),
    )

    def __init__(
        self,
        text: str,
        value: Value | None = None,
        *,
        panel: str | None = None,
        default: Any = None,
        default_text: str | None = None,
        scope: str | None = None,
        typed: str = "--",
        short: str = "",
        offers: tuple[str, ...] = (),
        command_only: bool = False,
        makes: str = "",
    ) -> None:
        self.name, self.help = "", text
        self.value: Value = value or Flag()
        self._is_open = value is None
        self.panel, self.scope, self.default, self._default_text = panel, scope, default, default_text
        self.spelling, self.short, self.offers = typed, short, offers
        self.command_only, self.makes = command_only, makes

    def complete(self, name: str, kind: Any, panel: str, scope: str) -> None:
        """Set what follows from its place in the table: the name, the type in Python, and what the group has."""
        self.name = name
        self.spelling += name.replace("_", "-") if self.spelling == "--" else ""
        self.panel = panel if self.panel is None else self.panel
        self.scope = scope if self.scope is None else self.scope
        words = [word for part in (kind, *get_args(kind)) if get_origin(part) is Literal for word in get_args(part)]
        if self._is_open and words:
            self.value = Text(words=filter(None, words))
        if self.value.metavar == "FRAME":
            self.offers = ("frames",)
        if self.default is None:
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

    __slots__ = ()

    @property
    def upstreams(self) -> bool:
        """Whether upstream's node has it."""
        return self.panel is PARAMS

    @property
    def is_shared(self) -> bool:
        """Whether laserscan_to_pointcloud has it, too."""
        return self.name in {"target_frame", "transform_tolerance", "queue_size"}

    @property
    def negation(self) -> str:
        """The command line's spelling that sets it to false: ``--no-use-inf``."""
        return f"--no-{self.name.replace('_', '-')}"

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
