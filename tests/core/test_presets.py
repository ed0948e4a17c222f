"""What a preset makes, its consumer takes: by the rules of `pc2scan check`, and by their transcription."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.consumer_rules import RULES, mrpt_2_5, mrpt_ros_bridge_3_2
from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.core.project import project
from pc2scan.core.verdicts import Scan, ScanTransforms, Verdict
from pc2scan.errors import ParameterError

#: Degrees: 20 fields of view by 15 increments; coarse ones too, where Karto's rule for circles is at its narrowest.
FIELDS = (30, 45, 60, 90, 100, 120, 135, 150, 180, 190, 200, 220, 240, 250, 270, 300, 330, 350, 359, 360)
INCREMENTS = (0.2, 0.225, 0.25, 0.3, 1 / 3, 0.36, 0.4, 0.5, 0.6, 0.75, 1.0, 2.0, 5.0, 7.3, 15.0)

#: Beams with a return and many without, before and behind the sensor.
POINTS = np.array([[3.0, 0.1, 0], [2.0, -1, 0], [0.0, 0.0, 0.0], [-4, 3, 0], [250, 3, 0]])


def scan_of(params: ProjectionParams) -> Scan:
    """A scan as the message would have it."""
    layout, made = params.layout, project(POINTS, params)
    return Scan.of(
        made.ranges,
        angle_min=layout.angle_min,
        angle_max=layout.angle_max,
        angle_increment=layout.angle_increment,
        range_min=params.range_min,
        range_max=params.range_max,
        scan_time=0.1,
        intensities=len(made.intensities),
    )


def test_every_preset_has_a_consumer_with_rules() -> None:
    assert set(PRESETS) == set(CONSUMERS)


@pytest.mark.parametrize("consumer", PRESETS)
@pytest.mark.parametrize("start", ["centred on x", "from 0", "from -pi"])
def test_a_preset_is_accepted_on_the_grid(consumer: str, start: str) -> None:
    for field in FIELDS if consumer != "mrpt" or start == "centred on x" else (360,):
        span = math.radians(field)
        low = {"centred on x": -span / 2, "from 0": 0.0, "from -pi": -math.pi}[start]
        for increment in INCREMENTS:
            params = ProjectionParams.preset(
                consumer,
                min_height=-1.0,
                angle_min=low,
                angle_max=low + span,
                angle_increment=math.radians(increment),
            )
            scan = scan_of(params)
            assert judge(consumer, scan).outcome == "accepted", (field, increment)
            assert RULES[consumer](scan, None, ScanTransforms()) == "accepted"
            if params.geometry == "centered":
                assert_others(scan)


def assert_others(scan: Scan) -> None:
    """A finite range_max and the last beam's angle satisfy all others that read the message as it is defined."""
    found = {name: judge(name, scan).outcome for name in CONSUMERS}
    assert found.pop("gmapping") == "shifted"
    found.pop("mrpt")
    assert set(found.values()) == {"accepted"}


@given(st.floats(-7, 4), st.floats(0.1, 7), st.floats(math.radians(0.18), 0.6))
def test_any_centered_scan_is_accepted_by_all(low: float, span: float, increment: float) -> None:
    # MRPT wants three beams, and what it divides by rounds to nothing in thousands.
    params = ProjectionParams.preset(
        "nav2", angle_min=low, angle_max=low + max(span, 2 * increment), angle_increment=increment
    )
    assert_others(scan_of(params))


@given(st.sampled_from([-math.pi, 0.0, -math.pi / 2, 1.0]), st.integers(3, 2000))
def test_any_circle_of_a_number_of_beams_is_accepted_by_all(low: float, beams: int) -> None:
    params = ProjectionParams.preset("amcl", angle_min=low, angle_max=low + 2 * math.pi, beams=beams)
    scan = scan_of(params)
    assert scan.beams == beams
    assert_others(scan)
    # gmapping's circle is one for slam_toolbox too.
    circle = scan_of(replace(params, geometry="half-open"))
    assert {name: judge(name, circle).outcome for name in CONSUMERS if name != "mrpt"} == dict.fromkeys(
        [name for name in CONSUMERS if name != "mrpt"], "accepted"
    )
    around = scan_of(replace(params, geometry="symmetric"))
    assert judge("mrpt", around).outcome == "accepted"
    assert_others(around)


