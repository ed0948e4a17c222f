"""The transform buffer's rules, one by one; test_through.py and tests/parity hold it to tf2 itself."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from pc2scan.core.rigid import interpolate_poses
from pc2scan.errors import RecordingError
from pc2scan.transforms.builder import TransformBuilder
from pc2scan.transforms.motion import sensor_motion
from transforms.small_buffers import EPOCH, SECOND, at, built, refusal, row, x_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.core.rigid import TransformRow


def test_the_ratio_is_that_of_seconds_in_float64() -> None:
    # 1e-9 times 3 is not 3e-9: what tf2 returns, in tests/parity too.
    buffer = built([row("odom", "base", 0, x=0), ("odom", "base", EPOCH + 7, 1.0, 0, 0, 0, 0, 0, 1)])
    assert x_of(buffer, "odom", "base", EPOCH + 3) == (1e-9 * 3) / (1e-9 * 7) != 3 / 7
    far = built([row("odom", "base", 0, x=0), row("odom", "base", 1, x=1e9)])
    assert x_of(far, "odom", "base", at(0.5) + 1) == pytest.approx(500_000_001, abs=1e-3)


def test_the_first_and_the_last_sample_are_given_as_they_are() -> None:
    rows = [row("odom", "base", second, x=0.1 * second, yaw=0.3 * second) for second in range(5)]
    buffer = built(rows)
    for entry in (rows[0], rows[-1]):
        assert buffer.lookup("odom", "base", entry[2]).pose == entry[3:]
    # Those between them with the ratio 0, which tf2's slerp may round away from them.
    for entry, after in pairwise(rows[1:]):
        found = buffer.lookup("odom", "base", entry[2]).pose
        assert found == interpolate_poses(entry[3:], after[3:], 0.0)
        assert found == pytest.approx(entry[3:], rel=1e-15)


def test_static_holds_at_any_time_and_the_last_one_counts() -> None:
    buffer = built(static=[row("a", "b", 50, x=1), row("c", "b", 40, x=2)])
    assert [x_of(buffer, "c", "b", stamp_ns) for stamp_ns in (1, at(0), at(99))] == [2, 2, 2]
    # As in tf2 the parent of the overwritten one is known, but connected to nothing.
    assert "no transforms connect" in refusal(buffer, "a", "b", at(0)).message


def test_a_rejected_transform_does_not_decide_whether_a_frame_is_static() -> None:
    builder = TransformBuilder()
    builder.add([row("a", "b", 1, x=math.nan)], static=False)
    builder.add([row("a", "b", 3, x=3)], static=True)
    builder.add([row("a", "b", 2, x=2)], static=False)
    assert x_of(builder.build(), "a", "b", at(9)) == 2


def test_a_frame_stays_with_its_parent_until_it_has_another() -> None:
    buffer = built([row("a", "b", 1, x=1), row("a", "b", 2, x=3), row("c", "b", 4, x=7), row("c", "b", 5, x=8)])
    assert [x_of(buffer, "a", "b", at(second)) for second in (1.5, 2, 3.9)] == [2, 3, 3]
    assert [x_of(buffer, "c", "b", at(second)) for second in (4, 4.5)] == [7, 7.5]


def test_a_stamp_of_zero_asks_for_the_latest_common_time() -> None:
    buffer = built(
        [row("map", "odom", second, x=10 * second) for second in range(4)]
        + [row("odom", "base", second / 2, x=second / 2) for second in range(12)],
        [row("base", "lidar", 99, x=100)],
    )
    assert [x_of(buffer, target, "lidar", 0) for target in ("map", "odom", "base")] == [133, 105.5, 100]


def test_what_only_localisation_moves_moves() -> None:
    driven = [row("map", "odom", number / 10, number / 10) for number in range(20)]
    motion = sensor_motion(built(driven, [row("odom", "base", 0), row("base", "lidar", 0)]), "lidar", 0.1)
    assert motion is not None
    assert motion.fixed == "map"
    assert motion.metres == pytest.approx(0.1)


@pytest.mark.parametrize(("second", "gap"), [(2.8 + 0.1, 0.1), (1.2 - 0.1, 0.1), (3.5, 0.7), (0.5, 0.7)])
def test_a_nanosecond_more_than_the_tolerance_is_refused(second: float, gap: float) -> None:
    buffer = built(
        [row("odom", "base", second, x=second) for second in (1, 2, 3)]
        + [row("base", "lidar", second, x=10 * second) for second in (1.2, 2.8)]
    )
    tolerance_ns = round(gap * SECOND)
    # Each frame of the chain is clamped for itself.
    expected = min(max(second, 1), 3) + 10 * min(max(second, 1.2), 2.8)
    assert x_of(buffer, "odom", "lidar", at(second), tolerance_ns) == pytest.approx(expected)
    message = refusal(buffer, "odom", "lidar", at(second), tolerance_ns - 1).message
    assert f"the time is {gap:.9f} s too {'late' if second > 2 else 'early'}" in message


def test_a_tolerance_changes_nothing_that_is_known_without_it() -> None:
    # b hangs below a until 1, a below b from 2 on: with a tolerance both ends would be known at 1.
    buffer = built([row("a", "b", 0, x=1), row("a", "b", 1, x=1), row("b", "a", 2, x=2), row("b", "a", 3, x=2)])
    assert x_of(buffer, "a", "b", at(1), SECOND) == 1
    assert x_of(buffer, "a", "b", at(2), SECOND) == -2


# The buffer and its builder.


@pytest.mark.parametrize(
    ("rows", "static", "told"),
    [
        ((row(f"f{n}", f"f{n + 1}", 0) for n in range(100_000)), True, "more than 100,000 frames"),
        ((row(f"f{n % 500}", f"g{n // 500}", n) for n in range(200_001)), False, "200,000 pairs"),
    ],
    ids=["frames", "pairs"],
)
def test_more_than_a_robot_has_is_refused(rows: Iterator[TransformRow], static: bool, told: str) -> None:
    with pytest.raises(RecordingError, match=told):
        TransformBuilder().add(rows, static=static)
