"""Boxes and a sloping height limit, held to a scalar reference."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.points import Points
from pc2scan.request.ground import MinHeightSlope
from pc2scan.request.regions import ExcludeBox
from support import sampled

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


def test_a_height_limit_grows_with_range() -> None:
    cloud = points([[3, 4, 0.14], [3, 4, 0.16], [0, 0, -0.09]])
    assert MinHeightSlope(-0.1, 0.05)(cloud).tolist() == [False, True, True]
