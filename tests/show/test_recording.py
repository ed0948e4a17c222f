"""Moments of a recording as text."""

from __future__ import annotations

from pc2scan.show.recording import moment_text


def test_a_stamp_is_a_date_and_of_a_simulation_it_is_seconds() -> None:
    assert moment_text(1_700_000_000_123_456_789) == "2023-11-14 22:13:20.123 UTC"
    assert moment_text(12_345_000_000) == "12.345 s"
