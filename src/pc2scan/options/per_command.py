"""Options that a single command has.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

from collections.abc import Iterable
from typing import Annotated, TypedDict

from pc2scan.core.presets import PRESETS

from .option import (
    Compression,
    File,
    FileFormat,
    Frame,
    How,
    Metres,
    Names,
    Path,
    Progress,
    Scope,
    Section,
    Storage,
    Time,
    Tolerance,
    When,
    group,
)
from .running import MAX_JOBS
from .values import FUNCTION, MOMENTS, SHARE, SWITCH, TOLERANCES, count, path, texts


@group(Section.EXPORT, Scope.CALL_ONLY)
class ExportFormat(TypedDict, total=False):
    """An export."""

    format: Annotated[
        FileFormat | None,
        "For scans: npz (NumPy arrays), csv (one row per scan). "
        "For the trajectory only: tum. For clouds, in a folder: pcd, kitti.",
        How(default_text="by OUT's suffix", short="-f"),
    ]
    overwrite: Annotated[bool, "Replace OUT: a file, or a folder with an export and nothing else."]


@group(Section.EXPORT, Scope.CONVERSION)
class BatchExport(TypedDict, total=False):
    """Results of a batch that are not recordings."""

    format: Annotated[
        FileFormat | None, "Write the files of pc2scan export, in a folder for each recording.", How(short="-f")
    ]


@group(Section.EXPORT, Scope.CONVERSION)
class Poses(TypedDict, total=False):
    """The robot's poses in an export."""

    pose_frame: Annotated[Frame, "Write the robot's pose in this frame, such as odom, at each message's stamp."]
    base_frame: Annotated[
        Frame,
        "The robot's frame, whose pose is written.",
        How(default_text="base_link, base_footprint, or that of the sensor"),
    ]


@group(Section.BATCH, Scope.CALL_ONLY)
class BatchRun(TypedDict, total=False):
    """How a batch runs."""

    dataset: Annotated[File, "A YAML file with options for recordings; options given here override it."]
    jobs: Annotated[
        int,
        count(high=MAX_JOBS),
        "Number of recordings at a time, each in its own process; the output does not depend on it.",
        How(default=0, default_text="number of cores", short="-j"),
    ]
    dask: Annotated[
        bool | str,
        SWITCH,
        "Convert on the Dask cluster of this scheduler, such as tcp://scheduler:8786; without an address (in Python: "
        "True), on a cluster that is started here. Needs pc2scan[dask].",
        How(default=False),
    ]
    again: Annotated[bool, "Convert again what is up to date. Only results that this batch has written are replaced."]
    report: Annotated[File, "Write the summary of all recordings to this file, as JSON."]


@group(Section.BATCH, Scope.CALL_ONLY)
class BatchScreen(TypedDict, total=False):
    """What a batch shows on the screen; an option of the command line only."""

    quiet: Annotated[
        bool, "Show warnings and errors only, no line for each recording.", How(short="-q", command_only=True)
    ]
    verbose: Annotated[bool, "Show every recording in the summary.", How(short="-v", command_only=True)]


@group(Section.PYTHON, Scope.CALL_ONLY)
class BatchRunProgress(TypedDict, total=False):
    """Progress of a batch."""

    progress: Annotated[
        Progress | None,
        FUNCTION,
        "A function that is called with four numbers: bytes done, bytes in all, recordings done, recordings in all.",
        How(typed=""),
    ]


class FirstClouds(TypedDict, total=False):
    """Which clouds a picture shows."""

    at: Annotated[
        Time | Iterable[Time] | None, MOMENTS, "Show the first cloud at or after this time, written like `start`."
    ]


class PageClouds(FirstClouds, total=False):
    """Which clouds a page shows."""

    clouds: Annotated[
        int,
        count(low=1, high=1000),
        "Number of clouds of each topic on the page, up to 1,000, evenly spread over the recording.",
        How(default=10),
    ]


class ShownFiles(TypedDict, total=False):
    """A page or a map on the disk; options of the command line only."""

    overwrite: Annotated[bool, "Replace files of these names.", How(command_only=True)]


class FigureClouds(FirstClouds, total=False):
    """Which clouds a figure shows."""

    clouds: Annotated[
        int,
        count(low=1),
        "Number of clouds of each topic, side by side, spread over the recording.",
        How(default=1, short="--frames"),
    ]
    overwrite: Annotated[bool, "Replace a file of that name."]


