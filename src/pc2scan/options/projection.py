"""The parameters of the projection, and where they come from.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypedDict

from pc2scan.core.params import CHOICES, ProjectionParams

from .option import (
    CONVERSION,
    PYTHON,
    SINGLE,
    SLAM,
    TOPICS,
    Names,
    Option,
    Parameter,
    Path,
    Preset,
    Quantity,
    Reduce,
)
from .values import Count, Instance, Number, Outputs, PathName, Reduction, Text, Texts


class Projection(TypedDict, total=False):
    """The parameters of the projection: upstream's in upstream's order, then pc2scan's own."""

    target_frame: Annotated[
        str,
        Parameter(
            "Frame that the clouds are transformed into; the scans are in this frame. Empty: the cloud's own frame.",
            Text("FRAME"),
        ),
    ]
    transform_tolerance: Annotated[
        Quantity,
        Parameter("How far a stamp may be before the first or after the last recorded transform.", Number("s")),
    ]
    min_height: Annotated[
        Quantity,
        Parameter(
            "Lowest z of the points used, in the target frame, inclusive. The default, the smallest positive number, "
            "rejects z <= 0.",
            Number("m"),
        ),
    ]
    max_height: Annotated[
        Quantity, Parameter("Highest z of the points used, in the target frame, inclusive.", Number("m"))
    ]
    angle_min: Annotated[
        Quantity,
        Parameter("Angle at which the scan begins; 0 is straight ahead, positive is to the left.", Number("rad")),
    ]
    angle_max: Annotated[Quantity, Parameter("Angle at which the scan ends.", Number("rad"))]
    angle_increment: Annotated[Quantity, Parameter("Angle from one beam to the next.", Number("rad"))]
    scan_time: Annotated[
        Quantity,
        Parameter(
            "Time between scans, copied into the scan. auto: the median interval of the recorded stamps.",
            Number("s", words=("auto",)),
        ),
    ]
    range_min: Annotated[
        Quantity, Parameter("Shortest horizontal distance of the points used, inclusive.", Number("m"))
    ]
    range_max: Annotated[Quantity, Parameter("Longest horizontal distance of the points used, inclusive.", Number("m"))]
    use_inf: Annotated[
        bool,
        Parameter("Whether beams without a return have the range inf; otherwise it is `range_max` + `inf_epsilon`."),
    ]
    inf_epsilon: Annotated[
        Quantity, Parameter("Added to `range_max` for beams without a return, if `use_inf` is off.", Number("m"))
    ]
    queue_size: Annotated[
        int,
        Parameter(
            "Maximum number of chunks of messages processed at a time; 0: as many as memory allows. Nothing is "
            "dropped.",
            Count(),
        ),
    ]
    geometry: Annotated[
        Literal["upstream", "centered", "half-open", "symmetric"],
        Parameter(
            "Angles of beam i. upstream: from angle i to angle i + 1; centered: around angle i; half-open, symmetric: "
            "also centered, for gmapping and MRPT.",
            panel=SLAM,
        ),
    ]
    beams: Annotated[
        int | str,
        Parameter(
            "Number of beams in the sector, instead of `angle_increment`. auto: the lidar's own resolution.",
            Count(2, words=("auto",)),
            panel=SLAM,
        ),
    ]
    no_return: Annotated[
        Literal["", "inf", "range-max-plus", "range-max-minus", "nan", "zero"],
        Parameter("Range of beams without a return. Default: set by `use_inf`.", panel=SLAM),
    ]
    reduce: Annotated[
        Reduce,
        Parameter(
            "What a beam's range is made of: its closest or farthest return, their mean or median, the closest "
            "surface, or with kth=2 the second closest return.",
            Reduction(words=CHOICES["reduce"]),
            panel=SLAM,
        ),
    ]
    min_points: Annotated[
        int, Parameter("Beams with fewer returns than this count as beams without a return.", Count(), panel=SLAM)
    ]
    intensity_field: Annotated[
        str,
        Parameter(
            "Field of the cloud that becomes the scan's intensities, from the points that give the ranges.",
            Text("NAME"),
            panel=SLAM,
        ),
    ]
    time_increment: Annotated[
        Quantity,
        Parameter(
            "Time from beam to beam, such as 48us. auto: by the points' times; the scan's stamp is then the first "
            "beam's.",
            Number("s", words=("auto",)),
            panel=SLAM,
        ),
    ]
    angle_rounding: Annotated[
        Literal["correct", "glibc-2.40"],
        Parameter(
            "Which atan2f is reproduced: the correct one of glibc 2.41 and later, or that of 2.31 to 2.40 "
            "(Ubuntu 20.04 to 24.04).",
            panel=SLAM,
        ),
    ]


class ParameterSources(TypedDict, total=False):
    """Where parameters come from, besides their own options."""

    params_file: Annotated[
        Path | None,
        Option(
            "The file that the robot was run with: a ROS 2 parameter file, a ROS 1 YAML file, or a launch file (XML or "
            "Python, which is read, not executed), whose remappings are used too.",
            PathName(),
        ),
    ]
    launch_args: Annotated[
        Names | None, Option("An argument of the launch file.", Texts("NAME:=VALUE"), typed="--arg", scope=SINGLE)
    ]
    node: Annotated[
        str | None,
        Option(
            "The node whose parameters are read, if the parameter file or launch file has several nodes.", Text("NAME")
        ),
    ]
    param: Annotated[
        Names | None,
        Option(
            "A parameter in ROS's notation. Overrides the file; the parameter's own option overrides it.",
            Texts("NAME:=VALUE"),
            short="-p",
            scope=CONVERSION,
        ),
    ]
    remap: Annotated[
        Names | None,
        Option(
            "A remapping in ROS's notation: cloud_in:=/points with scan:=/scan is the same as `topics=/points:=/scan`.",
            Texts("FROM:=TO"),
            panel=TOPICS,
            short="-r",
            scope=SINGLE,
        ),
    ]
    preset: Annotated[
        Preset | None,
        Option(
            "Parameters for a consumer of the scans: slam_toolbox, cartographer, gmapping, amcl, nav2, mrpt. "
            "Parameters given here or in a file override them.",
            Text("CONSUMER"),
            panel=SLAM,
            offers=("presets",),
        ),
    ]
    params: Annotated[
        ProjectionParams | None,
        Option(
            "The parameters of the projection, instead of `preset` and `params_file`.",
            Instance(),
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
            "A YAML file with several outputs, each with its own sources, parameters and filters. Parameters of the "
            "call override those of all outputs.",
            Outputs(),
        ),
    ]
