"""The options that commands share, in groups, and their conversion to the library's options.

No ``from __future__ import annotations`` here: see `pc2scan.cli.groups.Group`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from inspect import Parameter
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

import typer
from typer.models import TyperPath

from pc2scan.errors import UsageError
from pc2scan.pipeline.parameters import PARAMETERS, Setting, default_in_words
from pc2scan.pipeline.parameters import Parameter as TableRow
from pc2scan.pipeline.ros_scalars import plain_scalar
from pc2scan.text_enum import TextEnum

from . import completion
from .groups import Group
from .render import warn
from .spelling import as_typed

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from typing_extensions import Self

    from pc2scan.files.junit import JUnitCase
    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.pipeline.run import OutputOptions
    from pc2scan.tf.options import FrameOptions

__all__ = [
    "Compression",
    "ConversionGroup",
    "Destination",
    "Json",
    "Moments",
    "OutputGroup",
    "ParameterOptions",
    "ReportGroup",
    "ScratchGroup",
    "StaticTf",
    "Storage",
    "TfSources",
    "TfTopics",
    "length",
    "ros_arguments",
    "share",
    "typed_words",
]

Storage = Literal["mcap", "sqlite3"]
To = Literal["bag", "mcap", "rosbag2"]
Compression = Literal["none", "lz4", "zstd", "bz2"]

_TOPICS = "Topics and time"
_PARAMS = "Parameters of pointcloud_to_laserscan"
_SLAM = "Beyond pointcloud_to_laserscan (ready for SLAM)"
_POINTS = "Which points"
_FRAMES = "Frames"
_MOVING = "Robots that move"
_REVERSE = "LaserScan to PointCloud2"
_RUN = "Run"
_OUTPUT = "Output"
_REPORT = "Report"

#: The functions that read a parameter's number, by its kind.
_NUMBERS: Mapping[str, Callable[[str], float]] = {"int": int, "float": float}

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
        click_type=TyperPath(path_type=str),
    ),
]


def frame_option(text: str, *, show_default: bool = False, panel: str | None = None) -> Any:
    """Return an option that takes a frame of the recordings, which the shell offers."""
    return typer.Option(
        metavar="FRAME", help=text, autocompletion=completion.frames, show_default=show_default, rich_help_panel=panel
    )


Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Moments = Annotated[
    list[str],
    typer.Option(
        "--at",
        metavar="TIME",
        help="Show the first cloud at or after this time (see convert --start). Repeatable.",
    ),
]
StaticTf = Annotated[
    list[str],
    typer.Option(
        "--static-tf",
        metavar="TRANSFORM",
        help="Add a transform: 'parent child x y z qx qy qz qw' or 'parent child x y z roll pitch yaw' "
        "(m, rad; or 20cm, 90deg). Replaces the recording's transform to this child. Repeatable.",
        rich_help_panel=_FRAMES,
    ),
]
TfTopics = Annotated[
    list[str],
    typer.Option(
        "--tf-topic",
        metavar="TOPIC",
        autocompletion=completion.topics("/TFMessage", "/tfMessage"),
        help="Topic of the transforms, if not /tf and /tf_static. Repeatable.",
        rich_help_panel=_FRAMES,
    ),
]


class TopicsGroup(Group):
    """Options that choose topics and times."""

    topics: Annotated[
        list[str],
        typer.Option(
            "--topic",
            "-t",
            metavar="IN[:=OUT]",
            autocompletion=completion.topics("/PointCloud2", "/LaserScan"),
            help="PointCloud2 topic to convert, and the topic of its scans. Repeatable. "
            "Default: every PointCloud2 topic; the scans of a single topic are on /scan, of several on <topic>/scan.",
            rich_help_panel=_TOPICS,
        ),
    ]
    keep: Annotated[
        list[str],
        typer.Option(
            "--keep",
            metavar="TOPIC",
            autocompletion=completion.topics(),
            help="Copy only these of the topics that are not converted (names or globs). Repeatable.",
            rich_help_panel=_TOPICS,
        ),
    ]
    drop: Annotated[
        list[str],
        typer.Option(
            "--drop",
            metavar="TOPIC",
            autocompletion=completion.topics(),
            help="Do not write these topics (names or globs). Repeatable.",
            rich_help_panel=_TOPICS,
        ),
    ]
    keep_clouds: Annotated[
        bool, typer.Option("--keep-clouds", help="Write the converted clouds too.", rich_help_panel=_TOPICS)
    ] = False
    only_scans: Annotated[bool, typer.Option("--only-scans", help="Write only the scans.", rich_help_panel=_TOPICS)] = (
        False
    )
    start: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Start time: seconds from the beginning, @seconds since 1970, or a date and time (ISO 8601). "
            "Earlier latched messages and static transforms are kept.",
            rich_help_panel=_TOPICS,
        ),
    ] = None
    end: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="End time (exclusive), written like --start.", rich_help_panel=_TOPICS),
    ] = None


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
                rich_help_panel=_PARAMS if parameter.upstreams else _SLAM,
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


def length(option: str, text: str) -> float:
    """Read an option's length in metres; raises `UsageError` if it is not one."""
    from pc2scan.core.quantities import EXAMPLES, quantity

    try:
        return float(text)
    except ValueError:
        value = quantity(text, "m")
    if value is None:
        raise UsageError(f"{option}: {text!r} is not a number", hint=EXAMPLES["m"])
    return value


