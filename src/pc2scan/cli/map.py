"""``pc2scan map``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .damage import show_damage
from .options.conversion import ConversionGroup, length
from .options.frames import frame_option
from .options.single import Json
from .progress import progress_bar
from .render import print_json, say, warn
from .spelling import as_typed

__all__ = ["map"]

#: Maximum number of reasons for skipping that are shown.
_SHOWN = 5


def map(  # noqa: A001  # the function of a command has its name
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SRC...",
            help="Recordings with scans, or with clouds, which are converted like with `pc2scan convert`; several are "
            "merged in time order.",
        ),
    ],
    destination: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="NAME.yaml",
            help="The map for map_server, NAME.yaml and NAME.pgm, and the picture NAME.png.",
        ),
    ] = None,
    png: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The picture. Without -o, only this is written.")
    ] = None,
    resolution: Annotated[str, typer.Option(metavar="M", help="Side of a cell: 0.05, or 5cm.")] = "0.05",
    max_range: Annotated[
        str | None,
        typer.Option(
            metavar="M",
            help="Returns beyond this range mark no cell as occupied; the cells up to it are cleared.  [default: no "
            "limit]",
            show_default=False,
        ),
    ] = None,
    clear_to: Annotated[
        str,
        typer.Option(
            metavar="M",
            help="Up to which range beams without a return clear cells. 0: not at all, like in gmapping and "
            "slam_toolbox.",
        ),
    ] = "0",
    odom_frame: Annotated[
        str,
        frame_option("The frame of the map, in which the robot moves.", show_default=True),
    ] = "odom",
    base_frame: Annotated[
        str,
        frame_option("The robot's frame, whose path is drawn.  [default: base_link, or base_footprint]"),
    ] = "",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files of these names.")] = False,
    as_json: Json = False,
    *,
    conversion: ConversionGroup,
) -> None:
    """Draw the scans of a recording into a map, placed by the recorded odometry: a preview, not SLAM.

    Nothing is matched or corrected: doubled walls show that mounts, stamps or odometry do not fit together. A scan is
    placed at its stamp; if it has a time_increment, each beam is placed at its own time. Clouds are converted and drawn
    if there are no scans, if --topic names them, or with any option that is about their conversion.

    Exit status: 0 done, 1 failed, 2 wrong usage, 3 written, but with scans skipped or from a damaged source.
    """
    options = conversion.first_output("drawn")

    import math

    from pc2scan.look.map import write_map
    from pc2scan.look.map_options import MapOptions

    asked = MapOptions(
        odom_frame=odom_frame,
        base_frame=base_frame,
        resolution=length("--resolution", resolution),
        max_range=math.inf if max_range is None else length("--max-range", max_range),
        clear_to=length("--clear-to", clear_to),
    )
    with progress_bar(enabled=not as_json) as progress:
        made = write_map(
            sources,
            destination,
            png,
            options,
            asked,
            overwrite=overwrite,
            also_read=conversion.read_files(),
            progress=progress,
        )
    if as_json:
        print_json(made.as_dict())
    else:
        for line in made.lines():
            say(as_typed(line))
    for note in made.notes:
        warn(note)
    for skipped in made.skipped[:_SHOWN]:
        say(f"skipped: {skipped}", err=True)
    if len(made.skipped) > _SHOWN:
        say(f"skipped: for {len(made.skipped) - _SHOWN:,} more reasons (--json lists them)", err=True)
    show_damage(made.damage)
    raise typer.Exit(made.exit_status)
