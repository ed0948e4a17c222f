"""Options that a single command has.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

from collections.abc import Iterable
from typing import Annotated, TypedDict

from pc2scan.core.presets import PRESETS

from .option import (
    Compression,
    FileFormat,
    Names,
    Option,
    Path,
    Progress,
    Quantity,
    Storage,
    Time,
    Tolerance,
)
from .running import MAX_JOBS
from .values import (
    Count,
    Function,
    Moment,
    Moments,
    Number,
    PathName,
    Recording,
    Switch,
    Text,
    Texts,
    Tolerances,
)


class ExportFormat(TypedDict, total=False):
    """An export."""

    format: Annotated[
        FileFormat | None,
        Option(
            "For scans: npz (NumPy arrays), csv (one row per scan), carmen (ROBOTLASER1, .log), flaser (FLASER, .clf). "
            "For the trajectory only: tum. For clouds, in a folder: pcd, kitti.",
            default_text="by OUT's suffix",
            short="-f",
        ),
    ]
    overwrite: Annotated[bool, Option("Replace OUT: a file, or a folder with an export and nothing else.")]


class BatchExport(TypedDict, total=False):
    """Results of a batch that are not recordings."""

    format: Annotated[
        FileFormat | None,
        Option(
            "Write the files of pc2scan export instead of recordings, in a folder for each recording.",
            short="-f",
        ),
    ]


class Poses(TypedDict, total=False):
    """The robot's poses in an export."""

    pose_frame: Annotated[
        str,
        Option(
            "Write the robot's pose in this frame (odom, map) at each message's stamp, from the recorded transforms.",
            Text("FRAME"),
        ),
    ]
    base_frame: Annotated[
        str,
        Option(
            "The robot's frame, whose pose is written.",
            Text("FRAME"),
            default_text="base_link, base_footprint, or the frame that the sensor is mounted on",
        ),
    ]


class BatchRun(TypedDict, total=False):
    """How a batch runs."""

    dataset: Annotated[
        Path | None,
        Option(
            "A YAML file with options for the recordings that match a pattern. Options given here override it.",
            PathName(),
        ),
    ]
    jobs: Annotated[
        int,
        Option(
            f"Number of recordings at a time, up to {MAX_JOBS:,}, each in its own process; the output does not depend "
            "on it.",
            Count(0, MAX_JOBS),
            default=0,
            default_text="number of cores, as memory allows",
            short="-j",
        ),
    ]
    dask: Annotated[
        bool | str,
        Option(
            "Convert on the Dask cluster of this scheduler, such as tcp://scheduler:8786. Without an address (in "
            "Python: True), a cluster is started on this machine. Needs pc2scan[dask].",
            Switch("[ADDRESS]"),
            default=False,
        ),
    ]
    again: Annotated[
        bool, Option("Convert again what is up to date. Only results that this batch has written are replaced.")
    ]
    report: Annotated[Path | None, Option("Write the summary of all recordings to this file, as JSON.", PathName())]


class BatchScreen(TypedDict, total=False):
    """What a batch shows on the screen; only the command has it."""

    quiet: Annotated[bool, Option("Show warnings and errors only.", short="-q", command_only=True)]
    verbose: Annotated[
        bool,
        Option(
            "Show the tables of each conversion, and every recording in the summary.", short="-v", command_only=True
        ),
    ]


class BatchRunProgress(TypedDict, total=False):
    """Progress of a batch."""

    progress: Annotated[
        Progress | None,
        Option(
            "A function that is called from time to time with a tuple: bytes_done, bytes_total, recordings_done, "
            "recordings_total.",
            Function(),
            typed="",
        ),
    ]


class FirstClouds(TypedDict, total=False):
    """Which clouds a picture shows."""

    at: Annotated[
        Time | Iterable[Time] | None,
        Option("Show the first cloud at or after this time, written like `start`.", Moments("TIME")),
    ]


class PageClouds(FirstClouds, total=False):
    """Which clouds a page shows."""

    clouds: Annotated[
        int,
        Option(
            "Number of clouds of each topic on the page, up to 1,000, evenly spread over the recording.",
            Count(1, 1000),
            default=10,
        ),
    ]


class ShownFiles(TypedDict, total=False):
    """A page or a map on the disk; only the command has it."""

    overwrite: Annotated[
        bool, Option("Replace files of these names; an older page is always replaced.", command_only=True)
    ]


class FigureClouds(FirstClouds, total=False):
    """Which clouds a figure shows."""

    clouds: Annotated[
        int,
        Option(
            "Number of clouds of each topic, side by side, spread over the recording.",
            Count(1),
            default=1,
            short="--frames",
        ),
    ]
    overwrite: Annotated[bool, Option("Replace a file of that name.")]


