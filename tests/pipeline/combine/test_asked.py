"""What users write of scans of several messages."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import pytest

from pc2scan.errors import UsageError
from pc2scan.pipeline.combine.asked import Combining


@pytest.mark.parametrize(
    ("asked", "read"),
    [
        ({}, Combining()),
        ({"accumulate": 1}, Combining(span_ns=1_000_000_000)),
        ({"accumulate": "500ms"}, Combining(span_ns=500_000_000)),
        ({"accumulate": timedelta(seconds=2)}, Combining(span_ns=2_000_000_000)),
        ({"accumulate": "10clouds"}, Combining(count=10)),
        ({"accumulate": "3 scans", "every": "1/2"}, Combining(count=3, every_ns=500_000_000)),
        # An interval has what is in it, if nothing else is said.
        ({"every": 0.1}, Combining(every_ns=100_000_000)),
        ({"every": "1s", "accumulate": "2s"}, Combining(span_ns=2_000_000_000, every_ns=1_000_000_000)),
        ({"lead": "/a", "window": "30ms"}, Combining(lead="/a", window_ns=30_000_000)),
    ],
)
def test_times_and_numbers_of_clouds(asked: dict[str, Any], read: Combining) -> None:
    assert Combining.of(**asked) == read


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
