"""The table of options: each is a field of one group, with the type of its values, its default and its help.

A command takes a few groups: the classes at the end, which also are the types of the functions' keywords
(``**options: Unpack[Convert]``). A help text names other options in backticks, by their names in Python; the command
line shows them as they are typed.

No ``from __future__ import annotations`` here: the annotations are read at each start, and text would have to be
compiled.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime, timedelta
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypedDict

from pc2scan.core.params import CHOICES, ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.threads import MAX_JOBS

from .values import (
    Count,
    Duration,
    Flag,
    Moment,
    Moments,
    Number,
    Object,
    Outputs,
    PathName,
    PathNames,
    Share,
    Size,
    Switch,
    Text,
    Texts,
    Tolerances,
    Value,
    in_words,
)

if TYPE_CHECKING:
    import numpy as np

    from pc2scan.core.unproject import UnprojectParams
    from pc2scan.tf.options import FrameOptions
    from pc2scan.tf.static import StaticTransform

    Metres: TypeAlias = float | np.floating[Any] | np.integer[Any]
    Quantity: TypeAlias = str | float | np.floating[Any] | np.integer[Any]
    Time: TypeAlias = str | float | datetime | timedelta | np.datetime64 | np.timedelta64 | np.number[Any]
    Transforms: TypeAlias = str | StaticTransform | Iterable[str | StaticTransform]
    Channels: TypeAlias = str | Iterable[str] | UnprojectParams
else:
    Metres = float
    Quantity = str | float
    Time = str | float | datetime | timedelta
    Transforms = str | Iterable[str]
    Channels = str | Iterable[str]

Path: TypeAlias = str | PathLike[str]
Paths: TypeAlias = Path | Iterable[Path]
Names: TypeAlias = str | Iterable[str]
Period: TypeAlias = str | float | timedelta
Tolerance: TypeAlias = float | Mapping[str, float]
Progress: TypeAlias = Callable[..., object]

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


class Option:
    """An option: what its values mean, and how it is shown and typed.

    Attributes
    ----------
    name
        Its name in Python and in files.
    value
        The type of its values.
    help
        One or two sentences, without the default.
    default
        The value of a call that does not have it.
    panel
        The section of the help. Usually that of its group in `_SECTIONS`, like ``scope``.
    common
        Whether ``--help`` has it; ``--help-all`` has all.
    scope
        Where it may stand.
    typed, short
        How it is typed: ``--min-height``, ``-t``. An empty ``typed``: only Python has it.
    offers
        What the shell completes: ``frames``, ``presets``, or ``topics`` and the ends of their types.
    command_only
        Whether only the command has it.
    """

    __slots__ = (
        *("_default_text", "command_only", "common", "default", "help", "name", "offers", "panel", "scope", "short"),
        *("typed", "value"),
    )

    def __init__(
        self,
        value: Value,
        text: str,
        *,
        panel: str | None = None,
        default: Any = None,
        default_text: str | None = None,
        common: bool = False,
        scope: str | None = None,
        typed: str | None = None,
        short: str = "",
        offers: tuple[str, ...] = (),
        command_only: bool = False,
    ) -> None:
        self.name = ""
        self.value = value
        self.help = text
        self.panel = panel
        self.default = default
        self._default_text = default_text
        self.common = common
        self.scope = scope
        self.typed = typed
        self.short = short
        self.offers = offers
        self.command_only = command_only

    @property
    def default_text(self) -> str:
        """The default for users; empty: there is none to show."""
        if self._default_text is not None:
            return self._default_text
        return str(self.default) if self.default and self.default is not True else ""

    @property
    def spelling(self) -> str:
        """The command line's spelling; of a flag that is on by default, the one that switches it off."""
        return f"--{self.name.replace('_', '-')}" if self.typed is None else self.typed

    def __repr__(self) -> str:
        return f"<option {self.name}>"


class Parameter(Option):
    """A parameter of the projection, upstream's or pc2scan's own; its default is that of `ProjectionParams`."""

    __slots__ = ()

    def __init__(self, value: Value, text: str, panel: str = PARAMS, **more: Any) -> None:
        super().__init__(value, text, panel=panel, scope=ONE_OUTPUT, **more)

    @property
    def kind(self) -> str:
        """``float``, ``bool``, ``int`` or ``str``."""
        return self.value.kind

    @property
    def unit(self) -> str:
        """``m``, ``rad``, ``s`` or empty."""
        return self.value.unit

    @property
    def words(self) -> tuple[str, ...]:
        """The choices, or the words that a number may be instead."""
        return self.value.words

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
        # 0 beams and return 0: another parameter is used.
        if not text or text == "no limit" or self.name in {"beams", "kth"}:
            return "" if self.name in {"beams", "kth"} else text
        return f"{text} {self.unit}".rstrip() + (", 1 degree" if self.name == "angle_increment" else "")


def _topics(*ends: str) -> tuple[str, ...]:
    return ("topics", *ends)


_FRAME_NAMES = ("frames",)