class ProjectionGroup(Group):
    """Options with parameters of the projection."""

    scans: Annotated[
        Path | None,
        typer.Option(
            "--scans",
            metavar="FILE",
            help="A YAML file with several outputs, each with its own sources, parameters and filters. Parameters on "
            "the command line override those of all outputs.",
            rich_help_panel=_TOPICS,
        ),
    ] = None
    params_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The file that the robot was run with: a ROS 2 parameter file, a ROS 1 YAML file, or an XML launch "
            "file of either, whose remappings are used too.",
            rich_help_panel=_PARAMS,
        ),
    ] = None
    launch_args: Annotated[
        list[str],
        typer.Option(
            "--arg",
            metavar="NAME:=VALUE",
            help="An argument of the launch file. Repeatable.",
            rich_help_panel=_PARAMS,
        ),
    ]
    node: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="The node whose parameters are read, if the parameter file or launch file has several nodes.",
            rich_help_panel=_PARAMS,
        ),
    ] = None
    param: Annotated[
        list[str],
        typer.Option(
            "--param",
            "-p",
            metavar="NAME:=VALUE",
            help="A parameter in ROS's notation. Overrides the file; the options below override it. Repeatable.",
            rich_help_panel=_PARAMS,
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
            rich_help_panel=_TOPICS,
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
            rich_help_panel=_SLAM,
        ),
    ] = None
    given: ParameterOptions

    @property
    def is_given(self) -> bool:
        """Whether any parameter of the projection is given: as an option, by a preset or in a file."""
        return bool(self.given.settings or self.param or self.preset or self.params_file)


class PointsGroup(Group):
    """Options that select points of the clouds."""

    keep_used: Annotated[
        str,
        typer.Option(
            "--keep-used",
            metavar="TOPIC",
            help="Also write the points that give the scan its ranges, to this topic: PointCloud2 with all their "
            "fields and the beam's number.",
            show_default=False,
            rich_help_panel=_POINTS,
        ),
    ] = ""
    remove: Annotated[
        list[str],
        typer.Option(
            "--remove",
            metavar="BEAMS",
            help="Remove beams by the rules of laser_filters: shadows (returns between an edge and the surface behind "
            "it) or speckles. Its parameters follow: 'shadows min_angle=5 neighbors=10', 'speckles filter_window=3'. "
            "Repeatable.",
            rich_help_panel=_POINTS,
        ),
    ]
    where: Annotated[
        list[str],
        typer.Option(
            "--where",
            metavar="CONDITION",
            help="Use only points whose fields fulfil this condition: 'ring in (3, 4, 5) and intensity > 10'. Fields, "
            "numbers, < <= > >= == != in, and or not, + - * / %, abs(). Repeatable: all must be fulfilled.",
            rich_help_panel=_POINTS,
        ),
    ]
    exclude_box: Annotated[
        list[str],
        typer.Option(
            "--exclude-box",
            metavar="BOX",
            help="Reject points in this box, such as the robot's own body: 'frame x0 x1 y0 y1 z0 z1' (m). Repeatable.",
            rich_help_panel=_POINTS,
        ),
    ]
    exclude_polygon: Annotated[
        list[str],
        typer.Option(
            "--exclude-polygon",
            metavar="POLYGON",
            help="Reject points in this polygon, at any height, such as the robot's footprint: "
            "'frame x0 y0 x1 y1 x2 y2 ...' (m). Repeatable.",
            rich_help_panel=_POINTS,
        ),
    ]
    min_height_slope: Annotated[
        float | None,
        typer.Option(
            metavar="M/M",
            help="Reject points below min_height + this * range, a limit that rises with the range, for ramps and "
            "rough ground. 0.05 is about 3 degrees.",
            rich_help_panel=_POINTS,
        ),
    ] = None

    ground: Annotated[
        str,
        typer.Option(
            "--ground",
            metavar="keep|remove",
            help="remove: reject points on the ground, which is found in each cloud; it may slope by up to 15 degrees "
            "and have kerbs. Needs a frame of the robot whose z axis points up.",
            rich_help_panel=_POINTS,
        ),
    ] = "keep"


