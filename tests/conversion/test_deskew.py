"""Deskewing: held to one lookup a point, and to a simulated room with exact answers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pc2scan.conversion.deskew import Deskew, MovingCloud
from pc2scan.core.points import Points
from pc2scan.core.rigid import Rigid
from pc2scan.errors import DecodeError, TransformError
from pc2scan.request.filters import ExcludeBox
from pc2scan.request.point_time import PointTime
from pc2scan.transforms.builder import TransformBuilder
from pc2scan.transforms.placing import Placer
from support.tables import rows
from transforms.through import lookup_through

TABLES = Path(__file__).with_name("times.txt")
SECOND = 1_000_000_000
T0 = 1_700_000_000 * SECOND
MOUNT = Rigid.from_rpy(0.1, -0.2, 0.7, (0.3, -0.1, 0.5))
DIRECTIONS = ((1, 0, 0), (1, 1, 0), (0, 1, 0), (-1, 1, 0), (-1, 0, 0))


def driven(seconds: float) -> Rigid:
    """Where the robot is: 1.5 m/s and 1 rad/s, on a circle."""
    return Rigid.from_rpy(0.0, 0.0, seconds, (1.5 * math.sin(seconds), 1.5 - 1.5 * math.cos(seconds), 0.0))


def frames(target: str = "", *, rate: int = 50, begin: float = -1.0, end: float = 1.0, mount: Rigid = MOUNT) -> Placer:
    builder = TransformBuilder()
    for number in range(round(begin * rate), round(end * rate) + 1):
        stamp_ns = T0 + number * SECOND // rate
        builder.add([("odom", "base_link", stamp_ns, *driven(number / rate).pose)], static=False)
    builder.add([("base_link", "lidar", T0, *mount.pose)], static=True)
    return Placer(target, "", builder.build(), 0)


def points(xyz: Any, times: Any, name: str = "t", **fields: Any) -> Points:
    x, y, z = np.asarray(xyz, np.float32).reshape(-1, 3).T
    return Points(0, T0, "lidar", {"x": x, "y": y, "z": z, name: np.asarray(times), **fields})


def moving_of(stage: Deskew, cloud: Points) -> MovingCloud:
    found = stage(cloud)
    assert found is not None
    return found


def assert_placed_by_lookups(known: Placer, fixed: str, xyz: Any, times: Any, stamp: str = "header") -> None:
    """Each point is where a lookup with two times puts it, to the micrometre."""
    moving = moving_of(Deskew(known, fixed, PointTime(), stamp), points(xyz, times))
    low, high = int(times.min()), int(times.max())
    at = {"header": 0, "start": low, "end": high, "middle": (low + high) // 2}[stamp]
    assert abs(moving.stamp_ns - T0 - at) <= 1
    placed, kept, rejected = moving.place(moving.points)
    target, lost = known.target_frame or "lidar", 0
    assert placed.frame_id == moving.frame_id == target
    found = np.stack(placed.xyz(), axis=1)
    assert known.buffer is not None
    for place, (point, time) in enumerate(zip(xyz.astype(np.float64), times.tolist(), strict=True)):
        try:
            transform = lookup_through(known.buffer, target, moving.stamp_ns, "lidar", T0 + time, fixed)
        except TransformError:
            assert np.isnan(found[place]).all()
            lost += 1
            continue
        expected = transform.apply(point[np.newaxis])[0]
        np.testing.assert_allclose(found[place], expected, rtol=0, atol=1e-6 + 1e-7 * abs(expected).max())
    assert rejected == {"no_time": 0, "no_transform": lost}
    assert (kept is None) is (lost == 0)


@pytest.mark.parametrize("target", ["", "base_link", "odom"])
@pytest.mark.parametrize("stamp", ["header", "start", "middle", "end"])
def test_every_point_is_where_one_lookup_with_two_times_puts_it(target: str, stamp: str) -> None:
    rng = np.random.default_rng(5)
    xyz = rng.uniform(-8, 8, (400, 3)).astype(np.float32)
    assert_placed_by_lookups(frames(target, rate=30), "odom", xyz, rng.integers(-20_000_000, 80_000_000, 400), stamp)


def test_points_without_a_transform_or_a_time_are_counted() -> None:
    xyz = np.ones((10, 3))
    seconds = np.linspace(-0.05, 0.04, 10)
    seconds[3] = np.nan
    known = frames(end=0.005)
    moving = moving_of(Deskew(known, "odom", PointTime("time")), points(xyz, seconds, "time"))
    placed, kept, rejected = moving.place(moving.points)
    assert rejected == {"no_time": 1, "no_transform": 4}
    assert kept is not None
    assert kept.tolist() == [True, True, True, False, True, True, False, False, False, False]
    assert np.isnan(placed.field("x")[~kept]).all()


@pytest.mark.parametrize(
    ("kind", "unit", "name"), [("<f8", 1e-9, "time"), ("<f8", 1e-3, "timestamp"), ("<f8", 1.0, "t"), ("<u8", 1.0, "t")]
)
def test_a_time_of_zero_is_none_among_absolute_times(kind: str, unit: float, name: str) -> None:
    """Drivers write it for points without a return."""
    times = ((T0 + np.linspace(0, 0.05, 200) * SECOND) * unit).astype(kind)
    times[5::9] = 0
    moving = moving_of(Deskew(frames(), "odom", PointTime()), points(np.ones((200, 3)), times, name))
    _, kept, rejected = moving.place(moving.points)
    assert rejected == {"no_time": 22, "no_transform": 0}
    assert kept is not None
    assert np.array_equal(kept, times != 0)
    # After the stamp, 0 is a time.
    moving = moving_of(Deskew(frames(), "odom", PointTime()), points(np.ones((3, 3)), [0, 0, 50_000_000]))
    assert not sum(moving.place(moving.points)[2].values())


def test_a_cloud_before_all_transforms_is_an_error() -> None:
    with pytest.raises(TransformError):
        Deskew(frames(begin=0.5), "odom", PointTime())(points([[1, 1, 1]] * 2, [0, 1000]))
    # The scan's own time has a transform, within the tolerance, but no point has.
    known = frames(begin=0.0)
    near = Placer("", "", known.buffer, 10_000_000)
    with pytest.raises(TransformError) as caught:
        Deskew(near, "odom", PointTime())(points([[1, 1, 1]] * 2, [-2_000_000, -1_000_000]))
    assert "`time_offset=auto`" in str(caught.value.hint)
    # A column is measured at once.
    assert Deskew(near, "odom", PointTime())(points([[1, 1, 1]] * 2, [5, 5])) is not None


@pytest.mark.parametrize(("times", "name", "what"), rows(TABLES, "times that cannot be"))
def test_times_that_cannot_be_are_errors(times: Any, name: str, what: str) -> None:
    with pytest.raises(DecodeError) as caught:
        Deskew(frames(), "odom", PointTime())(points(DIRECTIONS[: len(times)], times, name))
    assert what in caught.value.message
    assert caught.value.hint
    assert caught.value.stamp_ns == T0


@pytest.mark.parametrize(
    ("asked", "times", "hint"),
    [
        ("t:us", [0, 100_000_000], "`point_time=t:ns`"),
        ("t:s", [0, 100_000_000], "`point_time=t:ns`"),
        ("t:s", [100_000_000, 100_000_050], "or have another unit: `point_time=t:us`"),
        ("", [0, 100 * SECOND], "`point_time=FIELD`"),
    ],
)
def test_a_unit_that_cannot_be_has_the_one_that_fits(asked: str, times: list[int], hint: str) -> None:
    with pytest.raises(DecodeError) as caught:
        Deskew(frames(), "odom", PointTime.parse(asked) if asked else PointTime())(points(np.ones((2, 3)), times))
    assert hint in str(caught.value.hint)


def test_what_is_fixed_to_the_robot_stays_where_it_is() -> None:
    """A box around a point of the robot rejects it whenever it was measured."""
    from pc2scan.conversion.steps import SelectStep

    known = frames("base_link")
    assert known.buffer is not None
    inside = known.buffer.lookup("lidar", "base_link", T0).apply(np.array([[0.5, 0.2, 0.1]]))
    cloud = points(np.repeat(inside, 3, axis=0), [0, 50_000_000, 100_000_000])
    moving = moving_of(Deskew(known, "odom", PointTime()), cloud)
    box = ExcludeBox("base_link", (0.49, 0.51), (0.19, 0.21), (0.09, 0.11))
    selected = SelectStep((box,), known).apply(moving.points, known.place("lidar", T0), moving)
    assert selected[2]["exclude_box"] == 3
