"""Which libm the angles are of: what the node returned with a correctly rounding one, and with that of glibc 2.36."""

from __future__ import annotations

import json
from itertools import product
from typing import TYPE_CHECKING

import pytest

from support import ROOT, sampled
from support.command import run
from support.outputs import opened

if TYPE_CHECKING:
    from pathlib import Path

FOLDER = ROOT / "fixtures" / "golden_exact"
CASES = sorted(path.parent.name for path in FOLDER.glob("*/expected_old_libm.bag"))

WAYS: dict[str, tuple[str, ...]] = {
    "option": ("--angle-rounding", "glibc-2.40"),
    "param": ("--param", "angle_rounding:=glibc-2.40"),
    "file": (),
}


def converted(case: str, destination: Path, *options: str | Path) -> None:
    done = run("convert", FOLDER / case / "input.bag", "-o", destination, "--only-scans", *options)
    assert done.status == 0, done.stderr


@pytest.mark.parametrize(("case", "way"), sampled(product(CASES, WAYS), 2))
def test_the_older_libm_to_the_byte(case: str, way: str, tmp_path: Path) -> None:
    params, report = tmp_path / "params.yaml", tmp_path / "report.json"
    text = (FOLDER / case / "params.yaml").read_text()
    params.write_text(f"{text.rstrip()}\n    angle_rounding: glibc-2.40\n" if way == "file" else text)
    converted(case, tmp_path / "out.bag", "--params-file", params, "--report", report, *WAYS[way])
    expected = opened(FOLDER / case / "expected_old_libm.bag").messages
    assert opened(tmp_path / "out.bag").messages == expected
    assert expected != opened(FOLDER / case / "expected.bag").messages
    found = json.loads(report.read_text())
    assert found["scans"][0]["params"]["angle_rounding"] == "glibc-2.40"
    assert "default" not in found["scans"][0]["param_origins"]["angle_rounding"]
