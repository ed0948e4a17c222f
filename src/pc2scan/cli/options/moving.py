"""Options about robots that move, and about scans of several messages.

No ``from __future__ import annotations`` here: see `pc2scan.cli.groups.Group`.
"""

from typing import Annotated, Literal

import typer

from pc2scan.cli import completion
from pc2scan.cli.groups import Group

from . import MOVING

__all__ = ["CombiningGroup", "MovingGroup"]


class MovingGroup(Group):
    """Options that use the robot's motion: points and beams are placed at their own times."""

    deskew: Annotated[
        bool,
        typer.Option(
            "--deskew",
            help="Transform each point of a cloud with the pose at its own time, through --fixed-frame. With "
            "--reverse, each beam of a scan; that needs a --target-frame such as odom.",
            rich_help_panel=MOVING,
        ),
    ] = False
    fixed_frame: Annotated[
        str,
        typer.Option(
            metavar="FRAME",
            help="A frame that does not move, such as odom; the robot's motion in it is corrected. For --level, its z "
            "axis points up.",
            show_default=False,
            rich_help_panel=MOVING,
        ),
    ] = ""
    point_time: Annotated[
        str,
        typer.Option(
            metavar="FIELD[:UNIT]",
            help="Field with the points' times, relative to the stamp or absolute; unit: s, ms, us, ns. For clouds "
            "without such a field: azimuth, which measures how the lidar turns; or azimuth:0.1 with the time of a "
            "turn (s), then :cw or :ccw, and :start or :end if the stamp is that of the turn's start or end.  "
            "[default: t, time, timestamp, time_stamp or offset_time]",
            show_default=False,
            rich_help_panel=MOVING,
        ),
    ] = ""
    stamp: Annotated[
        Literal["header", "start", "middle", "end"],
        typer.Option(
            help="The time of a deskewed scan: the cloud's stamp, or the start, middle or end of its points' times.",
            rich_help_panel=MOVING,
        ),
    ] = "header"
    level: Annotated[
        bool,
        typer.Option(
            "--level",
            help="Make scans in a frame without the roll and pitch of the target frame, which come from --fixed-frame "
            "or --imu. This frame has the target frame's name with _stabilized appended; its transforms are written "
            "to /tf.",
            rich_help_panel=MOVING,
        ),
    ] = False
    imu: Annotated[
        str,
        typer.Option(
            metavar="TOPIC[:FRAME]",
            autocompletion=completion.topics("/Imu"),
            help="sensor_msgs/Imu topic from which --level takes roll and pitch; and the IMU's frame, if its frame_id "
            "is wrong or empty.",
            show_default=False,
            rich_help_panel=MOVING,
        ),
    ] = ""


class CombiningGroup(Group):
    """Options that make a scan of several messages, or of other scans."""

    lead: Annotated[
        str,
        typer.Option(
            metavar="TOPIC",
            help="If several topics become one scan (--topic /a:=/scan --topic /b:=/scan), the topic whose stamps the "
            "scans get.  [default: the first]",
            show_default=False,
            rich_help_panel=MOVING,
        ),
    ] = ""
    window: Annotated[
        str | None,
        typer.Option(
            metavar="S",
            help="How far the stamps of the other topics may be from those of --lead.  [default: half the median "
            "period]",
            rich_help_panel=MOVING,
        ),
    ] = None
    accumulate: Annotated[
        str | None,
        typer.Option(
            metavar="S|Nclouds",
            help="Make each scan of all points of the last S seconds (1, 500ms), or of the last N clouds (10clouds).",
            rich_help_panel=MOVING,
        ),
    ] = None
    every: Annotated[
        str | None,
        typer.Option(
            metavar="S",
            help="Make one scan every S seconds, instead of one for each cloud.",
            rich_help_panel=MOVING,
        ),
    ] = None
    rebin: Annotated[
        bool,
        typer.Option(
            "--rebin",
            help="Convert LaserScan to LaserScan: with other beams, in another frame, or several into one.",
            rich_help_panel=MOVING,
        ),
    ] = False
