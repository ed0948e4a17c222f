"""``pc2scan plot``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .fonts import fonts_noted_elsewhere
from .render import show, warn


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
    from pc2scan.requests import conversion_of, first_output

    asked = conversion_of(options, warn)
    conversion = first_output(asked.options, "shown", warn)

    from pc2scan.look.plot import plot as draw

    with fonts_noted_elsewhere():
        drawn = draw(
            sources,
            destination,
            conversion,
            clouds=options.clouds,
            at=options.at,
            overwrite=options.overwrite,
            also_read=asked.files,
        )
    show(drawn)
    raise typer.Exit(drawn.exit_status)