class JUnitGroup(Group):
    """Options about JUnit XML."""

    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the results as JUnit XML, for CI systems.")
    ] = None
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the file of --junit, whatever it contains.")
    ] = False

    def writing(
        self, command: str, inputs: Iterable[Path] = ()
    ) -> "AbstractContextManager[Callable[[Iterable[JUnitCase]], None]]":
        """Check that the file can be written; the context is the function that writes it."""
        if self.overwrite and self.junit is None:
            raise UsageError("--overwrite has no effect without --junit")
        from pc2scan.files.junit import junit_file

        return junit_file(self.junit, command, inputs, overwrite=self.overwrite, option="--junit")


class TfSources(Group):
    """Options about the sources of transforms."""

    tf_from: Annotated[
        list[Path],
        typer.Option(
            "--tf-from",
            metavar="FILE",
            help="Read the transforms of this recording too. Repeatable.",
            rich_help_panel=_FRAMES,
        ),
    ]
    tf_topic: TfTopics

    def options(self) -> "FrameOptions":
        """Return the library's options."""
        from pc2scan.tf.options import FrameOptions

        return FrameOptions(tf_topics=tuple(self.tf_topic), tf_from=tuple(self.tf_from))


class FramesGroup(Group):
    """Options about frames and transforms."""

    static_tf: StaticTf
    static_tf_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="A YAML list of transforms like those of --static-tf.", rich_help_panel=_FRAMES
        ),
    ] = None
    write_static_tf: Annotated[
        bool,
        typer.Option(
            "--write-static-tf",
            help="Write the added transforms to DST's /tf_static.",
            rich_help_panel=_FRAMES,
        ),
    ] = False
    transforms: TfSources
    source_frame: Annotated[
        str,
        frame_option("Frame of the messages to convert, if their frame_id is wrong or empty.", panel=_FRAMES),
    ] = ""


