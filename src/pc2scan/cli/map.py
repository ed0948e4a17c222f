"""``pc2scan map``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .render import LiveWarnings, progress_bar, show


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
    *,
    options: Options,
) -> None:
    """Draw the scans of a recording into a map, placed by the recorded odometry: a preview, not SLAM.

    Nothing is matched or corrected: doubled walls show that mounts, stamps or odometry do not fit together. A scan is
    placed at its stamp; if it has a time_increment, each beam is placed at its own time. Clouds are converted and drawn
    if there are no scans, if --topic names them, or with any option that is about their conversion.

    Exit status: 0 done, 1 failed, 2 wrong usage, 3 written, but with scans skipped or from a damaged source.
    """
    from pc2scan.commands import map as run

    warn = LiveWarnings()
    with progress_bar(enabled=not options.as_json) as progress:
        result = run(sources, destination, options, warn=warn, progress=progress)
    show(result, as_json=options.as_json, known=warn)
    raise typer.Exit(result.exit_status)
