"""``pc2scan view``, ``pc2scan plot`` and ``pc2scan map``."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

from pc2scan.files.urls import path_or_url
from pc2scan.options.call import Options
from pc2scan.show import map as maps
from pc2scan.show import plot as figures
from pc2scan.show import view as pages

from .render import LiveWarnings, progress_bar, show


def view(sources: list[Path], destination: str | None, *, options: Options) -> int:
    """Write a page that shows clouds and their scans."""
    # "." and ".." are resolved, because the page has the name of the folder.
    source = sources[0] if sources[0].name.strip(".") else sources[0].resolve()
    name = source.stem if source.is_file() else source.name
    path = source.with_name(f"{name}_view.html") if destination is None else path_or_url(destination)
    warn = LiveWarnings()
    return show(pages.view(sources, path, options, warn=warn), options, known=warn)


def plot(sources: list[Path], destination: str, *, options: Options) -> int:
    """Draw clouds."""
    warn = LiveWarnings()
    with TemporaryDirectory(prefix="pc2scan-fonts-") as folder:
        # For matplotlib's list of fonts, which would be written into the user's home.
        os.environ.setdefault("MPLCONFIGDIR", folder)
        drawn = figures.plot(sources, path_or_url(destination), options, warn=warn)
    return show(drawn, options, known=warn)


def draw_map(sources: list[Path], destination: str, *, options: Options) -> int:
    """Draw scans into a map."""
    warn = LiveWarnings()
    with progress_bar(options) as progress:
        result = maps.draw_map(sources, path_or_url(destination), options, warn=warn, progress=progress)
    return show(result, options, known=warn)
