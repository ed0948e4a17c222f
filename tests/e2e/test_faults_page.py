"""docs/faults.md is what tests hold: faults.txt names the tests of each row, and they are there."""

from __future__ import annotations

import re

import pytest

from support import ROOT

TESTS = ROOT / "tests"
LISTED = (TESTS / "e2e" / "faults.txt").read_text("utf-8")


def rows_of_the_page() -> list[str]:
    """The faults in the tables of the page."""
    page = (ROOT / "docs" / "faults.md").read_text("utf-8")
    rows = [line.strip("| ").split(" | ")[0] for line in page.splitlines() if line.startswith("| ")]
    return [row for row in rows if row != "fault"]


def named_in(path: str) -> set[str]:
    """The tests of a module, or the cases of a text."""
    pattern = r"^\s*def (test_\w+)" if path.endswith(".py") else r"^== (.*)"
    return set(re.findall(pattern, (TESTS / path).read_text("utf-8"), re.MULTILINE))


#: For each row, the lines that name its tests: ``FILE`` or ``FILE::TEST``, FILE from ``tests/`` on.
NAMED = {
    row: re.findall(r"^    (.*)$", text, re.MULTILINE)
    for row, text in re.findall(r"^== (.*)\n((?:(?!== ).*\n?)*)", LISTED, re.MULTILINE)
}


def test_the_rows_are_those_of_the_page() -> None:
    assert list(NAMED) == rows_of_the_page()
    assert all(NAMED.values())


@pytest.mark.parametrize("row", NAMED)
def test_the_tests_of_a_row_are_there(row: str) -> None:
    for named in NAMED[row]:
        path, _, test = named.partition("::")
        assert (TESTS / path).is_file(), named
        assert not test or test in named_in(path), named