class RobotFrames(TypedDict, total=False):
    """The robot's frames."""

    odom_frame: Annotated[Frame, "The odometry's frame, to which scans must be connected.", How(default="odom")]
    base_frame: Annotated[Frame, "The robot's frame.", How(default_text="base_link, or base_footprint")]


class MapDrawing(RobotFrames, total=False):
    """A map."""

    resolution: Annotated[Metres, "Side of a cell: 0.05, or 5cm.", How(default=0.05)]


class CheckRules(RobotFrames, total=False):
    """A check."""

    consumers: Annotated[
        Names | None,
        texts("CONSUMER", words=tuple(PRESETS)),
        f"Consumer that decides the exit status: {', '.join(PRESETS)}. Default: all of them, and defects for all "
        "consumers too.",
        How(typed="--for"),
    ]
    topics: Annotated[
        Names | None,
        texts("TOPIC", offers=("topics", "/LaserScan")),
        "Topic of scans to check, or a glob. Default: all.",
        How(typed="--topic", short="-t"),
    ]


class InfoSamples(TypedDict, total=False):
    """A description of a recording."""

    topics: Annotated[
        Names | None,
        texts("TOPIC", offers=("topics", "/PointCloud2", "/LaserScan")),
        "Topic with clouds or scans to describe, or a glob. Default: all.",
        How(typed="--topic", short="-t"),
    ]
    target_frame: Annotated[Frame, "Show heights in this frame, like convert --target-frame."]


class RepairContainer(TypedDict, total=False):
    """A repair."""

    storage: Annotated[Storage | None, "Storage of a rosbag2 directory.", How(default_text="SRC's")]
    compression: Annotated[Compression | None, "Compression of DST.", How(default_text="SRC's")]


@group(Section.RULES, Scope.CALL_ONLY)
class ComparisonRules(TypedDict, total=False):
    """A comparison."""

    topics: Annotated[
        Names | None,
        texts("A[:=B]", offers=("topics",)),
        "Topic to compare, and its name in B if that differs. Default: every topic with scans or clouds.",
        How(typed="--topic", short="-t", panel=""),
    ]
    all_topics: Annotated[bool, "Compare the other topics too: matched by log time, byte for byte.", How(panel="")]
    atol: Annotated[
        Tolerance | None,
        TOLERANCES,
        "Absolute tolerance of all values, or of ranges, intensities or a field of the clouds.",
        How(default=0.0),
    ]
    rtol: Annotated[
        Tolerance | None,
        TOLERANCES,
        "Tolerance relative to A's value; the two are added.",
        How(default=0.0),
    ]
    allow_beams: Annotated[
        float,
        SHARE,
        "Share of a topic's beams (clouds: points) that may be beyond the tolerance: 0.001 is one in a thousand.",
        How(default=0.0),
    ]
    ignore: Annotated[
        Names | None,
        texts("NAME"),
        "Do not compare: log_time, seq, frame_id, order, intensities, ranges, angle_min and the other numbers of a "
        "scan, shape, layout, padding, is_dense.",
    ]


class CompareScreen(TypedDict, total=False):
    """What a comparison shows on the screen; an option of the command line only."""

    quiet: Annotated[bool, "Print nothing; only set the exit status.", How(short="-q", command_only=True)]


@group(Section.NEW_CASE, Scope.CALL_ONLY)
class GoldenCases(TypedDict, total=False):
    """Golden cases."""

    update: Annotated[bool, "Write the expected output of cases that differ or have none.", How(panel="")]
    init: Annotated[Path | None, path("SRC"), "Make a new case of this recording, in DIR."]
    start: Annotated[When, "With `init`: where the input begins, as in convert."]
    end: Annotated[When, "With `init`: where it ends."]
    topics: Annotated[
        Names | None,
        texts("TOPIC", offers=("topics", "/PointCloud2", "/LaserScan")),
        "With `init`: a topic of clouds or scans to keep, or a glob. Default: all.",
        How(typed="--topic", short="-t"),
    ]
    params_file: Annotated[File, "With `init`: the case's parameter file."]


class GoldenScreen(TypedDict, total=False):
    """What golden cases show on the screen; an option of the command line only."""

    quiet: Annotated[bool, "Do not show cases that passed.", How(short="-q", command_only=True)]
