"""What a preset makes, its consumer takes: by the rules of `pc2scan check`, and by their transcription."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pc2scan.core.consumers import CONSUMERS, ConsumerScan, ScanTransforms, judge
from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.core.project import project
from support.consumer_rules import RULES

PI = math.pi

#: Beams with a return and many without, before and behind the sensor.
POINTS = np.array([[3.0, 0.1, 0], [2.0, -1, 0], [0.0, 0.0, 0.0], [-4, 3, 0], [250, 3, 0]])


def scan_of(params: ProjectionParams) -> ConsumerScan:
    """A scan as the message would have it."""
    layout, made = params.layout, project(POINTS, params)
    return ConsumerScan.of(
        made.ranges,
        angle_min=layout.angle_min,
        angle_max=layout.angle_max,
        angle_increment=layout.angle_increment,
        range_min=params.range_min,
        range_max=params.range_max,
        scan_time=0.1,
        intensities=len(made.intensities),
    )


#: Radians; of the degrees, coarse ones too, where Karto's rule for circles is at its narrowest.
DEGREES = st.sampled_from([30, 45, 60, 90, 100, 120, 135, 150, 180, 190, 200, 220, 240, 250, 270, 300, 330, 350, 359])
SPANS = st.one_of(DEGREES.map(math.radians), st.just(2 * PI), st.floats(0.1, 7))
INCREMENTS = st.one_of(
    st.sampled_from([0.2, 0.225, 0.25, 0.3, 1 / 3, 0.36, 0.4, 0.5, 0.6, 0.75, 1.0, 2.0, 5.0, 7.3, 15.0]).map(
        math.radians
    ),
    st.floats(math.radians(0.18), 0.6),
)


@st.composite
def sectors(draw: st.DrawFn) -> dict[str, Any]:
    """A sector of a number of beams, or with an increment; MRPT wants three beams."""
    span = draw(SPANS)
    low = draw(st.one_of(st.sampled_from([-PI, 0.0, -PI / 2, 1.0, -span / 2]), st.floats(-7, 4)))
    if draw(st.booleans()):
        return {"angle_min": low, "angle_max": low + span, "beams": draw(st.integers(3, 2000))}
    increment = draw(INCREMENTS)
    assume(span >= 2 * increment)
    return {"angle_min": low, "angle_max": low + span, "angle_increment": increment}


@pytest.mark.parametrize("consumer", PRESETS)
@given(sectors())
def test_a_preset_is_accepted_by_its_consumer(consumer: str, sector: dict[str, Any]) -> None:
    span = sector["angle_max"] - sector["angle_min"]
    if consumer in {"mrpt", "gmapping"}:
        sector |= {"angle_min": -span / 2, "angle_max": span / 2}
    elif "beams" in sector:
        # Finer beams than lidars have are misplaced by sums of floats.
        sector["beams"] = min(sector["beams"], int(span / math.radians(0.18)))
    params = ProjectionParams.preset(consumer, min_height=-1.0, **sector)
    scan = scan_of(params)
    assert scan.beams == sector.get("beams", scan.beams)
    assert judge(consumer, scan).outcome == "accepted"
    assert consumer not in RULES or RULES[consumer](scan, None, ScanTransforms()) == "accepted"
    others = {name: judge(name, scan).outcome for name in CONSUMERS}
    if params.geometry == "centered":
        # A finite range_max and the last beam's angle satisfy all others that read the message as it is defined.
        assert others.pop("gmapping") == "shifted"
        others.pop("mrpt")
        assert set(others.values()) == {"accepted"}
    if params.geometry == "half-open" and params.layout.full_circle:
        # gmapping's circle is one for the others, too.
        others.pop("mrpt")
        assert set(others.values()) == {"accepted"}
