"""Points chosen by field, box, polygon and a sloping height limit; `tests/transcripts/selecting.txt` has the words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.core.terrain import on_ground
from support import ROOT

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

HALL = ROOT / "fixtures" / "hall.mcap"


def converted(folder: Path, **options: Any) -> tuple[list[NDArray[np.float32]], Any, pc2scan.Report]:
    """Ranges of the scans, the report's entry of their topic, and the report."""
    made = folder / "b.mcap"
    report = pc2scan.convert(HALL, made, **{"min_height": -9, "overwrite": True, "only_scans": True, **options})
    assert report.exit_status == 0
    (topic,) = (entry for entry in report.as_dict()["topics"] if entry["action"] == "converted")
    assert topic["points"]["total"] == sum(count for name, count in topic["points"].items() if name != "total")
    return [scan.ranges for scan in pc2scan.scans(made)], topic, report


def expected(keeps: Callable[..., Any], offset: float = 0.0) -> list[NDArray[np.float32]]:
    """Ranges of the clouds with only those points for which ``keeps`` is true."""
    found = []
    for cloud in pc2scan.clouds(HALL):
        fields = {name: cloud[name].astype(np.float64) for name in ("x", "y", "z", "intensity", "ring")}
        fields["x"] = fields["x"] + offset
        points = np.stack([cloud[axis] for axis in "xyz"], axis=1)[keeps(**fields)]
        found.append(pc2scan.project(points, pc2scan.ProjectionParams(min_height=-9.0)).ranges)
    return found


BODY = {"static_tf": "body lidar 1 0 0 0 0 0"}
CHOICES: list[tuple[dict[str, Any], Callable[..., Any], float, str]] = [
    (
        {"where": "ring in (3, 4, 5) and intensity > 10"},
        lambda ring, intensity, **_: np.isin(ring, (3, 4, 5)) & (intensity > 10),
        0.0,
        "where",
    ),
    (
        {"exclude_box": "body 1 6 -2 2 -1 1", **BODY},
        lambda x, y, z, **_: ~((x >= 1) & (x <= 6) & (abs(y) <= 2) & (abs(z) <= 1)),
        1.0,
        "exclude_box",
    ),
    (
        {"exclude_polygon": "body 1 -2 6 -2 6 2 1 2", **BODY},
        lambda x, y, **_: ~((x >= 1) & (x <= 6) & (abs(y) <= 2)),
        1.0,
        "exclude_polygon",
    ),
    (
        {"min_height": -0.5, "min_height_slope": 0.1},
        lambda x, y, z, **_: z >= -0.5 + 0.1 * np.hypot(x, y),
        0.0,
        "min_height_slope",
    ),
    ({"ground": "remove"}, lambda x, y, z, **_: ~on_ground(x, y, z), 0.0, "ground"),
    ({"ground": "keep"}, lambda x, **_: np.full(x.shape, True), 0.0, ""),
]


@pytest.mark.parametrize(("options", "keeps", "offset", "counted"), CHOICES, ids=lambda value: str(value)[:20])
def test_points_are_chosen_and_counted(
    options: dict[str, Any], keeps: Callable[..., Any], offset: float, counted: str, tmp_path: Path
) -> None:
    found, topic, report = converted(tmp_path, **options)
    np.testing.assert_array_equal(found, expected(keeps, offset))
    assert len(found) == 5
    points = topic["points"]
    assert set(points) & {name for *_, name in CHOICES} == {counted} - {""}
    if counted:
        assert 100 < points[counted] < 0.9 * points["total"]
        assert (points["height"] == 0) or counted == "min_height_slope"
    assert [each["name"] for each in report.as_dict()["scans"][0]["filters"]] == ([counted] if counted else [])
    assert not any("ground" in warning for warning in report.warnings)


def test_beams_are_removed_and_counted(tmp_path: Path) -> None:
    whole, topic, _ = converted(tmp_path, min_height=-0.5)
    assert topic["removed_beams"] == {}
    found, topic, report = converted(tmp_path, min_height=-0.5, remove=["shadows", "speckles"])
    counts = topic["removed_beams"]
    before, after = (int(np.isfinite(ranges).sum()) for ranges in (whole, found))
    assert counts["returns"] == before
    assert counts["returns"] - counts["shadows"] - counts["speckles"] == after < before
    kept = np.isfinite(found)
    np.testing.assert_array_equal(np.array(found)[kept], np.array(whole)[kept])
    assert any("beams were shadows, and are removed" in note for note in report.notes)
