"""``pc2scan repair``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.options.call import Options
from pc2scan.requests import repair as run

from .convert import say_next
from .render import progress_bar, show


def repair(source: Path, destination: str | None, *, options: Options) -> int:
    """Write what can be recovered of a damaged recording."""
    with progress_bar(options) as progress:
        result = run(source, destination, options, progress=progress)
    status = show(result, options)
    say_next(result, options)
    return status
