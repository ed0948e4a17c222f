"""Options that a single command has.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

from collections.abc import Iterable
from typing import Annotated, TypedDict, get_args

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
    Flag,
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
            Text(words=get_args(FileFormat)),
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
            offers=("frames",),
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
            offers=("frames",),
        ),
    ]
    overwrite: Annotated[
        bool, Option(Flag(), "Replace OUT: a file, or a folder with an export and nothing else.", common=True)
    ]


class BatchExport(TypedDict, total=False):
    """Results of a batch that are not recordings."""

    format: Annotated[
        FileFormat | None,
        Option(
            Text(words=get_args(FileFormat)),
            "Write the files of pc2scan export instead of recordings, in a folder for each recording.",
            short="-f",
        ),
    ]
    pose_frame: Annotated[
        str,
        Option(Text("FRAME"), "With `format`: the robot's pose in this frame (odom, map) at each stamp.", default=""),
    ]
    base_frame: Annotated[
        str, Option(Text("FRAME"), "With `format`: the robot's frame, whose pose is written.", default="")
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
    again: Annotated[
        bool,
        Option(
            Flag(),
            "Convert again what is up to date. Only results that this batch has written are replaced.",
            common=True,
        ),
    ]
    report: Annotated[
        Path | None, Option(PathName(), "Write the summary of all recordings to this file, as JSON.", common=True)
    ]


class BatchScreen(TypedDict, total=False):
    """What a batch shows on the screen; only the command has it."""

    quiet: Annotated[bool, Option(Flag(), "Show warnings and errors only.", short="-q", command_only=True)]
    verbose: Annotated[
        bool,
        Option(
            Flag(),
            "Show the tables of each conversion, and every recording in the summary.",
            short="-v",
            command_only=True,
        ),
    ]


class BatchRunProgress(TypedDict, total=False):
    """Progress of a batch."""

    progress: Annotated[
        Progress | None,
        Option(
            Function(),
            "A function that is called from time to time with a tuple: bytes_done, bytes_total, recordings_done, "
            "recordings_total.",
            typed="",
        ),
    ]


class PageClouds(TypedDict, total=False):
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


class PageOutput(TypedDict, total=False):
    """The page on the disk; only the command has it."""

    overwrite: Annotated[
        bool,
        Option(
            Flag(), "Replace any file of that name; an older page is always replaced.", common=True, command_only=True
        ),
    ]


class FigureClouds(TypedDict, total=False):
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
    overwrite: Annotated[bool, Option(Flag(), "Replace a file of that name.", common=True)]


class MapDrawing(TypedDict, total=False):
    """A map."""

    resolution: Annotated[Quantity, Option(Number("m"), "Side of a cell: 0.05, or 5cm.", default=0.05, common=True)]
    odom_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "The frame of the map, in which the robot moves.",
            default="odom",
            common=True,
            offers=("frames",),
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
            offers=("frames",),
        ),
    ]


class MapFiles(TypedDict, total=False):
    """A map on the disk; only the command has it."""

    overwrite: Annotated[bool, Option(Flag(), "Replace files of these names.", common=True, command_only=True)]


class CheckRules(TypedDict, total=False):
    """A check."""

    consumers: Annotated[
        Names | None,
        Option(
            Texts("CONSUMER", words=PRESETS),
            f"Consumer that decides the exit status: {', '.join(PRESETS)}. Default: all of them, and defects for all "
            "consumers too.",
            typed="--for",
        ),
    ]
    topics: Annotated[
        Names | None,
        Option(
            Texts("TOPIC"),
            "Topic of scans to check, or a glob. Default: all.",
            typed="--topic",
            short="-t",
            offers=("topics", "/LaserScan"),
        ),
    ]
    odom_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "The odometry's frame; the scans' frames must be connected to it.",
            default="odom",
            offers=("frames",),
        ),
    ]
    base_frame: Annotated[
        str,
        Option(
            Text("FRAME"),
            "The robot's frame.",
            default="",
            default_text="base_link, or base_footprint",
            offers=("frames",),
        ),
    ]


class InfoSamples(TypedDict, total=False):
    """A description of a recording."""

    topics: Annotated[
        Names | None,
        Option(
            Texts("TOPIC"),
            "Topic with clouds or scans to describe, or a glob. Default: all.",
            typed="--topic",
            short="-t",
            offers=("topics", "/PointCloud2", "/LaserScan"),
        ),
    ]
    target_frame: Annotated[
        str,
        Option(
            Text("FRAME"), "Show heights in this frame, like convert --target-frame.", default="", offers=("frames",)
        ),
    ]


class RepairContainer(TypedDict, total=False):
    """A repair."""

    storage: Annotated[
        Storage | None, Option(Text(words=get_args(Storage)), "Storage of a rosbag2 directory.", default_text="SRC's")
    ]
    compression: Annotated[
        Compression | None, Option(Text(words=get_args(Compression)), "Compression of DST.", default_text="SRC's")
    ]


class RepairScreen(TypedDict, total=False):
    """What a repair shows on the screen; only the command has it."""

    as_json: Annotated[bool, Option(Flag(), "Print the report as JSON.", typed="--json", command_only=True)]
    quiet: Annotated[bool, Option(Flag(), "Show damage, warnings and errors only.", short="-q", command_only=True)]


class ComparisonRules(TypedDict, total=False):
    """A comparison."""

    topics: Annotated[
        Names | None,
        Option(
            Texts("A[:=B]"),
            "Topic to compare, and its name in B if that differs. Default: every topic with scans or clouds.",
            typed="--topic",
            short="-t",
            panel="",
            offers=("topics",),
        ),
    ]
    all_topics: Annotated[
        bool, Option(Flag(), "Compare the other topics too: matched by log time, byte for byte.", panel="")
    ]
    atol: Annotated[
        Tolerance | None,
        Option(
            Tolerances("[NAME=]X"),
            "Absolute tolerance of all values, or of ranges, intensities or a field of the clouds.",
            default=0.0,
        ),
    ]
    rtol: Annotated[
        Tolerance | None,
        Option(Tolerances("[NAME=]X"), "Tolerance relative to A's value; the two are added.", default=0.0),
    ]
    allow_beams: Annotated[
        float,
        Option(
            Number(metavar="SHARE"),
            "Share of a topic's beams (clouds: points) that may be beyond the tolerance: 0.001 is one in a thousand.",
            default=0.0,
        ),
    ]
    ignore: Annotated[
        Names | None,
        Option(
            Texts("NAME"),
            "Do not compare: log_time, seq, frame_id, order, intensities, ranges, angle_min and the other numbers of a "
            "scan, shape, layout, padding, is_dense.",
        ),
    ]


class CompareScreen(TypedDict, total=False):
    """What a comparison shows on the screen; only the command has it."""

    quiet: Annotated[bool, Option(Flag(), "Print nothing; only set the exit status.", short="-q", command_only=True)]


class GoldenCases(TypedDict, total=False):
    """Golden cases."""

    update: Annotated[
        bool,
        Option(Flag(), "Write the expected output of cases that differ or have none; review the changes.", panel=""),
    ]
    init: Annotated[Path | None, Option(Recording("SRC"), "Make a new case of this recording, in DIR.")]
    start: Annotated[Time | None, Option(Moment("TIME"), "With `init`: where the input begins, as in convert.")]
    end: Annotated[Time | None, Option(Moment("TIME"), "With `init`: where it ends.")]
    topics: Annotated[
        Names | None,
        Option(
            Texts("TOPIC"),
            "With `init`: a topic of clouds or scans to keep, or a glob. Default: all.",
            typed="--topic",
            short="-t",
            offers=("topics", "/PointCloud2", "/LaserScan"),
        ),
    ]
    params_file: Annotated[Path | None, Option(PathName(), "With `init`: the case's parameter file.")]


class GoldenScreen(TypedDict, total=False):
    """What golden cases show on the screen; only the command has it."""

    quiet: Annotated[bool, Option(Flag(), "Do not show cases that passed.", short="-q", command_only=True)]
