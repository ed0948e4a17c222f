"""``pc2scan plot``."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.options.call import Options

from .render import LiveWarnings, show

if TYPE_CHECKING:
    from collections.abc import Iterator

_WHERE = "MPLCONFIGDIR"


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

    Needs matplotlib: pip install "pc2scan[plot]". To tune parameters, use `pc2scan view`.
    """
    from pc2scan.commands import plot as run

    warn = LiveWarnings()
    with _temporary_fonts():
        drawn = run(sources, destination, options, warn=warn)
    show(drawn, known=warn)
    raise typer.Exit(drawn.exit_status)


@contextmanager
def _temporary_fonts() -> Iterator[None]:
    """Make matplotlib write its list of fonts into a temporary folder, unless the user has set MPLCONFIGDIR.

    By default it is in the user's home. The library changes no setting of matplotlib, because it may run in another
    program's process.
    """
    if os.environ.get(_WHERE):
        yield
        return
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="pc2scan-fonts-") as folder:
        os.environ[_WHERE] = folder
        try:
            yield
        finally:
            del os.environ[_WHERE]
