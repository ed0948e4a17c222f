from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.consumer_rules import RULES, number_of_range_readings
from pc2scan.core.consumers import CONSUMERS, OUTCOMES, Scan, Verdict, expected_by_karto, judge, last_beam
from pc2scan.core.params import ProjectionParams, beam_count

#: Degrees: 20 fields of view by 15 increments.
FIELDS = (30, 45, 60, 90, 100, 120, 135, 150, 180, 190, 200, 220, 240, 250, 270, 300, 330, 350, 359, 360)
INCREMENTS = (0.1, 0.125, 0.2, 0.225, 0.25, 0.3, 1 / 3, 0.35, 0.36, 0.4, 0.5, 0.6, 0.75, 1.0, 2.0)
GRID = [(field, increment) for field in FIELDS for increment in INCREMENTS]


def upstream(params: ProjectionParams) -> Scan:
    """What upstream advertises: the sector that was asked for."""
    return Scan(
        angle_min=params.angle_min,
        angle_max=params.angle_max,
        angle_increment=params.angle_increment,
        range_min=params.range_min,
        range_max=params.range_max,
        beams=params.length,
    )


def pair(field: float, increment: float) -> Scan:
    half = math.radians(field) / 2
    return upstream(
        ProjectionParams(angle_min=-half, angle_max=half, angle_increment=math.radians(increment), range_max=30)
    )


def centered(scan: Scan) -> Scan:
    """A scan of the same beams that says where the last one is; a full circle's last beam is not the first again."""
    beams = scan.beams
    if beams * scan.angle_increment > 2 * math.pi + 0.5 * scan.angle_increment:
        beams -= 1
    scan = replace(scan, beams=beams)
    return replace(scan, angle_max=last_beam(scan))


def judged(scan: Scan, first: Scan | None = None) -> dict[str, str]:
    return {consumer: judge(consumer, scan, first).outcome for consumer in CONSUMERS}


def ruled(scan: Scan, first: Scan | None = None) -> dict[str, str]:
    return {consumer: rule(scan, first or scan) for consumer, rule in RULES.items()}


GOOD = Scan(angle_min=-1, angle_max=1, angle_increment=0.25, range_min=0.5, range_max=30, beams=9, returns=9)


def test_the_grid_has_300_pairs_and_every_consumer_a_rule() -> None:
    assert len(GRID) == 300
    assert list(RULES) == list(CONSUMERS)


@pytest.mark.parametrize("beams", [-1, 0, 1])
@pytest.mark.parametrize("range_max", [30.0, math.inf, 0.0, -1.0])
@pytest.mark.parametrize("turned", [False, True])
def test_every_consumer_agrees_with_its_rule_on_the_grid(beams: int, range_max: float, turned: bool) -> None:
    for field, increment in GRID:
        scan = pair(field, increment)
        scan = replace(scan, range_max=range_max, beams=scan.beams + beams, infinite=3, returns=4)
        if turned:
            scan = replace(
                scan, angle_min=scan.angle_max, angle_max=scan.angle_min, angle_increment=-scan.angle_increment
            )
        assert judged(scan) == ruled(scan), (field, increment)
        assert expected_by_karto(scan) == number_of_range_readings(scan)


def test_upstreams_geometry_is_refused_more_often_than_not_and_the_last_beams_angle_never() -> None:
    refused = [judge("slam_toolbox", pair(*it)).outcome == "ignored" for it in GRID]
    assert sum(refused) == sum(ruled(pair(*it))["slam_toolbox"] == "ignored" for it in GRID)
    assert len(GRID) / 2 < sum(refused) < len(GRID)
    for it in GRID:
        scan = centered(pair(*it))
        # gmapping has room for 2047 beams, whatever their angles.
        assert set(judged(scan).values()) - {"accepted"} == ({"aborts"} if scan.beams > 2047 else set()), it


