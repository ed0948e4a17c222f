"""``pc2scan check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.text_enum import TextEnum

from . import completion
from .damage import show_damage
from .options.frames import TfSources, frame_option
from .options.junit import JUnitGroup
from .options.single import Json
from .render import print_json, say, warn
from .spelling import as_typed

__all__ = ["check"]


class Consumer(TextEnum):
    """The consumers of scans, as in `pc2scan.core.consumers.CONSUMERS`."""

    slam_toolbox = "slam_toolbox"
    cartographer = "cartographer"
    gmapping = "gmapping"
    amcl = "amcl"
    nav2 = "nav2"
    mrpt = "mrpt"


#: Maximum number of a topic's frames that are shown.
_SHOWN = 5


def check(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings with scans; several are merged in time order."),
    ],
    consumers: Annotated[
        list[Consumer],
        typer.Option(
            "--for",
            metavar="CONSUMER",
            help=f"Consumer that decides the exit status: {', '.join(Consumer)}. Repeatable. "
            "Default: all of them, and defects for all consumers too.",
        ),
    ] = [],  # noqa: B006 - typer reads the default and never hands it out
    topics: Annotated[
        list[str],
        typer.Option(
            "--topic",
            "-t",
            metavar="TOPIC",
            help="LaserScan topic to check, or a glob. Repeatable. Default: all.",
            autocompletion=completion.topics("/LaserScan"),
        ),
    ] = [],  # noqa: B006
    odom_frame: Annotated[
        str,
        frame_option("The odometry's frame; the scans' frames must be connected to it.", show_default=True),
    ] = "odom",
    base_frame: Annotated[
        str,
        frame_option("The robot's frame.  [default: base_link, or base_footprint]"),
    ] = "",
    *,
    transforms: TfSources,
    junit: JUnitGroup,
    as_json: Json = False,
) -> None:
    """Check whether SLAM and navigation accept a recording's scans.

    The verdict for each LaserScan topic and consumer is: accepted; shifted (accepted, but rotated by up to one beam);
    misplaced (accepted, but with beams or ranges in wrong places); ignored; or aborts (the consumer crashes). Each
    comes with the rule, the numbers and a remedy. Problems for all consumers follow, as defects or notices: frames and
    transforms, stamps, rates, lengths, ranges.

    Exit status: 0 all accepted (without --for: or shifted, and no defect), 1 not all, 2 wrong usage.
    """
    from pc2scan.inspect.check import check as look

    from .junit_cases import of_check
    from .progress import progress_bar

    frames = transforms.options()
    with junit.writing("check", [*sources, *frames.tf_from]) as write_junit:
        with progress_bar(enabled=not as_json) as progress:
            result = look(
                sources,
                consumers=[consumer.value for consumer in consumers],
                topics=topics,
                odom_frame=odom_frame,
                base_frame=base_frame,
                frames=frames,
                progress=progress,
            )
        if as_json:
            print_json(result.as_dict())
        else:
            for line in result.lines():
                say(as_typed(line))
            for warning in result.warnings:
                warn(warning)
        show_damage(result.damage)
        write_junit(of_check(result))
    raise typer.Exit(result.exit_status)
