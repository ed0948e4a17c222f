"""How many differing beams another libm explains, over the scans of a topic."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.bags.opening import open_recording
from pc2scan.compare.libm import CloudsByStamp, Explainer, Explanation
from pc2scan.compare.rules import Rules
from pc2scan.core.rounding import CORRECT, GLIBC
from pc2scan.messages.laserscan import LaserScan
from support.builders import POINTS, T0, Item, Recording, cloud, item, points_of, write_mcap

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


def no_transforms(path: Path) -> Any:
    raise AssertionError(path)


def scan(ranges: Sequence[float], **changes: Any) -> LaserScan:
    values: dict[str, Any] = {
        "sequence": 0, "stamp_ns": 5, "frame_id": "lidar", "angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.5,
        "time_increment": 0.0, "scan_time": 0.1, "range_min": 0.0, "range_max": 30.0, "ranges": np.array(ranges, "<f4"),
    }  # fmt: skip
    return LaserScan(**{**values, **changes})


def explained(*pairs: tuple[LaserScan, LaserScan], rules: Rules | None = None) -> Explanation:
    explainer = Explainer(CloudsByStamp([], no_transforms), rules or Rules())
    for a, b in pairs:
        explainer.add(a, b)
    return explainer.found


NO_CLOUDS = "there are no clouds (`clouds` names some)"


@pytest.mark.parametrize(
    ("pairs", "tolerance", "expected"),
    [
        ([((1, 2, 3, 4), (1, 2, 3, 4))], 0.0, (0, 0, 0, 0, 0, {})),
        ([((9, 2, 5, 9), (9, 5, 2, 9)), ((4, 4, 4, 4), (4, 3, 4, 4))], 0.0, (2, 3, 2, 0, 0, {NO_CLOUDS: 2})),
        # What is within the tolerance does not differ.
        ([((1, 2, 3, 4), (1.2, 2, 9, 4))], 0.5, (1, 1, 0, 1, 0, {NO_CLOUDS: 1})),
    ],
)
def test_beams_are_explained_by_scans_alone(pairs: Any, tolerance: float, expected: tuple[Any, ...]) -> None:
    rules = Rules(atol={"ranges": tolerance})
    found = explained(*((scan(a), scan(b)) for a, b in pairs), rules=rules)
    sums = (found.scans_alone, found.beams_alone, found.in_neighbour, found.hidden, found.beams_not_judged)
    assert (*sums, found.reasons) == expected
    assert (found.scans, found.beams, found.explained, found.glibc) == (0, 0, 0, "")


def test_beams_that_look_elsewhere_are_not_judged() -> None:
    found = explained((scan([1, 2, 3, 4]), scan([2, 1, 3, 4], angle_min=-0.9)))
    assert (found.beams_not_judged, found.beams_alone, found.reasons) == (2, 0, {"angle_min differs": 1})


@pytest.mark.parametrize(
    ("a", "b", "glibc"),
    [
        ((9, 10), (10, 9), "a"),
        ((10, 9), (9, 10), "b"),
        # Only one side has a point that decides.
        ((9, 10), (9, 9), "a"),
        ((9, 9), (10, 9), "a"),
        # Both were made with the same angles, or no point decides.
        ((10, 9), (10, 9), ""),
        ((9, 10), (9, 10), ""),
        ((9, 9), (9, 9), ""),
    ],
)
def test_all_returns_decide_which_side_has_which_angles(a: tuple[int, int], b: tuple[int, int], glibc: str) -> None:
    found = Explanation(scans=1, beams=9, a_glibc=3, b_glibc=4)
    found.fitting[:, CORRECT], found.fitting[:, GLIBC] = (a[0], b[0]), (a[1], b[1])
    assert found.glibc == glibc
    assert found.explained == {"a": 3, "b": 4, "": 0}[glibc]


@pytest.mark.parametrize("order", [range(12), range(11, -1, -1), (3, 3, 0, 7, 6, 11, 2)])
def test_clouds_are_found_in_any_order(order: Sequence[int], tmp_path: Path) -> None:
    """Three of them at each log time."""

    def cloud_of(step: int) -> Item:
        def encoded(ros_version: int, _: int) -> bytes:
            return cloud(points_of(step), ros_version, stamp_ns=1000 + step)

        return item(POINTS, T0 + step // 3, encoded)

    path = write_mcap(tmp_path / "a.mcap", Recording((POINTS,), tuple(map(cloud_of, range(12)))))
    with closing(open_recording(path)) as reader:
        clouds = CloudsByStamp([reader], no_transforms)
        assert clouds
        assert not list(clouds.of(scan([1], stamp_ns=999)))
        for step in order:
            ((topic, parts),) = clouds.of(scan([1], stamp_ns=1000 + step))
            assert topic == "/points"
            ((x, y),) = parts
            np.testing.assert_array_equal(np.stack([x, y], axis=1), points_of(step)[:, :2])