class Projection(TypedDict, total=False):
    """The parameters of the projection: upstream's in upstream's order, then pc2scan's own."""

    target_frame: Annotated[
        str,
        Parameter(
            Text("FRAME"),
            "Frame that the clouds are transformed into; the scans are in this frame. Empty: the cloud's own frame.",
            common=True,
            offers=_FRAME_NAMES,
        ),
    ]
    transform_tolerance: Annotated[
        Quantity,
        Parameter(Number("s"), "How far a stamp may be before the first or after the last recorded transform."),
    ]
    min_height: Annotated[
        Metres,
        Parameter(
            Number("m"),
            "Lowest z of the points used, in the target frame, inclusive. The default, the smallest positive number, "
            "rejects z <= 0.",
            common=True,
        ),
    ]
    max_height: Annotated[
        Metres, Parameter(Number("m"), "Highest z of the points used, in the target frame, inclusive.", common=True)
    ]
    angle_min: Annotated[
        Quantity,
        Parameter(Number("rad"), "Angle at which the scan begins; 0 is straight ahead, positive is to the left."),
    ]
    angle_max: Annotated[Quantity, Parameter(Number("rad"), "Angle at which the scan ends.")]
    angle_increment: Annotated[Quantity, Parameter(Number("rad"), "Angle from one beam to the next.")]
    scan_time: Annotated[
        Quantity,
        Parameter(
            Number("s", words=("auto",)),
            "Time between scans, copied into the scan. auto: the median interval of the recorded stamps.",
        ),
    ]
    range_min: Annotated[Metres, Parameter(Number("m"), "Shortest horizontal distance of the points used, inclusive.")]
    range_max: Annotated[Metres, Parameter(Number("m"), "Longest horizontal distance of the points used, inclusive.")]
    use_inf: Annotated[
        bool,
        Parameter(
            Flag(), "Whether beams without a return have the range inf; otherwise it is `range_max` + `inf_epsilon`."
        ),
    ]
    inf_epsilon: Annotated[
        Metres, Parameter(Number("m"), "Added to `range_max` for beams without a return, if `use_inf` is off.")
    ]
    queue_size: Annotated[
        int,
        Parameter(
            Count(),
            "Maximum number of chunks of messages processed at a time; 0: as many as memory allows. Nothing is "
            "dropped.",
        ),
    ]
    geometry: Annotated[
        str,
        Parameter(
            Text(words=CHOICES["geometry"]),
            "Angles of beam i. upstream: from angle i to angle i + 1; centered: around angle i; half-open, symmetric: "
            "also centered, for gmapping and MRPT.",
            SLAM,
        ),
    ]
    beams: Annotated[
        int | str,
        Parameter(
            Count(words=("auto",)),
            "Number of beams in the sector, instead of `angle_increment`. auto: the lidar's own resolution.",
            SLAM,
        ),
    ]
    no_return: Annotated[
        str,
        Parameter(
            Text(words=CHOICES["no_return"]),
            "Range of beams without a return. Default: set by `use_inf`.",
            SLAM,
            common=True,
        ),
    ]
    reduce: Annotated[
        str,
        Parameter(
            Text(words=CHOICES["reduce"]),
            "What a beam's range is made of: its closest or farthest return, their mean or median, the kth closest, or "
            "the closest surface.",
            SLAM,
            common=True,
        ),
    ]
    kth: Annotated[
        int,
        Parameter(
            Count(),
            "Which return `reduce=kth` takes; 1 is the closest. Beams with fewer returns count as beams without a "
            "return.",
            SLAM,
        ),
    ]
    surface_depth: Annotated[
        Metres,
        Parameter(
            Number("m"),
            "For `reduce=surface`: returns at most this far behind the closest one are on the same surface.",
            SLAM,
        ),
    ]
    surface_slope: Annotated[
        float,
        Parameter(
            Number(metavar=""),
            "Added to `surface_depth`, as a multiple of the beam's width at the closest return.",
            SLAM,
        ),
    ]
    min_points: Annotated[
        int, Parameter(Count(), "Beams with fewer returns than this count as beams without a return.", SLAM)
    ]
    intensity_field: Annotated[
        str,
        Parameter(
            Text("NAME"),
            "Field of the cloud that becomes the scan's intensities, from the points that give the ranges.",
            SLAM,
        ),
    ]
    time_increment: Annotated[
        Quantity,
        Parameter(
            Number("s", words=("auto",)),
            "Time from beam to beam. auto: from the points' own times; the scan's stamp is then the first beam's.",
            SLAM,
        ),
    ]
    angle_rounding: Annotated[
        str,
        Parameter(
            Text(words=CHOICES["angle_rounding"]),
            "Which atan2f is reproduced: the correct one of glibc 2.41 and later, or that of 2.31 to 2.40 "
            "(Ubuntu 20.04 to 24.04).",
            SLAM,
        ),
    ]


class ParameterSources(TypedDict, total=False):
    """Where parameters come from, besides their own options."""

    params_file: Annotated[
        Path | None,
        Option(
            PathName(),
            "The file that the robot was run with: a ROS 2 parameter file, a ROS 1 YAML file, or an XML launch file of "
            "either, whose remappings are used too.",
            common=True,
        ),
    ]
    launch_args: Annotated[
        Names | None, Option(Texts("NAME:=VALUE"), "An argument of the launch file.", typed="--arg", scope=SINGLE)
    ]
    node: Annotated[
        str | None,
        Option(
            Text("NAME"), "The node whose parameters are read, if the parameter file or launch file has several nodes."
        ),
    ]
    param: Annotated[
        Names | None,
        Option(
            Texts("NAME:=VALUE"),
            "A parameter in ROS's notation. Overrides the file; the parameter's own option overrides it.",
            short="-p",
            scope=CONVERSION,
        ),
    ]
    remap: Annotated[
        Names | None,
        Option(
            Texts("FROM:=TO"),
            "A remapping in ROS's notation: cloud_in:=/points with scan:=/scan is the same as `topics=/points:=/scan`.",
            panel=TOPICS,
            short="-r",
            scope=SINGLE,
        ),
    ]
    ros_args: Annotated[
        bool | None,
        Option(Flag(), "ROS 2's marker in front of -r and -p; changes nothing.", scope=CALL_ONLY, command_only=True),
    ]
    preset: Annotated[
        str | None,
        Option(
            Text("CONSUMER"),
            "Parameters for a consumer of the scans: slam_toolbox, cartographer, gmapping, amcl, nav2, mrpt. "
            "Parameters given here or in a file override them.",
            panel=SLAM,
            common=True,
            offers=("presets",),
        ),
    ]
    params: Annotated[
        ProjectionParams | None,
        Option(
            Object(),
            "The parameters of the projection, instead of `preset` and `params_file`.",
            panel=PYTHON,
            typed="",
            scope=SINGLE,
        ),
    ]


