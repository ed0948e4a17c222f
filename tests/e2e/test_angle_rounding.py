"""Which libm the angles are of: what the node returned with a correctly rounding one, and with that of glibc 2.36."""

from __future__ import annotations

import json
from itertools import product
from typing import TYPE_CHECKING

import pytest

import pc2scan
from pc2scan.core import kernel, plain
from pc2scan.request.parameters import Setting, resolve
from pc2scan.request.params_file import load_params_file
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


def test_there_are_cases() -> None:
    assert CASES == ["aligned_columns", "hundredths_of_degrees"]


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


@pytest.mark.parametrize("case", sampled(CASES, 1))
def test_the_loops_in_numpy_make_the_same_bytes(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unused(*_: object) -> None:
        raise AssertionError

    for loop in ("angles", "gather", "project"):
        monkeypatch.setattr(kernel, loop, getattr(plain, loop) if loop == "project" else unused)
    params = load_params_file(FOLDER / case / "params.yaml").settings
    rounding = Setting("angle_rounding", "glibc-2.40", "the test")
    pc2scan.convert(
        FOLDER / case / "input.bag", tmp_path / "out.bag", params=resolve([rounding, *params]).params, only_scans=True
    )
    assert opened(tmp_path / "out.bag").messages == opened(FOLDER / case / "expected_old_libm.bag").messages


@pytest.mark.slow
def test_a_golden_case_can_ask_for_it(tmp_path: Path) -> None:
    source, case = FOLDER / CASES[0], tmp_path / "case"
    case.mkdir()
    (case / "case.yaml").write_text(
        f"input: {source / 'input.bag'}\nparams: {source / 'params.yaml'}\narguments: [--angle-rounding, glibc-2.40]\n"
    )
    (case / "expected.bag").write_bytes((source / "expected_old_libm.bag").read_bytes())
    assert run("golden", tmp_path).status == 0
    (case / "expected.bag").write_bytes((source / "expected.bag").read_bytes())
    assert run("golden", tmp_path).status == 1
