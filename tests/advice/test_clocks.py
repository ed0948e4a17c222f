"""Stamps of clouds are compared with those of transforms and of an IMU."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from pc2scan.advice.clocks import Clocks, are_doubtful, moving
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
        clocks = Clocks(survey, [survey.facts(own)], moving(reader.connections, ()))
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
