"""What is found out before a conversion begins."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.advice import measurements as measure_module
from pc2scan.advice.measurements import ask_measurements, measure
from pc2scan.advice.survey import Span, Survey
from pc2scan.bags.opening import open_recording
from pc2scan.core.params import ProjectionParams
from pc2scan.errors import ParameterError
from pc2scan.request.spec import ScanSpec
from pc2scan.transforms.builder import TransformBuilder
from pc2scan.transforms.placing import FrameOptions, Placer
from support.builders import CLOUD, SECOND, T0, Item, Recording, Stream, cloud, item, write_mcap

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.advice.measurements import Measurements

TURN = 2 * math.pi
NAMES = ("x", "y", "z", "time")
FRONT, REAR = Stream("/front", CLOUD), Stream("/rear", CLOUD)


def turning(rate: float = -10 * TURN, start: float = 0.5, columns: int = 300) -> NDArray[np.float32]:
    """One turn as x, y, z and seconds before the stamp."""
    times = np.linspace(-TURN / abs(rate), 0, columns, endpoint=False)
    angles = start + rate * (times - times[0])
    return np.stack([5 * np.cos(angles), 5 * np.sin(angles), 0 * angles, times], axis=1).astype(np.float32)


def recorded(stream: Stream, stamps: Sequence[int], points: NDArray[np.float32], names: tuple[str, ...]) -> list[Item]:
    return [
        item(stream, stamp, lambda g, s, t=stamp: cloud(points, g, seq=s, stamp_ns=t, names=names), number)  # type: ignore[misc]
        for number, stamp in enumerate(stamps)
    ]


def measured(
    folder: Path, items: list[Item], params: ProjectionParams, placer: Placer | None = None, **cut: Any
) -> tuple[dict[str, Measurements], list[str]]:
    streams = tuple(dict.fromkeys(entry.stream for entry in items))
    items = sorted(items, key=lambda entry: entry.log_time_ns)
    reader = open_recording(write_mcap(folder / "drive.mcap", Recording(streams, tuple(items))))
    try:
        placer = placer or Placer()
        spec = ScanSpec(params=replace(params, target_frame=placer.target_frame))
        span = Span(cut.get("start_ns"), cut.get("stop_ns"), 0)
        survey = Survey(reader, [], FrameOptions(), span)
        topics = survey.topics(reader.connections).values()
        for facts in topics:
            ask_measurements(facts, spec)
        survey.read()
        results = {facts.topic: measure(facts, spec, placer) for facts in topics}
        return {topic: timing for topic, (timing, _) in results.items()}, [
            note for _, notes in results.values() for note in notes
        ]
    finally:
        reader.close()


AUTO = ProjectionParams(geometry="centered", scan_time="auto", time_increment="auto", min_height=-1.0)


def test_each_topic_has_its_own_scan_time(tmp_path: Path) -> None:
    front = recorded(FRONT, [T0 + n * SECOND // 10 + (n == 3) * 7 for n in range(8)], turning(), NAMES)
    rear = recorded(REAR, [T0 + n * SECOND // 20 for n in range(8)], turning(), NAMES)
    timings, notes = measured(tmp_path, front + rear, ProjectionParams(scan_time="auto"))
    assert {topic: timing.scan_time for topic, timing in timings.items()} == {"/front": 0.1, "/rear": 0.05}
    assert all((timing.time_increment, timing.first_beam_ns) == (0, 0) for timing in timings.values())
    assert notes == [
        "/front: scan_time is 0.1 s, the median interval of its 8 stamps",
        "/rear: scan_time is 0.05 s, the median interval of its 8 stamps",
    ]


def test_only_the_first_clouds_within_the_cut_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure_module, "STAMPS", 5)
    intervals = [3] * 4 + [1] * 4 + [2] * 8
    stamps = (T0 + np.cumsum([0, *intervals]) * SECOND // 10).tolist()
    items = recorded(FRONT, stamps, turning(columns=8), NAMES)
    params = ProjectionParams(scan_time="auto")
    timings, notes = measured(tmp_path, items, params)
    assert timings["/front"].scan_time == 0.3
    assert notes == ["/front: scan_time is 0.3 s, the median interval of the first 5 stamps"]
    later, _ = measured(tmp_path, items, params, start_ns=stamps[4], stop_ns=stamps[9])
    assert later["/front"].scan_time == 0.1


def test_a_scan_that_begins_with_the_sweep_is_timed(tmp_path: Path) -> None:
    items = recorded(FRONT, [T0 + n * SECOND // 10 for n in range(3)], turning(), NAMES)
    params = ProjectionParams(
        geometry="centered", angle_min=0.5, angle_max=0.5 + TURN, beams=1000, time_increment="auto", scan_time=0.25
    )
    timings, notes = measured(tmp_path, items, params)
    timing = timings["/front"]
    assert timing.scan_time == 0.25
    assert timing.time_increment == pytest.approx(-1e-4, rel=1e-3)
    assert timing.first_beam_ns == pytest.approx(0, abs=400_000)
    assert "time_increment is -0.0001 s, from time: the lidar turns clockwise" in notes[0]


def test_a_scan_that_begins_elsewhere_is_told_where_to_begin(tmp_path: Path) -> None:
    items = recorded(FRONT, [T0 + n * SECOND // 10 for n in range(3)], turning(), NAMES)
    timings, notes = measured(tmp_path, items, AUTO)
    assert (timings["/front"].time_increment, timings["/front"].first_beam_ns) == (0, 0)
    assert "the clouds begin inside the scan's sector" in notes[1]
    assert "`angle_min=0.52" in notes[1]


def test_beams_are_timed_in_the_scans_frame(tmp_path: Path) -> None:
    builder = TransformBuilder()
    yaw = 1.25
    builder.add(
        [("base", "lidar", T0, 0.0, 0.0, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))],
        static=True,
    )
    items = recorded(FRONT, [T0], turning(), NAMES)
    placer = Placer("base", "", builder.build(), 0)
    _, notes = measured(tmp_path, items, AUTO, placer)
    assert "`angle_min=1.7" in notes[1]


def rings(columns: int) -> NDArray[np.float32]:
    """A turn of four lasers as x, y, z and the laser's number."""
    azimuths, ups = np.meshgrid(np.arange(columns) * TURN / columns, np.radians([-6.0, -2.0, 2.0, 6.0]))
    numbers = np.repeat(np.arange(4), columns)
    parts = [5 * np.cos(azimuths), 5 * np.sin(azimuths), 5 * np.tan(ups)]
    return np.stack([*(part.ravel() for part in parts), numbers], axis=1).astype(np.float32)


