"""Scans to points, against a reference of one beam at a time; upstream's recorded results are in tests/e2e."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pc2scan.core.rigid import Rigid
from pc2scan.core.unproject import UnprojectedScan, UnprojectParams, deskew, last_beam_ns, unproject
from pc2scan.errors import DecodeError

if TYPE_CHECKING:
    from numpy.typing import NDArray

NONE = np.empty(0, np.float32)
EVERYTHING = UnprojectParams(distances=True, stamps=True, viewpoint=True)
INF, NAN = math.inf, math.nan


class Transform(NamedTuple):
    """A transform whose quaternion stays as it is."""

    quaternion: tuple[float, ...]
    translation: tuple[float, ...]


def f32(*values: float | np.float32) -> NDArray[np.float32]:
    return np.array(values, np.float32)


def points_of(ranges: NDArray[np.float32], intensities: NDArray[np.float32] = NONE, **header: Any) -> UnprojectedScan:
    usual = {"angle_min": -0.5, "angle_increment": 0.1, "range_min": 0.1, "range_max": 12.0, "time_increment": 0.001}
    return unproject(ranges, intensities, **usual | header)


def test_every_channel_deskewed_is_what_laser_geometry_returned() -> None:
    # Recorded from laser_geometry 1.6.7 (Debian): quaternions not normalised, and of opposite signs.
    scan = points_of(
        f32(2.5, NAN, 0.75, 7.125, 12.0, 3.3, 0.05, 4.4),
        f32(1, 2, 3, 4, 5, 6, 7, 8),
        angle_min=-0.7,
        angle_increment=0.21,
        params=EVERYTHING,
    )
    moved = deskew(
        scan,
        Transform((0.1, -0.2, 0.3, 0.9), (1.5, -2.0, 0.25)),  # type: ignore[arg-type]
        Transform((-0.2, 0.1, -0.4, -0.85), (1.75, -1.5, 0.5)),  # type: ignore[arg-type]
    )
    assert [point.tobytes().hex() for point in moved.points] == [
        "07d0774094f710c0c05e7e3f0000803f0000000000002040000000000000c03f000000c00000803e",
        "6b0c0e40514dccbf8817183f00004040020000000000403f6f12033b9224c93fdbb6edbf4992a43e",
        "12addc4070a306405c0a484000008040030000000000e440a69b443bdbb6cd3f4992e4bf6edbb63e",
        "969b3a403259893fde1eeb3f0000c04005000000333353400bd7a33b6edbd63f2549d2bfb76ddb3e",
        "942fb23f83b11a4067331e400000004107000000cdcc8c404260e53b0000e03f0000c0bf0000003f",
    ]


finite = st.floats(-20, 20, width=32)
readings = st.one_of(
    st.floats(-1, 15, width=32),
    st.sampled_from([NAN, INF, -INF, 0.0, -0.0, 0.5, 12.0, float(np.nextafter(np.float32(12), np.float32(0))), 3e38]),
).map(lambda value: float(np.float32(value)))
channels = {name: st.booleans() for name in ("intensity", "index", "distances", "stamps", "viewpoint")}


@st.composite
def scans(draw: st.DrawFn) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    count = draw(st.integers(0, 40))
    ranges = draw(arrays(np.float32, count, elements=readings))
    return ranges, draw(arrays(np.float32, draw(st.sampled_from([0, count])), elements=finite))


@given(
    scan=scans(),
    limits=st.tuples(st.sampled_from([0.0, 0.5, -1.0, -INF, NAN]), st.sampled_from([12.0, 1.0, INF, NAN])),
    angles=st.tuples(finite, st.floats(-0.5, 0.5, width=32)),
    time_increment=st.floats(-1, 1, width=32),
    # Compared in float64: as float32 two of them are 0.5 and 12.
    range_cutoff=st.sampled_from([-1.0, -1e-9, 0.0, 0.5000000001, 12.0000001, 100.0, INF]),
    wanted=st.fixed_dictionaries(channels),
)
def test_points_are_those_of_one_beam_at_a_time(
    scan: tuple[NDArray[np.float32], NDArray[np.float32]],
    limits: tuple[float, float],
    angles: tuple[float, float],
    time_increment: float,
    range_cutoff: float,
    wanted: dict[str, bool],
) -> None:
    ranges, intensities = scan
    before = ranges.tobytes(), intensities.tobytes()
    header = {"angle_min": angles[0], "angle_increment": angles[1], "range_min": limits[0], "range_max": limits[1]}
    result = points_of(
        ranges,
        intensities,
        **header,
        time_increment=time_increment,
        params=UnprojectParams(range_cutoff=range_cutoff, **wanted),
    )
    rows: dict[str, list[float]] = {
        name: [] for name in (*"xyz", "intensity", "index", "distances", "stamps", "vp_x", "vp_y", "vp_z")
    }
    cutoff = limits[1] if range_cutoff < 0 else range_cutoff
    rejected = dict.fromkeys(("nan", "range"), 0)
    for beam, reading in enumerate(ranges.tolist()):
        if reading < cutoff and reading >= limits[0]:
            angle = angles[0] + beam * angles[1]
            lit = intensities[beam].item() if intensities.size else 0.0
            stamp = float(np.float32(beam) * np.float32(time_increment))
            with np.errstate(all="ignore"):
                row = (reading * math.cos(angle), reading * math.sin(angle), 0, lit, beam, reading, stamp, 0, 0, 0)
            for column, value in zip(rows.values(), row, strict=True):
                column.append(value)
        else:
            rejected["nan" if math.isnan(reading) else "range"] += 1
    if not intensities.size:
        del rows["intensity"]
    for name, column in rows.items():
        chosen = wanted.get("viewpoint" if name.startswith("vp_") else name, True)
        assert (name in result.points.dtype.fields) == chosen  # type: ignore[operator]
        if chosen:
            kind = np.int32 if name == "index" else np.float32
            assert result.points[name].tobytes() == np.array(column, kind).tobytes()
    # Packed, in laser_geometry's order.
    names = result.points.dtype.names or ()
    assert [*names] == [name for name in rows if name in names]
    assert result.points.dtype.itemsize == 4 * len(names)
    assert result.beams.tolist() == rows["index"]
    assert (result.beam_count, result.rejected) == (len(ranges), rejected)
    assert (ranges.tobytes(), intensities.tobytes()) == before


def test_an_empty_scan_is_an_empty_cloud() -> None:
    # Its angles are often NaN: (angle_max - angle_min) / 0.
    result = points_of(NONE, angle_min=NAN, angle_increment=NAN)
    assert (len(result.points), result.beam_count, result.rejected) == (0, 0, {"nan": 0, "range": 0})
    assert deskew(result, Rigid.identity(), Rigid.identity()).xyz.shape == (0, 3)


@pytest.mark.parametrize(("angle_min", "angle_increment"), [(NAN, 0.1), (0.0, NAN), (INF, 0.1), (0.0, 1e39)])
def test_angles_must_be_finite(angle_min: float, angle_increment: float) -> None:
    with pytest.raises(DecodeError, match=r"angle_min is .* and angle_increment .*finite"):
        points_of(f32(1), angle_min=angle_min, angle_increment=angle_increment)


def test_the_last_beams_time_is_a_float32_product() -> None:
    # float32(0.1) is 0.100000001490..., and 359 times that, as float32, 35.9000015258...
    assert last_beam_ns(360, 0.1) == 35_900_001_526
    assert last_beam_ns(2, 0.1) == 100_000_001
    assert last_beam_ns(2, -0.1) == -100_000_001
    assert last_beam_ns(1, 0.1) == last_beam_ns(0, 0.1) == last_beam_ns(1000, 0.0) == 0
    assert (last_beam_ns(2, 5e-10), last_beam_ns(2, 6e-10)) == (0, 1)
