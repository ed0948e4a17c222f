"""A report of one converted topic."""

from __future__ import annotations

from typing import Any

from pc2scan.core.counts import PointCounts
from pc2scan.core.params import ProjectionParams
from pc2scan.pipeline.report import Report
from pc2scan.pipeline.scan_spec import ScanSpec
from pc2scan.pipeline.topic_report import TopicReport


def report(params: ProjectionParams | None = None, /, **counts: Any) -> Report:
    """A concluded report with these counts of points and scans."""
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
