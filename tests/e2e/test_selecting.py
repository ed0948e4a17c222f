"""Points chosen by field, box, polygon and a sloping height limit, by the real command."""

from __future__ import annotations

import json
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.core.terrain import on_ground
from pc2scan.messages.laserscan import decode_laserscan
from pc2scan.messages.pointcloud2 import decode_pointcloud2
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

HALL = ROOT / "fixtures" / "hall.mcap"


def converted(folder: Path, *options: str, jobs: int = 1) -> tuple[list[NDArray[np.float32]], dict[str, int], Any]:
    """Ranges of the scans, the counts of points, and the report."""
    done = run(
        "convert", HALL, "-o", folder / "b.mcap", "--min-height", "-9", "--report", folder / "r.json", "--overwrite",
        "--jobs", str(jobs), "--only-scans", *options,
    )  # fmt: skip
    assert done.status == 0, done.stderr
    report = json.loads((folder / "r.json").read_text())
    with closing(open_recording(folder / "b.mcap")) as reader:
        ranges = [decode_laserscan(m.data, m.connection.serialization).ranges for m in reader.messages()]
    (topic,) = (entry for entry in report["topics"] if entry["action"] == "converted")
    return ranges, topic["points"], report


def expected(keeps: Any, offset: float = 0.0) -> list[NDArray[np.float32]]:
    """Ranges of the clouds with only those points for which ``keeps`` is true."""
    scans = []
    with closing(open_recording(HALL)) as reader:
        for message in reader.messages():
            if message.connection.topic == "/points":
                cloud = decode_pointcloud2(message.data, message.connection.serialization)
                names = ("x", "y", "z", "intensity", "ring")
                fields = {name: cloud.field(name).astype(np.float64) for name in names}
                fields["x"] = fields["x"] + offset
                mask = keeps(**fields)
                points = np.stack([axis[mask] for axis in cloud.xyz()], axis=1)
                scans.append(pc2scan.project(points, pc2scan.ProjectionParams(min_height=-9.0)).ranges)
    return scans


