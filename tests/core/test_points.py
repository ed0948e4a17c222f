"""Points of every form that callers have them in are the same points."""

from __future__ import annotations

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
