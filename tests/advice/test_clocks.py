"""Stamps of clouds are compared with those of transforms and of an IMU."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from pc2scan.advice.clocks import MOTIONS, Clocks, are_doubtful, moving
from pc2scan.advice.survey import Span, Survey
from pc2scan.bags.opening import open_recording
from pc2scan.transforms.placing import FrameOptions
from support.worlds.moving import BEGIN_NS, Lidar, write_world

if TYPE_CHECKING:
    from pathlib import Path

LIDAR = Lidar(columns=36, elevations=(0.0,))
MILLISECOND = 1_000_000


@pytest.mark.parametrize("kind", ["turning", "flat"])
@pytest.mark.parametrize(
    ("clock", "what"), [(0.0, ""), (-0.3, ""), (0.3, "ahead of"), (37.0, "ahead of"), (-9, "behind")]
)
def test_clouds_whose_clock_is_not_that_of_the_transforms(kind: str, clock: float, what: str, tmp_path: Path) -> None:
    path = write_world(tmp_path / "w.mcap", [replace(LIDAR, kind=kind, clock=clock)], seconds=0.3)
    with closing(open_recording(path)) as reader:
        own = [each for each in reader.connections if each.topic == "/points"]
        survey = Survey(reader, [], FrameOptions(), Span(None, None, BEGIN_NS))
        clocks = Clocks(survey, own, moving(reader.connections, ()))
        survey.read()
        found = clocks.warnings()
    assert len(found) == bool(what)
    assert all(text.startswith("the stamps of /points are ") and f" s {what} those of /tf" in text for text in found)


def test_a_slow_driver_is_not_another_clock() -> None:
    assert not are_doubtful(0, 450 * MILLISECOND)
    assert are_doubtful(0, 550 * MILLISECOND)
    assert not are_doubtful(0, 550 * MILLISECOND, 600 * MILLISECOND)
    # No driver is so quick that its messages are logged before their stamps; all may be early.
    assert are_doubtful(-150 * MILLISECOND, 0)
    assert not are_doubtful(-10 * MILLISECOND, 100 * MILLISECOND)
    assert not are_doubtful(-7_000 * MILLISECOND, -6_700 * MILLISECOND)


@pytest.mark.parametrize(
    ("lidar", "low", "high"),
    [
        # That of the message that was logged soonest: a driver is late, and never early.
        (replace(LIDAR, clock=-37.0, jitter=0.4), 36.99, 37.02),
        # Times of points in another unit: a cloud takes a second at most.
        (replace(LIDAR, clock=-37.0, time_scale=1000.0), 36.0, 37.0),
    ],
)
def test_an_offset_is_that_of_the_soonest_message(lidar: Lidar, low: float, high: float, tmp_path: Path) -> None:
    path = write_world(tmp_path / "w.mcap", [lidar], seconds=2)
    with closing(open_recording(path)) as reader:
        own = [each for each in reader.connections if each.topic == "/points"]
        survey = Survey(reader, [], FrameOptions(), Span(None, None, BEGIN_NS))
        clocks = Clocks(survey, own, most=MOTIONS)
        survey.read()
        found = clocks.findings()
    assert low * 1e9 <= found["/points"].offset_ns <= high * 1e9
