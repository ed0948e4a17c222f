"""``pc2scan map``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.errors import UsageError
from pc2scan.files.urls import path_or_url
from pc2scan.options.call import Options
from pc2scan.show.map import draw_map

from .render import LiveWarnings, progress_bar, show


def map(  # noqa: A001  # the function of a command has its name
    sources: list[Path], destination: str | None, *, options: Options
) -> int:
    """Draw scans into a map."""
    if destination is None:
        raise UsageError(
            "no file to write is given", hint="`destination=map.yaml`; or `destination=map.png`, the picture"
        )
    warn = LiveWarnings()
    with progress_bar(enabled=not options.as_json) as progress:
        result = draw_map(sources, path_or_url(destination), options, warn=warn, progress=progress)
    show(result, as_json=options.as_json, known=warn)
    return result.exit_status
