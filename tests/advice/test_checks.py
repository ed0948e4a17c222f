"""Every check of the table: what it finds in facts, and that none is without a case."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.advice import checks
from pc2scan.advice.checks.first_clouds import CloudFacts, KnownTransforms
from pc2scan.advice.checks.plausibility import OutputRequest
from pc2scan.conversion import result_checks as result
from pc2scan.conversion.combine.grouping import Run, SourceCounts
from pc2scan.conversion.report import Report, TopicReport
from pc2scan.core.params import ProjectionParams
from pc2scan.core.points import Points
from pc2scan.core.rule import PointCounts
from pc2scan.core.scene import CloudSample
from pc2scan.model import Connection, Summary
from pc2scan.options.call import Options
from pc2scan.parsing import conversion_of
from pc2scan.request.spec import ScanSpec
from pc2scan.transforms.builder import TransformBuilder
from support.tables import rows
from support.worlds.mounted import PLACES, cloud, mounted, write_clouds

if TYPE_CHECKING:
    from collections.abc import Iterable

TABLE = Path(__file__).with_name("checks.txt")

#: Checks with cases elsewhere: of cuts, clouds that move and stamps, in `tests/transcripts`; of rebinned scans, in
#: `tests/e2e/test_combined.py`; of whole results, in `test_report.py` and `tests/e2e`.
ELSEWHERE = {
    "target_that_moves",
    "clouds_in_fixed_frame",
    "heights_above_floor",
    "returns_at_sensor",
    "clouds_in_another_unit",
    "ceiling_within_heights",
    "unordered_stamps",
}


def named(group: Iterable[Any], *facts: Any) -> dict[str, list[str]]:
    """What each check of a group finds."""
    return {
        check.__name__: [getattr(text, "text", text) for text in texts]
        for check in group
        if (texts := list(check(*facts)))
    }


#: A recording without messages.
RECORDED = Summary("mcap", "", (), 0, 0, None, None)
MOVING = (Connection(0, "/tf", "tf2_msgs/msg/TFMessage", "cdr"),)


@pytest.mark.parametrize(("options", "name", "text"), rows(TABLE, "request"))
def test_a_check_of_the_request(options: dict[str, Any], name: str, text: str) -> None:
    request = conversion_of(Options("convert", options))
    found = named(checks.REQUEST, OutputRequest(request, request.scan, MOVING))
    assert list(found) == [name]
    assert found[name][0].startswith(text)
    assert checks.request_warnings(request, RECORDED, MOVING) == found[name]


@pytest.mark.parametrize(("roll", "options", "used", "name", "text"), rows(TABLE, "clouds"))
def test_a_check_of_the_first_clouds(roll: float, options: dict[str, Any], used: int, name: str, text: str) -> None:
    request = conversion_of(Options("convert", options))
    points = cloud(PLACES["hall"], "32 rings", mounted(roll, 0), 0.6)
    lossy = "made lossy" if name == "lossy_clouds" else ""
    sample = CloudSample.of(Points(0, 0, "lidar", dict(zip("xyz", points.T, strict=True)), lossy))
    counts = PointCounts(len(points), used, height=len(points) - used)
    facts = CloudFacts("/points", request.scan, KnownTransforms("", lambda: None), [sample], [counts])
    found = named((*checks.FRAME, *checks.FIRST_CLOUDS), facts)
    assert list(found) == [name]
    assert found[name][0].startswith(text)


@pytest.mark.parametrize(("frame", "moving", "cure"), rows(TABLE, "fixed frames"))
def test_clouds_in_a_frame_that_does_not_move_with_the_robot(frame: str, moving: bool | None, cure: str) -> None:
    builder = TransformBuilder()
    rows_of_tf = [("odom", "base_link", stamp, float(stamp), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0) for stamp in (1, 2)]
    builder.add(rows_of_tf[: 2 if moving else 1], static=not moving)
    known = KnownTransforms("", lambda: None if moving is None else builder.build())
    sample = CloudSample.of(Points(0, 0, frame, dict.fromkeys("xyz", np.ones(3, np.float32))))
    facts = CloudFacts("/points", ScanSpec(), known, [sample], [PointCounts()])
    found = named(checks.EACH_CLOUD, facts).get("clouds_in_fixed_frame", [""])
    assert cure in found[0]
    assert found[0].startswith("/points: the clouds are in '") is bool(cure)


@pytest.mark.parametrize("target", ["", "base_link"])
@pytest.mark.parametrize(("own", "source", "moves", "told"), rows(TABLE, "source frames"))
def test_a_source_frame_that_the_robot_moves_in(own: str, source: str, moves: bool, told: str, target: str) -> None:
    builder = TransformBuilder()
    builder.add([("base_link", "lidar", 0, 0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0)], static=True)
    for stamp_ns, x in ((1, 0.0), (2, 3.5 * moves)):
        builder.add([("odom", "base_link", stamp_ns, x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)], static=False)
    buffer = builder.build()
    known = KnownTransforms(source, lambda: buffer, buffer if target else None)
    sample = CloudSample.of(Points(0, 0, own, dict.fromkeys("xyz", np.ones(3, np.float32))))
    spec = ScanSpec(params=ProjectionParams(target_frame=target))
    found = named(checks.EACH_CLOUD, CloudFacts("/points", spec, known, [sample], [PointCounts()]))
    if not told and source == "odom" and not target:
        told = "/points: the clouds are in 'odom', a frame that does not move with the robot"
    texts = found.get("clouds_in_fixed_frame", [])
    assert [text.startswith(told) for text in texts] == [True] * bool(told)


def of_topic(spec: ScanSpec, **attributes: Any) -> dict[str, list[str]]:
    """What each check of a topic's counts finds, which is all that is said of the result."""
    known = {"messages_in": 4, "messages_out": 4, "points": PointCounts(100, 40, height=60), "action": "converted"}
    topic = TopicReport("/points", "", "/scan", spec=spec, **{**known, **attributes})
    report = Report([], "", (spec,), topics=[topic])
    groups = [group for attribute, group in result.TOPIC_CHECKS.items() if attrgetter(attribute)(topic)]
    found = named([check for group in groups for check in group], topic, spec, report)
    warnings, notes = result.result_findings(report)
    assert sorted(text for texts in found.values() for text in texts) == sorted(warnings + notes)
    return found


