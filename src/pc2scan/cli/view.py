"""``pc2scan view``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import leading

from .damage import DAMAGED, show_damage
from .options.conversion import ConversionGroup
from .options.single import Moments
from .render import say, size, warn

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["view"]


def view(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings with clouds or scans; several are merged in time order."),
    ],
    destination: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PAGE",
            help="The page, an HTML file. Default: next to SRC, named after it, with _view.html at the end.",
        ),
    ] = None,
    clouds: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=1,
            help="Number of clouds of each topic on the page, up to 1,000, evenly spread over the recording.",
        ),
    ] = 10,
    at: Moments = [],  # noqa: B006 - typer reads the default and never hands it out
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    overwrite: Annotated[
        bool, typer.Option(help="Replace any file of that name; an older page is always replaced.")
    ] = False,
    *,
    conversion: ConversionGroup,
) -> None:
    """Write a page that shows clouds and the scans made of them, to tune the parameters by eye.

    The page is one HTML file that needs no network. In it you change heights, ranges, sector, mount and all other
    parameters. It computes the same scans as `pc2scan convert`, to the bit, and shows the command line and parameter
    files for them. Of a recording without clouds, it shows the scans.
    """
    options = conversion.first_output("shown")

    from pc2scan.look.view import view as write
    from pc2scan.pipeline.options import TimeBound

    from .command_line import convert_words

    path = destination or _beside(sources)
    page = write(
        sources,
        path,
        options,
        clouds=clouds,
        at=[TimeBound.parse(time) for time in at],
        preset=conversion.projection.preset or "",
        command=convert_words(sources, options, "scans.mcap"),
        overwrite=overwrite,
        also_read=conversion.read_files(),
    )
    for note in page.notes:
        warn(note)
    say(f"{leading(str(path))}: {size(len(page.html))}")
    if open_page:
        _open(path)
    show_damage(page.damage)
    raise typer.Exit(DAMAGED if page.damage else 0)


def _beside(sources: Sequence[Path]) -> Path:
    """Return the path of the page, next to the first source."""
    first = sources[0]
    # "." and ".." are resolved, because the page has the name of the folder.
    named = first if first.name and first.name != ".." else first.resolve()
    return named.with_name(f"{named.stem if named.is_file() else named.name}_view.html")


def _open(path: Path) -> None:
    """Open a file in the browser; warn if there is none."""
    import webbrowser

    if not webbrowser.open(path.resolve().as_uri()):
        warn("no browser was found to open it with")
