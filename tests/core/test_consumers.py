from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.consumer_rules import RULES, mrpt_2_5, mrpt_ros_bridge_3_2, number_of_range_readings
from pc2scan.core.consumers import CONSUMERS, expected_by_karto, judge, last_beam
from pc2scan.core.params import ProjectionParams, beam_count
from pc2scan.core.verdicts import OUTCOMES, Scan, ScanTransforms, Verdict

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


def judged(scan: Scan, first: Scan | None = None, placed: ScanTransforms | None = None) -> dict[str, str]:
    return {consumer: judge(consumer, scan, first, placed).outcome for consumer in CONSUMERS}


def ruled(scan: Scan, first: Scan | None = None, placed: ScanTransforms | None = None) -> dict[str, str]:
    return {consumer: rule(scan, first, placed or ScanTransforms()) for consumer, rule in RULES.items()}


#: What is good for all: gmapping alone places the beams half an increment to the right.
FINE = dict.fromkeys(CONSUMERS, "accepted") | {"gmapping": "shifted"}


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
        found = judged(scan)
        # gmapping has room for 2047 beams, whatever their angles.
        assert found.pop("gmapping") == ("aborts" if scan.beams > 2047 else "shifted"), it
        # MRPT wants the sector in the middle.
        assert found.pop("mrpt") in {"accepted", "shifted"}, it
        assert set(found.values()) == {"accepted"}, it


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
        full=st.integers(0, 2),
        time_increment=st.sampled_from([0.0, 1e-5, -1e-5]),
    )


def places() -> st.SearchStrategy[ScanTransforms]:
    known = st.sampled_from([None, True, False])
    return st.builds(
        ScanTransforms,
        frame_id=st.sampled_from(["laser", "/laser", ""]),
        odometry=known,
        robot=known,
        up=st.one_of(st.none(), st.floats(-2, 2), st.sampled_from([1.0, -1.0, 0.9991, 0.9989, -0.9991])),
        turned=st.sampled_from([0.0, 0.034, -0.034, 0.036, -0.036]),
        moved=st.sampled_from([0.0, 0.1, 0.11]),
    )


@given(scans(), st.one_of(st.none(), scans()), places())
def test_every_consumer_agrees_with_its_rule_on_anything(
    scan: Scan, first: Scan | None, placed: ScanTransforms
) -> None:
    assert judged(scan, first, placed) == ruled(scan, first, placed)


@given(scans(), st.data())
def test_no_numbers_stop_the_check(scan: Scan, data: st.DataObject) -> None:
    numbers = st.one_of(st.floats(width=32), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 3e38, -3e38, 1e-45]))
    names = ("angle_min", "angle_max", "angle_increment", "time_increment")
    scan = replace(scan, **{name: data.draw(numbers) for name in names})  # type: ignore[arg-type]
    for placed in (ScanTransforms(), ScanTransforms(up=-1.0)):
        assert set(judged(scan, None, placed).values()) <= set(OUTCOMES)


@given(scans(), st.integers(2, 60), st.sampled_from([-1, 0, 1, 2]))
def test_sectors_around_0_too(scan: Scan, beams: int, steps: int) -> None:
    """Where MRPT truncates a quotient that is nearly a whole number."""
    step = abs(scan.angle_increment)
    scan = replace(scan, beams=beams, angle_min=-(beams - 1) * step / 2, angle_increment=step)
    scan = replace(scan, angle_max=(beams - 1) * step / 2 + steps * 2.0**-23)
    assert judged(scan) == ruled(scan)


#: angle_min, angle_max, beams and angle_increment of scans that are symmetric but for roundings, and how many beams
#: took another range in Debian's MRPT 2.5.8. An angle_min a few roundings lower changes everything.
READ_BY_MRPT = [
    (-1.5707964897155762, 1.570796251296997, 181, 0.01745329238474369, 71),
    (-1.7429115772247314, 1.7429115772247314, 952, 0.003665429074317217, 951),
    (-2.0862138271331787, 2.0862138271331787, 681, 0.006135920062661171, 0),
    (-2.5540084838867188, 2.5540075302124023, 53, 0.09823107719421387, 0),
    (-1.4437249898910522, 1.4437249898910522, 213, 0.013620046898722649, 0),
    (-2.813497543334961, 2.8134965896606445, 1200, 0.004693072754889727, 0),
]


