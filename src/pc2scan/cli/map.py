"""``pc2scan map``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .damage import show_damage
from .progress import progress_bar
from .render import print_json, say, warn
from .spelling import as_typed

#: Maximum number of reasons for skipping that are shown.
_SHOWN = 5


def map(  # noqa: A001  # the function of a command has its name
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SRC...",
            help="Recordings with scans, or with clouds, which are converted like with `pc2scan convert`; several are "
            "merged in time order.",
        ),
    ],
    destination: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="NAME.yaml",
            help="The map for map_server, NAME.yaml and NAME.pgm, and the picture NAME.png.",
        ),
    ] = None,
    *,
    options: Options,
) -> None:
    """Draw the scans of a recording into a map, placed by the recorded odometry: a preview, not SLAM.

    Nothing is matched or corrected: doubled walls show that mounts, stamps or odometry do not fit together. A scan is
    placed at its stamp; if it has a time_increment, each beam is placed at its own time. Clouds are converted and drawn
    if there are no scans, if --topic names them, or with any option that is about their conversion.

    Exit status: 0 done, 1 failed, 2 wrong usage, 3 written, but with scans skipped or from a damaged source.
    """
    from pc2scan.requests import conversion_of, first_output

    asked = conversion_of(options, warn)
    conversion = first_output(asked.options, "drawn", warn)

    from pc2scan.look.map import write_map
    from pc2scan.look.map_drawing import MapOptions

    with progress_bar(enabled=not options.as_json) as progress:
        made = write_map(
            sources,
            destination,
            options.png,
            conversion,
            MapOptions.of(options),
            overwrite=options.overwrite,
            also_read=asked.files,
            progress=progress,
        )
    if options.as_json:
        print_json(made.as_dict())
    else:
        for line in made.lines():
            say(as_typed(line))
    for note in made.notes:
        warn(note)
    for skipped in made.skipped[:_SHOWN]:
        say(f"skipped: {skipped}", err=True)
    if len(made.skipped) > _SHOWN:
        say(f"skipped: for {len(made.skipped) - _SHOWN:,} more reasons (--json lists them)", err=True)
    show_damage(made.damage)
    raise typer.Exit(made.exit_status)
