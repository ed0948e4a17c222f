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
from .values import Count, Flag, Instance, Number, Outputs, PathName, Reduction, Text, Texts


class Projection(TypedDict, total=False):
    """The parameters of the projection: upstream's in upstream's order, then pc2scan's own."""

    target_frame: Annotated[
        str,
        Parameter(
            Text("FRAME"),
            "Frame that the clouds are transformed into; the scans are in this frame. Empty: the cloud's own frame.",
            common=True,
            offers=("frames",),
        ),
    ]
    transform_tolerance: Annotated[
        Quantity,
        Parameter(Number("s"), "How far a stamp may be before the first or after the last recorded transform."),
    ]
    min_height: Annotated[
        Quantity,
        Parameter(
            Number("m"),
            "Lowest z of the points used, in the target frame, inclusive. The default, the smallest positive number, "
            "rejects z <= 0.",
            common=True,
        ),
    ]
    max_height: Annotated[
        Quantity, Parameter(Number("m"), "Highest z of the points used, in the target frame, inclusive.", common=True)
    ]
    angle_min: Annotated[
        Quantity,
        Parameter(
            Number("rad"), "Angle at which the scan begins; 0 is straight ahead, positive is to the left.", common=True
        ),
    ]
    angle_max: Annotated[Quantity, Parameter(Number("rad"), "Angle at which the scan ends.", common=True)]
    angle_increment: Annotated[Quantity, Parameter(Number("rad"), "Angle from one beam to the next.")]
    scan_time: Annotated[
        Quantity,
        Parameter(
            Number("s", words=("auto",)),
            "Time between scans, copied into the scan. auto: the median interval of the recorded stamps.",
        ),
    ]
    range_min: Annotated[
        Quantity, Parameter(Number("m"), "Shortest horizontal distance of the points used, inclusive.", common=True)
    ]
    range_max: Annotated[
        Quantity, Parameter(Number("m"), "Longest horizontal distance of the points used, inclusive.", common=True)
    ]
    use_inf: Annotated[
        bool,
        Parameter(
            Flag(), "Whether beams without a return have the range inf; otherwise it is `range_max` + `inf_epsilon`."
        ),
    ]
    inf_epsilon: Annotated[
        Quantity, Parameter(Number("m"), "Added to `range_max` for beams without a return, if `use_inf` is off.")
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
        Literal["upstream", "centered", "half-open", "symmetric"],
        Parameter(
            Text(words=CHOICES["geometry"]),
            "Angles of beam i. upstream: from angle i to angle i + 1; centered: around angle i; half-open, symmetric: "
            "also centered, for gmapping and MRPT.",
            panel=SLAM,
        ),
    ]
    beams: Annotated[
        int | str,
        Parameter(
            Count(2, words=("auto",)),
            "Number of beams in the sector, instead of `angle_increment`. auto: the lidar's own resolution.",
            panel=SLAM,
        ),
    ]
    no_return: Annotated[
        Literal["", "inf", "range-max-plus", "range-max-minus", "nan", "zero"],
        Parameter(
            Text(words=CHOICES["no_return"]),
            "Range of beams without a return. Default: set by `use_inf`.",
            panel=SLAM,
        ),
    ]
    reduce: Annotated[
        Reduce,
        Parameter(
            Reduction(words=CHOICES["reduce"]),
            "What a beam's range is made of: its closest or farthest return, their mean or median, the closest "
            "surface, or with kth=2 the second closest return.",
            panel=SLAM,
            common=True,
        ),
    ]
    min_points: Annotated[
        int, Parameter(Count(), "Beams with fewer returns than this count as beams without a return.", panel=SLAM)
    ]
    intensity_field: Annotated[
        str,
        Parameter(
            Text("NAME"),
            "Field of the cloud that becomes the scan's intensities, from the points that give the ranges.",
            panel=SLAM,
        ),
    ]
    time_increment: Annotated[
        Quantity,
        Parameter(
            Number("s", words=("auto",)),
            "Time from beam to beam, such as 48us. auto: by the points' times; the scan's stamp is then the first "
            "beam's.",
            panel=SLAM,
        ),
    ]
    angle_rounding: Annotated[
        Literal["correct", "glibc-2.40"],
        Parameter(
            Text(words=CHOICES["angle_rounding"]),
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
            PathName(),
            "The file that the robot was run with: a ROS 2 parameter file, a ROS 1 YAML file, or a launch file (XML or "
            "Python, which is read, not executed), whose remappings are used too.",
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
    preset: Annotated[
        Preset | None,
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
            Instance(),
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
            "A YAML file with several outputs, each with its own sources, parameters and filters. Parameters of the "
            "call override those of all outputs.",
        ),
    ]