class SeveralOutputs(TypedDict, total=False):
    """Several outputs of one recording."""

    scans: Annotated[
        Path | Mapping[str, Any] | list[Any] | None,
        Option(
            Outputs(),
            "A YAML file with several outputs, each with its own sources, parameters and filters. Parameters given "
            "besides override those of all outputs.",
        ),
    ]


class ConvertedTopics(TypedDict, total=False):
    """Which topics are converted."""

    topics: Annotated[
        Names | None,
        Option(
            Texts("IN[:=OUT]"),
            "PointCloud2 topic to convert, and the topic of its scans. Default: every PointCloud2 topic; the scans of "
            "a single topic are on /scan, of several on <topic>/scan.",
            typed="--topic",
            short="-t",
            common=True,
            offers=_topics("/PointCloud2", "/LaserScan"),
        ),
    ]


class Reading(TypedDict, total=False):
    """What is read of a recording, and how."""

    start: Annotated[
        Time | None,
        Option(
            Moment("TIME"),
            "Start time: seconds from the beginning, @seconds since 1970, or a date and time (ISO 8601). Messages that "
            "are latched then, and static transforms, are written at the start.",
            common=True,
        ),
    ]
    end: Annotated[Time | None, Option(Moment("TIME"), "End time (exclusive), written like `start`.", common=True)]
    verify: Annotated[
        bool,
        Option(
            Flag(),
            "Check the CRCs of an MCAP source. Without it, reading is faster, but damage may not be detected.",
            panel=RUN,
            default=True,
            typed="--no-verify",
        ),
    ]
    strict: Annotated[
        bool,
        Option(
            Flag(),
            "Refuse a damaged source. Without this option, everything readable is recovered, the damage is reported, "
            "and the exit status is 3.",
            panel=RUN,
            default=False,
        ),
    ]


class BadMessages(TypedDict, total=False):
    """What is done with messages that cannot be used."""

    on_error: Annotated[
        str,
        Option(
            Text(words=("skip", "fail")),
            "What to do with messages that cannot be converted. skip: count and list them; fail: end the run.",
            default="skip",
        ),
    ]


class Points(TypedDict, total=False):
    """Which points and beams are used."""

    remove: Annotated[
        Names | None,
        Option(
            Texts("BEAMS"),
            "Remove beams: shadows (returns between an edge and the surface behind it) or speckles. Parameters of "
            "laser_filters may follow, and it is its filter then: 'shadows min_angle=5 neighbors=10', "
            "'speckles filter_window=3'.",
            common=True,
        ),
    ]
    where: Annotated[
        Names | None,
        Option(
            Texts("CONDITION"),
            "Use only points whose fields fulfil this condition: 'ring in (3, 4, 5) and intensity > 10'. Fields, "
            "numbers, < <= > >= == != in, and or not, + - * / %, abs(). Of several, all must be fulfilled.",
        ),
    ]
    exclude_box: Annotated[
        Names | None,
        Option(Texts("BOX"), "Reject points in this box, such as the robot's own body: 'frame x0 x1 y0 y1 z0 z1' (m)."),
    ]
    exclude_polygon: Annotated[
        Names | None,
        Option(
            Texts("POLYGON"),
            "Reject points in this polygon, at any height, such as the robot's footprint: "
            "'frame x0 y0 x1 y1 x2 y2 ...' (m).",
        ),
    ]
    ground: Annotated[
        str,
        Option(
            Text("keep|remove", words=("keep", "remove")),
            "remove: reject points on the ground, which is found in each cloud; it may slope by up to 15 degrees and "
            "have kerbs. Needs a frame of the robot whose z axis points up.",
            default="keep",
        ),
    ]
    min_height_slope: Annotated[
        float | None,
        Option(
            Number(metavar="M/M"),
            "Reject points below `min_height` + this * range, a limit that rises with the range, for ramps and rough "
            "ground. 0.05 is about 3 degrees.",
        ),
    ]
    filters: Annotated[
        Any, Option(Object(), "Further filters of points, as objects.", panel=PYTHON, typed="", scope=SINGLE)
    ]


class TransformTopics(TypedDict, total=False):
    """The topics of transforms."""

    tf_topics: Annotated[
        Names | None,
        Option(
            Texts("TOPIC"),
            "Topic of the transforms, if not /tf and /tf_static.",
            typed="--tf-topic",
            offers=_topics("/TFMessage", "/tfMessage"),
        ),
    ]


class StaticTransforms(TypedDict, total=False):
    """Added transforms."""

    static_tf: Annotated[
        Transforms | None,
        Option(
            Texts("TRANSFORM", objects=("StaticTransform",)),
            "Add a transform: 'parent child x y z qx qy qz qw' or 'parent child x y z roll pitch yaw' (m, rad; or "
            "20cm, 90deg). Replaces the recording's transform to this child.",
            common=True,
        ),
    ]


class TransformSources(TransformTopics, total=False):
    """Where transforms come from."""

    tf_from: Annotated[Paths | None, Option(PathNames(), "Read the transforms of this recording too.")]
    frames: Annotated[
        "FrameOptions | None", Option(Object(), "All options about transforms in one object.", panel=PYTHON, typed="")
    ]


class SourceFrame(TypedDict, total=False):
    """The frame of messages."""

    source_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "Frame of the messages to convert, if their frame_id is wrong or empty.",
            default="",
            offers=_FRAME_NAMES,
        ),
    ]


class Frames(StaticTransforms, TransformSources, SourceFrame, total=False):
    """Frames and transforms of a conversion."""

    static_tf_file: Annotated[Path | None, Option(PathName(), "A YAML list of transforms like those of `static_tf`.")]


