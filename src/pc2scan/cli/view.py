"""``pc2scan view``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .damage import DAMAGED, show_damage
from .options import ConversionGroup, Moments
from .render import printable, size, warn

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
            help="The page, an HTML file. Default: next to SRC, with _view.html in its name.",
        ),
    ] = None,
    clouds: Annotated[
        int,
        typer.Option(metavar="N", min=1, help="Moments of each topic on the page, evenly spread over the recording."),
    ] = 10,
    at: Moments = [],  # noqa: B006 - typer reads the default and never hands it out
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    overwrite: Annotated[
        bool, typer.Option(help="Replace any file of that name; an older page is always replaced.")
    ] = False,
    *,
    conversion: ConversionGroup,
) -> None:
    """Write a page that shows clouds and the scan that comes of them, to tune its parameters by eye.

    One HTML file that opens anywhere, without a network. Heights, ranges, sector, mount and all else can be changed in
    the page, which projects as `pc2scan convert` does, to the bit, and hands back the command line and parameter files.
    A recording without clouds is shown by its scans.
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
    )
    for note in page.notes:
        warn(note)
    typer.echo(printable(f"{path}: {size(len(page.html))}"))
    if open_page:
        _open(path)
    show_damage(page.damage)
    raise typer.Exit(DAMAGED if page.damage else 0)


def _beside(sources: Sequence[Path]) -> Path:
    """Return the path of the page, next to the first source."""
    first = sources[0]
    # What ".." and "." are called decides the name of the page.
    named = first if first.name and first.name != ".." else first.resolve()
    return named.with_name(f"{named.stem if named.is_file() else named.name}_view.html")


def _open(path: Path) -> None:
    """Open a file in the browser, if there is one."""
    import webbrowser

    if not webbrowser.open(path.resolve().as_uri()):
        warn("no browser was found to open it with")
