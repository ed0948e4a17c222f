"""docs/faults.md names tests for every fault: they are there, under these names."""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

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


def names_in(file: str, folder: str) -> set[str] | None:
    """The tests of a file, or the cases of a text; None if it is not there."""
    places = [path for path in (TESTS / file, TESTS / folder / file) if path.is_file()]
    if not places:
        return None
    pattern = r"^\s*def (test_\w+)" if file.endswith(".py") else r"^== (.*)"
    return set(re.findall(pattern, places[0].read_text("utf-8"), re.MULTILINE))


def missing(folder: str, tests: str) -> list[str]:
    """The files and tests of a row that are not there."""
    words = re.findall(r"`([^`]+)`", tests)
    if not words or not words[0].endswith((".py", ".txt")):
        return [f"no tests of a file: {tests}"]
    found: list[str] = []
    names: list[set[str]] = []
    # Files, then the tests that each of them has.
    for are_files, group in groupby(words, key=lambda word: word.endswith((".py", ".txt"))):
        if are_files:
            files = {file: names_in(file, folder) for file in group}
            found += [f"{file} is not there" for file, known in files.items() if known is None]
            names = [known for known in files.values() if known is not None]
        else:
            found += [name for name in group for known in names if name not in known]
    return found


def test_the_tests_of_every_fault_are_there() -> None:
    found = rows()
    assert {fault: missing(folder, tests) for folder, fault, tests in found if missing(folder, tests)} == {}
    assert {folder for folder, _, _ in found} == set(FOLDERS.values())
