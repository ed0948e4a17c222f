"""Options that choose topics, times and points.

No ``from __future__ import annotations`` here: see `pc2scan.cli.groups.Group`.
"""

from typing import Annotated

import typer

from pc2scan.cli import completion
from pc2scan.cli.groups import Group

from . import POINTS, TOPICS

__all__ = ["PointsGroup", "TopicsGroup"]


class TopicsGroup(Group):
    """Options that choose topics and times."""

    topics: Annotated[
        list[str],
        typer.Option(
            "--topic",
            "-t",
            metavar="IN[:=OUT]",
            autocompletion=completion.topics("/PointCloud2", "/LaserScan"),
            help="PointCloud2 topic to convert, and the topic of its scans. Repeatable. "
            "Default: every PointCloud2 topic; the scans of a single topic are on /scan, of several on <topic>/scan.",
            rich_help_panel=TOPICS,
        ),
    ]
    keep: Annotated[
        list[str],
        typer.Option(
            "--keep",
            metavar="TOPIC",
            autocompletion=completion.topics(),
            help="Copy only these of the topics that are not converted (names or globs). Repeatable.",
            rich_help_panel=TOPICS,
        ),
    ]
    drop: Annotated[
        list[str],
        typer.Option(
            "--drop",
            metavar="TOPIC",
            autocompletion=completion.topics(),
            help="Do not write these topics (names or globs). Repeatable.",
            rich_help_panel=TOPICS,
        ),
    ]
    keep_clouds: Annotated[
        bool, typer.Option("--keep-clouds", help="Write the converted clouds too.", rich_help_panel=TOPICS)
    ] = False
    only_scans: Annotated[bool, typer.Option("--only-scans", help="Write only the scans.", rich_help_panel=TOPICS)] = (
        False
    )
    start: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Start time: seconds from the beginning, @seconds since 1970, or a date and time (ISO 8601). "
            "Messages that are latched then, and static transforms, are written at the start.",
            rich_help_panel=TOPICS,
        ),
    ] = None
    end: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="End time (exclusive), written like --start.", rich_help_panel=TOPICS),
    ] = None


class PointsGroup(Group):
    """Options that select points of the clouds."""

    keep_used: Annotated[
        str,
        typer.Option(
            "--keep-used",
            metavar="TOPIC",
            help="Also write the points that give the scan its ranges, to this topic: PointCloud2 with all their "
            "fields and the beam's number.",
            show_default=False,
            rich_help_panel=POINTS,
        ),
    ] = ""
    remove: Annotated[
        list[str],
        typer.Option(
            "--remove",
            metavar="BEAMS",
            help="Remove beams: shadows (returns between an edge and the surface behind it) or speckles. Parameters of "
            "laser_filters may follow, and it is its filter then: 'shadows min_angle=5 neighbors=10', "
            "'speckles filter_window=3'. Repeatable.",
            rich_help_panel=POINTS,
        ),
    ]
    where: Annotated[
        list[str],
        typer.Option(
            "--where",
            metavar="CONDITION",
            help="Use only points whose fields fulfil this condition: 'ring in (3, 4, 5) and intensity > 10'. Fields, "
            "numbers, < <= > >= == != in, and or not, + - * / %, abs(). Repeatable: all must be fulfilled.",
            rich_help_panel=POINTS,
        ),
    ]
    exclude_box: Annotated[
        list[str],
        typer.Option(
            "--exclude-box",
            metavar="BOX",
            help="Reject points in this box, such as the robot's own body: 'frame x0 x1 y0 y1 z0 z1' (m). Repeatable.",
            rich_help_panel=POINTS,
        ),
    ]
    exclude_polygon: Annotated[
        list[str],
        typer.Option(
            "--exclude-polygon",
            metavar="POLYGON",
            help="Reject points in this polygon, at any height, such as the robot's footprint: "
            "'frame x0 y0 x1 y1 x2 y2 ...' (m). Repeatable.",
            rich_help_panel=POINTS,
        ),
    ]
    min_height_slope: Annotated[
        float | None,
        typer.Option(
            metavar="M/M",
            help="Reject points below min_height + this * range, a limit that rises with the range, for ramps and "
            "rough ground. 0.05 is about 3 degrees.",
            rich_help_panel=POINTS,
        ),
    ] = None

    ground: Annotated[
        str,
        typer.Option(
            "--ground",
            metavar="keep|remove",
            help="remove: reject points on the ground, which is found in each cloud; it may slope by up to 15 degrees "
            "and have kerbs. Needs a frame of the robot whose z axis points up.",
            rich_help_panel=POINTS,
        ),
    ] = "keep"
