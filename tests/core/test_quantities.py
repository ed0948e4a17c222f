"""Times and sizes with units."""

from __future__ import annotations

import pytest

from pc2scan.core.quantities import byte_size, duration_ns


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("60s", 60_000_000_000),
        (" 1.5 min ", 90_000_000_000),
        ("2h", 7_200_000_000_000),
        ("500ms", 500_000_000),
        (".5s", 500_000_000),
        ("0.1s", 100_000_000),
        ("0.000000001s", 1),
        ("123456789.123456789s", 123_456_789_123_456_789),
        *((text, None) for text in ("60", "s", "", "1 s s", "-1s", "1e3s", "1m", "1MB", "٣s", "1,5s", "9" * 19 + "s")),
    ],
)
def test_durations_are_exact(text: str, expected: int | None) -> None:
    assert duration_ns(text) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("500MB", 500_000_000),
        ("1GiB", 1 << 30),
        ("1.5 kB", 1500),
        ("3b", 3),
        ("2TiB", 2 << 40),
        ("1gb", 10**9),
        *((text, None) for text in ("500", "MB", "1 MBB", "-1MB", "1m", "60s")),
    ],
)
def test_sizes_are_exact(text: str, expected: int | None) -> None:
    assert byte_size(text) == expected