class Motion(TypedDict, total=False):
    """The robot's motion, and scans of several messages."""

    deskew: Annotated[
        bool,
        Option(
            Flag(),
            "Transform each point of a cloud with the pose at its own time, through `fixed_frame`. With `reverse`, "
            "each beam of a scan; that needs a `target_frame` such as odom.",
            default=False,
            common=True,
        ),
    ]
    fixed_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "A frame that does not move, such as odom; the robot's motion in it is corrected. For `level`, its z axis "
            "points up.",
            default="",
            common=True,
            offers=_FRAME_NAMES,
        ),
    ]
    point_time: Annotated[
        str,
        Option(
            Text("FIELD[:UNIT]"),
            "Field with the points' times, relative to the stamp or absolute; unit: s, ms, us, ns. For clouds without "
            "such a field: azimuth, which measures how the lidar turns; or azimuth:0.1 with the time of a turn (s), "
            "then :cw or :ccw, and :start or :end if the stamp is that of the turn's start or end.",
            default="",
            default_text="t, time, timestamp, time_stamp or offset_time",
        ),
    ]
    stamp: Annotated[
        str,
        Option(
            Text(words=("header", "start", "middle", "end")),
            "The time of a deskewed scan: the cloud's stamp, or the start, middle or end of its points' times.",
            default="header",
        ),
    ]
    level: Annotated[
        bool,
        Option(
            Flag(),
            "Make scans in a frame without the roll and pitch of the target frame, which come from `fixed_frame` or "
            "`imu`. This frame has the target frame's name with _stabilized appended; its transforms are written to "
            "/tf.",
            default=False,
            common=True,
        ),
    ]
    imu: Annotated[
        str,
        Option(
            Text("TOPIC[:FRAME]"),
            "sensor_msgs/Imu topic from which `level` takes roll and pitch; and the IMU's frame, if its frame_id is "
            "wrong or empty.",
            default="",
            offers=_topics("/Imu"),
        ),
    ]
    lead: Annotated[
        str,
        Option(
            Text("TOPIC"),
            "If several topics become one scan (`topics=/a:=/scan` `topics=/b:=/scan`), the topic whose stamps the "
            "scans have.",
            default="",
            default_text="the first",
            offers=_topics("/PointCloud2", "/LaserScan"),
        ),
    ]
    window: Annotated[
        Period | None,
        Option(
            Duration("S"),
            "How far the stamps of the other topics may be from those of `lead`.",
            default_text="half the median period",
        ),
    ]
    accumulate: Annotated[
        Period | None,
        Option(
            Duration("S|Nclouds"),
            "Make each scan of all points of the last S seconds (1, 500ms), or of the last N clouds (10clouds).",
        ),
    ]
    every: Annotated[
        Period | None, Option(Duration("S"), "Make one scan every S seconds, instead of one for each cloud.")
    ]
    rebin: Annotated[
        bool,
        Option(
            Flag(),
            "Convert LaserScan to LaserScan: with other beams, in another frame, or several into one.",
            default=False,
        ),
    ]


class Reversal(TypedDict, total=False):
    """Whether scans are converted to clouds."""

    reverse: Annotated[
        bool, Option(Flag(), "Convert LaserScan to PointCloud2, as laserscan_to_pointcloud does.", default=False)
    ]


class ReverseOptions(Reversal, total=False):
    """What the clouds of scans have."""

    channels: Annotated[
        Channels | None,
        Option(
            Texts("NAME", words=("distances", "stamps", "viewpoint"), objects=("UnprojectParams",)),
            "Add these fields to the cloud: distances, stamps, viewpoint.",
            typed="--channel",
        ),
    ]
    range_cutoff: Annotated[
        Metres | None, Option(Number("m"), "Use only returns closer than this.", default_text="the scan's range_max")
    ]


class WrittenTopics(TypedDict, total=False):
    """What a recording has besides the scans."""

    keep: Annotated[
        Names | None,
        Option(
            Texts("TOPIC"),
            "Copy only these of the topics that are not converted (names or globs).",
            common=True,
            offers=_topics(),
        ),
    ]
    drop: Annotated[
        Names | None, Option(Texts("TOPIC"), "Do not write these topics (names or globs).", offers=_topics())
    ]
    keep_clouds: Annotated[bool, Option(Flag(), "Write the converted clouds too.", default=False)]
    only_scans: Annotated[bool, Option(Flag(), "Write only the scans.", default=False)]
    keep_used: Annotated[
        str,
        Option(
            Text("TOPIC"),
            "Also write the points that give the scan its ranges, to this topic: PointCloud2 with all their fields and "
            "the beam's number.",
            panel=POINTS,
            default="",
            scope=ONE_OUTPUT,
        ),
    ]
    write_static_tf: Annotated[
        bool, Option(Flag(), "Write the added transforms to DST's /tf_static.", panel=FRAMES, default=False)
    ]


class Demands(TypedDict, total=False):
    """When a run fails."""

    fail_on: Annotated[
        str,
        Option(
            Text(words=("empty", "warning")),
            "Fail and write nothing. empty: if a scan has no return; warning: if there is any warning, skipped message "
            "or damage.",
            default="",
        ),
    ]
    min_used: Annotated[
        Quantity,
        Option(
            Share(),
            "Fail and write nothing if less than this share of a topic's points is used in its scans: 0.05 or 5%.",
            default=0.0,
        ),
    ]