@pytest.mark.parametrize(("low", "high", "beams", "increment", "misread"), READ_BY_MRPT)
def test_the_rule_misreads_what_mrpt_2_5_misread(
    low: float, high: float, beams: int, increment: float, misread: int
) -> None:
    indexes = mrpt_2_5(low, high, beams)
    assert sum(index != beam for beam, index in enumerate(indexes)) == misread
    scan = replace(GOOD, angle_min=low, angle_max=high, angle_increment=increment, beams=beams)
    verdict = judge("mrpt", scan)
    if misread:
        assert verdict.outcome == "shifted"
        assert f"{misread} of {beams} beams off" in verdict.observed
        # The angles that are allowed are read right.
        low, high = (float(text.split()[-1]) for text in verdict.allowed.split(", "))
        assert judge("mrpt", replace(scan, angle_min=low, angle_max=high)).outcome == "accepted"


def test_the_bridge_of_mrpt_that_misreads_is_named() -> None:
    low, high, beams, increment, _ = READ_BY_MRPT[2]
    verdict = judge("mrpt", replace(GOOD, angle_min=low, angle_max=high, angle_increment=increment, beams=beams))
    assert "in mrpt_ros_bridge 3.2: 16 of 681 beams off" in verdict.observed


@given(st.floats(0.01, 3.1), st.integers(3, 300), st.integers(-6, 6), st.integers(-6, 6))
def test_mrpt_is_accepted_if_no_beam_is_misread(half: float, beams: int, first: int, last: int) -> None:
    step = np.spacing(np.float32(half))
    low, high = float(np.float32(-half) + first * step), float(np.float32(half) + last * step)
    increment = float(np.float32(2 * half / (beams - 1)))
    scan = replace(GOOD, angle_min=low, angle_max=high, angle_increment=increment, beams=beams)
    misread = [
        sum(index != beam for beam, index in enumerate(bridge(low, high, beams)))
        for bridge in (mrpt_2_5, mrpt_ros_bridge_3_2)
    ]
    verdict = judge("mrpt", scan)
    assert (verdict.outcome == "accepted") == (max(misread) == 0)
    assert not max(misread) or f"{max(misread)} of {beams} beams off" in verdict.observed


def circle(beams: int, low: float) -> Scan:
    increment = 2 * math.pi / beams
    scan = replace(GOOD, angle_min=low, angle_increment=increment, beams=beams)
    return replace(scan, angle_max=last_beam(scan))


@pytest.mark.parametrize(
    ("consumer", "beams", "low", "outcome"),
    [
        # As many beams as lidars of today have.
        *(
            (consumer, 3600, low, "accepted")
            for consumer in ("cartographer", "amcl", "nav2")
            for low in (-math.pi, 0.0)
        ),
        ("cartographer", 8192, 0.0, "shifted"),
        ("nav2", 8192, 0.0, "shifted"),
        ("nav2", 16384, -math.pi, "misplaced"),
        ("amcl", 16384, -math.pi, "misplaced"),
        ("amcl", 16384, 0.0, "accepted"),
    ],
)
def test_sums_of_floats_misplace_very_many_beams(consumer: str, beams: int, low: float, outcome: str) -> None:
    scan = circle(beams, low)
    verdict = judge(consumer, scan)
    assert verdict.outcome == RULES[consumer](scan, None, ScanTransforms()) == outcome
    assert outcome == "accepted" or "fewer beams" in verdict.cure


@given(st.integers(1000, 20_000), st.floats(-3, 0, width=32))
@settings(max_examples=25)
def test_sums_of_floats_agree_with_their_rules(beams: int, low: float) -> None:
    scan = circle(beams, low)
    for consumer in ("cartographer", "amcl", "nav2"):
        assert judge(consumer, scan).outcome == RULES[consumer](scan, None, ScanTransforms())


