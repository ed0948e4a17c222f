"""``pc2scan view``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.options.call import Options

from .render import LiveWarnings, show, warn

if TYPE_CHECKING:
    from collections.abc import Sequence


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
    *,
    options: Options,
) -> None:
    """Write a page that shows clouds and the scans made of them, to tune the parameters by eye.

    The page is one HTML file that needs no network. In it you change heights, ranges, sector, mount and all other
    parameters. It computes the same scans as `pc2scan convert`, to the bit, and shows the command line and parameter
    files for them. Of a recording without clouds, it shows the scans.
    """
    from pc2scan.commands import view as run

    path = destination or _beside(sources)
    warn = LiveWarnings()
    page = run(sources, path, options, warn=warn)
    show(page, known=warn)
    if options.open_page:
        _open(path)
    raise typer.Exit(page.exit_status)


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