class Container(TypedDict, total=False):
    """The format of the recording that is written."""

    to: Annotated[
        str | None,
        Option(
            Text(words=("bag", "mcap", "rosbag2")), "Format of DST, if its name does not say it.", default_text="SRC's"
        ),
    ]
    storage: Annotated[
        str | None, Option(Text(words=("mcap", "sqlite3")), "Storage of a rosbag2 directory.", default_text="mcap")
    ]
    compression: Annotated[
        str | None,
        Option(
            Text(words=("none", "lz4", "zstd", "bz2")),
            "Bags: lz4 (default), none, bz2. MCAP: zstd (default), none, lz4. sqlite3: none (default), zstd. Without "
            "this option, chunks that are copied whole keep their compression.",
        ),
    ]
    profile: Annotated[
        str | None, Option(Text(words=("ros1", "ros2")), "ROS version of an .mcap file.", default_text="the source's")
    ]
    metadata_version: Annotated[
        int,
        Option(
            Count(8, 9, metavar="8|9"),
            "Version of a rosbag2 directory's metadata.yaml; older readers do not accept 9.",
            default=8,
        ),
    ]
    ros_distro: Annotated[
        str,
        Option(
            Text("NAME"),
            "ROS distribution whose message definitions are written if the recording has none.",
            default="",
            default_text="noetic, jazzy",
        ),
    ]
    split: Annotated[
        str | None,
        Option(
            Text("TIME|SIZE"),
            "Write several files, DST_0, DST_1 and so on. Each covers this much log time (60s, 10min, 1h) or has this "
            "many bytes of messages before compression (500MB, 1GiB).",
            common=True,
        ),
    ]
    repeat_latched: Annotated[
        bool,
        Option(
            Flag(),
            "With `split`: repeat latched messages and static transforms at the beginning of each file.",
            default=False,
        ),
    ]


class Overwriting(TypedDict, total=False):
    """Whether a recording is replaced."""

    overwrite: Annotated[
        bool, Option(Flag(), "Replace DST, and the file of `report`, if they exist.", default=False, common=True)
    ]


class DryRun(TypedDict, total=False):
    """Whether anything is written."""

    dry_run: Annotated[
        bool,
        Option(Flag(), "Write nothing; show what would be read and written.", default=False, short="-n", common=True),
    ]


class Scratch(TypedDict, total=False):
    """Local copies of files at URLs."""

    scratch: Annotated[
        Path | None,
        Option(
            PathName("DIR"),
            "Folder for local copies of files at URLs.",
            default_text="the system's folder for temporary files",
        ),
    ]
    scratch_size: Annotated[
        str | None, Option(Size("SIZE"), "Maximum size of the local copies (20GB).", default_text="the free space")
    ]


class RunReport(TypedDict, total=False):
    """The report of a run."""

    report: Annotated[
        Path | None,
        Option(PathName(), "Write a report as JSON. An older report is replaced, any other file is not.", common=True),
    ]


class Threads(TypedDict, total=False):
    """Threads of a run."""

    jobs: Annotated[
        int,
        Option(
            Count(0, MAX_JOBS),
            f"Number of threads, up to {MAX_JOBS:,}; the output does not depend on it.",
            default=0,
            default_text="number of cores",
            short="-j",
        ),
    ]


class Watched(TypedDict, total=False):
    """Progress of a run."""

    progress: Annotated[
        Progress | None,
        Option(
            Object(called=True),
            "A function that is called from time to time with bytes read, bytes in total, and messages read.",
            typed="",
        ),
    ]


class Screen(TypedDict, total=False):
    """What a run shows on the screen; only commands have it."""

    quiet: Annotated[
        bool, Option(Flag(), "Show warnings and errors only.", default=False, short="-q", command_only=True)
    ]
    verbose: Annotated[
        bool,
        Option(
            Flag(), "Show every parameter and where its value comes from.", default=False, short="-v", command_only=True
        ),
    ]


class Json(TypedDict, total=False):
    """Results as JSON; only commands have it."""

    as_json: Annotated[
        bool, Option(Flag(), "Print JSON.", default=False, typed="--json", common=True, command_only=True)
    ]


class JUnit(TypedDict, total=False):
    """Results as JUnit XML; only commands have it."""

    junit: Annotated[
        Path | None,
        Option(PathName(), "Write the results as JUnit XML, for CI systems.", common=True, command_only=True),
    ]
    overwrite: Annotated[
        bool,
        Option(
            Flag(), "Replace the file of `junit`, whatever it contains.", default=False, common=True, command_only=True
        ),
    ]


class Exporting(TypedDict, total=False):
    """An export."""

    format: Annotated[
        str | None,
        Option(
            Text(words=("npz", "csv", "tum", "carmen", "flaser", "pcd", "kitti")),
            "For scans: npz (NumPy arrays), csv (one row per scan), carmen (ROBOTLASER1, .log), flaser (FLASER, .clf). "
            "For the trajectory only: tum. For clouds, in a folder: pcd, kitti.",
            default_text="by OUT's suffix",
            short="-f",
            common=True,
        ),
    ]
    pose_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "Write the robot's pose in this frame (odom, map) at each message's stamp, from the recorded transforms.",
            default="",
            common=True,
            offers=_FRAME_NAMES,
        ),
    ]
    base_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "The robot's frame, whose pose is written.",
            default="",
            default_text="base_link, base_footprint, or the frame that the sensor is mounted on",
            common=True,
            offers=_FRAME_NAMES,
        ),
    ]
    odom_topic: Annotated[
        str,
        Option(
            Text("TOPIC"),
            "Take the poses from this nav_msgs/Odometry topic instead of the transforms.",
            default="",
            common=True,
            offers=_topics("/Odometry"),
        ),
    ]
    overwrite: Annotated[
        bool,
        Option(Flag(), "Replace OUT: a file, or a folder with an export and nothing else.", default=False, common=True),
    ]


