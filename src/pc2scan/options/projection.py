"""The parameters of the projection, and where they come from.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypedDict

from pc2scan.core.params import CHOICES, ProjectionParams
from pc2scan.core.presets import PRESETS

from .option import (
    File,
    Frame,
    How,
    Metres,
    Names,
    Parameter,
    Path,
    Preset,
    Radians,
    Reduce,
    Scope,
    Seconds,
    SecondsOrAuto,
    Section,
    group,
)
from .values import OBJECT, OUTPUTS, count, text, texts


@group(Section.PARAMS, Scope.ONE_OUTPUT, Parameter)
class NodeParameters(TypedDict, total=False):
    """The parameters of upstream's node, in its order."""

    target_frame: Annotated[Frame, "Frame of the scans, into which clouds are transformed. Empty: their own."]
    transform_tolerance: Annotated[Seconds, "How far a stamp may be outside of the recorded transforms."]
    min_height: Annotated[
        Metres, "Lowest z of the points used, in the target frame, inclusive. The default rejects z <= 0."
    ]
    max_height: Annotated[Metres, "Highest z of the points used, in the target frame, inclusive."]
    angle_min: Annotated[Radians, "Angle at which the scan begins; 0 is straight ahead, positive is to the left."]
    angle_max: Annotated[Radians, "Angle at which the scan ends."]
    angle_increment: Annotated[Radians, "Angle from one beam to the next."]
    scan_time: Annotated[
        SecondsOrAuto,
        "Time between scans, copied into the scan. auto: the median interval of the recorded stamps.",
    ]
    range_min: Annotated[Metres, "Shortest horizontal distance of the points used, inclusive."]
    range_max: Annotated[Metres, "Longest horizontal distance of the points used, inclusive."]
    use_inf: Annotated[bool, "Whether beams without a return read inf; otherwise `range_max` + `inf_epsilon`."]
    inf_epsilon: Annotated[Metres, "Added to `range_max` for beams without a return, if `use_inf` is off."]
    queue_size: Annotated[
        int, count(), "Maximum number of chunks processed at a time; 0: as many as memory allows. Nothing is dropped."
    ]


@group(Section.SLAM, Scope.ONE_OUTPUT, Parameter)
class ScanParameters(TypedDict, total=False):
    """Further parameters of the projection."""

    geometry: Annotated[
        Literal["upstream", "centered", "half-open", "symmetric"],
        "Angles of beam i. upstream: from angle i to angle i + 1; centered: around angle i; half-open, symmetric: "
        "also centered, for gmapping and MRPT.",
    ]
    beams: Annotated[
        int | str,
        count(metavar="N|auto", low=2, words=("auto",)),
        "Number of beams in the sector, instead of `angle_increment`. auto: the lidar's own resolution.",
    ]
    no_return: Annotated[
        Literal["", "inf", "range-max-plus", "range-max-minus", "nan", "zero"],
        "Range of beams without a return. Default: set by `use_inf`.",
    ]
    reduce: Annotated[
        Reduce,
        text(words=CHOICES["reduce"]),
        "What a beam's range is made of: its closest or farthest return, their mean or median, the closest surface, "
        "or with kth=2 the second closest return.",
    ]
    min_points: Annotated[int, count(), "Beams with fewer returns than this count as beams without a return."]
    intensity_field: Annotated[
        str, text("NAME"), "Field of the cloud that becomes the scan's intensities, from the points that give ranges."
    ]
    time_increment: Annotated[
        SecondsOrAuto,
        "Time from beam to beam, such as 48us. auto: by the points' times; the scan's stamp is then the first beam's.",
    ]
    angle_rounding: Annotated[
        Literal["correct", "glibc-2.40"],
        "Which atan2f is reproduced: the correct one of glibc 2.41 and later, or that of 2.31 to 2.40 (Ubuntu 20.04 "
        "to 24.04).",
    ]


class Projection(NodeParameters, ScanParameters, total=False):
    """The parameters of the projection."""


#: The parameters that laserscan_to_pointcloud has, too.
SHARED = frozenset({"target_frame", "transform_tolerance", "queue_size"})


@group(Section.PARAMS, Scope.ONE_OUTPUT)
class ParameterSources(TypedDict, total=False):
    """Where parameters come from, besides their own options."""

    params_file: Annotated[
        File,
        "The file that the robot was run with: a ROS 2 parameter file, a ROS 1 YAML file, or a launch file (XML or "
        "Python, which is read, not executed), whose remappings are used too.",
    ]
    launch_args: Annotated[
        Names | None, texts("NAME:=VALUE"), "An argument of the launch file.", How(typed="--arg", scope=Scope.SINGLE)
    ]
    node: Annotated[str | None, text("NAME"), "The node whose parameters are read, if the file has several."]
    param: Annotated[
        Names | None,
        texts("NAME:=VALUE"),
        "A parameter in ROS's notation. Overrides the file; the parameter's own option overrides it.",
        How(short="-p", scope=Scope.CONVERSION),
    ]
    remap: Annotated[
        Names | None,
        texts("FROM:=TO"),
        "A remapping in ROS's notation: cloud_in:=/points with scan:=/scan is the same as `topics=/points:=/scan`.",
        How(panel=Section.TOPICS, short="-r", scope=Scope.SINGLE),
    ]
    preset: Annotated[
        Preset | None,
        text("CONSUMER", words=tuple(PRESETS)),
        "Parameters for a consumer of the scans: slam_toolbox, cartographer, gmapping, amcl, nav2, mrpt. Parameters "
        "given here or in a file override them.",
        How(panel=Section.SLAM),
    ]
    params: Annotated[
        ProjectionParams | None,
        OBJECT,
        "The parameters of the projection, instead of `preset` and `params_file`.",
        How(panel=Section.PYTHON, typed="", scope=Scope.SINGLE),
    ]


@group(Section.TOPICS, Scope.CONVERSION)
class SeveralOutputs(TypedDict, total=False):
    """Several outputs of one recording."""

    scans: Annotated[
        Path | Mapping[str, Any] | None,
        OUTPUTS,
        "A YAML file with several outputs, each with its own sources, parameters and filters. Parameters of the call "
        "override those of all outputs.",
    ]