def test_a_frame_that_turns_is_misplaced_by_slam_toolbox() -> None:
    def moved(**change: float) -> dict[str, str]:
        place = ScanTransforms(frame_id="laser", odometry=True, robot=True, up=1.0, **change)  # type: ignore[arg-type]
        assert judged(GOOD, GOOD, place) == ruled(GOOD, GOOD, place)
        found = judged(GOOD, GOOD, place)
        return {name: outcome for name, outcome in found.items() if outcome != FINE[name]}

    assert moved(turned=math.radians(1.9), moved=0.09) == {}
    assert moved(turned=math.radians(-30)) == {"slam_toolbox": "misplaced"}
    assert moved(moved=0.2) == {"slam_toolbox": "misplaced", "amcl": "misplaced"}
    place = ScanTransforms(frame_id="laser", turned=math.radians(30), moved=0.2)
    verdict = judge("slam_toolbox", GOOD, GOOD, place)
    assert verdict.observed == "since then the frame 'laser' has turned by 30 deg, and moved by 0.20 m"
    assert judge("amcl", GOOD, GOOD, place).observed == "since then the frame 'laser' has moved by 0.20 m"


@given(st.floats(5, 360), st.floats(0.1, 5), st.floats(-400, 400))
def test_the_last_beams_angle_satisfies_slam_toolbox(field: float, increment: float, start: float) -> None:
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


