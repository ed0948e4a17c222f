"""Filters: what options ask for; boxes and polygons against a scalar reference; conditions against Python itself."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError, UsageError
from pc2scan.options.table import options_of
from pc2scan.request.filters import ExcludeBox, ExcludePolygon, MinHeightSlope, Where, filters_of
from support import sampled
from support.tables import rows

#: Values of each option.
VALUES: dict[str, Any] = dict(rows(Path(__file__).with_name("values.txt"), "filters"))


@pytest.mark.parametrize("name", VALUES)
def test_an_option_makes_filters_of_its_name(name: str) -> None:
    assert name in options_of("convert")
    assert {each.name for each in filters_of(VALUES, -0.3)} == VALUES.keys()
    assert [each.name for each in filters_of({name: VALUES[name]}, -0.3)][-1:] == [name]


COORDINATES = st.one_of(
    st.sampled_from([0.0, -0.0, 0.1, -0.5, 0.5, 1.0, math.nan, math.inf, -math.inf]), st.floats(-2, 2, width=32)
)
POINTS = st.lists(st.tuples(COORDINATES, COORDINATES, COORDINATES), min_size=1, max_size=20)
LIMITS = st.tuples(st.floats(-2, 2), st.floats(-2, 2)).map(sorted).filter(lambda pair: pair[0] < pair[1])


def points(rows: Any, dtype: str = "<f4") -> Points:
    x, y, z = np.asarray(rows, np.float64).reshape(-1, 3).T.astype(dtype)
    return Points(0, 0, "base", {"x": x, "y": y, "z": z})


@pytest.mark.parametrize("dtype", sampled([">f4", "<f4", "<f8"], 1))
@given(rows=POINTS, limits=st.tuples(LIMITS, LIMITS, LIMITS))
def test_a_box_rejects_what_is_between_its_limits(dtype: str, rows: Any, limits: Any) -> None:
    box = ExcludeBox("base", *map(tuple, limits))
    cloud = points(rows, dtype)
    coordinates = zip(*(axis.tolist() for axis in cloud.xyz()), strict=True)
    expected = [
        not all(low <= value <= high for value, (low, high) in zip(point, limits, strict=True)) for point in coordinates
    ]
    assert box(cloud).tolist() == expected


def test_the_faces_of_a_box_are_in_it() -> None:
    box = ExcludeBox.parse("base 0 0.1 -1 1 -1 1")
    just_beyond = np.nextafter(np.float32(0.1), np.float32(1))
    # The float32 0.1 is above the float64 0.1: it is outside, as it is for height limits.
    rows = [[0, 1, -1], [np.nextafter(np.float32(0.1), np.float32(0)), 0, 0], [0.1, 0, 0], [just_beyond, 0, 0]]
    assert box(points(rows)).tolist() == [False, False, True, True]


def inside(x: float, y: float, corners: Any) -> bool | None:
    """Whether a point is in a polygon, in exact arithmetic; None for one on the outline, or nearly."""
    crossings = False
    px, py = Fraction(x), Fraction(y)
    for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
        x0, y0, x1, y1 = map(Fraction, (ax, ay, bx, by))
        side = (x1 - x0) * (py - y0) - (px - x0) * (y1 - y0)
        if abs(side) <= Fraction(1, 10**12) * (1 + abs(x1 - x0) + abs(y1 - y0)):
            return None
        if (y0 > py) != (y1 > py):
            crossings ^= px < (x1 - x0) * (py - y0) / (y1 - y0) + x0
    return crossings


CORNERS = st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2)), min_size=3, max_size=7).filter(
    lambda corners: abs(sum(a[0] * b[1] - a[1] * b[0] for a, b in pairwise([*corners, corners[0]]))) > 1e-6
)


def test_a_footprint_is_read_with_its_brackets() -> None:
    footprint = ExcludePolygon.parse("base_link [[1, 1], [-1, 1], [-1, -1], [0, 0], [1, -1]]")
    assert footprint.corners[3] == (0, 0)


@given(rows=POINTS, corners=CORNERS)
def test_a_polygon_rejects_what_is_in_it(rows: Any, corners: Any) -> None:
    cloud = points(rows)
    # As filters are called: of an edge that is nearly level, the quotient may overflow where it does not matter.
    with np.errstate(all="ignore"):
        kept = ExcludePolygon("base", tuple(corners))(cloud).tolist()
    x, y, _ = (axis.tolist() for axis in cloud.xyz())
    for place, (px, py) in enumerate(zip(x, y, strict=True)):
        if not (math.isfinite(px) and math.isfinite(py)):
            assert kept[place]
        elif (expected := inside(px, py, corners)) is not None:
            assert kept[place] is not expected


def test_a_height_limit_grows_with_range() -> None:
    cloud = points([[3, 4, 0.14], [3, 4, 0.16], [0, 0, -0.09]])
    assert MinHeightSlope(-0.1, 0.05)(cloud).tolist() == [False, True, True]


TABLE = Path(__file__).with_name("values.txt")
RING = np.array([0, 1, 2, 3, 4, 5, 250, 65535], np.uint16)
INTENSITY = np.array([0.1, 10, 11, 0.25, -3, 1e30, np.nan, 7], np.float32)
FAR = np.array([0, 1, 2, 3, 4, 5, 6, 2**32 - 1], ">u4")


def with_fields(**fields: Any) -> Points:
    return Points(0, 0, "lidar", {"ring": RING, "intensity": INTENSITY, "far": FAR, **fields})


def kept(condition: str) -> list[int]:
    with np.errstate(all="ignore"):
        mask = Where(condition)(with_fields())
    assert mask.dtype == np.bool_
    return np.flatnonzero(mask).tolist()


@pytest.mark.parametrize(("condition", "expected"), rows(TABLE, "conditions", text=True))
def test_conditions(condition: str, expected: list[int]) -> None:
    assert kept(condition) == expected


VALUES_OF_A_POINT = st.recursive(
    st.sampled_from(["ring", "far", "3", "7.5", "-2", "ring % 7", "far / 4"]),
    lambda inner: st.tuples(st.just("("), inner, st.sampled_from(["+", "-", "*"]), inner, st.just(")")).map(" ".join),
    max_leaves=3,
)
SIGNS = st.sampled_from(["<", "<=", ">", ">=", "==", "!="])
CONDITIONS = st.recursive(
    st.one_of(
        st.tuples(VALUES_OF_A_POINT, SIGNS, st.just("far"), SIGNS, VALUES_OF_A_POINT).map(" ".join),
        st.sampled_from(["ring in (1, 4, 250)", "ring not in (1, -4)"]),
    ),
    lambda inner: st.tuples(inner, st.sampled_from(["and", "or", "and not"]), inner).map(" ".join),
    max_leaves=4,
)


@given(CONDITIONS)
def test_conditions_mean_what_they_mean_in_python(condition: str) -> None:
    expected = [
        eval(condition, {"abs": abs}, {"ring": float(ring), "far": float(far)})  # made here
        for ring, far in zip(RING.tolist(), FAR.tolist(), strict=True)
    ]
    with np.errstate(all="ignore"):
        assert Where(condition)(with_fields()).tolist() == expected


def test_rows_with_gaps_have_masks_of_their_shape() -> None:
    ring = np.arange(12, dtype=np.uint16).reshape(3, 4)
    assert Where("ring % 2 == 0")(with_fields(ring=ring)).tolist() == [[True, False, True, False]] * 3


def test_a_field_that_a_cloud_lacks_is_an_error() -> None:
    with pytest.raises(DecodeError, match="no field 'reflectivity'; the cloud's fields are: ring, intensity, far"):
        Where("reflectivity > 3")(with_fields())


def test_conditions_are_not_endless() -> None:
    assert Where("ring > 3".ljust(2000)).fields == ("ring",)
    for condition in ("not " * 490 + "ring > 3", "ring == " + "-" * 1900 + "ring", "r" * 3000):
        with pytest.raises(UsageError, match=r"nested too deeply|at most 2,000"):
            Where(condition)
