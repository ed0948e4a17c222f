"""``pc2scan convert``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import Pc2ScanError
from pc2scan.options.call import Options

from .options import Destination
from .outcome import conclude, show, show_next
from .progress import progress_bar
from .render import warn

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

__all__ = ["convert"]


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
    from pc2scan.requests import conversion_of, destination_of, named_files, output_of

    sources, options = _with_ros_arguments(sources, options)
    named, folder = destination_of(destination)
    form = output_of(options, folder=folder)
    files: Mapping[str, Path] = named_files(options)
    try:
        conversion = conversion_of(options, warn)
    except Pc2ScanError as err:
        from pc2scan.pipeline.report import Failure
        from pc2scan.pipeline.run import report_failure
        from pc2scan.remote.urls import shown_path

        report_failure(Failure(err, [shown_path(source) for source in sources], destination), sources, form, files)
        raise

    from pc2scan.pipeline.run import run

    shown: list[str] = []

    def warned(text: str) -> None:
        shown.append(text)
        warn(text)

    with progress_bar(enabled=not options.quiet) as progress:
        result = run(
            sources, named, conversion.options, form, also_read=conversion.files, progress=progress, warn=warned
        )
    if not options.quiet:
        show(result, verbose=options.verbose)
    end = conclude(result, verbose=options.verbose, shown=shown)
    if not options.quiet and not result.dry_run:
        show_next(result)
    raise end


def _with_ros_arguments(words: Iterable[Path], options: Options) -> tuple[list[Path], Options]:
    """Split the positional arguments into recordings, and remappings and parameters as ``rosrun`` reads them."""
    sources, remaps, parameters = [], [], []
    for word in words:
        text = str(word)
        if ":=" not in text:
            sources.append(word)
        elif not text.startswith("_"):
            remaps.append(text)
        elif not text.startswith("__"):
            parameters.append(text)
    further = {"remap": (*(options.remap or ()), *remaps), "param": (*(options.param or ()), *parameters)}
    return sources, Options("convert", options.given | further, options.origins) if remaps or parameters else options
