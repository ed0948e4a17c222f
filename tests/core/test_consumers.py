"""What each consumer does with a scan, against its rules in the words of its C++."""

from __future__ import annotations

import math
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.consumers import CONSUMERS, ConsumerScan, ScanTransforms, Verdict, judge
from pc2scan.core.params import ProjectionParams
from support.consumer_rules import RULES
from support.tables import rows

TABLES = Path(__file__).with_name("consumers.txt")

#: Degrees.
FIELDS = (30, 45, 60, 90, 100, 120, 135, 150, 180, 190, 200, 220, 240, 250, 270, 300, 330, 350, 359, 360)
INCREMENTS = (0.1, 0.125, 0.2, 0.225, 0.25, 0.3, 1 / 3, 0.35, 0.36, 0.4, 0.5, 0.6, 0.75, 1.0, 2.0)
GRID = [(field, increment) for field in FIELDS for increment in INCREMENTS]
INF, NAN = math.inf, math.nan

GOOD = ConsumerScan(angle_min=-1, angle_max=1, angle_increment=0.25, range_min=0.5, range_max=30, beams=9, returns=9)
#: What is good for all: gmapping alone places the beams half an increment to the right.
FINE = dict.fromkeys(CONSUMERS, "accepted") | {"gmapping": "shifted"}
PLACED = ScanTransforms(frame_id="laser", odometry=True, robot=True, up=1.0)


def upstream(**params: float) -> ConsumerScan:
    """What upstream advertises: the sector that was asked for."""
    asked = ProjectionParams(**params)  # type: ignore[arg-type]
    names = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max")
    return ConsumerScan(**{name: getattr(asked, name) for name in names}, beams=asked.length)


def pair(field: float, increment: float) -> ConsumerScan:
    half = math.radians(field) / 2
    return upstream(angle_min=-half, angle_max=half, angle_increment=math.radians(increment), range_max=30)


def judged(
    scan: ConsumerScan, first: ConsumerScan | None = None, placed: ScanTransforms | None = None
) -> dict[str, str]:
    """The outcome for each consumer, which is that of its rule if it has one in C++'s words."""
    found: dict[str, str] = {consumer: judge(consumer, scan, first, placed).outcome for consumer in CONSUMERS}
    ruled = {consumer: rule(scan, first, placed or ScanTransforms()) for consumer, rule in RULES.items()}
    assert found == found | ruled
    return found


# Any scan.

numbers = st.floats(width=32)
few = st.integers(0, 2)


@st.composite
def scans(draw: st.DrawFn) -> ConsumerScan:
    """Scans of all kinds, upstream's with a beam more or less, and sectors that are symmetric but for roundings."""
    kind = draw(st.sampled_from(["any", "grid", "around 0"]))
    counts = {name: draw(few) for name in ("returns", "infinite", "short", "full")}
    if kind == "grid":
        scan = pair(*draw(st.sampled_from(GRID)))
        scan = replace(scan, range_max=draw(st.sampled_from([30.0, INF, 0.0, -1.0])), **counts)
        if draw(st.booleans()):
            ends: dict[str, Any] = {"angle_min": scan.angle_max, "angle_max": scan.angle_min}
            scan = replace(scan, **ends, angle_increment=-scan.angle_increment)
        return replace(scan, beams=scan.beams + draw(st.integers(-1, 1)))
    step = draw(st.floats(0.0009765625, 1, width=32))
    beams = draw(st.integers(0, 60))
    low, high = draw(st.floats(-7, 7, width=32)), draw(st.floats(-7, 7, width=32))
    if kind == "around 0":
        half = (beams - 1) * step / 2
        ulp = float(np.spacing(np.float32(half)))
        low, high = (side * half + draw(st.integers(-6, 6)) * ulp for side in (-1, 1))
    return ConsumerScan(
        angle_min=low,
        angle_max=high,
        angle_increment=step if kind == "around 0" else draw(st.sampled_from([step, -step])),
        range_min=draw(numbers),
        # No return is as far as a range_max that is no number.
        range_max=draw(st.floats(width=32, allow_nan=False)),
        beams=beams,
        intensities=draw(st.sampled_from([0, beams, 7])),
        time_increment=draw(st.sampled_from([0.0, 1e-5, -1e-5])),
        **counts,
    )