class MovingGroup(Group):
    """Options that use the robot's motion: points and beams are placed at their own times."""

    deskew: Annotated[
        bool,
        typer.Option(
            "--deskew",
            help="Transform each point of a cloud with the pose at its own time, through --fixed-frame. With "
            "--reverse, each beam of a scan; that needs a --target-frame such as odom.",
            rich_help_panel=_MOVING,
        ),
    ] = False
    fixed_frame: Annotated[
        str,
        typer.Option(
            metavar="FRAME",
            help="A frame that does not move, such as odom; the robot's motion in it is corrected. For --level, its z "
            "axis points up.",
            show_default=False,
            rich_help_panel=_MOVING,
        ),
    ] = ""
    point_time: Annotated[
        str,
        typer.Option(
            metavar="FIELD[:UNIT]",
            help="Field with the points' times, relative to the stamp or absolute; unit: s, ms, us, ns. For clouds "
            "without such a field: azimuth, which measures how the lidar turns; or azimuth:0.1 with the time of a "
            "turn (s), then :cw or :ccw, and :start or :end if the stamp is that of the turn's start or end.  "
            "[default: t, time, timestamp, time_stamp or offset_time]",
            show_default=False,
            rich_help_panel=_MOVING,
        ),
    ] = ""
    stamp: Annotated[
        Literal["header", "start", "middle", "end"],
        typer.Option(
            help="The time of a deskewed scan: the cloud's stamp, or the start, middle or end of its points' times.",
            rich_help_panel=_MOVING,
        ),
    ] = "header"
    level: Annotated[
        bool,
        typer.Option(
            "--level",
            help="Make scans in a frame without the roll and pitch of the target frame, which come from --fixed-frame "
            "or --imu. This frame has the target frame's name with _stabilized appended; its transforms are written "
            "to /tf.",
            rich_help_panel=_MOVING,
        ),
    ] = False
    imu: Annotated[
        str,
        typer.Option(
            metavar="TOPIC[:FRAME]",
            autocompletion=completion.topics("/Imu"),
            help="sensor_msgs/Imu topic from which --level takes roll and pitch; and the IMU's frame, if its frame_id "
            "is wrong or empty.",
            show_default=False,
            rich_help_panel=_MOVING,
        ),
    ] = ""


class CombiningGroup(Group):
    """Options that make a scan of several messages, or of other scans."""

    lead: Annotated[
        str,
        typer.Option(
            metavar="TOPIC",
            help="If several topics become one scan (--topic /a:=/scan --topic /b:=/scan), the topic whose stamps the "
            "scans get.  [default: the first]",
            show_default=False,
            rich_help_panel=_MOVING,
        ),
    ] = ""
    window: Annotated[
        str | None,
        typer.Option(
            metavar="S",
            help="How far the stamps of the other topics may be from those of --lead.  [default: half the median "
            "period]",
            rich_help_panel=_MOVING,
        ),
    ] = None
    accumulate: Annotated[
        str | None,
        typer.Option(
            metavar="S|Nclouds",
            help="Make each scan of all points of the last S seconds (1, 500ms), or of the last N clouds (10clouds).",
            rich_help_panel=_MOVING,
        ),
    ] = None
    every: Annotated[
        str | None,
        typer.Option(
            metavar="S",
            help="Make one scan every S seconds, instead of one for each cloud.",
            rich_help_panel=_MOVING,
        ),
    ] = None
    rebin: Annotated[
        bool,
        typer.Option(
            "--rebin",
            help="Convert LaserScan to LaserScan: with other beams, in another frame, or several into one.",
            rich_help_panel=_MOVING,
        ),
    ] = False


class Channel(TextEnum):
    """Channels that laser_geometry can add to a cloud."""

    distances = "distances"
    stamps = "stamps"
    viewpoint = "viewpoint"


class ReverseGroup(Group):
    """Options for converting scans to clouds."""

    reverse: Annotated[
        bool,
        typer.Option(
            "--reverse",
            help="Convert LaserScan to PointCloud2, as laserscan_to_pointcloud does.",
            rich_help_panel=_REVERSE,
        ),
    ] = False
    channels: Annotated[
        list[Channel],
        typer.Option(
            "--channel",
            metavar="NAME",
            help="Add these fields to the cloud: distances, stamps, viewpoint. Repeatable.",
            rich_help_panel=_REVERSE,
        ),
    ]
    range_cutoff: Annotated[
        str | None,
        typer.Option(
            metavar="M",
            help="Use only returns closer than this.  [default: the scan's range_max]",
            rich_help_panel=_REVERSE,
        ),
    ] = None


