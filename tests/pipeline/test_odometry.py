"""Odometry that fits the clouds is never doubted, whatever else is imperfect; one that does not is, by what is seen."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from support import sampled
from support.worlds.moving import Drive, Lidar
from support.worlds.weaving import REAR, RINGS, Fault, Weaving, write_weaving

if TYPE_CHECKING:
    from pathlib import Path

DRIVES = {
    "weaving": Weaving(),
    "weaving slowly": Weaving(hertz=0.1),
    "tilting": Weaving(tilt=0.05),
    "circle": Drive(speed=0.5),
    "straight": Drive(turn=0.0),
    "standing": Drive(speed=0.0, turn=0.0),
}
LIDARS: dict[str, list[Lidar]] = {
    "rings": [RINGS],
    "packets": [replace(RINGS, kind="packets")],
    "rosette": [replace(RINGS, kind="rosette", columns=6000)],
    "two": [RINGS, replace(REAR, phase=-0.03)],
}
#: Odometry that is as good as real odometry is.
SOUND = {"exact": Fault(), "scaled": Fault(scale=0.95), "rough": Fault(metres=0.002, degrees=0.03)}


def warnings(source: Path, lidars: list[Lidar], **options: Any) -> list[str]:
    joined = {"topics": [f"{lidar.topic}:=/scan" for lidar in lidars]} if len(lidars) > 1 else {}
    words = {"target_frame": "base_link", "min_height": 0.3, "max_height": 1.9, "fixed_frame": "odom", "deskew": True}
    destination = source.with_name("scans.mcap")
    return pc2scan.convert(source, destination, overwrite=True, **{"jobs": 1, **words, **joined, **options}).warnings


@pytest.mark.parametrize(
    ("drive", "lidars", "fault"), sampled([(d, i, f) for d in DRIVES for i in LIDARS for f in SOUND], 4)
)
def test_sound_odometry_is_not_doubted(drive: str, lidars: str, fault: str, tmp_path: Path) -> None:
    source = write_weaving(tmp_path / "drive.mcap", LIDARS[lidars], SOUND[fault], DRIVES[drive])
    assert warnings(source, LIDARS[lidars]) == []
    if lidars == "two":
        assert warnings(source, LIDARS[lidars], deskew=False) == []


@pytest.mark.parametrize("late", [-0.1, -0.03, 0.03, 0.1])
def test_odometry_that_lags_is_said_with_its_lag(late: float, tmp_path: Path) -> None:
    source = write_weaving(tmp_path / "drive.mcap", fault=Fault(late=late))
    (text,) = warnings(source, [RINGS])
    # What is to type leaves nothing to say.
    assert f"`time_offset={late:.2f}s`" in text
    assert warnings(source, [RINGS], time_offset=[f"{late:.2f}s"]) == []
    assert (
        f"of {1000 * abs(late):.0f} ms {'later: the odometry lags' if late > 0 else 'earlier: the odometry is ahead'}"
        in text
    )


def test_warnings_do_not_depend_on_the_number_of_threads(tmp_path: Path) -> None:
    source = write_weaving(tmp_path / "drive.mcap", fault=Fault(late=0.06))
    assert warnings(source, [RINGS], jobs=4) == warnings(source, [RINGS])


@pytest.mark.parametrize("clock", [-0.06, 0.03])
@pytest.mark.parametrize("deskew", [True, False])
def test_clocks_of_two_lidars_that_differ_are_said(clock: float, deskew: bool, tmp_path: Path) -> None:
    lidars = [RINGS, replace(REAR, clock=clock)]
    source = write_weaving(tmp_path / "drive.mcap", lidars)
    found = " ".join(warnings(source, lidars, deskew=deskew))
    assert "rear was" not in " ".join(warnings(source, lidars, deskew=deskew, time_offset=[f"/rear={-clock:.2f}s"]))
    assert f"`time_offset=/rear={-clock:.2f}s`" in found
    assert (
        f"/rear was measured {1000 * abs(clock):.0f} ms {'earlier' if clock > 0 else 'later'} than its stamps" in found
    )
