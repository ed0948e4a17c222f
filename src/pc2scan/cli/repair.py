"""``pc2scan repair``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options.output import Compression, Destination, Storage
from .outcome import conclude, show, show_next
from .render import print_json

__all__ = ["repair"]


def repair(
    source: Annotated[
        Path, typer.Argument(metavar="SRC", help="ROS 1 bag, rosbag2 directory, .db3 or .mcap file; damaged or not.")
    ],
    destination: Destination = None,
    *,
    storage: Annotated[
        Storage | None, typer.Option(help="Storage of a rosbag2 directory.  [default: SRC's]", show_default=False)
    ] = None,
    compression: Annotated[
        Compression | None, typer.Option(help="Compression of DST.  [default: SRC's]", show_default=False)
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace DST, and the file of --report, if they exist.")
    ] = False,
    no_verify: Annotated[bool, typer.Option("--no-verify", help="Do not check the CRCs of an MCAP source.")] = False,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write a report as JSON. An older report is replaced, any other file is not."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show damage, warnings and errors only.")] = False,
) -> None:
    """Write everything that can be recovered of a damaged recording, of any type, byte for byte.

    The exit status is 0 if nothing was damaged (DST is then a complete copy), 3 if something was. SRC is never changed.
    """
    from pc2scan.pipeline.options import ConvertOptions, destination_and_folder
    from pc2scan.pipeline.run import OutputOptions, run

    from .progress import progress_bar

    named, folder = destination_and_folder(destination)
    form = OutputOptions(storage=storage, compression=compression, overwrite=overwrite, report=report, folder=folder)
    options = ConvertOptions(repair=True, verify=not no_verify)
    with progress_bar(enabled=not (quiet or as_json)) as progress:
        result = run([source], named, options, form, progress=progress)
    if as_json:
        print_json(result.as_dict())
    elif not quiet:
        show(result)
    end = conclude(result)
    if not (as_json or quiet):
        show_next(result)
    raise end
