"""The command that `info` proposes, pasted, in simulated places: its scans see what is there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from support import sampled
from support.worlds.scenes import World, outcome

if TYPE_CHECKING:
    from pathlib import Path

ROOM = (-4.0, 5.0, -3.5, 3.5, 2.6)
HALL = (-9.0, 12.0, -8.0, 8.0, 5.0)
CELL = (-3.0, 3.0, -2.5, 2.5, 2.6)
GARAGE = (-30.0, 30.0, -20.0, 20.0, 3.2)
CORRIDOR = (-8.0, 14.0, -1.0, 1.2, 2.5)
DESKS = ((2.0, 3.2, 1.5, 2.3, 0.0, 0.75), (-2.5, -2.0, -2.0, -1.5, 0.0, 1.7), (2.2, 2.6, -2.0, -1.7, 0.0, 1.7))
YARD = ((-13.0, 25.0, 8.0, 11.0, 0.0, 6.0), (-13.0, 25.0, -12.0, -9.0, 0.0, 8.0), (19.0, 22.0, -9.0, 8.0, 0.0, 5.0))
POSTS = tuple((x, x + 2.0, y, y + 1.0, -1.0, 6.0) for x in range(-8, 16, 4) for y in (-7.0, 6.0))
RISING = (*POSTS, (16.0, 19.0, -7.0, 7.0, 0.0, 5.0), (-12.0, -9.0, -7.0, 7.0, 0.0, 5.0))
#: A car park: cars, and beams at the height of the lidar on the car's roof.
PARKED = (
    *((x, x + 4.0, y, y + 1.8, 0.2, 1.5) for x in (6.0, -10.0) for y in (-6.0, 4.0)),
    *((x, x + 0.4, -9.0, 9.0, 2.36, 2.6) for x in (-14.0, 16.0)),
)


def at(height: float, x: float = 0.2) -> tuple[float, float, float, float, float]:
    """A level mount."""
    return (x, height, 0.0, 0.0, 0.0)


UPSIDE_DOWN = (0.2, 0.6, 180.0, 0.0, 0.0)
LIO = ("camera_init", "body")


#: Of each: the world, and a word of what `info` says of it, if it does.
WORLDS = {
    "level lidar at 1.5 m": (World(ROOM, DESKS, "32 even rings", at(1.5)), ""),
    "level lidar at 2 m, below the ceiling": (World(ROOM, DESKS, "16 rings", at(2.0)), ""),
    "Mid-360 in a hall": (World(HALL, DESKS, "mid-360", at(0.5)), ""),
    "Mid-360 halfway up": (World(CELL, DESKS, "mid-360", at(1.3)), ""),
    "Mid-360 halfway up, pitches": (World(CORRIDOR, (), "mid-360", at(1.25), "pitches"), ""),
    "Mid-360 in a corridor, no mount": (World(CORRIDOR, (), "mid-360", at(0.5), has_mount=False, odometry=""), ""),
    "packets": (World(ROOM, DESKS, "packets", at(0.6), "drives"), ""),
    "sparse pattern": (World(ROOM, DESKS, "sparse", at(0.7)), ""),
    "clouds in base_link": (World(ROOM, DESKS, "mid-360", at(0.3), "drives", placed_in="base_link"), ""),
    "LIO": (World(HALL, DESKS, "mid-360", at(0.6, 0), "drives", 0, False, placed_in=LIO[0], axle=0.6, pair=LIO), ""),
    "one ring": (World(HALL, DESKS, "1 ring", at(0.4)), ""),
    "two rings near the floor": (World(HALL, DESKS, "2 rings", at(0.27), "drives"), ""),
    "two rings, the lower one on walls": (World((-13, 14, -8, 8, 8), DESKS, "2 rings", at(1.2)), ""),
    "one ring, pitches": (World(HALL, DESKS, "1 ring", at(0.6), "pitches"), ""),
    "four rings": (World(HALL, DESKS, "4 rings", at(0.4), "drives"), ""),
    "32 rings, pitches, which nothing says": (World(CORRIDOR, (), "32 rings", at(0.9), "pitches", odometry=""), ""),
    "64 rings, pitches": (World(HALL, DESKS, "64 rings", at(1.2), "pitches"), ""),
    "rising ground": (World(None, RISING, "16 rings", at(0.9), "drives", slope=0.12), ""),
    "rising ground, low, open at the sides": (World(None, RISING[-2:], "16 rings", at(0.5), slope=0.06), ""),
    "rising ground, Mid-360": (World(None, RISING, "mid-360", at(1.8), slope=0.13), ""),
    "rising ground, 2,000 points": (World(None, RISING, "thin mid-360", at(0.5), "drives", slope=0.12), ""),
    "rising ground, packets": (World(None, RISING, "packets", at(1.5), "pitches", slope=0.06), ""),
    "odometry as a topic": (World(ROOM, DESKS, "16 rings", at(0.6), "drives", odometry="topic"), ""),
    "mounts on /tf": (World(ROOM, DESKS, "16 rings", at(0.6), "drives", odometry="topic", mounted_by="/tf"), ""),
    "another clock": (World(ROOM, DESKS, "16 rings", at(0.6), "drives", clock=37.0, late=0.31), "--time-offset -37s"),
    "in odom": (World(ROOM, DESKS, "32 rings", at(0.6), "drives", placed_in="odom", clock=-99.0, unit=1e-3), "auto"),
    "packets in odom": (World(ROOM, DESKS, "packets", at(0.6), "drives", placed_in="odom", late=0.4), ""),
    "two lidars": (World(ROOM, DESKS, "32 rings", at(0.5), "drives", second=True), ""),
    "street, no mount": (World(None, YARD[:2], "32 rings", at(1.8), has_mount=False, odometry=""), ""),
    "car park, no mount": (World(GARAGE, PARKED, "16 rings", at(2.43), has_mount=False, odometry=""), ""),
    "base_link at the height of an axle": (World(HALL, DESKS, "32 rings", at(0.6), axle=0.2), ""),
    "no mount, no floor": (World(CELL, (), "16 rings", at(1.7), has_mount=False, odometry=""), "no floor is visible"),
    "upside down, which tf does not say": (World(HALL, DESKS, "16 rings", UPSIDE_DOWN, claim=0.0), "with -z up"),
    "upright, and upside down by tf": (World(ROOM, DESKS, "32 rings", at(1.7), claim=180.0), "with -z up"),
    "two rings that turn wrong": (World(HALL, DESKS, "2 rings", UPSIDE_DOWN, "drives", claim=0.0), "is upside down"),
}


@pytest.mark.parametrize("name", sampled(WORLDS, 2))
def test_a_proposed_command_sees_what_is_there(name: str, tmp_path: Path) -> None:
    world, said = WORLDS[name]
    found = outcome(world, tmp_path)
    assert (found.right >= 0.95, found.filled >= 0.9) == (True, True), found
    assert said in found.text
    assert (found.word, "warning" in found.text) == ("right", bool(said)), found


def test_what_blurs_scans_is_said_before_they_are_made(tmp_path: Path) -> None:
    world = World(HALL, DESKS, "sparse", at(0.5), "drives", odometry="")
    assert "the robot moves, and nothing says how" in outcome(world, tmp_path).text
