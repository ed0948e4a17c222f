"""``pc2scan export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .options import PathType
from .render import LiveWarnings, progress_bar, show


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
    *,
    options: Options,
) -> None:
    """Write scans with poses, the trajectory, or clouds as files for learning and evaluation.

    The scans are those of the LaserScan topics. With any parameter of the projection, the clouds are converted first,
    like with `pc2scan convert`. Poses are interpolated like in tf2, and never extrapolated: messages without a pose at
    their stamp are skipped and counted, and the exit status is 3.
    """
    from pc2scan.commands import export as run

    warn = LiveWarnings()
    with progress_bar(enabled=not options.as_json) as progress:
        report = run(sources, destination, options, warn=warn, progress=progress)
    show(report, as_json=options.as_json, known=warn)
    raise typer.Exit(report.exit_status)