def assert_same(found: list[NDArray[np.float32]], reference: list[NDArray[np.float32]]) -> None:
    assert len(found) == len(reference) == 5
    for one, other in zip(found, reference, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("jobs", [1, 2])
def test_points_are_chosen_by_field(tmp_path: Path, jobs: int) -> None:
    found, points, report = converted(tmp_path, "--where", "ring in (3, 4, 5) and intensity > 10", jobs=jobs)
    assert_same(found, expected(lambda ring, intensity, **_: np.isin(ring, (3, 4, 5)) & (intensity > 10)))
    assert 0 < points["where"] < points["total"]
    assert points["total"] == sum(count for name, count in points.items() if name != "total")
    assert report["filters"] == [{"name": "where", "condition": "ring in (3, 4, 5) and intensity > 10"}]


def test_the_robots_own_body_is_excluded(tmp_path: Path) -> None:
    options = ("--static-tf", "body lidar 1 0 0 0 0 0", "--exclude-box", "body 1 6 -2 2 -1 1")
    found, points, _ = converted(tmp_path, *options)
    inside = expected(lambda x, y, z, **_: ~((x >= 1) & (x <= 6) & (abs(y) <= 2) & (abs(z) <= 1)), offset=1.0)
    assert_same(found, inside)
    assert points["exclude_box"] > 100
    polygon = (*options[:2], "--exclude-polygon", "body 1 -2 6 -2 6 2 1 2")
    found, points, _ = converted(tmp_path, *polygon)
    assert_same(found, expected(lambda x, y, **_: ~((x >= 1) & (x <= 6) & (abs(y) <= 2)), offset=1.0))


def test_a_height_limit_may_grow_with_range(tmp_path: Path) -> None:
    found, points, _ = converted(tmp_path, "--min-height", "-0.5", "--min-height-slope", "0.1")
    assert_same(found, expected(lambda x, y, z, **_: z >= -0.5 + 0.1 * np.hypot(x, y)))
    assert points["min_height_slope"] > 1000
    assert points["height"] == 0


def test_the_ground_is_removed(tmp_path: Path) -> None:
    found, points, report = converted(tmp_path, "--min-height", "-9", "--ground", "remove")
    assert_same(found, expected(lambda x, y, z, **_: ~on_ground(x, y, z)))
    assert 0.2 < points["ground"] / points["total"] < 0.8
    assert points["total"] == sum(count for name, count in points.items() if name != "total")
    assert report["filters"] == [{"name": "ground"}]
    assert not any("ground" in warning for warning in report["warnings"])
    kept, points, _ = converted(tmp_path, "--min-height", "-9", "--ground", "keep")
    assert "ground" not in points
    assert_same(kept, expected(lambda x, **_: np.full(x.shape, True)))


def test_clouds_without_ground_are_warned_of(tmp_path: Path) -> None:
    _, points, report = converted(tmp_path, "--min-height", "-9", "--where", "z > 0.5", "--ground", "remove")
    assert points["ground"] == 0
    assert any("found no ground in any cloud" in warning for warning in report["warnings"])


def test_beams_are_removed_and_counted(tmp_path: Path) -> None:
    whole, _, report = converted(tmp_path, "--min-height", "-0.5")
    assert next(entry for entry in report["topics"] if entry["action"] == "converted")["removed_beams"] == {}
    found, _, report = converted(tmp_path, "--min-height", "-0.5", "--remove", "shadows", "--remove", "speckles")
    (topic,) = (entry for entry in report["topics"] if entry["action"] == "converted")
    counts = topic["removed_beams"]
    assert counts["returns"] == sum(int(np.isfinite(ranges).sum()) for ranges in whole)
    left = sum(int(np.isfinite(ranges).sum()) for ranges in found)
    assert counts["returns"] - counts["shadows"] - counts["speckles"] == left < counts["returns"]
    for one, other in zip(found, whole, strict=True):
        kept = np.isfinite(one)
        np.testing.assert_array_equal(one[kept], other[kept])
    assert any("beams were shadows, and are removed" in note for note in report["notes"])


def test_several_filters_count_each_point_once_and_are_shown(tmp_path: Path) -> None:
    done = run(
        "convert", HALL, "-o", tmp_path / "b.mcap", "--min-height", "-9", "--where", "ring > 2", "--where", "ring < 9",
        "--exclude-box", "lidar 0 9 -9 9 -9 9", "--min-height-slope", "0.01",
    )  # fmt: skip
    assert done.status == 0, done.stderr
    heads = next(line for line in done.stdout.splitlines() if line.startswith("on "))
    assert heads.split("past end")[1].split() == ["where", "exclude", "box", "min", "height", "slope", "empty"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--where", "ring in 3"], "--where: column 9 of 'ring in 3': expected '(', not '3'"),
        (["--where", "rnig > 3"], "--where needs the field 'rnig', which the clouds on /points do not have"),
        (["--exclude-box", "body 0 1"], "--exclude-box: 'body 0 1' has 2 numbers, a box has 6"),
        (["--exclude-polygon", "body 0 1"], "--exclude-polygon: the polygon in body has 1 corners"),
        (["--remove", "shadow"], "--remove is 'shadow', it must begin with one of shadows, speckles"),
        (["--ground", "remvoe"], "--ground is 'remvoe', it must be one of keep, remove"),
        (["--min-height-slope", "-1"], "--min-height-slope is -1.0, it must be 0 or more"),
        (["--reverse", "--where", "ring > 3"], "filters select points of clouds"),
    ],
)
def test_what_cannot_be_is_wrong_usage(tmp_path: Path, options: list[str], said: str) -> None:
    done = run("convert", HALL, "-o", tmp_path / "b.mcap", *options)
    assert done.status == 2
    assert said in " ".join(done.stderr.split())
    assert not (tmp_path / "b.mcap").exists()


def test_a_frame_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    done = run("convert", HALL, "-o", tmp_path / "b.mcap", "--exclude-box", "bdy 0 1 0 1 0 1")
    assert done.status == 1
    assert "bdy" in done.stderr


def test_the_filter_to_blame_for_empty_scans_is_named(tmp_path: Path) -> None:
    done = run("convert", HALL, "-o", tmp_path / "b.mcap", "--where", "ring > 900")
    assert "5 of 5 scans on /scan have no return at all: 100% of all points were rejected by --where" in " ".join(
        done.stderr.split()
    )