class BatchExport(TypedDict, total=False):
    """Results of a batch that are not recordings."""

    export: Annotated[
        str | None,
        Option(
            Text(words=("npz", "csv", "tum", "carmen", "flaser", "pcd", "kitti")),
            "Write the files of pc2scan export instead of recordings, in a folder for each recording.",
        ),
    ]
    pose_frame: Annotated[
        str,
        Option(Text("FRAME"), "With `export`: the robot's pose in this frame (odom, map) at each stamp.", default=""),
    ]
    base_frame: Annotated[
        str, Option(Text("FRAME"), "With `export`: the robot's frame, whose pose is written.", default="")
    ]
    odom_topic: Annotated[
        str, Option(Text("TOPIC"), "With `export`: take the poses from this nav_msgs/Odometry topic.", default="")
    ]


class BatchRun(TypedDict, total=False):
    """How a batch runs."""

    dataset: Annotated[
        Path | None,
        Option(
            PathName(),
            "A YAML file with options for the recordings that match a pattern. Options given here override it.",
            common=True,
        ),
    ]
    jobs: Annotated[
        int,
        Option(
            Count(0, MAX_JOBS),
            f"Number of recordings at a time, up to {MAX_JOBS:,}, each in its own process; the output does not depend "
            "on it.",
            default=0,
            default_text="number of cores, as memory allows",
            short="-j",
            common=True,
        ),
    ]
    retries: Annotated[
        int,
        Option(
            Count(0, 100),
            "How often a recording is tried again if its process was killed, for instance for lack of memory; up to "
            "100 times.",
            default=1,
        ),
    ]
    dask: Annotated[
        bool | str,
        Option(
            Switch("[ADDRESS]"),
            "Convert on the Dask cluster of this scheduler, such as tcp://scheduler:8786. Without an address (in "
            "Python: True), a cluster is started on this machine. Needs pc2scan[dask].",
            default=False,
            common=True,
        ),
    ]
    force: Annotated[
        bool, Option(Flag(), "Convert again what earlier runs have converted.", default=False, common=True)
    ]
    checksum: Annotated[
        bool,
        Option(
            Flag(),
            "Recognise unchanged recordings by SHA-256 instead of their modification time. Reads every byte.",
            default=False,
        ),
    ]
    fail_fast: Annotated[bool, Option(Flag(), "Stop at the first recording that fails.", default=False)]
    report: Annotated[
        Path | None, Option(PathName(), "Write the summary of all recordings: *.json, *.csv or *.md.", common=True)
    ]


class BatchScreen(TypedDict, total=False):
    """What a batch shows on the screen; only the command has it."""

    quiet: Annotated[
        bool, Option(Flag(), "Show warnings and errors only.", default=False, short="-q", command_only=True)
    ]
    verbose: Annotated[
        bool,
        Option(
            Flag(),
            "Show the tables of each conversion, and every recording in the summary.",
            default=False,
            short="-v",
            command_only=True,
        ),
    ]


class ShownClouds(TypedDict, total=False):
    """Which clouds a page shows."""

    clouds: Annotated[
        int,
        Option(
            Count(1, 1000),
            "Number of clouds of each topic on the page, up to 1,000, evenly spread over the recording.",
            default=10,
            common=True,
        ),
    ]
    at: Annotated[
        Time | Iterable[Time] | None,
        Option(Moments("TIME"), "Show the first cloud at or after this time, written like `start`.", common=True),
    ]


class Browsing(TypedDict, total=False):
    """The page on the disk; only the command has it."""

    open_page: Annotated[
        bool,
        Option(Flag(), "Open the page in the browser.", default=False, typed="--open", common=True, command_only=True),
    ]
    overwrite: Annotated[
        bool,
        Option(
            Flag(),
            "Replace any file of that name; an older page is always replaced.",
            default=False,
            common=True,
            command_only=True,
        ),
    ]


class DrawnClouds(TypedDict, total=False):
    """Which clouds a figure shows."""

    clouds: Annotated[
        int,
        Option(
            Count(1),
            "Number of clouds of each topic, side by side, spread over the recording.",
            default=1,
            short="--frames",
            common=True,
        ),
    ]
    at: Annotated[
        Time | Iterable[Time] | None,
        Option(Moments("TIME"), "Show the first cloud at or after this time, written like `start`.", common=True),
    ]
    overwrite: Annotated[bool, Option(Flag(), "Replace a file of that name.", default=False, common=True)]


class MapDrawing(TypedDict, total=False):
    """A map."""

    resolution: Annotated[Quantity, Option(Number("m"), "Side of a cell: 0.05, or 5cm.", default=0.05, common=True)]
    max_range: Annotated[
        Metres,
        Option(
            Number("m"),
            "Returns beyond this range mark no cell as occupied; the cells up to it are cleared.",
            default=float("inf"),
            default_text="no limit",
            common=True,
        ),
    ]
    clear_to: Annotated[
        Metres,
        Option(
            Number("m"),
            "Up to which range beams without a return clear cells. 0: not at all, like in gmapping and slam_toolbox.",
            default=0.0,
            default_text="0",
            common=True,
        ),
    ]
    odom_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "The frame of the map, in which the robot moves.",
            default="odom",
            common=True,
            offers=_FRAME_NAMES,
        ),
    ]
    base_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "The robot's frame, whose path is drawn.",
            default="",
            default_text="base_link, or base_footprint",
            common=True,
            offers=_FRAME_NAMES,
        ),
    ]


class MapFiles(TypedDict, total=False):
    """A map on the disk; only the command has it."""

    png: Annotated[
        Path | None,
        Option(PathName(), "The picture. Without -o, only this is written.", common=True, command_only=True),
    ]
    overwrite: Annotated[
        bool, Option(Flag(), "Replace files of these names.", default=False, common=True, command_only=True)
    ]


