"""``pc2scan diff``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.compare.diff import diff as compare
from pc2scan.options.call import Options

from .render import progress_bar, show


def diff(a: Path, b: Path | None, *, options: Options) -> int:
    """Show the differences between two recordings."""
    with progress_bar(options) as progress:
        result = compare(a, b, options, progress=progress)
    return show(result, options)
