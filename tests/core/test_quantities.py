"""Times with units."""

from __future__ import annotations

from pathlib import Path

import pytest

from pc2scan.core.quantities import duration_ns
from support.tables import rows

TABLES = Path(__file__).with_name("quantities.txt")


@pytest.mark.parametrize(("text", "expected"), rows(TABLES, "durations"))
def test_durations_are_exact(text: str, expected: int | None) -> None:
    assert duration_ns(text) == expected
