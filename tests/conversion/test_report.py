"""The report of a conversion: what it counts, and its warnings, which name the cause and the parameter."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from pc2scan.conversion.engine import Item, Tally
from pc2scan.conversion.plan import Output, Route
from pc2scan.conversion.report import Report, TopicReport
from pc2scan.conversion.result_checks import result_findings
from pc2scan.core.params import ProjectionParams
from pc2scan.core.rule import PointCounts
from pc2scan.errors import MessageError
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.model import Connection
from pc2scan.request.spec import ScanSpec
from pc2scan.result import MAX_LISTED, Skipped
from support.tables import rows

TABLES = Path(__file__).with_name("reports.txt")


def report(params: ProjectionParams | None = None, /, **counts: Any) -> Report:
    """A checked report of one topic with these counts of points and scans."""
    names = ("messages_out", "empty_scans", "advice", "longest_gap_s", "removed_beams", "is_level")
    own = {name: counts.pop(name) for name in names if name in counts}
    moved: dict[str, Any] = (
        {"deskew": True, "fixed_frame": "odom"} if {"no_time", "no_transform"} & counts.keys() else {}
    )
    spec = ScanSpec(params=params or ProjectionParams(), **moved)
    made = Report(["a.bag"], "b.bag", (spec,))
    points = PointCounts(**{"total": 100, "used": 0, **counts})
    made.topics.append(
        TopicReport(
            "/points",
            "a/msg/B",
            "/scan",
            "converted",
            messages_in=4,
            points=points,
            spec=spec,
            **{"messages_out": 4, **own},
        )
    )
    made.add(*result_findings(made))
    return made


@pytest.mark.parametrize(("counts", "params", "start", "words"), rows(TABLES, "warnings"))
def test_a_warning_names_the_cause(counts: dict[str, Any], params: dict[str, float], start: str, words: str) -> None:
    (warning,) = report(ProjectionParams(**params), **counts).warnings  # type: ignore[arg-type]
    assert warning.startswith(start)
    assert words in warning
    # The numbers are those of the recording, never a constant.
    assert "advice" in counts or not re.search(r"min_height=-?\d", warning)
    assert not params or "default" not in warning


@pytest.mark.parametrize(("counts", "params"), rows(TABLES, "no warnings"))
def test_what_is_as_it_should_be_draws_no_warning(counts: dict[str, Any], params: dict[str, float]) -> None:
    made = report(ProjectionParams(**params), **counts)  # type: ignore[arg-type]
    assert (made.warnings, made.exit_status) == ([], 0)


def test_skipped_messages_are_all_counted_and_some_listed() -> None:
    made = report(used=100)
    output = Output(None, "/scan", report=made.topics[0])
    route = Route(Connection(1, "/points", POINTCLOUD2, "cdr"), [output])
    tally = Tally({1: route}, strict=False)
    for i in range(MAX_LISTED + 7):
        tally.count(Item(route, i, i, 0, [(output, MessageError("reason", stamp_ns=i))]))
    made.skipped = tally.skipped
    assert made.skipped[2] == Skipped("/points", 2, 2, "reason", "", ("/scan",))
    assert (tally.failures, route.messages) == (MAX_LISTED + 7, MAX_LISTED + 7)
    assert (made.skipped_count, len(made.skipped), made.exit_status) == (MAX_LISTED + 7, MAX_LISTED, 3)


@pytest.mark.parametrize("lost", [True, False])
def test_what_cannot_be_carried_over_is_a_loss(lost: bool) -> None:
    """And what the user dropped is none."""
    made = report(used=100)
    made.topics.append(TopicReport("/x", "a/msg/B", None, "skipped", note="cannot be written", lost=lost))
    assert made.exit_status == 0
    made.topics[-1].skip(3)
    assert (made.exit_status, made.skipped_count) == ((3, 3) if lost else (0, 0))
    assert made.topics[-1].messages_in == 3
    made.add(*result_findings(made))
    assert made.warnings == ["3 messages of 1 topic are skipped: /x (3: cannot be written)"][: int(lost)]
