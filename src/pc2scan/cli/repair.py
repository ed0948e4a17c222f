"""``pc2scan repair``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .convert import next_command
from .options import Destination
from .render import say, show


def repair(
    source: Annotated[
        Path, typer.Argument(metavar="SRC", help="ROS 1 bag, rosbag2 directory, .db3 or .mcap file; damaged or not.")
    ],
    destination: Destination = None,
    *,
    options: Options,
) -> None:
    """Write everything that can be recovered of a damaged recording, of any type, byte for byte.

    The exit status is 0 if nothing was damaged (DST is then a complete copy), 3 if something was. SRC is never changed.
    """
    from pc2scan.commands import repair as run

    from .render import progress_bar

    silent = options.quiet or options.as_json
    with progress_bar(enabled=not silent) as progress:
        result = run(source, destination, options, progress=progress)
    show(result, as_json=options.as_json, quiet=options.quiet)
    if not silent:
        say(f"next: {next_command(result)}")
    raise typer.Exit(result.exit_status)
