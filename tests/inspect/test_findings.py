"""What `pc2scan.check` finds in scans: a table of recordings, each with all its findings."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
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
EMPTY = np.full(9, math.inf, np.float32)

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


@pytest.mark.parametrize("name", CASES)
def test_all_findings_and_no_others(name: str, tmp_path: Path) -> None:
    content, how, expected = CASES[name]
    (topic,) = pc2scan.check(write(tmp_path / "a.mcap", *content, **how)).topics
    assert {each.kind: each.level[0] for each in topic.findings} == {kind: told[0] for kind, told in expected.items()}
    # Defects come first.
    assert [each.level for each in topic.findings] == sorted(each.level for each in topic.findings)
    for each in topic.findings:
        _, *told = expected[each.kind]
        step = None if each.stamp_ns is None else (each.stamp_ns - START) / STEP
        numbers = [number for number in told if not isinstance(number, str)]
        assert [each.count, step][: len(numbers)] == numbers
        assert [text for text in told if isinstance(text, str) and text not in each.text] == []
    # What is no number is no cure.
    assert not [each for each in topic.consumers if "nan" in each.verdict.cure or "inf," in each.verdict.cure]


@pytest.mark.parametrize("step", [1_000, 3_333_333, 99_999_999])
def test_the_interval_is_the_median(step: int, tmp_path: Path) -> None:
    (topic,) = pc2scan.check(write(tmp_path / "a.mcap", *scans(9, step=step))).topics
    assert topic.interval_ns == step
    # Of 0.8, 0.9, 1.1 and 1.2 the lower one of the middle.
    (topic,) = pc2scan.check(write(tmp_path / "b.mcap", *at(0, 1.2, 2, 3.1, 4))).topics
    assert topic.interval_ns == 0.9 * STEP
