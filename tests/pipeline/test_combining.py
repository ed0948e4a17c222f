"""What users write of scans of several messages."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from pc2scan.errors import UsageError
from pc2scan.pipeline.options import Combining
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