class RunGroup(Group):
    """Options about the run."""

    on_error: Annotated[
        Literal["skip", "fail"],
        typer.Option(
            help="What to do with messages that cannot be converted. skip: count and list them; fail: end the run.",
            rich_help_panel=_RUN,
        ),
    ] = "skip"
    fail_on: Annotated[
        Literal["empty", "warning"] | None,
        typer.Option(
            help="Fail and write nothing. empty: if a scan has no return; warning: if there is any warning, skipped "
            "message or damage.",
            rich_help_panel=_RUN,
        ),
    ] = None
    min_used: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE",
            help="Fail and write nothing if less than this share of a topic's points is used in its scans: 0.05 or 5%.",
            rich_help_panel=_RUN,
        ),
    ] = None
    jobs: Annotated[
        int,
        typer.Option(
            "--jobs",
            "-j",
            min=0,
            metavar="N",
            help="Number of threads; the output does not depend on it.  [default: number of cores]",
            show_default=False,
            rich_help_panel=_RUN,
        ),
    ] = 0
    no_verify: Annotated[
        bool,
        typer.Option(
            "--no-verify",
            help="Do not check the CRCs of an MCAP source. This is faster, but damage may not be detected.",
            rich_help_panel=_RUN,
        ),
    ] = False
    strict: Annotated[
        bool,
        typer.Option(
            "--strict",
            help="Refuse a damaged source. Without this option, everything readable is recovered, the damage is "
            "reported, and the exit status is 3.",
            rich_help_panel=_RUN,
        ),
    ] = False


def share(text: str | None) -> float:
    """Read a share: ``0.05`` or ``5%``."""
    if text is None:
        return 0.0
    try:
        return float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    except ValueError as err:
        raise UsageError(f"`min_used`: {text!r} is not a share", hint="write 0.05 or 5%") from err


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


class ConversionGroup(Group):
    """All options that decide what is converted, but not how it is written or reported."""

    topics: TopicsGroup
    projection: ProjectionGroup
    points: PointsGroup
    frames: FramesGroup
    moving: MovingGroup
    combining: CombiningGroup
    reverse: ReverseGroup
    running: RunGroup

    #: The files that `options` read, by option.
    files = MappingProxyType[str, Path]({})

    def options(self, *, ros_distro: str = "") -> "ConvertOptions":
        """Return the library's options; other entries of a parameter file are reported on standard error."""
        from pc2scan.requests import conversion_of

        words, origins = typed_words(self)
        found = conversion_of(words | {"ros_distro": ros_distro}, origins, warn)
        self.files = MappingProxyType(found.files)
        return found.options

    def first_output(self, verb: str) -> "ConvertOptions":
        """Return the library's options with the first output only; ``verb`` says in the warning what it is used for."""
        options = self.options()
        if options.scans[1:]:
            warn(f"only the first of {len(options.scans)} outputs is {verb}: {options.scan.name}")
        return options.with_scan()

    def read_files(self) -> dict[str, Path]:
        """Return the files other than recordings that the options name, by option."""
        named = {"`params_file`": self.projection.params_file, "`static_tf_file`": self.frames.static_tf_file}
        named["`scans`"] = self.projection.scans
        return {option: path for option, path in named.items() if path is not None} | dict(self.files)


#: Attributes of the groups whose keyword in the library has another name.
_NAMES = {"tf_topic": "tf_topics"}


def typed_words(*groups: Group) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the options that differ from their defaults, as keywords, and where each parameter was typed.

    The keywords are those of `pc2scan.requests.conversion_of`.
    """
    words: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for group in groups:
        if isinstance(group, ParameterOptions):
            words |= {setting.name: setting.value for setting in group.settings}
            origins |= {setting.name: setting.origin for setting in group.settings}
            continue
        for name, kind in type(group).__annotations__.items():
            value = getattr(group, name)
            if isinstance(value, Group):
                inner, from_inner = typed_words(value)
                words |= inner
                origins |= from_inner
            elif value not in _defaults(group, name, kind):
                words[_NAMES.get(name, name)] = _word(name, value)
    if words.pop("no_verify", False):
        words["verify"] = False
    words.pop("ros_args", None)
    return words, origins


def _defaults(group: Group, name: str, kind: object) -> tuple[Any, ...]:
    is_list = get_origin(get_args(kind)[0]) is list
    return ([], ()) if is_list else (getattr(type(group), name, None),)


def _word(name: str, value: Any) -> Any:
    if name == "range_cutoff":
        return length("--range-cutoff", value)
    if name == "min_used":
        return share(value)
    if isinstance(value, list):
        return tuple(each.value if isinstance(each, TextEnum) else each for each in value)
    return value


class ScratchGroup(Group):
    """Options about local copies of files at URLs."""

    scratch: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for local copies of files at URLs.  [default: the system's folder for temporary files]",
            show_default=False,
            rich_help_panel=_OUTPUT,
        ),
    ] = None
    scratch_size: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="Maximum size of the local copies (20GB).  [default: the free space]",
            show_default=False,
            rich_help_panel=_OUTPUT,
        ),
    ] = None

    def on(self, output: "OutputOptions") -> "OutputOptions":
        """Return the output's options with the options of this group."""
        from pc2scan.pipeline.run import scratch_bytes

        return output._replace(scratch=self.scratch, scratch_size=scratch_bytes(self.scratch_size))


