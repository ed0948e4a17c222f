"""Warnings and notes of a conversion name the cause and the parameter."""

from __future__ import annotations

import math
import re

import pytest

from pc2scan.core.counts import PointCounts
from pc2scan.core.params import ProjectionParams
from pc2scan.pipeline.report import Report
from pc2scan.pipeline.scan_spec import ScanSpec
from pc2scan.pipeline.topic_report import TopicReport
from pipeline.reports import report


def test_a_sound_conversion_has_no_warning() -> None:
    made = report(used=100)
    assert made.warnings == []
    assert made.exit_status == 0


@pytest.mark.parametrize(
    ("counts", "word"),
    [
        ({"height": 60}, "min_height"),
        ({"range": 60, "height": 40}, "range_min"),
        ({"angle": 60, "height": 40}, "angle_min"),
        ({"nan": 60, "height": 40}, "NaN"),
        ({"total": 0}, "no points"),
    ],
)
def test_scans_without_returns_name_the_parameter_to_blame(counts: dict[str, int], word: str) -> None:
    (warning,) = report(empty_scans=2, **counts).warnings
    assert "2 of 4 scans" in warning
    assert word in warning


def test_the_default_min_height_is_named_only_if_it_rejects_many_points() -> None:
    (warning,) = report(used=51, height=49).warnings
    assert "z <= 0; `min_height` sets it" in warning
    # The numbers are those of the recording, never a constant.
    assert not re.search(r"min_height=-?\d", warning)
    (warning,) = report(used=51, height=49, advice="`min_height=-3.7` `max_height=-2`").warnings
    assert warning.endswith(": `min_height=-3.7` `max_height=-2`")
    assert report(used=90, height=10).warnings == []
    assert report(ProjectionParams(min_height=-0.5), used=51, height=49).warnings == []


def test_given_heights_are_not_called_defaults() -> None:
    (warning,) = report(ProjectionParams(min_height=1.0), empty_scans=4, height=100).warnings
    assert "default" not in warning
    assert "target_frame" in warning


def test_a_topic_without_converted_messages_draws_a_warning() -> None:
    assert report(total=0, messages_out=0).warnings == ["no message of /points could be converted"]


@pytest.mark.parametrize(("name", "option"), [("no_transform", "`tf_from`"), ("no_time", "`deskew`")])
def test_many_points_that_cannot_be_placed_draw_a_warning(name: str, option: str) -> None:
    spec = ScanSpec(params=ProjectionParams(target_frame="base", min_height=-9.0), deskew=True, fixed_frame="odom")
    for lost, number in ((10, 0), (11, 1)):
        made = Report(["a.bag"], "b.bag", (spec,))
        counts = PointCounts(100, 100 - lost, **{name: lost})
        made.topics = [TopicReport("/points", "x", "/scan", "converted", messages_out=3, points=counts)]
        made.conclude()
        assert len(made.warnings) == number
    (warning,) = made.warnings
    assert warning.startswith("/scan: 11 of 100 points (11%) were ")
    assert option in warning


@pytest.mark.parametrize("name", ["where", "exclude_box", "ground", "min_height_slope", "range", "nan"])
def test_points_that_users_reject_draw_no_warning(name: str) -> None:
    assert report(ProjectionParams(min_height=-9.0), used=10, **{name: 90}).warnings == []


def test_a_gap_between_transforms_draws_a_warning() -> None:
    made = Report(["a.bag"], "b.bag", (ScanSpec(),))
    for gap in (0.1, 0.3):
        motions = [(0.1, 0.01, 0.02), (0.3, 0.02, gap), (0.2, 0.03, 0.02)]
        made.topics = [TopicReport("/points", "x", f"/scan{gap}", "converted", messages_out=3, motions=motions)]
        made.conclude()
    (warning,) = made.warnings
    assert warning.startswith(
        "/scan0.3: while clouds were measured, transforms to `fixed_frame` were missing for up to 0.3"
    )
    assert made.topics[0].motion == pytest.approx(
        {
            "largest_m": 0.3,
            "median_m": 0.2,
            "largest_deg": math.degrees(0.03),
            "median_deg": math.degrees(0.02),
            "longest_gap_s": 0.3,
        }
    )