known = st.sampled_from([None, True, False, True])
places = st.builds(
    ScanTransforms,
    frame_id=st.sampled_from(["laser", "/laser", ""]),
    odometry=known,
    robot=known,
    up=st.one_of(st.none(), st.floats(-2, 2), st.sampled_from([1.0, -1.0, 0.9991, 0.9989, -0.9991])),
    turned=st.sampled_from([0.0, 0.034, -0.034, 0.036, -0.036]),
    moved=st.sampled_from([0.0, 0.1, 0.11]),
)


@given(scans(), st.one_of(st.none(), scans()), places)
def test_every_consumer_does_what_its_rule_says(
    scan: ConsumerScan, first: ConsumerScan | None, placed: ScanTransforms
) -> None:
    judged(scan)
    judged(scan, first, placed)


# What is wrong with a scan: by what it differs from a good one, and for whom.


@pytest.mark.parametrize(("change", "outcomes"), rows(TABLES, "what is wrong, and for whom"), ids=str)
def test_what_is_wrong_and_for_whom(change: dict[str, Any], outcomes: dict[str, str]) -> None:
    names = {"frame_id", "odometry", "robot", "turned", "moved", "up"}
    placed = PLACED._replace(**{name: value for name, value in change.items() if name in names})
    scan = replace(GOOD, **{name: value for name, value in change.items() if name not in names})
    assert judged(scan, None, placed) == FINE | outcomes
    for consumer in CONSUMERS:
        verdict = judge(consumer, scan, None, placed)
        assert verdict.consumer == consumer
        if verdict.outcome == "accepted":
            assert verdict == Verdict(consumer)
        else:
            assert all((verdict.rule, verdict.observed or "odometry" in verdict.rule, verdict.allowed, verdict.cure))


def test_a_scan_after_the_first() -> None:
    longer = replace(GOOD, beams=10, angle_max=1.25)
    assert judged(longer) == FINE | {"mrpt": "shifted"}
    only = dict.fromkeys(("slam_toolbox", "gmapping"), "ignored")
    assert judged(longer, GOOD) == FINE | only | {"mrpt": "shifted"}
    # Off at the first beam and at the last one; at the last one alone.
    stretched = replace(GOOD, angle_max=1.08, angle_increment=0.26)
    for later in (replace(GOOD, angle_min=-0.9, angle_max=1.1), stretched):
        turned = judged(later, GOOD)
        assert {consumer for consumer, outcome in turned.items() if outcome == "misplaced"} >= set(only)
        assert not {"cartographer", "amcl", "nav2"} & {name for name in turned if turned[name] != "accepted"}
    # gmapping does not start with tilted scans, and takes them for level later.
    tilted = PLACED._replace(up=math.cos(math.radians(7.6)))
    assert judged(GOOD, GOOD, tilted) == FINE


@pytest.mark.parametrize(("low", "high", "beams", "increment", "misread"), rows(TABLES, "read by MRPT"))
def test_the_rule_misreads_what_mrpt_2_5_misread(
    low: float, high: float, beams: int, increment: float, misread: int
) -> None:
    scan = replace(GOOD, angle_min=low, angle_max=high, angle_increment=increment, beams=beams)
    verdict = judge("mrpt", scan)
    if misread:
        assert verdict.outcome == "shifted"
        assert f"{misread} of {beams} beams off" in verdict.observed
        # The angles that are allowed are read right.
        low, high = (float(text.split()[-1]) for text in verdict.allowed.split(", "))
        assert judge("mrpt", replace(scan, angle_min=low, angle_max=high)).outcome == "accepted"
    elif beams == 681:
        # The other bridge misreads it, and is named.
        assert "in mrpt_ros_bridge 3.2: 16 of 681 beams off" in verdict.observed


# What is in a scan.


def scan_of(ranges: list[float], **header: float) -> ConsumerScan:
    usual = {"angle_min": -1, "angle_max": 1, "angle_increment": 0.25, "range_min": 0.5, "range_max": 30}
    return ConsumerScan.of(np.array(ranges, np.float32), **usual | header)


def test_what_is_in_the_ranges() -> None:
    ranges = [INF, NAN, 0, 0.25, 0.5, 1, 30, 31, -INF]
    of = attrgetter("beams", "returns", "infinite", "nan", "zero", "short", "long")
    assert of(scan_of(ranges)) == (9, 3, 1, 1, 1, 3, 1)
    assert of(scan_of(ranges, range_max=INF)) == (9, 4, 1, 1, 1, 3, 0)