class OutputGroup(Group):
    """Options about the destination."""

    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            "-n",
            help="Write nothing; show what would be read and written.",
            rich_help_panel=_OUTPUT,
        ),
    ] = False
    each: Annotated[
        bool,
        typer.Option(
            "--each",
            help="Convert each SRC, and each recording in a folder, on its own.",
            rich_help_panel=_OUTPUT,
        ),
    ] = False
    to: Annotated[
        To | None,
        typer.Option(
            help="Format of DST, if -o does not name a file.  [default: SRC's]",
            show_default=False,
            rich_help_panel=_OUTPUT,
        ),
    ] = None
    storage: Annotated[
        Storage | None,
        typer.Option(help="Storage of a rosbag2 directory.  [default: mcap]", rich_help_panel=_OUTPUT),
    ] = None
    compression: Annotated[
        Compression | None,
        typer.Option(
            help="Bags: lz4 (default), none, bz2. MCAP: zstd (default), none, lz4. sqlite3: none (default), zstd. "
            "Without this option, chunks that are copied whole keep their compression.",
            show_default=False,
            rich_help_panel=_OUTPUT,
        ),
    ] = None
    profile: Annotated[
        Literal["ros1", "ros2"] | None,
        typer.Option(help="ROS version of an .mcap file.  [default: the source's]", rich_help_panel=_OUTPUT),
    ] = None
    metadata_version: Annotated[
        int,
        typer.Option(
            min=8,
            max=9,
            metavar="8|9",
            help="Version of a rosbag2 directory's metadata.yaml; older readers do not accept 9.",
            rich_help_panel=_OUTPUT,
        ),
    ] = 8
    ros_distro: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="ROS distribution whose message definitions are written if the recording has none.  "
            "[default: noetic, jazzy]",
            show_default=False,
            rich_help_panel=_OUTPUT,
        ),
    ] = ""
    split: Annotated[
        str | None,
        typer.Option(
            metavar="TIME|SIZE",
            help="Write several files, DST_0, DST_1 and so on. Each covers this much log time (60s, 10min, 1h) or has "
            "this many bytes of messages before compression (500MB, 1GiB).",
            rich_help_panel=_OUTPUT,
        ),
    ] = None
    repeat_latched: Annotated[
        bool,
        typer.Option(
            "--repeat-latched",
            help="With --split: repeat latched messages and static transforms at the beginning of each file.",
            rich_help_panel=_OUTPUT,
        ),
    ] = False
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite", help="Replace DST, and the file of --report, if they exist.", rich_help_panel=_OUTPUT
        ),
    ] = False

    def options(self, *, folder: Path | None = None, report: Path | None = None) -> "OutputOptions":
        """Return the library's options."""
        from pc2scan.pipeline.run import OutputOptions

        cut = None
        if self.split is not None or self.repeat_latched:
            from pc2scan.pipeline.parts import cut_of

            cut = cut_of(self.split, repeat_latched=self.repeat_latched)
        return OutputOptions(
            cut=cut,
            storage=self.storage,
            compression=self.compression,
            profile=self.profile,
            metadata_version=self.metadata_version,
            overwrite=self.overwrite,
            report=report,
            folder=folder,
            to=self.to,
            dry_run=self.dry_run,
        )


class ReportGroup(Group):
    """Options about the report and the output on screen."""

    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a report as JSON. An older report is replaced, any other file is not.",
            rich_help_panel=_REPORT,
        ),
    ] = None
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show warnings and errors only.", rich_help_panel=_REPORT)
    ] = False
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose", "-v", help="Show every parameter and where its value comes from.", rich_help_panel=_REPORT
        ),
    ] = False