class RobotFrames(TypedDict, total=False):
    """The robot's frames."""

    odom_frame: Annotated[
        str,
        Option("The odometry's frame, to which scans must be connected.", Text("FRAME"), default="odom"),
    ]
    base_frame: Annotated[str, Option("The robot's frame.", Text("FRAME"), default_text="base_link, or base_footprint")]


class MapDrawing(RobotFrames, total=False):
    """A map."""

    resolution: Annotated[Quantity, Option("Side of a cell: 0.05, or 5cm.", Number("m"), default=0.05)]


class CheckRules(RobotFrames, total=False):
    """A check."""

    consumers: Annotated[
        Names | None,
        Option(
            f"Consumer that decides the exit status: {', '.join(PRESETS)}. Default: all of them, and defects for all "
            "consumers too.",
            Texts("CONSUMER", words=PRESETS),
            typed="--for",
        ),
    ]
    topics: Annotated[
        Names | None,
        Option(
            "Topic of scans to check, or a glob. Default: all.",
            Texts("TOPIC"),
            typed="--topic",
            short="-t",
            offers=("topics", "/LaserScan"),
        ),
    ]


class InfoSamples(TypedDict, total=False):
    """A description of a recording."""

    topics: Annotated[
        Names | None,
        Option(
            "Topic with clouds or scans to describe, or a glob. Default: all.",
            Texts("TOPIC"),
            typed="--topic",
            short="-t",
            offers=("topics", "/PointCloud2", "/LaserScan"),
        ),
    ]
    target_frame: Annotated[str, Option("Show heights in this frame, like convert --target-frame.", Text("FRAME"))]


class RepairContainer(TypedDict, total=False):
    """A repair."""

    storage: Annotated[Storage | None, Option("Storage of a rosbag2 directory.", default_text="SRC's")]
    compression: Annotated[Compression | None, Option("Compression of DST.", default_text="SRC's")]


class RepairScreen(TypedDict, total=False):
    """What a repair shows on the screen; only the command has it."""

    as_json: Annotated[bool, Option("Print the report as JSON.", typed="--json", command_only=True)]
    quiet: Annotated[bool, Option("Show damage, warnings and errors only.", short="-q", command_only=True)]


class ComparisonRules(TypedDict, total=False):
    """A comparison."""

    topics: Annotated[
        Names | None,
        Option(
            "Topic to compare, and its name in B if that differs. Default: every topic with scans or clouds.",
            Texts("A[:=B]"),
            typed="--topic",
            short="-t",
            panel="",
            offers=("topics",),
        ),
    ]
    all_topics: Annotated[bool, Option("Compare the other topics too: matched by log time, byte for byte.", panel="")]
    atol: Annotated[
        Tolerance | None,
        Option(
            "Absolute tolerance of all values, or of ranges, intensities or a field of the clouds.",
            Tolerances("[NAME=]X"),
            default=0.0,
        ),
    ]
    rtol: Annotated[
        Tolerance | None,
        Option("Tolerance relative to A's value; the two are added.", Tolerances("[NAME=]X"), default=0.0),
    ]
    allow_beams: Annotated[
        float,
        Option(
            "Share of a topic's beams (clouds: points) that may be beyond the tolerance: 0.001 is one in a thousand.",
            Number(metavar="SHARE"),
            default=0.0,
        ),
    ]
    ignore: Annotated[
        Names | None,
        Option(
            "Do not compare: log_time, seq, frame_id, order, intensities, ranges, angle_min and the other numbers of a "
            "scan, shape, layout, padding, is_dense.",
            Texts("NAME"),
        ),
    ]


class CompareScreen(TypedDict, total=False):
    """What a comparison shows on the screen; only the command has it."""

    quiet: Annotated[bool, Option("Print nothing; only set the exit status.", short="-q", command_only=True)]


class GoldenCases(TypedDict, total=False):
    """Golden cases."""

    update: Annotated[
        bool, Option("Write the expected output of cases that differ or have none; review the changes.", panel="")
    ]
    init: Annotated[Path | None, Option("Make a new case of this recording, in DIR.", Recording("SRC"))]
    start: Annotated[Time | None, Option("With `init`: where the input begins, as in convert.", Moment("TIME"))]
    end: Annotated[Time | None, Option("With `init`: where it ends.", Moment("TIME"))]
    topics: Annotated[
        Names | None,
        Option(
            "With `init`: a topic of clouds or scans to keep, or a glob. Default: all.",
            Texts("TOPIC"),
            typed="--topic",
            short="-t",
            offers=("topics", "/PointCloud2", "/LaserScan"),
        ),
    ]
    params_file: Annotated[Path | None, Option("With `init`: the case's parameter file.", PathName())]


class GoldenScreen(TypedDict, total=False):
    """What golden cases show on the screen; only the command has it."""

    quiet: Annotated[bool, Option("Do not show cases that passed.", short="-q", command_only=True)]
