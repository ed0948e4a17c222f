from __future__ import annotations

import json
import math

from pc2scan.core.params import ProjectionParams
from pc2scan.pipeline.report import MAX_LISTED, Skipped
from pc2scan.pipeline.topic_report import TopicReport
from pipeline.reports import report


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
