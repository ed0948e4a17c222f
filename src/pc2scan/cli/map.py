"""``pc2scan map``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.files.urls import path_or_url
from pc2scan.options.call import Options
from pc2scan.show.map import draw_map

from .render import LiveWarnings, progress_bar, show


def map(sources: list[Path], destination: str, *, options: Options) -> int:  # noqa: A001  # the command's name
    """Draw scans into a map."""
    warn = LiveWarnings()
    with progress_bar(options) as progress:
        result = draw_map(sources, path_or_url(destination), options, warn=warn, progress=progress)
    return show(result, options, known=warn)