class Checking(TypedDict, total=False):
    """A check."""

    consumers: Annotated[
        Names | None,
        Option(
            Texts("CONSUMER", words=PRESETS),
            f"Consumer that decides the exit status: {', '.join(PRESETS)}. Default: all of them, and defects for all "
            "consumers too.",
            typed="--for",
            common=True,
        ),
    ]
    topics: Annotated[
        Names | None,
        Option(
            Texts("TOPIC"),
            "LaserScan topic to check, or a glob. Default: all.",
            typed="--topic",
            short="-t",
            common=True,
            offers=_topics("/LaserScan"),
        ),
    ]
    odom_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "The odometry's frame; the scans' frames must be connected to it.",
            default="odom",
            common=True,
            offers=_FRAME_NAMES,
        ),
    ]
    base_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "The robot's frame.",
            default="",
            default_text="base_link, or base_footprint",
            common=True,
            offers=_FRAME_NAMES,
        ),
    ]


class Describing(TypedDict, total=False):
    """A description of a recording."""

    samples: Annotated[
        int,
        Option(
            Count(1, metavar="N"),
            "Number of clouds and scans to read of each topic, spread over the recording.",
            default=10,
            common=True,
        ),
    ]
    target_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "Show heights in this frame, like convert --target-frame.",
            default="",
            common=True,
            offers=_FRAME_NAMES,
        ),
    ]


class Repairing(TypedDict, total=False):
    """A repair."""

    storage: Annotated[
        str | None,
        Option(Text(words=("mcap", "sqlite3")), "Storage of a rosbag2 directory.", default_text="SRC's", common=True),
    ]
    compression: Annotated[
        str | None,
        Option(Text(words=("none", "lz4", "zstd", "bz2")), "Compression of DST.", default_text="SRC's", common=True),
    ]
    verify: Annotated[
        bool, Option(Flag(), "Check the CRCs of an MCAP source.", default=True, typed="--no-verify", common=True)
    ]


class RepairScreen(TypedDict, total=False):
    """What a repair shows on the screen; only the command has it."""

    as_json: Annotated[
        bool, Option(Flag(), "Print the report as JSON.", default=False, typed="--json", common=True, command_only=True)
    ]
    quiet: Annotated[
        bool,
        Option(
            Flag(), "Show damage, warnings and errors only.", default=False, short="-q", common=True, command_only=True
        ),
    ]


class Comparing(TypedDict, total=False):
    """A comparison."""

    topics: Annotated[
        Names | None,
        Option(
            Texts("A[:=B]"),
            "Topic to compare, and its name in B if that differs. Default: every LaserScan and PointCloud2 topic.",
            typed="--topic",
            short="-t",
            panel="",
            common=True,
            offers=_topics(),
        ),
    ]
    all_topics: Annotated[
        bool,
        Option(
            Flag(),
            "Compare the other topics too: matched by log time, byte for byte.",
            default=False,
            panel="",
            common=True,
        ),
    ]
    atol: Annotated[
        Tolerance | None,
        Option(
            Tolerances("[NAME=]X"),
            "Absolute tolerance of all values, or of ranges, intensities or a field of the clouds.",
            common=True,
        ),
    ]
    rtol: Annotated[
        Tolerance | None,
        Option(Tolerances("[NAME=]X"), "Tolerance relative to A's value; the two are added.", common=True),
    ]
    allow_beams: Annotated[
        float,
        Option(
            Number(metavar="SHARE"),
            "Share of a topic's beams (clouds: points) that may be beyond the tolerance: 0.001 is one in a thousand.",
            default=0.0,
            common=True,
        ),
    ]
    ignore: Annotated[
        Names | None,
        Option(
            Texts("NAME"),
            "Do not compare: log_time, seq, frame_id, order, intensities, ranges, angle_min and the other numbers of a "
            "scan, shape, layout, padding, is_dense.",
            common=True,
        ),
    ]
    view: Annotated[
        Path | None,
        Option(
            PathName("PAGE"),
            "Also write an HTML page that shows the scans with most differing beams on top of each other.",
            panel="",
            common=True,
        ),
    ]


class CompareScreen(TypedDict, total=False):
    """What a comparison shows on the screen; only the command has it."""

    quiet: Annotated[
        bool,
        Option(
            Flag(),
            "Print nothing; only set the exit status.",
            default=False,
            short="-q",
            common=True,
            command_only=True,
        ),
    ]


class GoldenCases(TypedDict, total=False):
    """Golden cases."""

    update: Annotated[
        bool,
        Option(
            Flag(),
            "Write the expected output of cases that differ or have none; review the changes.",
            default=False,
            panel="",
            common=True,
        ),
    ]
    init: Annotated[Path | None, Option(PathName("SRC"), "Make a new case of this recording, in DIR.", common=True)]
    start: Annotated[
        Time | None, Option(Moment("TIME"), "With `init`: where the input begins, as in convert.", common=True)
    ]
    end: Annotated[Time | None, Option(Moment("TIME"), "With `init`: where it ends.", common=True)]
    topics: Annotated[
        Names | None,
        Option(
            Texts("TOPIC"),
            "With `init`: a topic of clouds or scans to keep, or a glob. Default: all.",
            typed="--topic",
            short="-t",
            common=True,
            offers=_topics("/PointCloud2", "/LaserScan"),
        ),
    ]
    params_file: Annotated[Path | None, Option(PathName(), "With `init`: the case's parameter file.", common=True)]


class GoldenScreen(TypedDict, total=False):
    """What golden cases show on the screen; only the command has it."""

    quiet: Annotated[
        bool,
        Option(Flag(), "Do not show cases that passed.", default=False, short="-q", common=True, command_only=True),
    ]


class BatchWatched(TypedDict, total=False):
    """Progress of a batch."""

    progress: Annotated[
        Progress | None,
        Option(Object(called=True), "A function that is called from time to time with the progress.", typed=""),
    ]


# Which command takes which groups; the order is that of the help's sections.


class _Scans(ParameterSources, Projection, Reading, Points, Frames, Motion, total=False):
    """How clouds become scans, and what is read."""


