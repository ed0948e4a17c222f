"""``pc2scan repair``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.options.call import Options
from pc2scan.requests import repair as run

from .convert import next_command
from .render import progress_bar, say, show


def repair(source: Path, destination: str | None, *, options: Options) -> int:
    """Write what can be recovered of a damaged recording."""
    silent = options.quiet or options.as_json
    with progress_bar(enabled=not silent) as progress:
        result = run(source, destination, options, progress=progress)
    show(result, as_json=options.as_json, quiet=options.quiet)
    if not silent:
        say(f"next: {next_command(result)}")
    return result.exit_status