def scans() -> st.SearchStrategy[Scan]:
    numbers = st.floats(width=32, allow_nan=True, allow_infinity=True)
    angles = st.floats(-7, 7, width=32)
    increments = st.floats(0.0009765625, 1, width=32)
    return st.builds(
        Scan,
        angle_min=angles,
        angle_max=angles,
        angle_increment=st.one_of(increments, increments.map(lambda value: -value)),
        range_min=numbers,
        range_max=numbers,
        beams=st.integers(0, 60),
        intensities=st.integers(0, 60),
        returns=st.integers(0, 2),
        infinite=st.integers(0, 2),
        short=st.integers(0, 2),
    )


@given(scans(), st.one_of(st.none(), scans()))
def test_every_consumer_agrees_with_its_rule_on_anything(scan: Scan, first: Scan | None) -> None:
    assert judged(scan, first) == ruled(scan, first)


@given(st.floats(5, 360), st.floats(0.1, 5), st.floats(-400, 400))
def test_the_last_beams_angle_satisfies_slam_toolbox_and_mrpt(field: float, increment: float, start: float) -> None:
    scan = Scan(
        angle_min=math.radians(start),
        angle_max=0,
        angle_increment=math.radians(increment),
        range_min=0,
        range_max=30,
        beams=max(math.floor(field / increment), 3),
    )
    scan = replace(scan, angle_max=last_beam(scan))
    assert judge("slam_toolbox", scan).outcome == "accepted"
    assert judge("mrpt", scan).outcome == "accepted"


def test_upstreams_defaults() -> None:
    scan = replace(upstream(ProjectionParams()), infinite=100, returns=260)
    # 360 beams of a full circle are what slam_toolbox expects; its infinite range_max is what others stumble on.
    assert judged(scan) == {
        "slam_toolbox": "accepted",
        "cartographer": "misplaced",
        "gmapping": "misplaced",
        "amcl": "accepted",
        "nav2": "misplaced",
        "mrpt": "misplaced",
    }


def test_upstreams_sample_launch_parameters() -> None:
    """361.1 increments make 362 beams, and round(361.1) + 1 are expected: refused they are not."""
    params = ProjectionParams(angle_min=-1.5708, angle_max=1.5708, angle_increment=0.0087, range_min=0.45, range_max=4)
    scan = upstream(params)
    assert (scan.beams, expected_by_karto(scan), number_of_range_readings(scan)) == (362, 362, 362)
    assert judge("slam_toolbox", scan).outcome == "accepted"
    # A degree as increment makes it 180 beams where 181 are expected.
    scan = upstream(ProjectionParams(angle_min=-1.5708, angle_max=1.5708, angle_increment=math.pi / 180))
    verdict = judge("slam_toolbox", replace(scan, beams=180))
    assert verdict.outcome == "ignored"
    assert verdict.observed.startswith("180 ranges")
    assert verdict.allowed == "181 ranges"


def test_a_full_circle_needs_no_extra_beam_unless_it_has_one() -> None:
    full = upstream(ProjectionParams(range_max=30))
    assert (full.beams, expected_by_karto(full)) == (360, 360)
    assert expected_by_karto(replace(full, beams=361)) == 361
    assert judge("slam_toolbox", replace(full, beams=361)).outcome == "accepted"
    assert judge("slam_toolbox", replace(full, beams=359)).outcome == "ignored"


@pytest.mark.parametrize(
    "change",
    [
        {"angle_increment": 0.0},
        {"angle_increment": math.nan},
        {"angle_max": math.inf},
        {"angle_min": math.nan},
        {"angle_increment": 1e-45},
        {"angle_min": -3e38, "angle_max": 3e38},
        {"beams": 0},
    ],
    ids=str,
)
def test_angles_that_are_none(change: dict[str, float]) -> None:
    verdict = judge("slam_toolbox", replace(GOOD, **change))  # type: ignore[arg-type]
    assert verdict.outcome == "ignored"
    assert verdict.cure


