"""``pc2scan check``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.options.call import Options

from .render import show


def check(sources: list[Path], *, options: Options) -> int:
    """Check whether SLAM and navigation accept scans."""
    from pc2scan.commands import check as run

    from .render import progress_bar

    with progress_bar(enabled=not options.as_json) as progress:
        result = run(sources, options, progress=progress)
    show(result, as_json=options.as_json)
    return result.exit_status
