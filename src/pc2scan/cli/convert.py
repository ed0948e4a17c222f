"""``pc2scan convert``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import DestinationError, Pc2ScanError

from .options.conversion import ConversionGroup
from .options.output import Destination, OutputGroup, ReportGroup, ScratchGroup
from .options.parameters import ros_arguments
from .outcome import conclude, show, show_each, show_next, show_outcome
from .progress import progress_bar
from .render import warn

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.pipeline.run import OutputOptions

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
    conversion: ConversionGroup,
    output: OutputGroup,
    scratch: ScratchGroup,
    reporting: ReportGroup,
) -> None:
    """Convert recorded clouds to laser scans, or back.

    PointCloud2 becomes LaserScan, with the results of ROS's pointcloud_to_laserscan. All other topics are copied.
    Messages that cannot be converted are counted, listed, and reflected in the exit status.
    """
    sources, remaps, parameters = ros_arguments(sources)
    conversion.projection.remap += remaps
    conversion.projection.param += parameters
    from pc2scan.pipeline.options import destination_and_folder

    named, folder = destination_and_folder(destination)
    form = scratch.on(output.options(folder=folder, report=reporting.report))
    also_read = conversion.read_files()
    try:
        options = conversion.options(ros_distro=output.ros_distro)
        # Only after `options`, because a launch file may name further files.
        also_read = conversion.read_files()
        if output.each:
            raise _convert_each(sources, named, options, form, reporting, also_read)
    except Pc2ScanError as err:
        from pc2scan.pipeline.report import Failure
        from pc2scan.pipeline.run import report_failure
        from pc2scan.remote.urls import shown_path

        report_failure(Failure(err, [shown_path(source) for source in sources], destination), sources, form, also_read)
        raise

    from pc2scan.pipeline.run import run

    shown: list[str] = []

    def warned(text: str) -> None:
        shown.append(text)
        warn(text)

    with progress_bar(enabled=not reporting.quiet) as progress:
        result = run(sources, named, options, form, also_read=also_read, progress=progress, warn=warned)
    if not reporting.quiet:
        show(result, verbose=reporting.verbose)
    end = conclude(result, verbose=reporting.verbose, shown=shown)
    if not reporting.quiet and not result.dry_run:
        show_next(result)
    raise end


def _convert_each(
    sources: Sequence[Path],
    named: Path | None,
    options: ConvertOptions,
    form: OutputOptions,
    reporting: ReportGroup,
    also_read: Mapping[str, Path],
) -> typer.Exit:
    """Convert each recording on its own; return the exception that ends the command."""
    from pc2scan.pipeline.each import run_each

    if named is not None:
        raise DestinationError(
            "`each` needs a folder as destination", path=named, hint=f"did you mean `destination={named}/`?"
        )
    with progress_bar(enabled=not reporting.quiet) as progress:
        results = run_each(
            sources,
            options,
            form,
            also_read=also_read,
            progress=progress,
            done=partial(show_outcome, verbose=reporting.verbose and not reporting.quiet),
        )
    if not reporting.quiet:
        show_each(results)
    return typer.Exit(results.exit_status)
