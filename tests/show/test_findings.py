"""What `pc2scan.check` finds in scans: a table of recordings, each with all its findings."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.core.consumers import CONSUMERS
from support.scan_recordings import GOOD, START, STEP, scans, write

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pc2scan.messages.laserscan import LaserScan


def at(*steps: float) -> list[LaserScan]:
    return [replace(GOOD, stamp_ns=START + round(step * STEP)) for step in steps]


def like(count: int = 3, **changes: Any) -> list[LaserScan]:
    return scans(count, replace(GOOD, **changes))


def ranges(*values: float, **changes: Any) -> list[LaserScan]:
    return like(4, ranges=np.array([*values, *[1] * (9 - len(values))], np.float32), **changes)


def with_one(index: int, count: int, **changes: Any) -> list[LaserScan]:
    """Scans of which one is different."""
    content = scans(count)
    content[index] = replace(content[index], **changes)
    return content


ANGLES: tuple[dict[str, Any], ...] = ({"angle_min": math.nan}, {"angle_increment": math.inf}, {"angle_increment": 0.0})


def mounted(transform: str) -> dict[str, Any]:
    """Asks with a transform of the laser on the robot."""
    return {"static_tf": transform}


EMPTY = np.full(9, math.inf, np.float32)

#: Without a preset gmapping places the beams half an increment to the right.
FINE = dict.fromkeys(CONSUMERS, "accepted") | {"gmapping": "shifted"}
NOBODY: dict[str, Any] = {"status": 1, **dict.fromkeys(CONSUMERS, "ignored")}
BARE: dict[str, Any] = {"tree": (("odom", "base_link"),)}
ROBOT: dict[str, Any] = {"tree": (("odom", "laser"),)}

#: What it is; the scans, and how they are recorded; and all findings: kinds with levels (d: defect, n: notice), how
#: many scans have them, the step of the first one, and parts of the text.
Case = tuple["Sequence[LaserScan]", dict[str, Any], dict[str, tuple[Any, ...]]]
CASES: dict[str, Case] = {
    "good": (scans(10), {}, {}),
    "one": (scans(1), {}, {}),
    "none": ((), {}, {"no-scans": ("d",)}),
    # Stamps.
    "stamps that go back or repeat": (
        at(0, 1, 2, 2, 1, 2, 3),
        {},
        {"stamps-repeated": ("d", 1, 2), "stamps-back": ("d", 1, 1)},
    ),
    "stamps of zero": ([replace(scan, stamp_ns=0) for scan in scans(3)], {}, {"stamps-zero": ("d", 3)}),
    "a delay": (scans(3), {"delay": 900_000_000}, {}),
    "a long delay": (scans(3), {"delay": 1_500_000_000}, {"stamps-far": ("n", 0, "1.500 to 1.500 s after")}),
    "logged before": (scans(3), {"delay": -2_000_000_000}, {"stamps-far": ("n", 0, "2.000 to 2.000 s before")}),
    "delays that differ": (at(0, 0.9, 2), {"delay": 1_500_000_000}, {"stamps-far": ("n", 0, "1.500 to 1.510 s after")}),
    "a rate that trembles": (at(0, 1, 2.2, 3, 4.1, 5), {}, {}),
    # Of 7 intervals one is twice the usual and one a fifth.
    "a rate that stutters": (at(0, 1, 2, 4, 5, 6, 6.2, 7), {}, {"rate": ("n", 2, "2 of 7", "0.200 s")}),
    # Times within a scan.
    "beams within the scan": (like(time_increment=0.0125), {}, {}),
    "beams behind the scan": (like(time_increment=0.013), {}, {"time-increment": ("n",)}),
    "beams and no scan time": (like(time_increment=0.013, scan_time=0), {}, {}),
    "another scan time": (like(scan_time=1 / 30), {}, {"scan-time": ("n", "0.03333 s")}),
    "no number as scan time": (like(scan_time=math.nan), {}, {"times": ("n",)}),
    "a scan time below zero": (like(scan_time=-0.1), {}, {"times": ("n",)}),
    # Ranges.
    "infinite ranges": (ranges(math.inf), {}, {}),
    "short ranges": (ranges(0, 0.25), {}, {"ranges-short": ("n", "22.2%", "11.1% are 0")}),
    "long ranges": (ranges(31), {}, {"ranges-long": ("n",)}),
    "ranges of nan": (ranges(math.nan), {}, {"ranges-nan": ("n",)}),
    "ranges of zero that are returns": (
        ranges(0, range_min=0),
        {},
        {"ranges-zero": ("n", "11.1% of the ranges are 0, and range_min is 0 m or less")},
    ),
    "millimetres": (
        like(ranges=GOOD.ranges * 1000, range_min=100, range_max=30_000),
        {},
        {"units": ("n", "ranges of the first scan are 1,000 to 9,000 m (median 5,000 m)")},
    ),
    # Returns.
    "one scan without returns": (with_one(2, 4, ranges=EMPTY), {}, {"no-returns": ("n", 1, 2)}),
    "scans without returns": (like(4, ranges=EMPTY), {}, {"no-returns": ("d", 4, 0)}),
    "scans without beams": (like(2, ranges=EMPTY[:0]), {}, {"no-returns": ("d",)}),
    "as many intensities": (like(2, intensities=np.ones(9, np.float32)), {}, {}),
    "too few intensities": (like(2, intensities=np.ones(8, np.float32)), {}, {"intensities": ("d",)}),
    "one beam fewer": (with_one(2, 3, ranges=GOOD.ranges[:8]), {}, {"length": ("d", "8 to 9")}),
    # Angles.
    **{f"angles: {wrong}": (like(**wrong), {}, {"angles": ("d",)}) for wrong in ANGLES},
    # Transforms; the tree is odom <- base_link <- laser otherwise.
    "no transforms": (scans(3), {"tree": ()}, {"no-transforms": ("n",)}),
    "an unknown frame": (scans(3), {"tree": (("odom", "base_link"),)}, {"frame-unknown": ("d",)}),
    "no odometry": (scans(3), {"tree": (("base_link", "laser"),)}, {"no-odometry-frame": ("d",)}),
    "no robot": (scans(3), {"tree": (("odom", "laser"),)}, {"no-robot-frame": ("n",)}),
    "two trees": (scans(3), {"tree": (("odom", "base_link"), ("sensors", "laser"))}, {"frame-apart": ("d",)}),
    "a slash before the frame": (like(frame_id="/laser"), {}, {}),
    "no frame": (like(frame_id=""), {}, {"no-frame": ("d",)}),
    # The last two of twelve are more than a second after the first; of forty, thirty.
    "a few scans without a transform": (scans(13), {"static": False}, {"no-transform": ("n",)}),
    "many scans without a transform": (scans(40), {"static": False}, {"no-transform": ("d",)}),
    "scans behind the transforms": (
        [replace(scan, stamp_ns=scan.stamp_ns + 5 * 10**9) for scan in scans(3)],
        {"static": False, "delay": 5 * 10**9},
        {"no-transform": ("d", 3)},
    ),
    "an optical frame without transforms": (
        like(frame_id="camera_optical_frame"),
        {"tree": ()},
        {"no-transforms": ("n",), "optical-frame": ("d",)},
    ),
    "several defects": (
        like(frame_id="", ranges=np.full(9, math.nan, np.float32)),
        {},
        {"no-frame": ("d",), "no-returns": ("d", 3), "ranges-nan": ("n",)},
    ),
}


INFINITE: Case = (like(2, ranges=EMPTY, range_max=math.inf), {}, {"no-returns": ("d",)})
BACK: Case = ([*scans(3), *scans(1)], {}, {"stamps-back": ("d",)})
HALF_OPEN: Case = (like(angle_max=1.25), {}, {})

#: The same, with what is asked for, and the exit status and outcomes for consumers that it has.
ASKED: dict[str, tuple[Case, dict[str, Any], dict[str, Any]]] = {
    # Whose verdict counts.
    "infinite, for all": (INFINITE, {}, {"status": 1}),
    "infinite, for nav2": (INFINITE, {"consumers": "nav2"}, {"status": 1, "nav2": "misplaced"}),
    "infinite, for two": (INFINITE, {"consumers": ["amcl", "nav2"]}, {"status": 1}),
    # They are accepted, but every scan is empty.
    "infinite, for amcl": (INFINITE, {"consumers": ["slam_toolbox", "amcl"]}, {"status": 1, "amcl": "accepted"}),
    "stamps back, for all": (BACK, {}, {"status": 1, **FINE}),
    "stamps back, for all by name": (BACK, {"consumers": sorted({*CONSUMERS} - {"gmapping"})}, {"status": 1}),
    # Half a beam counts only for those that are asked for.
    "half a beam": (CASES["good"], {}, {"status": 0, **FINE}),
    "half a beam for gmapping": (CASES["good"], {"consumers": "gmapping"}, {"status": 1}),
    "half-open for gmapping": (HALF_OPEN, {"consumers": "gmapping"}, {"status": 0}),
    "half-open for slam_toolbox": (HALF_OPEN, {"consumers": "slam_toolbox"}, {"status": 1}),
    "no scans": (CASES["none"], {"consumers": "amcl"}, {"status": 1}),
    # Scans that nobody can place are dropped. Navigation and Cartographer need no odometry.
    **{f"no place for {name}": (CASES["no transforms"], {"consumers": name}, NOBODY) for name in CONSUMERS},
    "no odometry": (
        CASES["no odometry"],
        {},
        FINE | dict.fromkeys(("slam_toolbox", "gmapping", "amcl"), "ignored"),
    ),
    "few without a transform": (CASES["a few scans without a transform"], {}, FINE),
    # What the robot's frame is called is not known, unless it is named.
    "an unnamed robot": (CASES["no robot"], {}, FINE),
    "a named robot": ((scans(3), ROBOT, {"no-robot-frame": ("n",)}), {"base_frame": "chassis"}, NOBODY),
    # gmapping does not start with tilted scans. It looks at a point above the robot, not at the axis: in front of
    # the robot a degree is too much.
    "tilted": (
        (scans(3), BARE, {"tilted": ("n",)}),
        mounted("base_link laser 0 0 0.3 0 7.6deg 0"),
        FINE | {"gmapping": "ignored"},
    ),
    "tilted a little": ((scans(3), BARE, {}), mounted("base_link laser 0 0 0.3 0 1deg 0"), FINE),
    "tilted in front": (
        (scans(3), BARE, {}),
        mounted("base_link laser 0.3 0 0.3 0 1deg 0"),
        FINE | {"gmapping": "ignored"},
    ),
    "upside down": ((scans(3), BARE, {}), mounted("base_link laser 0 0 0.3 180deg 0 0"), FINE),
    "an optical frame": (
        (like(frame_id="camera"), BARE, {"optical-frame": ("d",)}),
        mounted("base_link camera 0 0 0.3 -90deg 0 0"),
        {"status": 1},
    ),
    "an optical name alone": (
        (like(frame_id="camera_optical_frame"), BARE, {}),
        mounted("base_link camera_optical_frame 0 0 0.3 0 0 0"),
        FINE,
    ),
    "an optical name without a transform": (
        (like(frame_id="camera_optical_frame"), {}, {"frame-unknown": ("d",), "optical-frame": ("d",)}),
        {},
        {"status": 1},
    ),
    # Frames have other names.
    "other frames": (
        (scans(3), {"tree": (("world", "robot"), ("robot", "laser"))}, {}),
        {"odom_frame": "/world", "base_frame": "robot"},
        FINE,
    ),
}


@pytest.mark.parametrize(
    ("case", "asked", "told"),
    [*((case, {}, {}) for case in CASES.values()), *ASKED.values()],
    ids=[*CASES, *(f"asked: {name}" for name in ASKED)],
)
def test_all_findings_and_no_others(case: Case, asked: dict[str, Any], told: dict[str, Any], tmp_path: Path) -> None:
    content, how, expected = case
    found = pc2scan.check(write(tmp_path / "a.mcap", *content, **how), **asked)
    (topic,) = found.topics
    assert {each.kind: each.level[0] for each in topic.findings} == {kind: of[0] for kind, of in expected.items()}
    # Defects come first.
    assert [each.level for each in topic.findings] == sorted(each.level for each in topic.findings)
    for each in topic.findings:
        _, *details = expected[each.kind]
        step = None if each.stamp_ns is None else (each.stamp_ns - START) / STEP
        numbers = [number for number in details if not isinstance(number, str)]
        assert [each.count, step][: len(numbers)] == numbers
        assert [text for text in details if isinstance(text, str) and text not in each.text] == []
    outcomes = {each.consumer: each.outcome for each in topic.consumers}
    assert list(outcomes) == (list(CONSUMERS) if content else [])
    assert {"status": found.exit_status, **outcomes} == {"status": found.exit_status, **outcomes, **told}
    # What is no number is no cure.
    assert not [each for each in topic.consumers if "nan" in each.verdict.cure or "inf," in each.verdict.cure]
    json.dumps(found.as_dict(), allow_nan=False)


@pytest.mark.parametrize("step", [1_000, 3_333_333, 99_999_999])
def test_the_interval_is_the_median(step: int, tmp_path: Path) -> None:
    (topic,) = pc2scan.check(write(tmp_path / "a.mcap", *scans(9, step=step))).topics
    assert topic.interval_ns == step
    # Of 0.8, 0.9, 1.1 and 1.2 the lower one of the middle.
    (topic,) = pc2scan.check(write(tmp_path / "b.mcap", *at(0, 1.2, 2, 3.1, 4))).topics
    assert topic.interval_ns == 0.9 * STEP