@pytest.mark.parametrize(("attributes", "name", "text"), rows(TABLE, "topic"))
def test_a_check_of_the_counts(attributes: dict[str, Any], name: str, text: str) -> None:
    # Only the checks of points look at these.
    params = (
        ProjectionParams() if name in {"rejected_points", "scans_without_return"} else ProjectionParams(min_height=0)
    )
    assert any(each.startswith(text) for each in of_topic(ScanSpec(params=params), **attributes)[name])


@pytest.mark.parametrize("lowest", [0.1, -1.1])
def test_points_that_are_no_returns_are_not_outside_the_heights(lowest: float, tmp_path: Path) -> None:
    """Every other point is at (0, 0, 0), which the default heights reject, as the node does."""
    points = np.random.default_rng(1).uniform((-5.0, -5.0, lowest), (5.0, 5.0, lowest + 1.9), (3000, 3))
    points[::2] = 0.0
    outside = (points[1::2, 2] < 0).mean()
    told = [f"/scan: {outside:.0%} of the returns were outside the heights"] if lowest < 0 else []
    path = write_clouds(tmp_path / "drive.mcap", [points.astype(np.float32)] * 4)
    report = pc2scan.convert(path, tmp_path / "scans.mcap", range_min=0.1)
    (scans,) = (topic for topic in report.topics if topic.target == "/scan")
    assert scans.points.height >= 6000
    assert [":".join(text.split(":")[:2]) for text in report.warnings if "heights" in text] == told


@pytest.mark.parametrize(("counts", "name", "text"), rows(TABLE, "joined"))
def test_a_check_of_the_counts_of_several_messages(counts: dict[str, Any], name: str, text: str) -> None:
    if "longest_unmatched" in counts:
        counts["longest_unmatched"] = Run(*counts["longest_unmatched"])
    joined = SourceCounts(**counts)
    found = of_topic(ScanSpec(), action="joined", joined=joined)
    assert list(found) == [name]
    assert found[name][0].startswith(text)


def test_every_check_has_a_case() -> None:
    groups: list[Any] = [
        group for name, group in vars(checks).items() if name.isupper() and isinstance(group, tuple | dict)
    ]
    groups += result.TOPIC_CHECKS.values()
    known = {check.__name__ for group in groups for check in group}
    assert len(known) == sum(map(len, groups))
    sections = (("request", 1), ("clouds", 3), ("topic", 1), ("joined", 1))
    assert {row[place] for section, place in sections for row in rows(TABLE, section)} | ELSEWHERE == known
