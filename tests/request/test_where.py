"""Conditions on fields, held to Python's own evaluation of them, one point at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError, UsageError
from pc2scan.request.where import Where
from support.tables import rows

VALUES = Path(__file__).with_name("values.txt")
RING = np.array([0, 1, 2, 3, 4, 5, 250, 65535], np.uint16)
INTENSITY = np.array([0.1, 10, 11, 0.25, -3, 1e30, np.nan, 7], np.float32)
FAR = np.array([0, 1, 2, 3, 4, 5, 6, 2**32 - 1], ">u4")


def points(**fields: Any) -> Points:
    return Points(0, 0, "lidar", {"ring": RING, "intensity": INTENSITY, "far": FAR, **fields})


def kept(condition: str) -> list[int]:
    with np.errstate(all="ignore"):
        mask = Where(condition)(points())
    assert mask.dtype == np.bool_
    return np.flatnonzero(mask).tolist()


@pytest.mark.parametrize(("condition", "expected"), rows(VALUES, "conditions", text=True))
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
        assert Where(condition)(points()).tolist() == expected


def test_rows_with_gaps_have_masks_of_their_shape() -> None:
    ring = np.arange(12, dtype=np.uint16).reshape(3, 4)
    assert Where("ring % 2 == 0")(points(ring=ring)).tolist() == [[True, False, True, False]] * 3


def test_a_field_that_a_cloud_lacks_is_an_error() -> None:
    with pytest.raises(DecodeError, match="no field 'reflectivity'; the cloud's fields are: ring, intensity, far"):
        Where("reflectivity > 3")(points())


def test_conditions_are_not_endless() -> None:
    assert Where("ring > 3".ljust(2000)).fields == ("ring",)
    for condition in ("not " * 490 + "ring > 3", "ring == " + "-" * 1900 + "ring", "r" * 3000):
        with pytest.raises(UsageError, match=r"nested too deeply|at most 2,000"):
            Where(condition)
