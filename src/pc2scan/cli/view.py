"""``pc2scan view``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.files.urls import path_or_url
from pc2scan.options.call import Options
from pc2scan.show.view import view as run

from .render import LiveWarnings, show

if TYPE_CHECKING:
    from collections.abc import Sequence


def view(sources: list[Path], destination: str | None, *, options: Options) -> int:
    """Write a page that shows clouds and their scans."""
    path = _beside(sources) if destination is None else path_or_url(destination)
    warn = LiveWarnings()
    page = run(sources, path, options, warn=warn)
    show(page, known=warn)
    return page.exit_status


def _beside(sources: Sequence[Path]) -> Path:
    """Return the path of the page, next to the first source."""
    first = sources[0]
    # "." and ".." are resolved, because the page has the name of the folder.
    named = first if first.name and first.name != ".." else first.resolve()
    return named.with_name(f"{named.stem if named.is_file() else named.name}_view.html")
