"""``pc2scan check``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.options.call import Options
from pc2scan.show.check import check as judge

from .render import progress_bar, show


def check(sources: list[Path], *, options: Options) -> int:
    """Check whether SLAM and navigation accept scans."""
    with progress_bar(options) as progress:
        result = judge(sources, options, progress)
    return show(result, options)
