"""Points of every form that callers have them in are the same points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pc2scan import PointCounts, ProjectionParams, project

PARAMS = ProjectionParams(min_height=-1.0)
POINTS = np.array([[2.0, 0.1, 0.3], [1.0, 0.1, 0.9], [-3.0, -3.0, 0.0], [0.5, 4.0, 5.0]], np.float32)
X, Y, Z = POINTS.T
EXPECTED = project(POINTS, PARAMS)


def records(*shape: int) -> np.ndarray[Any, np.dtype[Any]]:
    """What a PointCloud2 reader returns: fields of several types in any order."""
    array = np.zeros(len(POINTS), [("z", ">f4"), ("ring", "u2"), ("x", "<f8"), ("y", "<f4")])
    array["x"], array["y"], array["z"], array["ring"] = X, Y, Z, 7
    return array.reshape(shape or -1)


@pytest.mark.parametrize(
    "points",
    [
        records(),
        records(2, 2),
        records().view(np.recarray),
        np.ma.array(records()),
        {"x": X, "y": Y, "z": Z, "intensity": None},
        {"x": X.tolist(), "y": tuple(Y), "z": Z.reshape(-1)},
        {axis: part.reshape(2, 2) for axis, part in (("z", Z), ("y", Y), ("x", X))},
        np.ma.array(POINTS),
        np.ma.array(POINTS, mask=False),
    ],
    ids=[
        "structured", "organised", "record array", "masked structure", "dict", "lists", "dict, organised",
        "without mask", "nothing masked",
    ],
)  # fmt: skip
def test_points_in_other_forms(points: Any) -> None:
    scan = project(points, PARAMS)
    assert scan.counts == EXPECTED.counts
    np.testing.assert_array_equal(scan.ranges, EXPECTED.ranges)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32, np.int64, ">f4"])
@pytest.mark.parametrize("form", ["array", "dict", "structured"])
def test_masked_points_are_dropped(form: str, dtype: Any) -> None:
    points = np.ma.array(np.array([[1, 0, 0], [2, 0, 0], [0, 3, 0], [0, 4, 0]], dtype), fill_value=9)
    points[0, 1] = np.ma.masked
    points[2] = np.ma.masked
    given: Any = points
    if form == "dict":
        given = {axis: points[:, column] for column, axis in enumerate("xyz")}
    elif form == "structured":
        given = np.ma.zeros(4, [(axis, dtype) for axis in "xyz"])
        for column, axis in enumerate("xyz"):
            given[axis] = points[:, column]
    scan = project(given, PARAMS)
    assert scan.counts == PointCounts(total=4, used=2, nan=2)
    assert sorted(scan.ranges[np.isfinite(scan.ranges)].tolist()) == [2, 4]
    # What is masked is as it was.
    assert points.mask.sum() == 4
    assert points.data[0, 0] == 1


@pytest.mark.parametrize("dtype", [np.float32, np.uint8, np.int64])
def test_masked_intensities_are_nan(dtype: Any) -> None:
    values = np.ma.array(np.array([9, 8, 7, 6], dtype), mask=[True, False, False, False])
    scan = project([[1, 0, 0], [2, 0, 0], [0, 3, 0], [0, 4, 0]], PARAMS, intensities=values)
    shown = {reach: value for reach, value in zip(scan.ranges, scan.intensities, strict=True) if np.isfinite(reach)}
    assert math.isnan(shown[np.float32(1)])
    assert shown[np.float32(3)] == 7


@pytest.mark.parametrize("values", [["a", "b"], [1j, 2], [None, 1.0], np.array(["2020-01-01"] * 2, "M8[s]")])
def test_intensities_that_are_no_numbers_are_refused(values: Any) -> None:
    with pytest.raises(TypeError, match=r"intensities are of type .*, expected integers or floats"):
        project([[1, 0, 0], [2, 0, 0]], PARAMS, intensities=values)


@pytest.mark.parametrize(
    ("points", "error", "told"),
    [
        ({"x": X, "y": Y}, ValueError, "points have no z, their fields are x, y"),
        ({}, ValueError, "points have no x and no y and no z, their fields are none"),
        (records()[["x", "z", "ring"]], ValueError, "points have no y, their fields are x, z, ring"),
        ({"x": X, "y": Y, "z": Z[:2]}, ValueError, r"x, y and z have the shapes \(4,\), \(4,\), \(2,\)"),
        ({"x": X, "y": ["a"] * 4, "z": Z}, TypeError, "y are of type <U1, expected integers or floats"),
        (X, ValueError, r"\(4,\), expected \(M, 3\) or \(H, W, 3\), or a structured array or a dict with x, y and z"),
    ],
)  # fmt: skip
def test_points_that_cannot_be_read(points: Any, error: type[Exception], told: str) -> None:
    with pytest.raises(error, match=told):
        project(points, PARAMS)
