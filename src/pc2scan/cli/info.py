"""``pc2scan info``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .render import show


def info(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings; several are merged in time order."),
    ],
    *,
    options: Options,
) -> None:
    """Describe a recording, its clouds and its scans.

    For each topic with clouds, it shows fields, points, frame, NaN, the spread of x, y, z and range, and a histogram of
    heights, which helps to choose --min-height and --max-height. For each LaserScan topic: beams, sector and
    increment, limits, the share of returns, and the consumers that accept them. Then the heights of floor and ceiling,
    whether the clouds are tilted, upside down or in a camera's optical frame, and a convert command for them.
    """
    from pc2scan.commands import info as run

    result = run(sources, options)
    show(result, as_json=options.as_json)
    raise typer.Exit(result.exit_status)
