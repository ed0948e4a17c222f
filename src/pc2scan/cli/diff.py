"""``pc2scan diff``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .render import show


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="A recording, the reference.")],
    b: Annotated[
        Path | None,
        typer.Argument(metavar="[B]", help="The recording to compare with it. Default: A itself, see --topic."),
    ] = None,
    *,
    options: Options,
) -> None:
    """Show the differences between two recordings.

    Scans and clouds are compared message by message, matched by their header's stamp: repeated stamps in order,
    messages without a stamp by log time. All bits must be equal unless a tolerance is given. Container, compression
    and ROS version are not compared.

    Exit status: 0 the same, 1 different, 2 not comparable.
    """
    from pc2scan.commands import diff as run

    from .render import progress_bar

    with progress_bar(enabled=not (options.as_json or options.quiet)) as progress:
        result = run(a, b, options, progress=progress)
    show(result, as_json=options.as_json, quiet=options.quiet)
    raise typer.Exit(result.exit_status)
