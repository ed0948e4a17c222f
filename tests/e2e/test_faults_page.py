"""docs/faults.md names tests for every fault: they are there, under these names."""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TESTS = ROOT / "tests"

#: Where the files of a section's tests are, if they are not told from `tests/` on.
FOLDERS = {"Damaged recordings": "bags", "Hostile recordings": "hostile", "Output under faults": "e2e"}


def rows() -> list[tuple[str, str, str]]:
    """Folder, fault and tests of every row of the tables."""
    found = []
    folder = ""
    page = (ROOT / "docs" / "faults.md").read_text("utf-8")
    # What is measured has tables of its own.
    for line in re.sub("<!-- (factors|costs) -->.*?<!-- end of \\1 -->", "", page, flags=re.DOTALL).splitlines():
        if line.startswith("## "):
            folder = FOLDERS[line.removeprefix("## ")]
        elif line.startswith("| ") and not line.startswith("| fault "):
            fault, _, tests = (cell.strip() for cell in line.strip("|").split(" | "))
            found.append((folder, fault, tests))
    return found


ROWS = rows()


def names_in(file: str, folder: str) -> set[str]:
    """The tests of a file, or the cases of a text."""
    places = [path for path in (TESTS / file, TESTS / folder / file) if path.is_file()]
    assert places, f"{file} is not there"
    pattern = r"^\s*def (test_\w+)" if file.endswith(".py") else r"^== (.*)"
    return set(re.findall(pattern, places[0].read_text("utf-8"), re.MULTILINE))


@pytest.mark.parametrize(("folder", "fault", "tests"), ROWS, ids=[fault for _, fault, _ in ROWS])
def test_the_tests_of_a_fault_are_there(folder: str, fault: str, tests: str) -> None:
    words = re.findall(r"`([^`]+)`", tests)
    assert words, f"no test for: {fault}"
    assert words[0].endswith((".py", ".txt")), f"tests of no file: {words[0]}"
    # Files, then the tests that each of them has.
    for are_files, group in groupby(words, key=lambda word: word.endswith((".py", ".txt"))):
        if are_files:
            files = {word: names_in(word, folder) for word in group}
            continue
        for name in group:
            assert [file for file, names in files.items() if name not in names] == [], name


def test_every_section_is_read() -> None:
    assert {folder for folder, _, _ in ROWS} == set(FOLDERS.values())
