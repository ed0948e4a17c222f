"""What is written, and how a command runs: the destination, reports, threads, the screen.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

from typing import Annotated, Literal, TypedDict

from .option import Compression, File, How, Path, Progress, Scope, Section, Storage, group
from .values import FUNCTION, count, path

#: The largest number of threads, or of processes of a batch. More than any machine has cores would only take memory.
MAX_JOBS = 1024


@group(Section.OUTPUT, Scope.CONVERSION)
class Container(TypedDict, total=False):
    """The format of the recording that is written."""

    to: Annotated[
        Literal["bag", "mcap", "rosbag2"] | None,
        "Format of DST, if its name does not say it.",
        How(default_text="SRC's"),
    ]
    storage: Annotated[Storage | None, "Storage of a rosbag2 directory.", How(default_text="mcap")]
    compression: Annotated[
        Compression | None,
        "Bags: lz4 (default), none, bz2. MCAP: zstd (default), none, lz4. sqlite3: none (default), zstd. Chunks that "
        "are copied whole keep theirs by default.",
    ]
    profile: Annotated[
        Literal["ros1", "ros2"] | None, "ROS version of an .mcap file.", How(default_text="the source's")
    ]
    dry_run: Annotated[
        bool, "Write nothing; show what would be read and written.", How(short="-n", scope=Scope.CALL_ONLY)
    ]
    scratch: Annotated[
        Path | None,
        path("DIR"),
        "Folder for local copies of files at URLs.",
        How(default_text="the system's folder for temporary files", scope=Scope.CALL_ONLY),
    ]


@group(Section.OUTPUT, Scope.CALL_ONLY)
class Replacement(TypedDict, total=False):
    """Whether a recording is replaced."""

    overwrite: Annotated[bool, "Replace DST, and the file of `report`, if they exist."]


@group(Section.REPORT, Scope.CALL_ONLY)
class RunReport(TypedDict, total=False):
    """The report of a run."""

    report: Annotated[File, "Write a report as JSON. An older report is replaced, any other file is not."]


@group(Section.RUN, Scope.CALL_ONLY)
class ThreadCount(TypedDict, total=False):
    """Threads of a run."""

    jobs: Annotated[
        int,
        count(high=MAX_JOBS),
        f"Number of threads, up to {MAX_JOBS:,}; the output does not depend on it.",
        How(default=0, default_text="number of cores", short="-j"),
    ]


@group(Section.PYTHON, Scope.CALL_ONLY)
class RunProgress(TypedDict, total=False):
    """Progress of a run."""

    progress: Annotated[
        Progress | None,
        FUNCTION,
        "A function that is called from time to time with bytes read, bytes in total, and messages read (0 while "
        "transforms are read ahead).",
        How(typed=""),
    ]


@group(Section.REPORT, Scope.CALL_ONLY)
class Quiet(TypedDict, total=False):
    """What a command does not show on the screen; only commands have it."""

    quiet: Annotated[bool, "Show warnings and errors only.", How(short="-q", command_only=True)]


@group(Section.REPORT, Scope.CALL_ONLY)
class ScreenOutput(Quiet, total=False):
    """What a run shows on the screen; only commands have it."""

    verbose: Annotated[bool, "Show every parameter and where its value comes from.", How(short="-v", command_only=True)]


class JsonOutput(TypedDict, total=False):
    """Results as JSON; only commands have it."""

    as_json: Annotated[bool, "Print JSON.", How(typed="--json", command_only=True)]
