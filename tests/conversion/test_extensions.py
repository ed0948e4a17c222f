"""Filters that the package does not know of."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.request.filters import Frame
from support.builders import POINTS, T0, Item, Recording, cloud, write_mcap

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.core.points import Points


BAND = pc2scan.ProjectionParams(min_height=-1.0, max_height=2.0)
FORWARD = [[2.0, 0.01, 0.5, 7], [3.0, 0.01, 0.5, 1], [0.0, 4.0, 0.5, 1], [-5.0, -1.0, 0.5, 9], [1.0, 1.0, 9.0, 9]]


@dataclass(frozen=True)
class EveryNth:
    """Keeps every n-th point whose ring is not too high."""

    n: int
    highest: int = 100

    name = "thinned"
    explanation = "thinned out (see n)"
    fields = ("ring",)
    frame = Frame.SOURCE

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        ring = points.field("ring").reshape(-1)
        kept: NDArray[np.bool_] = (np.arange(ring.size) % self.n == 0) & (ring <= self.highest)
        return kept


@dataclass(frozen=True)
class Beyond:
    """Keeps what is beyond a plane of a frame."""

    frame: Any
    x: float

    name = "this_side"
    explanation = "on this side"
    fields = ()

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        kept: NDArray[np.bool_] = ~(points.field("x") <= self.x)
        return kept


def recorded(path: Path, clouds: int) -> Path:
    """Record clouds that are all alike."""
    data = cloud(np.array(FORWARD, np.float32), 2, names=("x", "y", "z", "ring"))
    items = tuple(Item(POINTS, T0 + number, {2: data}) for number in range(clouds))
    return write_mcap(path, Recording((POINTS,), items))


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_new_filter_is_one_class(tmp_path: Path, jobs: int) -> None:
    source = recorded(tmp_path / "a.mcap", 2)
    report = pc2scan.convert(
        source, tmp_path / "b.mcap", params=BAND, filters=[EveryNth(2, highest=8)], jobs=jobs, only_scans=True
    )
    (topic,) = report.topics
    # The third and the first are kept; the fifth would be, but for its ring.
    assert topic.points == pc2scan.PointCounts(total=10, used=4, thinned=6)
    assert topic.points.thinned == 6
    written = json.loads(report.as_json())
    assert written["scans"][0]["filters"] == [{"name": "thinned", "n": 2, "highest": 8}]
    assert list(written["topics"][0]["points"]) == [*pc2scan.PointCounts().as_dict(), "thinned"]
    for scan in pc2scan.scans(tmp_path / "b.mcap"):
        assert scan.ranges[np.isfinite(scan.ranges)].tolist() == pytest.approx([2.0, 4.0], rel=1e-4)


@pytest.mark.parametrize("frame", [Frame.SOURCE, Frame.TARGET, "base"])
def test_filters_work_in_the_frame_that_they_name(tmp_path: Path, frame: Any) -> None:
    source = recorded(tmp_path / "a.mcap", 1)
    static = [pc2scan.StaticTransform.parse("map lidar 0 0 0 0 0 1 0")]
    static.append(pc2scan.StaticTransform.parse("base lidar 10 0 0 0 0 0 1"))
    static.pop(1 if frame != "base" else 0)
    params = pc2scan.ProjectionParams(
        min_height=-1.0, max_height=2.0, target_frame="map" if frame is Frame.TARGET else ""
    )
    limit = {Frame.SOURCE: 1.5, Frame.TARGET: 0.0, "base": 11.5}[frame]
    options: dict[str, Any] = {"params": params, "static_tf": static, "filters": [Beyond(frame, limit)]}
    points = pc2scan.convert(source, tmp_path / "b.mcap", **options).topics[0].points
    # Turned by half a turn, the fourth is in front; the third is at -4e-16 or so.
    expected = {"used": 1, "this_side": 4} if frame is Frame.TARGET else {"used": 2, "this_side": 3}
    assert points.total == 5
    assert {name: getattr(points, name) for name in expected} == expected
