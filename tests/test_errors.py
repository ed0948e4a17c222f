"""Texts that errors are made of."""

from __future__ import annotations

from pc2scan.errors import name_list


def test_long_lists_are_cut() -> None:
    assert name_list([]) == "none"
    assert name_list(["/a", "/b", "/c"], limit=2) == "/a, /b and 1 more"
