"""``pc2scan diff``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.options.call import Options

from .render import show


def diff(a: Path, b: Path | None, *, options: Options) -> int:
    """Show the differences between two recordings."""
    from pc2scan.commands import diff as run

    from .render import progress_bar

    with progress_bar(enabled=not (options.as_json or options.quiet)) as progress:
        result = run(a, b, options, progress=progress)
    show(result, as_json=options.as_json, quiet=options.quiet)
    return result.exit_status
