"""``pc2scan export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from . import completion
from .damage import show_damage
from .groups import PathType
from .options.conversion import ConversionGroup
from .options.frames import frame_option
from .options.single import Json
from .progress import progress_bar
from .render import print_json, say, show_parts, warn
from .spelling import as_typed

__all__ = ["export"]

#: The names of `pc2scan.export.formats.FORMATS`, which are not loaded for ``--help``; a test compares them.
FORMATS = Literal["npz", "csv", "tum", "carmen", "flaser", "pcd", "kitti"]


def export(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings with scans or clouds; several are merged in time order."),
    ],
    destination: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="The file to write. DIR/: a new folder with a file for each topic. For clouds: always a folder.",
            show_default=False,
            click_type=PathType(path_type=str),
        ),
    ],
    format: Annotated[  # noqa: A002  # the name of the option
        FORMATS | None,
        typer.Option(
            "--format",
            "-f",
            help="For scans: npz (NumPy arrays), csv (one row per scan), carmen (ROBOTLASER1, .log), flaser (FLASER, "
            ".clf). For the trajectory only: tum. For clouds, in a folder: pcd, kitti.  [default: by OUT's suffix]",
            show_default=False,
        ),
    ] = None,
    pose_frame: Annotated[
        str,
        frame_option(
            "Write the robot's pose in this frame (odom, map) at each message's stamp, from the recorded transforms."
        ),
    ] = "",
    base_frame: Annotated[
        str,
        frame_option(
            "The robot's frame, whose pose is written.  [default: base_link, base_footprint, or the frame that "
            "the sensor is mounted on]"
        ),
    ] = "",
    odom_topic: Annotated[
        str,
        typer.Option(
            metavar="TOPIC",
            autocompletion=completion.topics("/Odometry"),
            help="Take the poses from this nav_msgs/Odometry topic instead of the transforms.",
            show_default=False,
        ),
    ] = "",
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace OUT: a file, or a folder with an export and nothing else.")
    ] = False,
    as_json: Json = False,
    *,
    conversion: ConversionGroup,
) -> None:
    """Write scans with poses, the trajectory, or clouds as files for learning and evaluation.

    The scans are those of the LaserScan topics. With any parameter of the projection, the clouds are converted first,
    like with `pc2scan convert`. Poses are interpolated like in tf2, and never extrapolated: messages without a pose at
    their stamp are skipped and counted, and the exit status is 3.
    """
    from pc2scan.export.poses import PoseOptions
    from pc2scan.export.run import ExportOptions, run
    from pc2scan.pipeline.options import destination_and_folder

    options = conversion.options()
    named, folder = destination_and_folder(destination)
    place = named or folder
    assert place is not None
    form = ExportOptions(
        format=format,
        poses=PoseOptions(pose_frame=pose_frame, base_frame=base_frame, odom_topic=odom_topic),
        converting=conversion.projection.is_given or options.scan.may_combine,
        overwrite=overwrite,
    )
    with progress_bar(enabled=not as_json) as progress:
        report = run(
            sources,
            place,
            options,
            form,
            in_folder=named is None,
            also_read=conversion.read_files(),
            progress=progress,
        )
    if as_json:
        print_json(report.as_dict())
    else:
        show_parts([report.table()])
        for text in report.remarks():
            say(as_typed(text), err=True)
        for text in report.warnings:
            warn(text)
    show_damage(report.damage)
    raise typer.Exit(report.exit_status)
