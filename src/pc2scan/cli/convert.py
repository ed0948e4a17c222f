"""``pc2scan convert``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.options.call import Options

from .next_command import next_line
from .options import Destination
from .progress import progress_bar
from .render import LiveWarnings, say, show

if TYPE_CHECKING:
    from collections.abc import Iterable


def convert(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SRC...",
            help="ROS 1 bag, rosbag2 directory, .db3 or .mcap file, or a URL of one. Several are merged in time order.",
        ),
    ],
    destination: Destination = None,
    *,
    options: Options,
) -> None:
    """Convert recorded clouds to laser scans, or back.

    PointCloud2 becomes LaserScan, with the results of ROS's pointcloud_to_laserscan. All other topics are copied.
    Messages that cannot be converted are counted, listed, and reflected in the exit status.
    """
    from pc2scan import commands

    sources, further = _ros_arguments(sources)
    if further:
        options = options.with_further(further)
    warn = LiveWarnings()
    with progress_bar(enabled=not options.quiet) as progress:
        result = commands.convert(sources, destination, options, warn=warn, progress=progress)
    show(result, quiet=options.quiet, verbose=options.verbose, known=warn)
    if not options.quiet and not result.dry_run:
        say(next_line(result))
    raise typer.Exit(result.exit_status)


def _ros_arguments(words: Iterable[Path]) -> tuple[list[Path], dict[str, list[str]]]:
    """Split the positional arguments into recordings, and remappings and parameters as ``rosrun`` reads them."""
    sources: list[Path] = []
    further: dict[str, list[str]] = {}
    for word in words:
        text = str(word)
        if ":=" not in text:
            sources.append(word)
        elif not text.startswith("__"):
            further.setdefault("param" if text.startswith("_") else "remap", []).append(text)
    return sources, further