class _Conversion(
    ConvertedTopics,
    _Scans,
    SeveralOutputs,
    BadMessages,
    ReverseOptions,
    WrittenTopics,
    Demands,
    Container,
    Overwriting,
    DryRun,
    Scratch,
    total=False,
):
    """A conversion to a recording."""


class Convert(_Conversion, RunReport, Threads, Watched, total=False):
    """``convert``."""


class Batch(BatchRun, BatchExport, _Conversion, BatchWatched, total=False):
    """``batch``."""


class Export(Exporting, ConvertedTopics, _Scans, BadMessages, Watched, total=False):
    """``export``."""


class View(ShownClouds, ConvertedTopics, _Scans, SeveralOutputs, Reversal, total=False):
    """``view``."""


class Plot(DrawnClouds, ConvertedTopics, _Scans, SeveralOutputs, total=False):
    """``plot``."""


class Map(MapDrawing, ConvertedTopics, _Scans, SeveralOutputs, BadMessages, Watched, total=False):
    """``map``."""


class Check(Checking, TransformSources, total=False):
    """``check``."""


class Info(Describing, StaticTransforms, TransformSources, SourceFrame, total=False):
    """``info``."""


class Tf(TransformTopics, StaticTransforms, total=False):
    """``tf``."""


class Repair(Repairing, Overwriting, RunReport, Watched, total=False):
    """``repair``."""


class Diff(Comparing, total=False):
    """``diff``."""


class Golden(GoldenCases, total=False):
    """``golden``."""


class Scans(_Scans, BadMessages, total=False):
    """``pc2scan.scans``."""


class Clouds(Reading, BadMessages, total=False):
    """``pc2scan.clouds``."""


#: For each command, the groups that its function takes too, and those that only the command has; then the functions
#: without a command.
GROUPS: Mapping[str, tuple[Any, ...]] = {
    "convert": (Convert, Screen),
    "batch": (Batch, BatchScreen),
    "export": (Export, Json),
    "view": (View, Browsing),
    "plot": (Plot,),
    "map": (Map, MapFiles, Json),
    "check": (Check, JUnit, Json),
    "info": (Info, Json),
    "tf": (Tf, Json),
    "repair": (Repair, RepairScreen),
    "diff": (Diff, JUnit, Json, CompareScreen),
    "golden": (Golden, JUnit, Json, GoldenScreen),
    "scans": (Scans,),
    "clouds": (Clouds,),
}


#: Where the options of a group stand in the help, and where they may stand, unless they say otherwise.
_SECTIONS: Mapping[Any, tuple[str, str]] = {
    Projection: (PARAMS, ONE_OUTPUT),
    ParameterSources: (PARAMS, ONE_OUTPUT),
    SeveralOutputs: (TOPICS, CONVERSION),
    ConvertedTopics: (TOPICS, SINGLE),
    Reading: (TOPICS, CONVERSION),
    BadMessages: (RUN, CONVERSION),
    Points: (POINTS, ONE_OUTPUT),
    Frames: (FRAMES, CONVERSION),
    SourceFrame: (FRAMES, CONVERSION),
    Motion: (MOVING, ONE_OUTPUT),
    ReverseOptions: (REVERSE, SINGLE),
    WrittenTopics: (TOPICS, CONVERSION),
    Demands: (RUN, CONVERSION),
    Container: (OUTPUT, CONVERSION),
    Overwriting: (OUTPUT, CALL_ONLY),
    DryRun: (OUTPUT, CALL_ONLY),
    Scratch: (OUTPUT, CALL_ONLY),
    RunReport: (REPORT, CALL_ONLY),
    Threads: (RUN, CALL_ONLY),
    Watched: (PYTHON, CALL_ONLY),
    Screen: (REPORT, CALL_ONLY),
    BatchExport: (EXPORT, CONVERSION),
    BatchRun: (BATCH, CALL_ONLY),
    BatchScreen: (BATCH, CALL_ONLY),
    BatchWatched: (PYTHON, CALL_ONLY),
    Comparing: (RULES, CALL_ONLY),
    GoldenCases: (NEW_CASE, CALL_ONLY),
}


def _place(option: Option, name: str, panel: str, scope: str) -> None:
    """Give an option its name, and its place if it has none of its own."""
    option.name = name
    option.panel = panel if option.panel is None else option.panel
    option.scope = scope if option.scope is None else option.scope
    if isinstance(option, Parameter):
        option.default = ProjectionParams.__dataclass_fields__[name].default


for _group in (*_SECTIONS, *(group for groups in GROUPS.values() for group in groups)):
    for _name, _annotation in _group.__annotations__.items():
        if not _annotation.__metadata__[0].name:
            _place(_annotation.__metadata__[0], _name, *_SECTIONS.get(_group, ("", CALL_ONLY)))


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


#: What to use instead of options that there are no more.
_GONE = {
    "each": "pc2scan batch converts each recording on its own",
    "explain": "for differences of libm, convert again with the other `angle_rounding`",
}


def instead_of(command: str, name: str) -> str:
    """Return what to use instead of an option that a command does not have; empty if nothing is known."""
    if name in options_of(command):
        return ""
    if name in _GONE:
        return _GONE[name]
    others = [other for other in GROUPS if name in options_of(other) and not options_of(other)[name].command_only]
    if not others:
        return ""
    if "convert" in others and command in {"export", "map", "plot", "scans", "view"}:
        return f"it is for recordings that are written; convert has it, {command} writes none"
    return f"only {', '.join(others[:3])} {'has' if len(others) == 1 else 'have'} it"


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
        if name != "overwrite" and not isinstance(option.value, Object)
    }


def output_options() -> Mapping[str, Option]:
    """Return the options of one output that are no parameters of the projection, as scans files have them."""
    return {
        name: option
        for name, option in options_of("convert").items()
        if option.scope == ONE_OUTPUT and not isinstance(option, Parameter)
    }
