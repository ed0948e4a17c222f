"""``pc2scan plot``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .damage import DAMAGED, show_damage
from .fonts import fonts_noted_elsewhere
from .options.conversion import ConversionGroup
from .options.single import Moments
from .render import warn

__all__ = ["plot"]


def plot(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings with clouds; several are merged in time order."),
    ],
    destination: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FIGURE", help="The figure: *.png, *.svg or *.pdf.", show_default=False),
    ],
    clouds: Annotated[
        int,
        typer.Option(
            "--clouds",
            "--frames",
            metavar="N",
            min=1,
            help="Number of clouds of each topic, side by side, spread over the recording.",
        ),
    ] = 1,
    at: Moments = [],  # noqa: B006 - typer reads the default and never hands it out
    overwrite: Annotated[bool, typer.Option(help="Replace a file of that name.")] = False,
    *,
    conversion: ConversionGroup,
) -> None:
    """Draw clouds from above and from the side, with the height band and the scan, for reports.

    Needs matplotlib: pip install 'pc2scan[plot]'. To tune parameters, use `pc2scan view`.
    """
    options = conversion.first_output("shown")

    from pc2scan.look.plot import plot as draw
    from pc2scan.pipeline.options import TimeBound

    with fonts_noted_elsewhere():
        drawn = draw(
            sources,
            destination,
            options,
            clouds=clouds,
            at=[TimeBound.parse(time) for time in at],
            overwrite=overwrite,
            also_read=conversion.read_files(),
        )
    for note in drawn.notes:
        warn(note)
    show_damage(drawn.damage)
    raise typer.Exit(DAMAGED if drawn.damage else 0)
