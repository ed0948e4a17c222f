"""What users write of scans of several messages."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

import pc2scan
from exports.driving import PATTERN, STAMPS, drive
from pc2scan.errors import ParameterError, UsageError
from pc2scan.request.options import Combining
from support.builders import write_mcap
from support.tables import rows


@pytest.mark.parametrize(("asked", "read"), rows(Path(__file__).with_name("combining.txt"), "times and numbers"))
def test_times_and_numbers_of_clouds(asked: dict[str, Any], read: dict[str, Any]) -> None:
    assert Combining.of(**asked) == Combining(**read)


def test_an_interval_is_a_time_too() -> None:
    assert Combining.of(accumulate=timedelta(seconds=2)) == Combining(span_ns=2_000_000_000)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"accumulate": True}, "`accumulate` is True, which is not a time"),
        ({"every": float("nan")}, "it must be more than 0"),
    ],
)
def test_what_cannot_be_names_the_option(asked: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError) as caught:
        Combining.of(**asked)
    assert said in caught.value.message


@pytest.mark.parametrize("increment", [0.0, float("nan"), float("inf")])
def test_scans_that_do_not_say_their_resolution_have_none(increment: float, tmp_path: Path) -> None:
    scans = [replace(PATTERN, stamp_ns=stamp_ns, angle_increment=increment) for stamp_ns in STAMPS]
    source = write_mcap(tmp_path / "a.mcap", drive({"/scan": scans}))
    with pytest.raises(ParameterError, match="no scan on /scan has an angle_increment"):
        pc2scan.convert(source, tmp_path / "b.mcap", topics="/scan:=/new", rebin=True, beams="auto")