def test_what_is_good_for_all() -> None:
    assert set(judged(GOOD).values()) == {"accepted"}
    assert judge("nav2", GOOD) == Verdict("nav2")
    assert set(judged(replace(GOOD, infinite=4, nan=2, zero=1, short=1, long=3)).values()) == {"accepted"}


@pytest.mark.parametrize(
    ("change", "outcomes"),
    [
        ({"range_min": -0.5}, {"cartographer": "aborts"}),
        ({"range_min": 31.0}, {"cartographer": "aborts"}),
        ({"range_max": 0.0}, {"cartographer": "aborts", "amcl": "ignored"}),
        ({"range_max": math.inf}, {}),
        (
            {"range_max": math.inf, "infinite": 1},
            {"cartographer": "misplaced", "gmapping": "misplaced", "nav2": "misplaced"},
        ),
        ({"range_max": math.inf, "short": 1}, {"gmapping": "misplaced"}),
        ({"intensities": 9}, {}),
        ({"intensities": 8}, {"cartographer": "aborts"}),
        ({"intensities": 8, "returns": 0}, {}),
        ({"beams": 8, "returns": 8}, {"slam_toolbox": "ignored", "mrpt": "misplaced"}),
        ({"angle_max": 1.01}, {}),
        ({"angle_max": 1.05}, {"mrpt": "misplaced"}),
        ({"angle_min": 1.0, "angle_max": -1.0, "angle_increment": -0.25}, {}),
        (
            {"angle_min": 1.0, "angle_max": -1.0},
            {"slam_toolbox": "ignored", "cartographer": "aborts", "mrpt": "misplaced"},
        ),
        ({"beams": 2, "angle_max": -0.75}, {"mrpt": "aborts"}),
    ],
    ids=str,
)
def test_one_thing_wrong(change: dict[str, float], outcomes: dict[str, str]) -> None:
    scan = replace(GOOD, **change)  # type: ignore[arg-type]
    assert judged(scan) == dict.fromkeys(CONSUMERS, "accepted") | outcomes
    assert judged(scan) == ruled(scan)
    for consumer in outcomes:
        verdict = judge(consumer, scan)
        assert verdict.consumer == consumer
        assert all((verdict.rule, verdict.observed, verdict.allowed, verdict.cure))


def test_a_scan_after_the_first() -> None:
    longer = replace(GOOD, beams=10, angle_max=1.25)
    assert set(judged(longer).values()) == {"accepted"}
    only = {"slam_toolbox", "gmapping"}
    assert {c for c, outcome in judged(longer, GOOD).items() if outcome == "ignored"} == only
    turned = replace(GOOD, angle_min=-0.9, angle_max=1.1)
    assert {c for c, outcome in judged(turned, GOOD).items() if outcome == "misplaced"} == only
    assert "5.73 deg" in judge("slam_toolbox", turned, GOOD).observed


def test_what_is_in_the_ranges() -> None:
    ranges = np.array([math.inf, math.nan, 0, 0.25, 0.5, 1, 30, 31, -math.inf], np.float32)
    scan = Scan.of(ranges, angle_min=-1, angle_max=1, angle_increment=0.25, range_min=0.5, range_max=30)
    assert (scan.beams, scan.returns, scan.infinite, scan.nan, scan.zero, scan.short, scan.long) == (
        9,
        3,
        1,
        1,
        1,
        3,
        1,
    )
    scan = Scan.of(ranges, angle_min=-1, angle_max=1, angle_increment=0.25, range_min=0.5, range_max=math.inf)
    assert (scan.returns, scan.infinite, scan.short, scan.long) == (4, 1, 3, 0)


def test_numbers_are_float32() -> None:
    assert replace(GOOD, angle_increment=0.1).angle_increment == float(np.float32(0.1))
    assert replace(GOOD, range_max=1.7976931348623157e308).range_max == math.inf
    assert beam_count(GOOD.angle_min, GOOD.angle_max, GOOD.angle_increment) == 8


def test_unknown_consumers() -> None:
    with pytest.raises(KeyError):
        judge("hector", GOOD)
    assert OUTCOMES[0] == "accepted"
