"""Scans that SLAM cannot use although each message is well-formed; and for each, sound ones that are like them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

import pc2scan
from pc2scan.core.consumers import CONSUMERS
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.messages.tfmessage import encode_transforms
from support import sampled
from support.builders import SCAN, TF, Item, Recording, Stream, write_mcap
from support.scan_recordings import GOOD, START, STEP, scans

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from pc2scan.show.check import Check

SECOND = 1_000_000_000

#: x, y, yaw: where the laser is on the robot, given the seconds since the start.
Mount = tuple[float, float, float]


def fixed(_seconds: float) -> Mount:
    return 0.1, 0.0, 0.0


def written(
    path: Path,
    content: Iterable[LaserScan],
    log_times_ns: Iterable[int],
    *,
    driven: tuple[float, float],
    mount: Callable[[float], Mount] = fixed,
) -> Path:
    """Write scans, with transforms of a robot from the one to the other second of ``driven``, 20 times a second."""
    scan_stream, tf_stream = Stream("/scan", SCAN), Stream("/tf", TF)
    items = [
        Item(scan_stream, log_time_ns, {2: encode_laserscan(scan, "cdr")})
        for scan, log_time_ns in zip(content, log_times_ns, strict=True)
    ]
    first, last = (round(20 * seconds) for seconds in driven)
    for number in range(first, last + 1):
        stamp_ns, (x, y, yaw) = START + number * SECOND // 20, mount(number / 20)
        rows = [
            ("odom", "base_link", stamp_ns, number / 40, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
            ("base_link", "laser", stamp_ns, x, y, 0.2, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
        ]
        items.append(Item(tf_stream, stamp_ns, {2: encode_transforms(rows, "cdr")}))
    ordered = tuple(sorted(items, key=lambda item: item.log_time_ns))
    return write_mcap(path, Recording((scan_stream, tf_stream), ordered))


def checked(
    tmp_path: Path,
    content: Sequence[LaserScan],
    *consumers: str,
    driven: tuple[float, float] | None = None,
    mount: Callable[[float], Mount] = fixed,
    log_times_ns: Iterable[int] | None = None,
) -> Check:
    logged = [scan.stamp_ns for scan in content] if log_times_ns is None else log_times_ns
    last = max(scan.stamp_ns for scan in content)
    seconds = (0.0, (last - START) / SECOND + 0.1) if driven is None else driven
    path = written(tmp_path / "a.mcap", content, logged, driven=seconds, mount=mount)
    return pc2scan.check(path, consumers=consumers)


def outcomes(found: Check) -> dict[str, tuple[str, int]]:
    (topic,) = found.topics
    return {each.consumer: (each.outcome, each.scans) for each in topic.consumers}


def kinds(found: Check) -> dict[str, str]:
    (topic,) = found.topics
    return {finding.kind: finding.level for finding in topic.findings}


def text(found: Check, kind: str) -> str:
    (topic,) = found.topics
    return next(finding.text for finding in topic.findings if finding.kind == kind)


DRIVEN = {(0.0, 4.95): 50, (5.0, 10.0): 50, (3.0, 10.0): 30, (0.0, 7.0): 29}


@pytest.mark.parametrize(
    ("driven", "unplaced", "consumer"),
    sampled([(*driven, consumer) for consumer in CONSUMERS for driven in DRIVEN.items()], 9),
)
def test_transforms_that_end_half_way(
    driven: tuple[float, float], unplaced: int, consumer: str, tmp_path: Path
) -> None:
    found = checked(
        tmp_path, scans(100, replace(GOOD, angle_max=1.25 if consumer == "gmapping" else 1)), consumer, driven=driven
    )
    assert outcomes(found)[consumer] == ("ignored", unplaced)
    assert (found.exit_status, kinds(found)) == (1, {"no-transform": "defect"})
    assert f"ignored {unplaced} of 100 scans" in str(found)


@pytest.mark.parametrize(
    ("number", "driven"),
    [
        (100, (0.0, 10.0)),
        (100, (1.9, 10.0)),
        (100, (0.0, 8.1)),
        (100, (0.9, 9.0)),
        (15, (0.5, 1.4)),
        (1000, (0.0, 95.0)),
    ],
    ids=str,
)
def test_transforms_that_begin_a_little_later(number: int, driven: tuple[float, float], tmp_path: Path) -> None:
    found = checked(tmp_path, scans(number), "slam_toolbox", "amcl", "nav2", driven=driven)
    assert found.exit_status == 0
    assert set(kinds(found).items()) <= {("no-transform", "notice")}


def turning(degrees_a_second: float) -> Callable[[float], Mount]:
    return lambda seconds: (0.1, 0.0, math.radians(degrees_a_second) * seconds)


def trembling(seconds: float) -> Mount:
    """A joint that stands still, and a mast that swings by centimetres."""
    return 0.1 + 0.03 * math.sin(7 * seconds), 0.0, math.radians(0.5) * math.sin(11 * seconds)


@pytest.mark.parametrize(
    ("mount", "misplaced"),
    [
        (turning(30.0), {"slam_toolbox"}),
        (turning(-0.5), {"slam_toolbox"}),
        (lambda seconds: (0.05 * seconds, 0.0, 0.0), {"slam_toolbox", "amcl"}),
        (lambda seconds: (0.5 * math.cos(seconds), 0.5 * math.sin(seconds), seconds), {"slam_toolbox", "amcl"}),
        (trembling, set()),
        (fixed, set()),
        # Half a turn to the right and half a turn to the left are the same.
        (lambda seconds: (0.1, 0.0, math.pi * (1 if round(10 * seconds) % 2 else -1)), set()),
    ],
)
def test_frames_that_turn_or_move_on_the_robot(
    mount: Callable[[float], Mount], misplaced: set[str], tmp_path: Path
) -> None:
    found = checked(tmp_path, scans(100), "slam_toolbox", driven=(0.0, 10.0), mount=mount)
    assert {name for name, (outcome, _) in outcomes(found).items() if outcome == "misplaced"} == misplaced
    assert found.exit_status == ("slam_toolbox" in misplaced)
    assert not misplaced or "`target_frame=base_link`" in found.topics[0].consumers[0].verdict.cure


CIRCLE = LaserScan(
    0, 0, "laser", -math.pi, math.pi * 179 / 180, math.pi / 180, 0, 0.1, 0.5, 30, np.full(360, np.inf, np.float32)
)


def filled(*beams: Iterable[int]) -> list[LaserScan]:
    """Scans of 360 beams with returns in these."""
    content = []
    for number, returns in enumerate(beams):
        ranges = CIRCLE.ranges.copy()
        ranges[np.array(list(returns), int) % 360] = 5.0
        content.append(replace(CIRCLE, stamp_ns=START + number * STEP, ranges=ranges))
    return content


def packets(width: int, step: int, number: int = 60) -> list[LaserScan]:
    return filled(*(range(i * step, i * step + width) for i in range(number)))


def by_chance(share: float, number: int = 60) -> list[LaserScan]:
    rng = np.random.default_rng(1)
    return filled(*(np.flatnonzero(rng.random(360) < share) for _ in range(number)))


PARTS = {
    "packets of 5 degrees": packets(5, 5),
    "packets with a beam in common": packets(6, 5),
    "every tenth packet": packets(4, 37),
    "a quarter of a turn": packets(90, 90),
    "clockwise": packets(20, -20),
    "some packets are empty": filled(*(range(i, i + 6) if i % 360 < 200 else () for i in range(0, 720, 6))),
}

#: Sound scans with few returns, or with other ones from scan to scan.
SOUND = {
    "a wall on one side": filled(*(range(100, 160) for _ in range(30))),
    "a robot that turns before a wall": packets(70, 20),
    "a lidar that is coarser than the beams": by_chance(0.25),
    "a yard with trees": by_chance(0.1),
    "a sector in a full circle": filled(*(range(160, 200) for _ in range(30))),
    "alternating rings": filled(*(range(i % 4, 360, 4) for i in range(60))),
    "one full turn and one half": filled(*(range(360 if i % 2 else 170) for i in range(60))),
    "one scan": filled(range(40)),
    "two posts that a turning robot sees": filled(*((30 * i, 30 * i + 5) for i in range(20))),
}


@pytest.mark.parametrize("content", PARTS.values(), ids=PARTS)
def test_packets_are_parts_of_a_turn(content: list[LaserScan], tmp_path: Path) -> None:
    found = checked(tmp_path, content, "slam_toolbox")
    assert (found.exit_status, kinds(found)["parts"]) == (1, "defect")
    assert "of the directions have a return" in text(found, "parts")


@pytest.mark.parametrize("content", SOUND.values(), ids=SOUND)
def test_sound_scans_are_no_parts(content: list[LaserScan], tmp_path: Path) -> None:
    found = checked(tmp_path, content, "slam_toolbox")
    assert found.exit_status == 0
    assert set(kinds(found)) <= {"no-returns"}


def test_scans_that_fill_a_few_directions_cannot_be_matched(tmp_path: Path) -> None:
    few = filled(*(range(10, 15) for _ in range(20)))
    found = checked(tmp_path, few, "slam_toolbox")
    assert (found.exit_status, kinds(found)) == (1, {"few-directions": "defect"})
    assert "only 5 of 360 directions" in text(found, "few-directions")
    # The collision monitor stops at whatever is there.
    assert checked(tmp_path, few, "nav2").exit_status == 0
    # Over time, the few returns are everywhere.
    assert checked(tmp_path, by_chance(0.01, 300), "nav2").exit_status == 0
    assert "few-directions" not in kinds(checked(tmp_path, by_chance(0.01, 300)))


def two_clocks(number: int, *, switched: bool = False) -> tuple[list[LaserScan], list[int]]:
    """Scans whose stamps are now the time of day, and now seconds since the start of the sensor; and log times."""
    logged = [START + i * STEP // 2 for i in range(number)]
    since_start = [number // 2 <= i if switched else i % 2 == 1 for i in range(number)]
    stamps = [
        100 * SECOND + log_time_ns - START if other else log_time_ns
        for log_time_ns, other in zip(logged, since_start, strict=True)
    ]
    return [replace(GOOD, stamp_ns=stamp_ns, scan_time=0.05 if switched else 0.1) for stamp_ns in stamps], logged


@pytest.mark.parametrize("switched", [False, True], ids=["alternating", "once"])
def test_stamps_that_jump_are_of_another_clock(switched: bool, tmp_path: Path) -> None:
    content, logged = two_clocks(60, switched=switched)
    found = checked(tmp_path, content, "nav2", log_times_ns=logged)
    (topic,) = found.topics
    assert topic.interval_ns == (STEP / 2 if switched else None)
    told = kinds(found)
    assert told["clocks"] == "notice"
    assert not {"rate", "scan-time"} & set(told)
    times = "1 time" if switched else "59 times"
    assert f"the stamps jump {times} to another time, by up to 1,699,999," in text(found, "clocks")


@pytest.mark.parametrize(
    "logged",
    [
        # Logged up to 4 s late, a pause of an hour, and a recording that was played at ten times its rate.
        [START + i * STEP + (i // 20) * 2 * SECOND for i in range(60)],
        [START + i * STEP + (3600 * SECOND if i > 30 else 0) for i in range(60)],
        [START + i * STEP // 10 for i in range(60)],
    ],
    ids=["late", "paused", "played fast"],
)
def test_other_log_times_are_no_other_clock(logged: list[int], tmp_path: Path) -> None:
    found = checked(tmp_path, scans(60), log_times_ns=logged)
    assert "clocks" not in kinds(found)
    assert found.topics[0].interval_ns == pytest.approx(STEP)