def test_upstreams_defaults() -> None:
    scan = replace(upstream(ProjectionParams()), infinite=100, returns=260)
    # 360 beams of a full circle are what slam_toolbox expects; its infinite range_max is what others stumble on.
    assert judged(scan) == {
        "slam_toolbox": "accepted",
        "cartographer": "misplaced",
        "gmapping": "aborts",
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
    assert judged(GOOD) == FINE
    assert judge("nav2", GOOD) == Verdict("nav2")
    assert judged(replace(GOOD, infinite=4, nan=2, zero=1, short=1, long=3)) == FINE


@pytest.mark.parametrize(
    ("change", "outcomes"),
    [
        ({"range_min": -0.5}, {"cartographer": "aborts"}),
        ({"range_min": 31.0}, {"cartographer": "aborts"}),
        ({"range_max": 0.0}, {"cartographer": "aborts", "amcl": "ignored"}),
        ({"range_max": math.inf}, {}),
        (
            {"range_max": math.inf, "infinite": 1},
            {"cartographer": "misplaced", "gmapping": "aborts", "nav2": "misplaced"},
        ),
        ({"range_max": math.inf, "short": 1}, {"gmapping": "aborts"}),
        ({"time_increment": -1e-4}, {"cartographer": "misplaced"}),
        ({"time_increment": 1e-4}, {}),
        ({"range_max": 25.0, "full": 3}, {"slam_toolbox": "misplaced"}),
        ({"range_max": 25.001, "full": 3}, {}),
        ({"angle_min": 0.0, "angle_max": 2.0}, {"mrpt": "misplaced"}),
        ({"angle_max": 1.25}, {"slam_toolbox": "ignored", "gmapping": "accepted", "mrpt": "misplaced"}),
        ({"intensities": 9}, {}),
        ({"intensities": 8}, {"cartographer": "aborts"}),
        ({"intensities": 8, "returns": 0}, {}),
        ({"beams": 8, "returns": 8}, {"slam_toolbox": "ignored", "gmapping": "accepted", "mrpt": "shifted"}),
        # A hundredth off 0, and MRPT takes every range for that of the next beam.
        ({"angle_max": 1.01}, {"mrpt": "shifted"}),
        ({"angle_min": -1.01}, {"mrpt": "accepted"}),
        ({"angle_min": 1.0, "angle_max": -1.0, "angle_increment": -0.25}, {}),
        (
            {"angle_min": 1.0, "angle_max": -1.0},
            {"slam_toolbox": "ignored", "cartographer": "aborts", "gmapping": "misplaced", "mrpt": "misplaced"},
        ),
        ({"beams": 1, "angle_max": -1.0}, {"cartographer": "aborts", "mrpt": "aborts"}),
    ],
    ids=str,
)
def test_one_thing_wrong(change: dict[str, float], outcomes: dict[str, str]) -> None:
    scan = replace(GOOD, **change)  # type: ignore[arg-type]
    assert judged(scan) == FINE | outcomes
    assert judged(scan) == ruled(scan)
    for consumer in set(outcomes) - {name for name, outcome in outcomes.items() if outcome == "accepted"}:
        verdict = judge(consumer, scan)
        assert verdict.consumer == consumer
        assert all((verdict.rule, verdict.observed, verdict.allowed, verdict.cure))


def test_a_scan_after_the_first() -> None:
    longer = replace(GOOD, beams=10, angle_max=1.25)
    assert judged(longer) == FINE | {"mrpt": "shifted"}
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


def test_ranges_that_stand_for_no_return_at_the_end_of_the_range() -> None:
    for no_return, full in (("inf", 0), ("range-max-plus", 0), ("range-max-minus", 3), ("nan", 0), ("zero", 0)):
        for range_max in (0.5, 20.0, 100.0, 12345.0):
            params = ProjectionParams(range_max=range_max, no_return=no_return)
            ranges = np.array([params.empty_range] * 3 + [range_max * 0.9], np.float32)
            scan = Scan.of(ranges, angle_min=-1, angle_max=1, angle_increment=0.5, range_min=0, range_max=range_max)
            assert scan.full == full


@pytest.mark.parametrize("consumer", ["slam_toolbox", "gmapping", "amcl"])
def test_scans_without_a_pose_are_dropped(consumer: str) -> None:
    verdict = judge(consumer, GOOD, None, ScanTransforms(frame_id="laser", odometry=False, robot=True))
    assert (verdict.outcome, verdict.unplaced) == ("ignored", True)
    assert "odometry" in verdict.rule


@pytest.mark.parametrize("consumer", CONSUMERS)
def test_every_consumer_needs_the_robots_frame(consumer: str) -> None:
    verdict = judge(consumer, GOOD, None, ScanTransforms(odometry=True, robot=False, missing="there is no frame"))
    assert (verdict.outcome, verdict.observed) == ("ignored", "there is no frame")
    assert not judge(consumer, GOOD, None, ScanTransforms(odometry=True, robot=True, up=1.0)).refused


def test_gmapping_does_not_start_with_tilted_scans_and_takes_them_for_level_later() -> None:
    tilted = ScanTransforms(odometry=True, robot=True, up=math.cos(math.radians(7.6)))
    verdict = judge("gmapping", GOOD, None, tilted)
    assert (verdict.outcome, verdict.unplaced) == ("ignored", True)
    assert not judge("gmapping", GOOD, GOOD, tilted).refused


def test_slam_toolbox_reverses_the_ranges_of_a_sensor_that_is_upside_down() -> None:
    below = ScanTransforms(odometry=True, robot=True, up=-1.0)
    assert judge("slam_toolbox", GOOD, None, below).outcome == "accepted"
    side = replace(GOOD, angle_min=0.0, angle_max=2.0)
    assert judge("slam_toolbox", side).outcome == "accepted"
    verdict = judge("slam_toolbox", side, None, below)
    assert (verdict.outcome, "115 deg" in verdict.observed) == ("misplaced", True)
    # A circle from 0 is read one beam off.
    circle = replace(GOOD, angle_min=0.0, angle_increment=math.radians(1), beams=360, angle_max=math.radians(359))
    assert judge("slam_toolbox", circle, None, below).outcome == "shifted"
    # Without beams nothing is turned over.
    nothing = replace(GOOD, angle_min=0.0, angle_max=1.0, angle_increment=-1.0, beams=0)
    assert judge("slam_toolbox", nothing, None, below).outcome == "accepted"


def test_gmappings_beams() -> None:
    """With the angle_max of the half-open geometry they are where the scan says; reversed, one increment less is."""
    half_open = replace(GOOD, angle_max=1.25)
    assert judge("gmapping", half_open).outcome == "accepted"
    verdict = judge("gmapping", GOOD)
    assert verdict.outcome == "shifted"
    assert "7.16 deg (0.5 of an increment)" in verdict.observed
    assert verdict.allowed == "angle_max 1.25"
    turned = replace(GOOD, angle_min=1.0, angle_increment=-0.25)
    assert judge("gmapping", replace(turned, angle_max=-0.75)).outcome == "accepted"
    assert judge("gmapping", replace(turned, angle_max=-1.0)).outcome == "shifted"
    below = ScanTransforms(up=-1.0)
    assert judge("gmapping", half_open, None, below).outcome == "shifted"
    assert judge("gmapping", replace(GOOD, angle_max=0.75), None, below).outcome == "accepted"


def test_numbers_are_float32() -> None:
    assert replace(GOOD, angle_increment=0.1).angle_increment == float(np.float32(0.1))
    assert replace(GOOD, range_max=1.7976931348623157e308).range_max == math.inf
    assert beam_count(GOOD.angle_min, GOOD.angle_max, GOOD.angle_increment) == 8


def test_unknown_consumers() -> None:
    with pytest.raises(KeyError):
        judge("hector", GOOD)
    assert OUTCOMES[0] == "accepted"