@given(st.floats(0.05, 3.1), st.integers(3, 2000))
def test_any_symmetric_sector_is_where_mrpt_and_gmapping_place_it(half: float, beams: int) -> None:
    for consumer in ("mrpt", "gmapping"):
        scan = scan_of(ProjectionParams.preset(consumer, angle_min=-half, angle_max=half, beams=beams))
        assert scan.beams == beams
        assert judge(consumer, scan).outcome == "accepted"


@given(st.floats(0.001, 3.5), st.integers(3, 1500), st.booleans())
def test_both_bridges_of_mrpt_read_every_beam(half: float, beams: int, by_increment: bool) -> None:
    wanted = {"angle_increment": 2 * min(half, math.pi) / beams} if by_increment else {"beams": beams}
    scan = scan_of(ProjectionParams.preset("mrpt", angle_min=-half, angle_max=half, **wanted))
    for reads in mrpt_2_5, mrpt_ros_bridge_3_2:
        assert reads(scan.angle_min, scan.angle_max, scan.beams) == list(range(scan.beams))
    assert judge("mrpt", scan).outcome == "accepted"


@pytest.mark.parametrize("beams", [4000, 20_000, 99_999, 100_000])
@pytest.mark.parametrize("half", [math.pi, 1.999999, 1.0, 0.3])
def test_mrpt_reads_very_many_beams(half: float, beams: int) -> None:
    layout = ProjectionParams.preset("mrpt", angle_min=-half, angle_max=half, beams=beams).layout
    angles = {name: getattr(layout, name) for name in ("angle_min", "angle_max", "angle_increment")}
    scan = Scan(**angles, range_min=0.1, range_max=100, beams=beams)
    assert judge("mrpt", scan) == Verdict("mrpt")


@pytest.mark.parametrize("beams", [2, 100_001])
def test_numbers_of_beams_that_mrpt_misreads_are_refused(beams: int) -> None:
    with pytest.raises(ParameterError, match="3 to 100,000 beams") as caught:
        ProjectionParams.preset("mrpt", angle_min=-1.0, angle_max=1.0, beams=beams)
    assert caught.value.name == "beams"
    with pytest.raises(ParameterError, match="3 to 100,000 beams"):
        ProjectionParams.preset("mrpt", angle_min=-1.0, angle_max=1.0, angle_increment=2 / (beams - 1))


def test_a_sector_to_one_side_is_refused_for_mrpt() -> None:
    with pytest.raises(ParameterError, match="not symmetric around 0") as caught:
        ProjectionParams.preset("mrpt", angle_min=0.0, angle_max=1.5)
    assert caught.value.hint == "`angle_min=-1.5` `angle_max=1.5`, or a full circle"


@pytest.mark.parametrize(("preset", "turned"), [("slam_toolbox", 0.5), ("gmapping", 0.0)])
def test_where_gmapping_sees_a_wall(preset: str, turned: float) -> None:
    """Heading of points as gmapping places them against where they are: half a beam off, or not."""
    angles = np.linspace(-3.1, 3.1, 5000)
    params = ProjectionParams.preset(preset, min_height=-1.0)
    ranges = project(np.stack([5 * np.cos(angles), 5 * np.sin(angles), 0 * angles], axis=1), params).ranges
    layout = params.layout
    beams = np.flatnonzero(ranges < 50)
    middle = (layout.angle_min + layout.angle_max) / 2
    seen = middle + (beams - ranges.size / 2) * layout.angle_increment
    true = layout.angle_min + beams * layout.angle_increment
    assert np.abs(seen - true).max() / layout.angle_increment == pytest.approx(turned, abs=1e-3)


def test_without_a_preset_they_refuse_or_misplace() -> None:
    upstream = scan_of(ProjectionParams(min_height=-1.0, angle_min=-math.pi / 2, angle_max=math.pi / 2))
    assert judge("slam_toolbox", upstream).refused
    assert judge("cartographer", upstream).outcome == "misplaced"
    # Each half of the cure alone is not enough for all of them.
    endless = scan_of(replace(ProjectionParams.preset("slam_toolbox"), range_max=math.inf))
    assert judge("cartographer", endless).outcome == "misplaced"


@pytest.mark.parametrize("consumer", PRESETS)
def test_a_non_return_at_the_origin_and_one_beyond_are_left_out(consumer: str) -> None:
    params = ProjectionParams.preset(consumer, min_height=-1.0)
    made = project(POINTS, params)
    assert made.counts.range == 2
    assert made.ranges.min() > 2
    assert np.isfinite(made.ranges).all() == (consumer == "gmapping")
