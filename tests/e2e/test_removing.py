"""Beams that are removed: mixed pixels, walls and posts in simulated recordings, and warnings of removing too much."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest

from pc2scan.cli.render import as_typed
from pc2scan.core.params import ProjectionParams
from pc2scan.core.project import project
from support import conversions, sampled
from support.tables import rows
from support.worlds.labelled import labelled
from support.worlds.mounted import write_clouds
from support.worlds.veiled import LIDARS, PLANS, Kind, Scan, Veiled, scan_of, veiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

LOWEST, HIGHEST = -0.3, 0.6
TABLES = Path(__file__).with_name("removing.txt")
BEAMS = (360, 720)
#: In these there is an edge every few degrees.
CROWDED = {"store 1", "store 2", "store 3"}


class Conversion(NamedTuple):
    """The scans of a recording, its warnings about removed beams, and the counts of beams."""

    scans: list[NDArray[np.float32]]
    warnings: list[str]
    removed: dict[str, int]


def written(folder: Path, *clouds: Veiled) -> Path:
    return write_clouds(folder / "in.mcap", [cloud.points for cloud in clouds])


def expected(cloud: Veiled, beams: int) -> Scan:
    return scan_of(cloud, ProjectionParams(angle_increment=2 * math.pi / beams, min_height=LOWEST, max_height=HIGHEST))


def converted(recording: Path, beams: int, *options: str) -> Conversion:
    heights = ("--min-height", str(LOWEST), "--max-height", str(HIGHEST))
    words = ("--angle-increment", repr(2 * math.pi / beams), *heights, *options)
    made = conversions.converted(recording.with_name("out.mcap"), recording, *words)
    assert made.done.status == 0, made.done.stderr
    (topic,) = (entry for entry in made.report["topics"] if entry["action"] == "converted")
    warnings = [as_typed(each) for each in made.report["warnings"] if " removed " in each]
    return Conversion([scan.ranges for scan in made.scans], warnings, topic["removed_beams"])


@pytest.mark.parametrize("plan", sampled(sorted(PLANS.keys() - CROWDED), 1))
def test_shadows_keep_clean_walls_and_posts(plan: str, tmp_path: Path) -> None:
    clouds = [veiled(plan, lidar, noise=noise) for lidar in LIDARS for noise in (0.0, 0.02)]
    recording = written(tmp_path, *clouds)
    for beams in BEAMS:
        found = converted(recording, beams, "--remove", "shadows")
        assert not found.warnings
        for cloud, scan in zip(clouds, found.scans, strict=True):
            ranges, kinds = expected(cloud, beams)
            gone = np.isfinite(ranges) & ~np.isfinite(scan)
            assert np.count_nonzero(gone[kinds == Kind.WALL]) <= 0.01 * np.count_nonzero(kinds == Kind.WALL)
            assert not gone[kinds == Kind.POST].any()


@pytest.mark.slow
def test_shadows_remove_most_mixed_pixels(tmp_path: Path) -> None:
    clouds = [veiled(plan, lidar, noise=0.02, mixed=True) for plan in PLANS for lidar in ("16 rings", "1 ring")]
    recording = written(tmp_path, *clouds)
    mixed, true = np.zeros(2, int), np.zeros(2, int)
    for beams in BEAMS:
        for cloud, scan in zip(clouds, converted(recording, beams, "--remove", "shadows").scans, strict=True):
            kinds, gone = expected(cloud, beams).kinds, ~np.isfinite(scan)
            mixed += [gone[kinds == Kind.MIXED].sum(), np.count_nonzero(kinds == Kind.MIXED)]
            surface = (kinds == Kind.WALL) | (kinds == Kind.POST)
            true += [gone[surface].sum(), np.count_nonzero(surface)]
    assert mixed[1] > 100
    assert mixed[0] > 0.9 * mixed[1]
    assert true[0] < 0.005 * true[1]


@pytest.mark.parametrize(("plan", "lidar", "options", "said"), rows(TABLES, "filters that remove a tenth"))
def test_filters_that_remove_a_tenth_are_warned_of(
    plan: str, lidar: str, options: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    recording = written(tmp_path, veiled(plan, lidar, noise=0.02))
    found = converted(recording, 576, *options)
    (warning,) = found.warnings
    assert said in warning
    name = "speckles" if "--remove" in options else "sparse"
    assert f"{found.removed[name]:,} of {found.removed['returns']:,} beams" in warning
    (whole,), (scan,) = converted(recording, 576).scans, found.scans
    assert found.removed == {
        "returns": int(np.isfinite(whole).sum()),
        name: int(np.isfinite(whole).sum() - np.isfinite(scan).sum()),
    }


@pytest.mark.parametrize(("lidar", "height"), sampled([("16 rings", 1.0), ("32 rings", 1.8), ("64 rings", 1.8)], 1))
def test_beams_end_on_boxes_where_the_ground_is_removed(lidar: str, height: float, tmp_path: Path) -> None:
    cloud = labelled("boxes of 0.3 m", lidar, lidar=height)
    high = ~cloud.ground & (cloud.above > 0.16 + 0.008 * np.hypot(cloud.points[:, 0], cloud.points[:, 1]))
    params = ProjectionParams(min_height=LOWEST, max_height=HIGHEST, angle_increment=math.tau / 360)
    boxes, nearest = (project(cloud.points[those], params).ranges for those in (~cloud.ground, high))
    (scan,) = converted(write_clouds(tmp_path / "in.mcap", [cloud.points]), 360, "--ground", "remove").scans
    seen = np.isfinite(nearest)
    # Nothing but boxes is in the scan, and at most one beam lost its box.
    assert np.count_nonzero(scan[seen] > nearest[seen] + 0.5) <= 1
    assert not np.isfinite(scan[~np.isfinite(boxes)]).any()
