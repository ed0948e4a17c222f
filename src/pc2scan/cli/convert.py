"""``pc2scan convert``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import Conversion, Output, Reporting
from .outcome import conclude, show

__all__ = ["convert"]


def convert(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SRC...",
            help="ROS 1 bag, rosbag2 directory, .db3 or .mcap file. Several are one recording, merged in time order.",
        ),
    ],
    destination: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DST",
            help="*.bag: ROS 1 bag; *.mcap: MCAP file; any other name: rosbag2 directory. "
            "Left out: beside SRC, in its format, with _scan in its name.",
        ),
    ] = None,
    *,
    conversion: Conversion,
    output: Output,
    reporting: Reporting,
) -> None:
    """Convert recorded clouds to laser scans, or back.

    PointCloud2 becomes LaserScan as ROS's pointcloud_to_laserscan does it. Every other topic passes through.
    Nothing is dropped in silence: what could not be converted is counted, listed, and reflected in the exit status.
    """
    options, origins = conversion.options(ros_distro=output.ros_distro)

    from pc2scan.pipeline.run import run

    from .progress import progress_bar

    with progress_bar(enabled=not reporting.quiet) as progress:
        result = run(
            sources,
            destination,
            options,
            output.options(report=reporting.report),
            origins=origins,
            also_read=conversion.read_files(),
            progress=progress,
        )
    if not reporting.quiet:
        show(result, verbose=reporting.verbose)
    raise conclude(result, verbose=reporting.verbose)
