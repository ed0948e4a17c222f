"""Scans to points: against recorded results of upstream, and against a reference of one beam at a time."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pc2scan.core.unproject import RejectedBeams, UnprojectedScan, UnprojectParams, deskew, last_beam_ns, unproject
from pc2scan.errors import DecodeError, ParameterError, TransformError
from support import GOLDEN

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]

NONE = np.empty(0, np.float32)
EVERYTHING = UnprojectParams(distances=True, stamps=True, viewpoint=True)
CODES = {"f": 7, "i": 5}  # sensor_msgs/PointField: FLOAT32, INT32


class Transform(NamedTuple):
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    translation: Vector = (0.0, 0.0, 0.0)


IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)
ORIGIN: Vector = (0.0, 0.0, 0.0)


def f32(*values: float | np.float32) -> NDArray[np.float32]:
    return np.array(values, np.float32)


def points_of(
    ranges: NDArray[np.float32],
    intensities: NDArray[np.float32] = NONE,
    *,
    angle_min: float = -0.5,
    angle_increment: float = 0.1,
    range_min: float = 0.1,
    range_max: float = 12.0,
    time_increment: float = 0.001,
    params: UnprojectParams | None = None,
) -> UnprojectedScan:
    return unproject(
        ranges,
        intensities,
        angle_min=angle_min,
        angle_increment=angle_increment,
        range_min=range_min,
        range_max=range_max,
        time_increment=time_increment,
        params=params,
    )


def fields_of(points: NDArray[np.void]) -> list[tuple[str, int, int, int]]:
    fields = cast("dict[str, tuple[np.dtype[Any], int]]", points.dtype.fields)
    return [(name, fields[name][1], CODES[fields[name][0].kind], 1) for name in points.dtype.names or ()]


# --- upstream's recorded results -------------------------------------------------------------------------


def recorded(bag: Path, topic: str) -> list[Any]:
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(bag) as reader:
        connections = [connection for connection in reader.connections if connection.topic == topic]
        return [store.deserialize_ros1(raw, connection.msgtype) for connection, _, raw in reader.messages(connections)]


@pytest.mark.skipif(not GOLDEN.is_dir(), reason="the golden cases are not here (../shared/golden)")
@pytest.mark.parametrize("case", ["scan_plain", "scan_intensity"])
def test_golden_cases_are_equal_to_the_bit(case: str) -> None:
    scans = recorded(GOLDEN / case / "input.bag", "/scan")
    clouds = recorded(GOLDEN / case / "expected.bag", "/cloud")
    assert len(scans) == len(clouds) > 0
    for scan, cloud in zip(scans, clouds, strict=True):
        result = points_of(
            scan.ranges,
            scan.intensities,
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            range_min=scan.range_min,
            range_max=scan.range_max,
            time_increment=scan.time_increment,
        )
        assert fields_of(result.points) == [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields]
        assert result.points.dtype.itemsize == cloud.point_step
        assert len(result.points) == cloud.width
        assert result.points.tobytes() == cloud.data.tobytes()


def test_every_channel_deskewed_is_what_laser_geometry_returned() -> None:
    # Recorded from laser_geometry 1.6.7 (Debian): quaternions not normalised, and of opposite signs.
    scan = points_of(
        f32(2.5, math.nan, 0.75, 7.125, 12.0, 3.3, 0.05, 4.4),
        f32(1, 2, 3, 4, 5, 6, 7, 8),
        angle_min=-0.7,
        angle_increment=0.21,
        params=EVERYTHING,
    )
    moved = deskew(
        scan,
        Transform((0.1, -0.2, 0.3, 0.9), (1.5, -2.0, 0.25)),
        Transform((-0.2, 0.1, -0.4, -0.85), (1.75, -1.5, 0.5)),
    )
    assert [name for name, *_ in fields_of(moved.points)] == (
        ["x", "y", "z", "intensity", "index", "distances", "stamps", "vp_x", "vp_y", "vp_z"]
    )
    assert [point.tobytes().hex() for point in moved.points] == [
        "07d0774094f710c0c05e7e3f0000803f0000000000002040000000000000c03f000000c00000803e",
        "6b0c0e40514dccbf8817183f00004040020000000000403f6f12033b9224c93fdbb6edbf4992a43e",
        "12addc4070a306405c0a484000008040030000000000e440a69b443bdbb6cd3f4992e4bf6edbb63e",
        "969b3a403259893fde1eeb3f0000c04005000000333353400bd7a33b6edbd63f2549d2bfb76ddb3e",
        "942fb23f83b11a4067331e400000004107000000cdcc8c404260e53b0000e03f0000c0bf0000003f",
    ]


def test_numpys_cosine_and_sine_are_the_c_librarys() -> None:
    # Upstream calls cos and sin of libm. NumPy had its own for a while (1.22 to 1.24), one to four ulp off.
    angles = np.random.default_rng(5).uniform(-7, 7, 20_000)
    assert np.array_equal(np.cos(angles), [math.cos(angle) for angle in angles])
    assert np.array_equal(np.sin(angles), [math.sin(angle) for angle in angles])


# --- one beam at a time ----------------------------------------------------------------------------------


def reference(
    *,
    ranges: NDArray[np.float32],
    intensities: NDArray[np.float32],
    limits: tuple[float, float],
    angles: tuple[float, float],
    time_increment: float,
    range_cutoff: float,
) -> list[tuple[float, ...]]:
    """Every channel of every point; all arguments are float32 values but the cutoff."""
    cutoff = limits[1] if range_cutoff < 0 else range_cutoff
    points = []
    for index, reading in enumerate(ranges.tolist()):
        if reading < cutoff and reading >= limits[0]:
            angle = angles[0] + index * angles[1]
            row = [reading * math.cos(angle), reading * math.sin(angle), 0.0]
            row += [intensities[index].item()] if len(intensities) else []
            row += [index, reading, float(np.float32(index) * np.float32(time_increment)), 0.0, 0.0, 0.0]
            points.append(tuple(row))
    return points


finite = st.floats(-20, 20, width=32)
readings = st.one_of(
    st.floats(-1, 15, width=32),
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0, -0.0, 0.5, 12.0, float(np.float32(3e38))]),
)


@st.composite
def scans(draw: st.DrawFn) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    count = draw(st.integers(0, 40))
    ranges = draw(arrays(np.float32, count, elements=readings))
    with_intensities = draw(st.booleans())
    return ranges, draw(arrays(np.float32, count if with_intensities else 0, elements=finite))


@settings(deadline=None)
@given(
    scan=scans(),
    limits=st.tuples(st.sampled_from([0.0, 0.5, -1.0]), st.sampled_from([12.0, 1.0, math.inf])),
    angles=st.tuples(finite, st.floats(-0.5, 0.5, width=32)),
    time_increment=st.floats(-1, 1, width=32),
    range_cutoff=st.sampled_from([-1.0, 0.0, 0.5000000001, 12.0000001, 100.0, math.inf]),
)
def test_agrees_with_one_beam_at_a_time(
    scan: tuple[NDArray[np.float32], NDArray[np.float32]],
    limits: tuple[float, float],
    angles: tuple[float, float],
    time_increment: float,
    range_cutoff: float,
) -> None:
    ranges, intensities = scan
    before = ranges.tobytes(), intensities.tobytes()
    result = points_of(
        ranges,
        intensities,
        angle_min=angles[0],
        angle_increment=angles[1],
        range_min=limits[0],
        range_max=limits[1],
        time_increment=time_increment,
        params=UnprojectParams(distances=True, stamps=True, viewpoint=True, range_cutoff=range_cutoff),
    )
    expected = reference(
        ranges=ranges,
        intensities=intensities,
        limits=limits,
        angles=angles,
        time_increment=time_increment,
        range_cutoff=range_cutoff,
    )
    assert result.points.tobytes() == np.array(expected, result.points.dtype).tobytes()
    assert result.rejected.total + len(result.points) == result.beam_count == len(ranges)
    assert result.rejected.nan == sum(map(math.isnan, ranges))
    assert result.rejected.infinite == sum(map(math.isinf, ranges))
    assert (ranges.tobytes(), intensities.tobytes()) == before


# --- limits ----------------------------------------------------------------------------------------------


def test_limits_are_inclusive_below_and_exclusive_above() -> None:
    low, high = np.float32(0.1), np.float32(12)
    ranges = f32(
        low,
        np.nextafter(low, f32(0)[0]),
        high,
        np.nextafter(high, f32(0)[0]),
        math.nan,
        math.inf,
        -math.inf,
        0,
        -3,
    )
    result = points_of(ranges)
    assert result.beams.tolist() == [0, 3]
    assert result.beams.dtype == np.int32
    assert result.rejected == RejectedBeams(nan=1, infinite=2, below_min=3, beyond_max=1)
    assert result.rejected.total == 7


def test_zeros_are_points_where_range_min_allows_them() -> None:
    result = points_of(f32(0.0, -0.0, -0.1), range_min=0.0)
    assert result.beams.tolist() == [0, 1]
    assert not result.xyz.any()
    assert result.rejected == RejectedBeams(below_min=1)


@pytest.mark.parametrize(
    ("range_cutoff", "beams"),
    [
        (-1.0, [0, 1]),  # the scan's range_max
        (-1e-9, [0, 1]),
        (5.0, [0]),
        (5.000000001, [0, 1]),  # compared in float64: as float32 it is 5
        (12.5, [0, 1, 2]),  # beyond range_max: a way to keep maximum readings
        (math.inf, [0, 1, 2, 3]),
        (0.0, []),
    ],
)
def test_range_cutoff(range_cutoff: float, beams: list[int]) -> None:
    result = points_of(f32(1, 5, 12, 40, math.inf), params=UnprojectParams(range_cutoff=range_cutoff))
    assert result.beams.tolist() == beams
    assert result.rejected == RejectedBeams(infinite=1, beyond_max=4 - len(beams))


def test_infinite_range_max_keeps_every_finite_range() -> None:
    result = points_of(f32(3e38, math.inf, math.nan), range_max=1.7976931348623157e308)
    assert result.beams.tolist() == [0]
    assert np.isfinite(result.xyz).all()


def test_minus_infinity_is_a_point_only_where_range_min_is() -> None:
    result = points_of(f32(-math.inf, -math.inf), angle_min=0.0, range_min=-math.inf)
    assert result.beams.tolist() == [0, 1]
    assert result.points["x"].tolist() == [-math.inf, -math.inf]
    assert math.isnan(result.points["y"][0])
    assert result.rejected == RejectedBeams()


def test_limits_that_are_nan_keep_nothing() -> None:
    assert points_of(f32(1, 2), range_min=math.nan).rejected == RejectedBeams(below_min=2)
    assert points_of(f32(1, 2), range_max=math.nan).rejected == RejectedBeams(beyond_max=2)


# --- shapes and channels ---------------------------------------------------------------------------------


def test_negative_increments_turn_the_other_way() -> None:
    forward = points_of(f32(1, 2, 3), angle_min=0.25, angle_increment=0.5)
    backward = points_of(f32(1, 2, 3), angle_min=-0.25, angle_increment=-0.5)
    assert np.array_equal(forward.points["x"], backward.points["x"])
    assert np.array_equal(forward.points["y"], -backward.points["y"])
    assert forward.points["y"][2] > 0


def test_angles_are_the_messages_float32_values() -> None:
    exact = float(np.float32(0.1))
    result = points_of(f32(1, 1, 1), angle_min=0.1, angle_increment=0.1)
    assert result.points["y"].tolist() == [np.float32(math.sin(exact + i * exact)) for i in range(3)]


@pytest.mark.parametrize("intensities", [NONE, f32(7)])
def test_intensity_is_a_field_only_where_the_scan_has_any(intensities: NDArray[np.float32]) -> None:
    result = points_of(f32(1), intensities)
    names = [name for name, *_ in fields_of(result.points)]
    assert names == ["x", "y", "z", *(["intensity"] if len(intensities) else []), "index"]
    assert result.points["index"].tolist() == [0]


@pytest.mark.parametrize(
    ("params", "expected"),
    [
        (UnprojectParams(), ["intensity", "index"]),
        (UnprojectParams(intensity=False, index=False), []),
        (UnprojectParams(index=False, viewpoint=True), ["intensity", "vp_x", "vp_y", "vp_z"]),
        (UnprojectParams(intensity=False, stamps=True), ["index", "stamps"]),
        (EVERYTHING, ["intensity", "index", "distances", "stamps", "vp_x", "vp_y", "vp_z"]),
    ],
)
def test_channels_are_packed_in_laser_geometrys_order(params: UnprojectParams, expected: list[str]) -> None:
    result = points_of(f32(1, 0, 3), f32(5, 6, 7), params=params)
    names = ["x", "y", "z", *expected]
    assert fields_of(result.points) == [
        (name, 4 * position, 5 if name == "index" else 7, 1) for position, name in enumerate(names)
    ]
    assert result.points.dtype.itemsize == 4 * len(names)
    assert result.beams.tolist() == [0, 2]


def test_channel_values() -> None:
    result = points_of(f32(1, 0, 3), f32(5, 6, 7), params=EVERYTHING)
    assert result.points["intensity"].tolist() == [5, 7]
    assert result.points["distances"].tolist() == [1, 3]
    # The product is float32's, as upstream's.
    assert result.points["stamps"].tolist() == [0, np.float32(2) * np.float32(0.001)]
    assert result.viewpoint is not None
    assert not result.viewpoint.any()


@pytest.mark.parametrize("intensities", [0, 2])
def test_scan_without_a_kept_beam_has_its_fields(intensities: int) -> None:
    result = points_of(f32(math.nan, 0), np.ones(intensities, np.float32), params=EVERYTHING)
    assert len(result.points) == len(result.beams) == 0
    assert result.xyz.shape == (0, 3)
    assert ("intensity" in (result.points.dtype.names or ())) == bool(intensities)


def test_empty_scan_is_an_empty_cloud() -> None:
    # Its angles are often NaN: (angle_max - angle_min) / 0.
    result = points_of(NONE, angle_min=math.nan, angle_increment=math.nan)
    assert (len(result.points), result.beam_count, result.rejected.total) == (0, 0, 0)
    moved = deskew(result, Transform(), Transform())
    assert moved.xyz.shape == (0, 3)


@pytest.mark.parametrize(("ranges", "intensities"), [(3, 2), (3, 4), (0, 1)])
def test_intensities_of_another_length_are_an_error(ranges: int, intensities: int) -> None:
    message = f"intensities has {intensities} values, but ranges has {ranges}"
    with pytest.raises(DecodeError, match=message):
        points_of(np.ones(ranges, np.float32), np.ones(intensities, np.float32))


@pytest.mark.parametrize(
    ("angle_min", "angle_increment"), [(math.nan, 0.1), (0.0, math.nan), (math.inf, 0.1), (0.0, 1e39)]
)
def test_angles_must_be_finite(angle_min: float, angle_increment: float) -> None:
    with pytest.raises(DecodeError, match=r"angle_min is .* and angle_increment .*finite"):
        points_of(f32(1), angle_min=angle_min, angle_increment=angle_increment)


def test_range_cutoff_must_be_a_number() -> None:
    with pytest.raises(ParameterError, match="range_cutoff is NaN") as caught:
        UnprojectParams(range_cutoff=math.nan)
    assert caught.value.name == "range_cutoff"


def test_results_are_read_only() -> None:
    result = points_of(f32(1), params=EVERYTHING)
    with pytest.raises(ValueError, match="read-only"):
        result.points["x"] = 1
    with pytest.raises(ValueError, match="read-only"):
        result.xyz[:] = 1


def test_with_xyz_replaces_the_place_and_nothing_else() -> None:
    result = points_of(f32(1, 0, 3), f32(5, 6, 7), params=EVERYTHING)
    before = result.points.tobytes()
    moved = result.with_xyz([[1, 2, 3], [4, 5, 6]], viewpoint=(7, 8, 9))
    assert moved.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert moved.viewpoint is not None
    assert moved.viewpoint.tolist() == [[7, 8, 9]] * 2
    for name in ("intensity", "index", "distances", "stamps"):
        assert np.array_equal(moved.points[name], result.points[name])
    assert moved.rejected == result.rejected
    assert result.points.tobytes() == before
    with pytest.raises(ValueError, match="read-only"):
        moved.xyz[:] = 0


def test_with_xyz_needs_no_viewpoint_channels() -> None:
    moved = points_of(f32(1)).with_xyz([[1, 2, 3]], viewpoint=(7, 8, 9))
    assert moved.viewpoint is None
    assert moved.xyz.tolist() == [[1, 2, 3]]


# --- the last beam's time ---


def test_the_last_beams_time_is_a_float32_product_rounded_to_nanoseconds() -> None:
    # float32(0.1) is 0.100000001490..., and 359 times that, as float32, 35.9000015258...
    assert last_beam_ns(360, 0.1) == 35_900_001_526
    assert last_beam_ns(2, 0.1) == 100_000_001
    assert last_beam_ns(2, -0.1) == -100_000_001
    assert last_beam_ns(1, 0.1) == last_beam_ns(0, 0.1) == last_beam_ns(1000, 0.0) == 0
    assert (last_beam_ns(2, 5e-10), last_beam_ns(2, 6e-10)) == (0, 1)


@pytest.mark.parametrize("increment", [math.nan, math.inf, -math.inf, 3e38, 2.2e9, -2.2e9])
def test_times_that_no_duration_holds_are_an_error(increment: float) -> None:
    with pytest.raises(DecodeError, match="time_increment is"):
        last_beam_ns(2, increment)
    # Without a beam there is no last one.
    assert last_beam_ns(0, increment) == 0


# --- deskew ----------------------------------------------------------------------------------------------


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by + ay * bw + az * bx - ax * bz,
        aw * bz + az * bw + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def conjugate(q: Quaternion) -> Quaternion:
    return (-q[0], -q[1], -q[2], q[3])


def rotated(q: Quaternion, point: Vector) -> Vector:
    x, y, z, _ = multiply(multiply(q, (*point, 0.0)), conjugate(q))
    return (x, y, z)


def turned(start: Quaternion, end: Quaternion, ratio: float) -> Quaternion:
    """Slerp by another way: the relative rotation as axis and angle, a part of the angle."""
    x, y, z, w = multiply(conjugate(start), end)
    if w < 0:
        x, y, z, w = -x, -y, -z, -w
    sine = math.hypot(x, y, z)
    half = math.atan2(sine, w) * ratio
    scale = math.sin(half) / sine if sine else 0.0
    return multiply(start, (x * scale, y * scale, z * scale, math.cos(half)))


def yaw(angle: float) -> Quaternion:
    return (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))


@st.composite
def quaternions(draw: st.DrawFn) -> Quaternion:
    raw = [draw(st.floats(-1, 1)) for _ in range(4)]
    norm = math.hypot(*raw)
    return cast("Quaternion", tuple(value / norm for value in raw)) if norm > 0.01 else IDENTITY


vectors = st.tuples(*[st.floats(-50, 50)] * 3)


@settings(deadline=None)
@given(
    ranges=arrays(np.float32, st.integers(1, 20), elements=readings),
    start=st.builds(Transform, quaternions(), vectors),
    end=st.builds(Transform, quaternions(), vectors),
)
def test_deskew_agrees_with_one_beam_at_a_time(ranges: NDArray[np.float32], start: Transform, end: Transform) -> None:
    # Half a turn has two shortest ways; the reference may take the other one.
    assume(abs(sum(a * b for a, b in zip(start.quaternion, end.quaternion, strict=True))) > 1e-6)
    scan = points_of(ranges, params=EVERYTHING)
    moved = deskew(scan, start, end)
    assert moved.viewpoint is not None
    for row, beam in enumerate(cast("list[int]", scan.beams.tolist())):
        ratio = beam / (len(ranges) - 1) if len(ranges) > 1 else 0.0
        place = [(1 - ratio) * a + ratio * b for a, b in zip(start.translation, end.translation, strict=True)]
        point = rotated(turned(start.quaternion, end.quaternion, ratio), cast("Vector", tuple(scan.xyz[row].tolist())))
        expected = [a + b for a, b in zip(point, place, strict=True)]
        np.testing.assert_allclose(moved.xyz[row], expected, rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose(moved.viewpoint[row], place, rtol=1e-6, atol=1e-6)
    for name in ("index", "distances", "stamps"):
        assert np.array_equal(moved.points[name], scan.points[name])


def test_first_and_last_beam_take_the_transforms_at_their_ends() -> None:
    scan = points_of(f32(1, 2, 3), angle_min=0.0, angle_increment=1e-9)
    moved = deskew(scan, Transform(yaw(0.0), (10, 0, 0)), Transform(yaw(math.pi / 2), (20, 0, 0)))
    half = 2 * math.sqrt(0.5)
    np.testing.assert_allclose(moved.xyz, [[11.0, 0, 0], [15 + half, half, 0], [20.0, 3, 0]], atol=1e-6)


def test_beams_that_were_rejected_count_for_the_ratio() -> None:
    scan = points_of(f32(math.nan, math.nan, 3, math.nan, math.nan), angle_increment=0.0, angle_min=0.0)
    moved = deskew(scan, Transform(), Transform(IDENTITY, (8, 0, 0)))
    assert moved.xyz.tolist() == [[7, 0, 0]]


def test_one_beam_takes_the_first_transform() -> None:
    scan = points_of(f32(2), angle_min=0.0, params=EVERYTHING)
    moved = deskew(scan, Transform(yaw(math.pi / 2), (1, 2, 3)), Transform(yaw(1.0), (9, 9, 9)))
    np.testing.assert_allclose(moved.xyz, [[1, 4, 3]], atol=1e-6)
    assert moved.viewpoint is not None
    assert moved.viewpoint.tolist() == [[1, 2, 3]]


def test_sensor_at_rest_is_one_rigid_transform() -> None:
    scan = points_of(np.linspace(1, 10, 50, dtype=np.float32))
    rotation: Quaternion = (0.5, -0.5, 0.1, 0.7)
    norm = math.hypot(*rotation)
    unit = cast("Quaternion", tuple(value / norm for value in rotation))
    moved = deskew(scan, Transform(rotation, (1, 2, 3)), Transform(rotation, (1, 2, 3)))
    rows = cast("list[Vector]", scan.xyz.tolist())
    expected = np.add([rotated(unit, row) for row in rows], (1.0, 2.0, 3.0))
    np.testing.assert_allclose(moved.xyz, expected, atol=2e-6)


def test_at_rest_in_its_own_frame_deskew_changes_nothing() -> None:
    scan = points_of(np.linspace(1, 10, 50, dtype=np.float32), params=EVERYTHING)
    moved = deskew(scan, Transform(), Transform((0, 0, 0, -1), ORIGIN))
    assert moved.points.tobytes() == scan.points.tobytes()


def test_there_and_back_is_the_identity() -> None:
    # Rotations about one axis commute, so the inverse of the interpolated is the interpolated inverse.
    scan = points_of(np.linspace(1, 10, 50, dtype=np.float32))
    there = deskew(scan, Transform(yaw(0.3), ORIGIN), Transform(yaw(1.1), ORIGIN))
    back = deskew(there, Transform(yaw(-0.3), ORIGIN), Transform(yaw(-1.1), ORIGIN))
    assert np.abs(there.xyz - scan.xyz).max() > 0.5
    np.testing.assert_allclose(back.xyz, scan.xyz, atol=2e-6)


def test_a_wall_seen_while_driving_is_straight_again() -> None:
    # Wall x = 5 of the map, seen by a sensor that drives 1 m towards it and turns during the scan.
    beams = np.arange(101)
    ratio = beams / 100
    heading, drift = 0.4 * ratio, 1.0 * ratio
    direction = -0.5 + 0.01 * beams
    ranges = ((5 - drift) / np.cos(direction + heading)).astype(np.float32)
    scan = points_of(ranges, angle_min=-0.5, angle_increment=0.01)
    moved = deskew(scan, Transform(yaw(0.0), ORIGIN), Transform(yaw(0.4), (1, 0, 0)))
    assert np.ptp(scan.xyz[:, 0]) > 0.5
    np.testing.assert_allclose(moved.xyz[:, 0], 5, atol=1e-5)


@pytest.mark.parametrize(
    ("transform", "message"),
    [
        (Transform((0, 0, 0, 0)), "the quaternion at the {} beam is zero"),
        (Transform((0, 0, 1e-171, 0)), "the quaternion at the {} beam has the squared norm 0.0, which is no rotation"),
        (Transform((0, 0, 0, 1e171)), "the quaternion at the {} beam has the squared norm inf, which is no rotation"),
        (Transform((0, 0, math.nan, 1)), "the quaternion at the {} beam is [0.0, 0.0, nan, 1.0]"),
        (Transform(IDENTITY, (0, math.inf, 0)), "the translation at the {} beam is [0.0, inf, 0.0]"),
    ],
)
def test_transforms_that_are_none_are_an_error(transform: Transform, message: str) -> None:
    scan = points_of(f32(1, 2))
    with pytest.raises(TransformError, match=re.escape(message.format("first"))):
        deskew(scan, transform, Transform())
    with pytest.raises(TransformError, match=re.escape(message.format("last"))):
        deskew(scan, Transform(), transform)
