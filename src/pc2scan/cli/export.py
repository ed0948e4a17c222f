"""``pc2scan export``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.exports.run import export as run
from pc2scan.options.call import Options

from .render import LiveWarnings, progress_bar, show


def export(sources: list[Path], destination: str, *, options: Options) -> int:
    """Write scans, the trajectory, or clouds as files."""
    warn = LiveWarnings()
    with progress_bar(options) as progress:
        report = run(sources, destination, options, warn=warn, progress=progress)
    return show(report, options, known=warn)
