"""``pc2scan view``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.files.urls import path_or_url
from pc2scan.options.call import Options
from pc2scan.show.view import view as run

from .render import LiveWarnings, show


def view(sources: list[Path], destination: str | None, *, options: Options) -> int:
    """Write a page that shows clouds and their scans."""
    # "." and ".." are resolved, because the page has the name of the folder.
    source = sources[0] if sources[0].name.strip(".") else sources[0].resolve()
    name = source.stem if source.is_file() else source.name
    path = source.with_name(f"{name}_view.html") if destination is None else path_or_url(destination)
    warn = LiveWarnings()
    return show(run(sources, path, options, warn=warn), options, known=warn)
