"""`pc2scan.check` on recordings whose messages are each well-formed, and on sound ones that are like them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan import check
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.messages.tfmessage import encode_transforms
from support import RECORDINGS, needs_shared, sampled
from support.builders import SCAN, TF, Item, Recording, Stream, write_mcap
from support.scan_recordings import GOOD, START, STEP, recording, scans

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from pc2scan.show.check import Check

SECOND = 1_000_000_000

#: x, y, yaw: where the laser is on the robot, given the seconds since the start.
Mount = tuple[float, float, float]


def fixed(_seconds: float) -> Mount:
    return 0.1, 0.0, 0.0


def checked(
    tmp_path: Path, content: Sequence[LaserScan], *consumers: str, mount: Callable[[float], Mount] = fixed
) -> Check:
    """Check scans with 20 transforms a second."""
    end_ns = max(scan.stamp_ns for scan in content) + STEP
    scan_stream, tf_stream = Stream("/scan", SCAN), Stream("/tf", TF)
    items = [Item(scan_stream, scan.stamp_ns, {2: encode_laserscan(scan, "cdr")}) for scan in content]
    for number in range(round(20 * (end_ns - START) / SECOND) + 1):
        stamp_ns, (x, y, yaw) = START + number * SECOND // 20, mount(number / 20)
        rows = [
            ("odom", "base_link", stamp_ns, number / 40, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
            ("base_link", "laser", stamp_ns, x, y, 0.2, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
        ]
        items.append(Item(tf_stream, stamp_ns, {2: encode_transforms(rows, "cdr")}))
    ordered = tuple(sorted(items, key=lambda item: item.log_time_ns))
    path = write_mcap(tmp_path / "a.mcap", Recording((scan_stream, tf_stream), ordered))
    return check(path, consumers=consumers)


def kinds(found: Check) -> dict[str, str]:
    return {finding.kind: finding.level for topic in found.topics for finding in topic.findings}


def test_topics_are_looked_at_apart(tmp_path: Path) -> None:
    longer = replace(GOOD, ranges=np.ones(5, np.float32), angle_min=-0.5, angle_max=0.5)
    path = write_mcap(tmp_path / "a.mcap", recording({"/front": scans(3), "/back": scans(2, longer)}))
    found = [(topic.topic, topic.scans, topic.beams) for topic in check(path).topics]
    assert found == [("/back", 2, (5, 5)), ("/front", 3, (9, 9))]
    assert [topic.topic for topic in check(path, topics=["front"]).topics] == ["/front"]


def test_messages_that_are_no_scans(tmp_path: Path) -> None:
    content = recording({"/scan": scans(3)})
    cut = [
        replace(entry, data={g: data[:50] for g, data in entry.data.items()})
        if entry.stream.topic == "/scan" and entry.log_time_ns > START + STEP
        else entry
        for entry in content.items
    ]
    found = check(write_mcap(tmp_path / "a.mcap", replace(content, items=tuple(cut))))
    (topic,) = found.topics
    assert (topic.scans, topic.findings[0].count, kinds(found)) == (1, 2, {"undecodable": "defect"})


@needs_shared
@pytest.mark.parametrize(
    ("name", "expected"),
    sampled(
        [
            ("jarvis_two_lasers.bag", {"rate"}),
            ("guardian_pallet.bag", {"no-transform", "tilted"}),
            # It has no transforms.
            ("luminar_highway.bag", set()),
        ],
        1,
    ),
)
def test_scans_of_real_sensors_are_accepted(name: str, expected: set[str]) -> None:
    found = check(RECORDINGS / name)
    assert found.exit_status == (name == "luminar_highway.bag")
    assert set(kinds(found)) == expected


def turning(degrees_a_second: float) -> Callable[[float], Mount]:
    return lambda seconds: (0.1, 0.0, math.radians(degrees_a_second) * seconds)


@pytest.mark.parametrize(
    ("mount", "misplaced"),
    [
        (turning(-0.5), {"slam_toolbox"}),
        (lambda seconds: (0.05 * seconds, 0.0, 0.0), {"slam_toolbox", "amcl"}),
        # A joint that stands still, and a mast that swings by centimetres.
        (lambda seconds: (0.1 + 0.03 * math.sin(7 * seconds), 0.0, math.radians(0.5) * math.sin(11 * seconds)), set()),
        # Half a turn to the right and half a turn to the left are the same.
        (lambda seconds: (0.1, 0.0, math.pi * (1 if round(10 * seconds) % 2 else -1)), set()),
    ],
)
def test_frames_that_turn_or_move_on_the_robot(
    mount: Callable[[float], Mount], misplaced: set[str], tmp_path: Path
) -> None:
    found = checked(tmp_path, scans(100), "slam_toolbox", mount=mount)
    assert {each.consumer for each in found.topics[0].consumers if each.outcome == "misplaced"} == misplaced
    assert found.exit_status == ("`target_frame=base_link`" in str(found)) == bool(misplaced)


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


def packets(width: int, step: int) -> list[LaserScan]:
    return filled(*(range(i * step, i * step + width) for i in range(60)))


def by_chance(share: float, number: int = 60) -> list[LaserScan]:
    rng = np.random.default_rng(1)
    return filled(*(np.flatnonzero(rng.random(360) < share) for _ in range(number)))


#: Scans, and what is found in them.
PARTS = {
    "packets with a beam in common": (packets(6, 5), "parts"),
    "a quarter of a turn": (packets(90, 90), "parts"),
    "some packets are empty": (filled(*(range(i, i + 6) if i % 360 < 200 else () for i in range(0, 720, 6))), "parts"),
    "a wall on one side": (filled(*(range(100, 160) for _ in range(30))), ""),
    "a robot that turns before a wall": (packets(70, 20), ""),
    "a lidar that is coarser than the beams": (by_chance(0.25), ""),
    "few returns, which are everywhere over time": (by_chance(0.01, 300), ""),
    "two posts that a turning robot sees": (filled(*((30 * i, 30 * i + 5) for i in range(20))), ""),
}


@pytest.mark.parametrize(("content", "expected"), PARTS.values(), ids=PARTS)
def test_parts_of_a_turn(content: list[LaserScan], expected: str, tmp_path: Path) -> None:
    found = checked(tmp_path, content, "slam_toolbox")
    assert found.exit_status == bool(expected)
    assert set(kinds(found)) - {"no-returns"} == ({expected} if expected else set())
