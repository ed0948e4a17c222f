from __future__ import annotations

import math

import pytest

from pc2scan.compare.rules import IGNORABLE, Rules
from pc2scan.errors import UsageError
from pc2scan.options.values import Tolerances


def test_the_default_is_exact() -> None:
    assert Rules().tolerance("ranges").exact


def test_a_name_beats_the_number_for_all() -> None:
    rules = Rules(atol=Tolerances().read("atol", ["0.5", "x=1e-6"]), rtol={"y": 0.1})
    assert rules.tolerance("x").atol == 1e-6
    assert rules.tolerance("ranges").atol == 0.5
    assert (rules.tolerance("y").atol, rules.tolerance("y").rtol) == (0.5, 0.1)


@pytest.mark.parametrize("text", ["", "x=", "x=y", "0,5"])
def test_what_is_no_tolerance(text: str) -> None:
    with pytest.raises(UsageError, match="`atol`"):
        Tolerances().read("atol", [text])


def test_a_tolerance_is_given_once() -> None:
    with pytest.raises(UsageError, match="twice for x"):
        Tolerances().read("rtol", ["x=1", "x=2"])


@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan])
def test_shares(share: float) -> None:
    with pytest.raises(UsageError, match="share from 0 to 1"):
        Rules(allow_beams=share)


def test_what_can_be_ignored_is_named() -> None:
    assert Rules(ignore=frozenset(IGNORABLE)).ignore == IGNORABLE.keys()
    with pytest.raises(UsageError, match="'stamps'") as caught:
        Rules(ignore=frozenset({"stamps"}))
    assert "log_time" in (caught.value.hint or "")


def test_tolerances_are_checked_at_once() -> None:
    with pytest.raises(UsageError, match="at least 0"):
        Rules(atol={"x": -1.0})
