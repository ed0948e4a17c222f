"""``pc2scan check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .render import show


def check(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings with scans; several are merged in time order."),
    ],
    *,
    options: Options,
) -> None:
    """Check whether SLAM and navigation accept a recording's scans.

    The verdict for each LaserScan topic and consumer is: accepted; shifted (accepted, but rotated by up to one beam);
    misplaced (accepted, but with beams or ranges in wrong places); ignored; or aborts (the consumer crashes). Each
    comes with the rule, the numbers and a remedy. Problems for all consumers follow, as defects or notices: frames and
    transforms, stamps, rates, lengths, ranges.

    Exit status: 0 all accepted (without --for: or shifted, and no defect), 1 not all, 2 wrong usage.
    """
    from pc2scan.commands import check as run

    from .render import progress_bar

    with progress_bar(enabled=not options.as_json) as progress:
        result = run(sources, options, progress=progress)
    show(result, as_json=options.as_json)
    raise typer.Exit(result.exit_status)
