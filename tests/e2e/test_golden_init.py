"""``golden --init`` cuts a case out of a drive."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

import pc2scan
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

PARAMS = "pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: -0.3\n"


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize(("fixture", "made"), [("hall.bag", "input.bag"), ("hall.mcap", "input.mcap")])
def test_a_case_is_cut_out_of_a_drive(tmp_path: Path, fixture: str, made: str) -> None:
    (tmp_path / "params.yaml").write_text(PARAMS)
    words = ("golden", "cases/turn", "--init", ROOT / "fixtures" / fixture, "--start", "0.1", "--end", "0.35")
    done = run(*words, "--params-file", "params.yaml", cwd=tmp_path)
    assert (done.status, done.stderr) == (0, "")
    assert "next: look at cases/turn/expected.txt" in done.stdout
    case = tmp_path / "cases" / "turn"
    assert names(case) == ["expected.txt", made, "params.yaml"]
    clouds = {connection: number for connection, number in counts(case / made).items() if connection == "/points"}
    assert clouds == {"/points": 3}
    assert run("golden", "cases", cwd=tmp_path).status == 0
    (case / "params.yaml").write_text(PARAMS.replace("-0.3", "-0.1"))
    assert run("golden", "cases", cwd=tmp_path).status == 1
    again = run(*words, cwd=tmp_path)
    assert again.status == 2
    assert "exists already" in again.stderr


def counts(recording: Path) -> dict[str, int]:
    return {topic.topic: topic.messages for topic in pc2scan.info(recording).topics}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--init", "drive.bag", "--start", "60"), "no messages on /points"),
        (("--init", "drvie.bag"), "did you mean drive.bag"),
        (("--init", "drive.bag", "--topic", "/pionts"), "did you mean /points"),
        (("--init", "drive.bag", "--params-file", "none.yaml"), "none.yaml"),
        (("--init", "drive.bag", "--update"), "cannot be combined with"),
        (("--start", "1"), "need --init"),
    ],
)
def test_what_is_wrong_leaves_nothing(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "drive.bag")
    done = run("golden", "cases/turn", *words, cwd=tmp_path)
    assert done.status in {1, 2}
    assert said in done.stderr
    assert names(tmp_path) == ["drive.bag"]


def test_from_python(tmp_path: Path) -> None:
    report = pc2scan.golden(tmp_path / "case", init=ROOT / "fixtures" / "hall.bag", topics="/points", end=0.2)
    assert [case.outcome for case in report.cases] == ["passed"]
    with pytest.raises(pc2scan.Pc2ScanError, match="have no effect without init"):
        pc2scan.golden(tmp_path / "case", start=1)


@pytest.mark.parametrize(("right", "wrong"), [("params.yaml", "param.yaml"), ("case.yaml", "case.yml")])
def test_a_misnamed_file_is_an_error(tmp_path: Path, right: str, wrong: str) -> None:
    shutil.copytree(ROOT / "fixtures" / "golden" / "tf_static", tmp_path / "case")
    file = tmp_path / "case" / right
    if file.exists():
        file.rename(file.with_name(wrong))
    else:
        file.with_name(wrong).write_text("exit_status: 0\n")
    done = run("golden", tmp_path / "case")
    assert done.status == 2
    assert f"{wrong} is not read" in done.stdout
    assert f"did you mean {right}?" in done.stdout