RINGS = ("x", "y", "z", "ring")


def test_each_topic_has_the_beams_of_its_lidar(tmp_path: Path) -> None:
    front = recorded(FRONT, [T0, T0 + SECOND], rings(900), RINGS)
    rear = recorded(REAR, [T0, T0 + SECOND], rings(360)[:, :3], ("x", "y", "z"))
    found, notes = measured(tmp_path, front + rear, ProjectionParams(beams="auto"))
    assert {topic: round(TURN / each.azimuth_step) for topic, each in found.items()} == {"/front": 900, "/rear": 360}
    assert notes == [
        "/front: beams is 900, angle_increment 0.00698132 rad: the lidar measures every 0.4 deg",
        "/rear: beams is 360, angle_increment 0.0174533 rad: the lidar measures every 1 deg",
    ]


def test_clouds_without_rings_are_refused(tmp_path: Path) -> None:
    points = np.random.default_rng(3).normal(0, 5, (5000, 3)).astype(np.float32)
    items = recorded(FRONT, [T0, T0 + SECOND], points, ("x", "y", "z"))
    with pytest.raises(ParameterError, match="of 2 of the first 2 are in no regular rings") as caught:
        measured(tmp_path, items, ProjectionParams(beams="auto"))
    assert (caught.value.name, "`angle_increment`" in (caught.value.hint or "")) == ("beams", True)
