"""``pc2scan plot``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .fonts import fonts_noted_elsewhere
from .render import LiveWarnings, show


def plot(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings with clouds; several are merged in time order."),
    ],
    destination: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FIGURE", help="The figure: *.png, *.svg or *.pdf.", show_default=False),
    ],
    *,
    options: Options,
) -> None:
    """Draw clouds from above and from the side, with the height band and the scan, for reports.

    Needs matplotlib: pip install 'pc2scan[plot]'. To tune parameters, use `pc2scan view`.
    """
    from pc2scan import commands

    warn = LiveWarnings()
    with fonts_noted_elsewhere():
        drawn = commands.plot(sources, destination, options, warn=warn)
    show(drawn, known=warn)
    raise typer.Exit(drawn.exit_status)
