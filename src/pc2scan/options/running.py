"""What is written, and how a command runs: the destination, reports, threads, the screen.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

from typing import Annotated, Literal, TypedDict

from .option import Compression, Option, Path, Progress, Storage
from .values import Count, Function, OpenText, PathName

#: The largest number of threads, or of processes of a batch. More than any machine has cores would only take memory.
MAX_JOBS = 1024


class Container(TypedDict, total=False):
    """The format of the recording that is written."""

    to: Annotated[
        Literal["bag", "mcap", "rosbag2"] | None,
        Option(
            "Format of DST, if its name does not say it.",
            OpenText(words=("bag", "mcap", "rosbag2")),
            default_text="SRC's",
        ),
    ]
    storage: Annotated[Storage | None, Option("Storage of a rosbag2 directory.", default_text="mcap")]
    compression: Annotated[
        Compression | None,
        Option(
            "Bags: lz4 (default), none, bz2. MCAP: zstd (default), none, lz4. sqlite3: none (default), zstd. Without "
            "this option, chunks that are copied whole keep their compression.",
        ),
    ]
    profile: Annotated[
        Literal["ros1", "ros2"] | None,
        Option("ROS version of an .mcap file.", default_text="the source's"),
    ]


class Replacement(TypedDict, total=False):
    """Whether a recording is replaced."""

    overwrite: Annotated[bool, Option("Replace DST, and the file of `report`, if they exist.")]


class DryRun(TypedDict, total=False):
    """Whether anything is written."""

    dry_run: Annotated[bool, Option("Write nothing; show what would be read and written.", short="-n")]


class Scratch(TypedDict, total=False):
    """Local copies of files at URLs."""

    scratch: Annotated[
        Path | None,
        Option(
            "Folder for local copies of files at URLs.",
            PathName("DIR"),
            default_text="the system's folder for temporary files",
        ),
    ]


class RunReport(TypedDict, total=False):
    """The report of a run."""

    report: Annotated[
        Path | None, Option("Write a report as JSON. An older report is replaced, any other file is not.", PathName())
    ]


class ThreadCount(TypedDict, total=False):
    """Threads of a run."""

    jobs: Annotated[
        int,
        Option(
            f"Number of threads, up to {MAX_JOBS:,}; the output does not depend on it.",
            Count(0, MAX_JOBS),
            default=0,
            default_text="number of cores",
            short="-j",
        ),
    ]


class RunProgress(TypedDict, total=False):
    """Progress of a run."""

    progress: Annotated[
        Progress | None,
        Option(
            "A function that is called from time to time with bytes read, bytes in total, and messages read "
            "(0 while transforms are read ahead).",
            Function(),
            typed="",
        ),
    ]


class ScreenOutput(TypedDict, total=False):
    """What a run shows on the screen; only commands have it."""

    quiet: Annotated[bool, Option("Show warnings and errors only.", short="-q", command_only=True)]
    verbose: Annotated[
        bool, Option("Show every parameter and where its value comes from.", short="-v", command_only=True)
    ]


class JsonOutput(TypedDict, total=False):
    """Results as JSON; only commands have it."""

    as_json: Annotated[bool, Option("Print JSON.", typed="--json", command_only=True)]
