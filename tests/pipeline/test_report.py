from __future__ import annotations

import json
import math
import re
from typing import Any

import pytest

from pc2scan.core.counts import PointCounts
from pc2scan.core.params import ProjectionParams
from pc2scan.pipeline.report import MAX_LISTED, Report, Skipped, TopicReport
from pc2scan.pipeline.scan_spec import ScanSpec


def report(params: ProjectionParams | None = None, /, **counts: Any) -> Report:
    made = Report(["a.bag"], "b.bag", (ScanSpec(params=params or ProjectionParams()),))
    points = {"total": 100, **{k: v for k, v in counts.items() if k not in ("messages_out", "empty_scans", "advice")}}
    made.topics.append(
        TopicReport(
            "/points",
            "sensor_msgs/msg/PointCloud2",
            "/scan",
            "converted",
            messages_in=4,
            messages_out=counts.get("messages_out", 4),
            points=PointCounts(**{"used": 0, "nan": 0, "height": 0, "range": 0, "angle": 0, "past_end": 0, **points}),
            empty_scans=counts.get("empty_scans", 0),
            advice=counts.get("advice", ""),
        )
    )
    made.conclude()
    return made


def test_all_is_well() -> None:
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


def test_the_default_min_height_is_named_where_it_bites_and_only_there() -> None:
    (warning,) = report(used=51, height=49).warnings
    assert "z <= 0; `min_height` sets it" in warning
    # The numbers are those of the recording, never a constant.
    assert not re.search(r"min_height=-?\d", warning)
    (warning,) = report(used=51, height=49, advice="`min_height=-3.7` `max_height=-2`").warnings
    assert warning.endswith(": `min_height=-3.7` `max_height=-2`")
    assert report(used=90, height=10).warnings == []
    assert report(ProjectionParams(min_height=-0.5), used=51, height=49).warnings == []


def test_a_height_band_of_ones_own_is_not_called_the_default() -> None:
    (warning,) = report(ProjectionParams(min_height=1.0), empty_scans=4, height=100).warnings
    assert "default" not in warning
    assert "target_frame" in warning


def test_nothing_converted_is_worth_a_warning() -> None:
    assert report(total=0, messages_out=0).warnings == ["no message of /points could be converted"]


def test_a_gap_that_deskewing_bridged_is_a_warning() -> None:
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


def test_skipped_messages_are_all_counted_and_the_first_ones_listed() -> None:
    made = report(used=100)
    for i in range(MAX_LISTED + 7):
        made.list_skipped(Skipped("/points", i, i, "reason"))
    made.topics[0].skipped = MAX_LISTED + 7
    assert made.skipped_count == MAX_LISTED + 7
    assert len(made.skipped) == MAX_LISTED
    assert made.exit_status == 3


def test_a_topic_that_cannot_be_carried_over_shows_in_the_exit_status() -> None:
    made = report(used=100)
    made.topics.append(TopicReport("/x", "a/msg/B", None, "skipped", note="cannot be written", lost=True))
    assert made.exit_status == 0
    made.topics[-1].skip(3)
    assert made.exit_status == 3
    assert made.skipped_count == 3
    made.conclude()
    assert made.warnings == ["3 messages of 1 topic are skipped: /x (3: cannot be written)"]


def test_a_topic_that_the_user_dropped_is_no_loss() -> None:
    made = report(used=100)
    made.topics.append(TopicReport("/x", "a/msg/B", None, "skipped"))
    made.topics[-1].skip(3)
    assert (made.exit_status, made.skipped_count) == (0, 0)
    assert made.topics[-1].messages_in == 3
    made.conclude()
    assert made.warnings == []


def test_json_has_no_infinities_and_keeps_every_nanosecond() -> None:
    made = report(ProjectionParams(range_max=math.inf), used=100)
    made.list_skipped(Skipped("/points", 1604515190231374463, None, "no header"))
    read = json.loads(json.dumps(made.as_dict(), allow_nan=False))
    assert read["params"]["range_max"] == "inf"
    assert read["skipped"][0]["log_time_ns"] == 1604515190231374463
    assert read["topics"][0]["points"]["used"] == 100
