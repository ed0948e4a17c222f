"""Options about what is written: the destination, local copies of files at URLs, and the report.

No ``from __future__ import annotations`` here: see `pc2scan.cli.groups.Group`.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from pc2scan.cli.groups import Group, PathType

from . import OUTPUT, REPORT

if TYPE_CHECKING:
    from pc2scan.pipeline.run import OutputOptions

__all__ = ["Compression", "Destination", "OutputGroup", "ReportGroup", "ScratchGroup", "Storage", "To"]

Storage = Literal["mcap", "sqlite3"]
To = Literal["bag", "mcap", "rosbag2"]
Compression = Literal["none", "lz4", "zstd", "bz2"]

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
        click_type=PathType(path_type=str),
    ),
]


class ScratchGroup(Group):
    """Options about local copies of files at URLs."""

    scratch: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for local copies of files at URLs.  [default: the system's folder for temporary files]",
            show_default=False,
            rich_help_panel=OUTPUT,
        ),
    ] = None
    scratch_size: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="Maximum size of the local copies (20GB).  [default: the free space]",
            show_default=False,
            rich_help_panel=OUTPUT,
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
            rich_help_panel=OUTPUT,
        ),
    ] = False
    each: Annotated[
        bool,
        typer.Option(
            "--each",
            help="Convert each SRC, and each recording in a folder, on its own.",
            rich_help_panel=OUTPUT,
        ),
    ] = False
    to: Annotated[
        To | None,
        typer.Option(
            help="Format of DST, if -o does not name a file.  [default: SRC's]",
            show_default=False,
            rich_help_panel=OUTPUT,
        ),
    ] = None
    storage: Annotated[
        Storage | None,
        typer.Option(help="Storage of a rosbag2 directory.  [default: mcap]", rich_help_panel=OUTPUT),
    ] = None
    compression: Annotated[
        Compression | None,
        typer.Option(
            help="Bags: lz4 (default), none, bz2. MCAP: zstd (default), none, lz4. sqlite3: none (default), zstd. "
            "Without this option, chunks that are copied whole keep their compression.",
            show_default=False,
            rich_help_panel=OUTPUT,
        ),
    ] = None
    profile: Annotated[
        Literal["ros1", "ros2"] | None,
        typer.Option(help="ROS version of an .mcap file.  [default: the source's]", rich_help_panel=OUTPUT),
    ] = None
    metadata_version: Annotated[
        int,
        typer.Option(
            min=8,
            max=9,
            metavar="8|9",
            help="Version of a rosbag2 directory's metadata.yaml; older readers do not accept 9.",
            rich_help_panel=OUTPUT,
        ),
    ] = 8
    ros_distro: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="ROS distribution whose message definitions are written if the recording has none.  "
            "[default: noetic, jazzy]",
            show_default=False,
            rich_help_panel=OUTPUT,
        ),
    ] = ""
    split: Annotated[
        str | None,
        typer.Option(
            metavar="TIME|SIZE",
            help="Write several files, DST_0, DST_1 and so on. Each covers this much log time (60s, 10min, 1h) or has "
            "this many bytes of messages before compression (500MB, 1GiB).",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    repeat_latched: Annotated[
        bool,
        typer.Option(
            "--repeat-latched",
            help="With --split: repeat latched messages and static transforms at the beginning of each file.",
            rich_help_panel=OUTPUT,
        ),
    ] = False
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite", help="Replace DST, and the file of --report, if they exist.", rich_help_panel=OUTPUT
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
            rich_help_panel=REPORT,
        ),
    ] = None
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show warnings and errors only.", rich_help_panel=REPORT)
    ] = False
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose", "-v", help="Show every parameter and where its value comes from.", rich_help_panel=REPORT
        ),
    ] = False
