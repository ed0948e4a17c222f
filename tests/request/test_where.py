"""Conditions on fields, held to Python's own evaluation of them, one point at a time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError, UsageError
from pc2scan.request.where import Where
from support.tables import rows

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy

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


def values() -> SearchStrategy[str]:
    leaves = st.sampled_from(["ring", "far", "3", "7.5", "250", "-2"])
    operators = st.sampled_from(["+", "-", "*"])
    return st.recursive(
        leaves,
        lambda inner: st.one_of(
            st.tuples(inner, operators, inner).map(" ".join),
            st.tuples(inner, st.sampled_from([" % 7", " / 4"])).map("".join),
            inner.map("({})".format),
            inner.map("abs({})".format),
        ),
        max_leaves=4,
    )


def conditions() -> SearchStrategy[str]:
    signs = st.sampled_from(["<", "<=", ">", ">=", "==", "!="])
    leaves = st.one_of(
        st.tuples(values(), signs, st.just("ring")).map(" ".join),
        st.tuples(values(), signs, st.just("far"), signs, values()).map(" ".join),
        st.tuples(st.just("ring"), st.sampled_from([" in (1, 4, 250)", " not in (1, -4)"])).map("".join),
    )
    return st.recursive(
        leaves,
        lambda inner: st.one_of(
            st.tuples(inner, st.sampled_from(["and", "or"]), inner).map(" ".join),
            inner.map("not {}".format),
            inner.map("({})".format),
        ),
        max_leaves=4,
    )


@given(conditions())
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


def test_fields_are_those_that_the_condition_names_once() -> None:
    assert Where("ring > 3 and (x < 1 or ring == 0)").fields == ("ring", "x")


def test_a_field_that_a_cloud_lacks_is_an_error() -> None:
    with pytest.raises(DecodeError, match="no field 'reflectivity'; the cloud's fields are: ring, intensity, far"):
        Where("reflectivity > 3")(points())


@pytest.mark.parametrize(
    ("condition", "what"),
    [
        ("ring > 3 and " + "(" * 300 + "ring > 3" + ")" * 300, "`where`: column .*: unexpected"),
        ("not " * 160 + "ring > 3", "`where`: column 401 of .*: more than 100 levels"),
        ("ring == " + "-" * 1900 + "ring", "`where`: column .*: (more than 100 levels|it cannot be read)"),
        ("ring" + "+1" * 900 + "> 3", "`where`: column 1 of .*: more than 100 levels"),
        ("r" * 3000, "3,000 characters, at most 2,000"),
    ],
)
def test_conditions_are_not_endless(condition: str, what: str) -> None:
    assert Where("ring > 3".ljust(2000)).fields == ("ring",)
    with pytest.raises(UsageError, match=what):
        Where(condition)
