from __future__ import annotations

import ast
from typing import TYPE_CHECKING

import pytest

from planted.faults import faults_in, plant, sample
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

MODULE = """
from __future__ import annotations

LIMIT = 3

def later(stamps: list[int], first: int, last: int) -> list[int]:
    if not (first < last):
        raise ValueError("1 < 2")
    stamps.sort()
    return [stamp for stamp in stamps if first <= (stamp + LIMIT * 1000) and max(stamp, last) == stamp]
"""

EVERY = [
    ("bound", "3", "4"),
    ("operator", "not (first < last)", "bool(first < last)"),
    ("dropped check", "not (first < last)", "False"),
    ("operator", " < ", " <= "),
    ("missing call", "stamps.sort()", "pass"),
    ("operator", " <= ", " < "),
    ("operator", " + ", " - "),
    ("operator", " * ", " / "),
    ("unit", "1000", "1000000"),
    ("operator", " and ", " or "),
    ("operator", " == ", " != "),
    ("call", "max", "min"),
    ("arguments", "stamp, last", "last, stamp"),
]


def test_every_kind_of_fault_is_found() -> None:
    found = list(faults_in("src/pc2scan/core/some.py", MODULE))
    assert sorted((fault.kind, fault.old, fault.new) for fault in found) == sorted(EVERY)
    assert {fault.line for fault in found if fault.kind == "missing call"} == {9}


def test_operators_in_c_are_found_outside_comments() -> None:
    text = 'int at(int i) { /* i < 3 */ puts("a < b"); return i < 3 && i > 0; } // i + 1\n'
    found = [(fault.old, fault.new) for fault in faults_in("src/pc2scan/core/loops/some.c", text)]
    assert found == [(" < ", " <= "), (" && ", " || "), (" > ", " >= ")]


def test_planted_modules_still_parse_and_differ() -> None:
    for path in ("conversion/run.py", "core/project.py", "files/outputs.py"):
        text = (ROOT / "src" / "pc2scan" / path).read_text("utf-8")
        for fault in list(faults_in(path, text))[::45]:
            planted = plant(text, fault)
            assert ast.unparse(ast.parse(planted)) != ast.unparse(ast.parse(text)), fault


def test_the_same_seed_draws_the_same_faults(tmp_path: Path) -> None:
    module = tmp_path / "src" / "pc2scan" / "core" / "some.py"
    module.parent.mkdir(parents=True)
    module.write_text(MODULE)
    assert sample(tmp_path, 5, 1) == sample(tmp_path, 5, 1)
    assert len({tuple(sample(tmp_path, 5, seed)) for seed in range(9)}) > 1


def test_a_fault_is_not_planted_in_other_text() -> None:
    fault = next(fault for fault in faults_in("src/pc2scan/core/some.py", MODULE) if fault.old == "3")
    with pytest.raises(ValueError, match="the source has changed"):
        plant(MODULE.replace("= 3", "= 5"), fault)
