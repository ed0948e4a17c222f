from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.inspect.scan_topic import ScanTopic
from support.scan_recordings import GOOD, START, STEP, scans

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pc2scan.inspect.findings import Finding
    from pc2scan.messages.laserscan import LaserScan


def seen(content: Iterable[LaserScan], delay: int = 0) -> ScanTopic:
    topic = ScanTopic()
    for scan in content:
        topic.add(scan, scan.stamp_ns + delay)
    return topic


def findings(content: Iterable[LaserScan], delay: int = 0) -> dict[str, Finding]:
    return {finding.kind: finding for finding in seen(content, delay).findings()}


def at(*steps: float) -> list[LaserScan]:
    return [replace(GOOD, stamp_ns=START + round(step * STEP)) for step in steps]


def test_good_scans() -> None:
    assert findings(scans(10)) == {}
    assert findings(scans(1)) == {}


def test_stamps_that_go_back_or_repeat() -> None:
    found = findings(at(0, 1, 2, 2, 1, 2, 3))
    assert (found["stamps-repeated"].count, found["stamps-repeated"].stamp_ns) == (1, START + 2 * STEP)
    assert (found["stamps-back"].count, found["stamps-back"].stamp_ns) == (1, START + STEP)
    assert {finding.level for finding in found.values()} == {"defect"}
    zero = findings(replace(scan, stamp_ns=0) for scan in scans(3))
    assert (set(zero), zero["stamps-zero"].count) == ({"stamps-zero"}, 3)


def test_stamps_far_from_log_times() -> None:
    assert findings(scans(3), delay=900_000_000) == {}
    assert "1.500 to 1.500 s after" in findings(scans(3), delay=1_500_000_000)["stamps-far"].text
    assert "2.000 to 2.000 s before" in findings(scans(3), delay=-2_000_000_000)["stamps-far"].text


def test_rates_that_stutter() -> None:
    assert findings(at(0, 1, 2.2, 3, 4.1, 5)) == {}
    found = findings(at(0, 1, 2, 4, 5, 6, 6.2, 7))
    assert set(found) == {"rate"}
    # Of 7 intervals one is twice the usual and one a fifth.
    assert found["rate"].count == 2
    assert "2 of 7" in found["rate"].text
    assert "0.200 s" in found["rate"].text


@pytest.mark.parametrize("step", [1_000, 3_333_333, 99_999_999, 3_600_000_000_000])
def test_the_median_interval(step: int) -> None:
    assert seen(scans(9, step=step)).interval_ns == step
    # Of 0.8, 0.9, 1.1 and 1.2 the lower one of the middle.
    assert seen(at(0, 1.2, 2, 3.1, 4)).interval_ns == 0.9 * STEP


def test_times_within_a_scan() -> None:
    assert findings(scans(3, replace(GOOD, time_increment=0.0125))) == {}
    assert set(findings(scans(3, replace(GOOD, time_increment=0.013)))) == {"time-increment"}
    assert set(findings(scans(3, replace(GOOD, time_increment=0.013, scan_time=0)))) == set()
    found = findings(scans(3, replace(GOOD, scan_time=1 / 30)))
    assert set(found) == {"scan-time"}
    assert "0.03333 s" in found["scan-time"].text
    assert set(findings(scans(3, replace(GOOD, scan_time=math.nan)))) == {"times"}
    assert set(findings(scans(3, replace(GOOD, scan_time=-0.1)))) == {"times"}


def test_ranges() -> None:
    def with_ranges(*values: float) -> dict[str, Finding]:
        return findings(scans(4, replace(GOOD, ranges=np.array([*values, *[1] * (9 - len(values))], np.float32))))

    assert set(with_ranges(math.inf)) == set()
    found = with_ranges(0, 0.25)
    assert set(found) == {"ranges-short"}
    assert "22.2%" in found["ranges-short"].text
    assert "11.1% are 0" in found["ranges-short"].text
    assert set(with_ranges(31)) == {"ranges-long"}
    assert set(with_ranges(math.nan)) == {"ranges-nan"}


def test_scans_without_returns() -> None:
    empty = replace(GOOD, ranges=np.full(9, math.inf, np.float32))
    content = scans(4)
    content[2] = replace(empty, stamp_ns=content[2].stamp_ns)
    found = findings(content)["no-returns"]
    assert (found.level, found.count, found.stamp_ns) == ("notice", 1, content[2].stamp_ns)
    assert findings(scans(4, empty))["no-returns"].level == "defect"
    nothing = replace(GOOD, ranges=np.empty(0, np.float32))
    assert set(findings(scans(2, nothing))) == {"no-returns"}


def test_arrays_of_other_lengths() -> None:
    assert findings(scans(2, replace(GOOD, intensities=np.ones(9, np.float32)))) == {}
    assert set(findings(scans(2, replace(GOOD, intensities=np.ones(8, np.float32))))) == {"intensities"}
    found = findings([*scans(2), replace(GOOD, stamp_ns=START + 2 * STEP, ranges=GOOD.ranges[:8])])
    assert "8 to 9" in found["length"].text


def test_defects_come_first() -> None:
    odd = replace(GOOD, frame_id="", ranges=np.array([math.nan] * 9, np.float32))
    levels = [finding.level for finding in seen(scans(3, odd)).findings()]
    assert levels == sorted(levels)
    assert set(levels) == {"defect", "notice"}
