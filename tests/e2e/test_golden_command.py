"""``pc2scan golden``: from an empty folder to a guarded conversion."""

from __future__ import annotations

import json
import os
import shutil
import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

import pc2scan
from pc2scan.cli.app import application
from support import ROOT
from support.command import Finished, run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"
PARAMS = "pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: -0.3\n    max_height: 1.0\n"


def golden(*arguments: str | Path) -> Finished:
    done = CliRunner().invoke(application(), ["golden", *(str(argument) for argument in arguments)])
    return Finished(done.exit_code, done.stdout, done.stderr)


def outcomes(folder: Path, *options: str) -> dict[str, str]:
    found = json.loads(golden(folder, "--json", *options).stdout)
    return {case["name"]: case["outcome"] for case in found["cases"]}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one case that has no expected output yet."""
    case = tmp_path / "golden" / "hall"
    case.mkdir(parents=True)
    shutil.copy(HALL, case / "input.bag")
    (case / "params.yaml").write_text(PARAMS)
    return tmp_path / "golden"


def change(folder: Path, height: str = "0.5") -> None:
    (folder / "hall" / "params.yaml").write_text(PARAMS.replace("1.0", height))


def test_from_the_first_case_to_a_reviewed_change(folder: Path) -> None:
    done = golden(folder)
    assert done.status == 1
    assert "there is no expected output: --update writes expected.txt" in done.stdout
    assert not (folder / "hall" / "expected.txt").exists()

    done = run("golden", folder, "--update")
    assert (done.status, done.stderr) == (0, "")
    assert "updated hall" in done.stdout
    expected = folder / "hall" / "expected.txt"
    before = expected.read_bytes()
    assert golden(folder).status == 0

    change(folder)
    done = run("golden", folder)
    assert done.status == 1
    assert "failed  hall" in done.stdout
    assert "in expected" in done.stdout
    assert "in actual" in done.stdout
    assert "1 failed in" in done.stdout
    assert "hint: if this is intended, --update" in done.stdout
    assert expected.read_bytes() == before

    assert outcomes(folder, "--update") == {"hall": "updated"}
    assert expected.read_bytes() != before
    assert outcomes(folder, "--update") == {"hall": "passed"}
    assert sorted(path.name for path in expected.parent.iterdir()) == ["expected.txt", "input.bag", "params.yaml"]


def test_an_update_writes_what_convert_writes(folder: Path, tmp_path: Path) -> None:
    assert golden(folder, "--update").status == 0
    case = folder / "hall"
    done = run("convert", HALL, "-o", tmp_path / "out.bag", "--params-file", case / "params.yaml", "--only-scans")
    assert done.status == 0, done.stderr
    assert pc2scan.diff(case / "expected.txt", tmp_path / "out.bag").same


@pytest.mark.parametrize("name", ["expected.bag", "expected.mcap", "expected"])
def test_an_expected_recording_stays_what_it_is(name: str, folder: Path) -> None:
    case = folder / "hall"
    params = pc2scan.ProjectionParams(min_height=-0.3, max_height=1.0)
    pc2scan.convert(HALL, case / name, params=params, only_scans=True)
    assert outcomes(folder) == {"hall": "passed"}
    change(folder)
    assert outcomes(folder) == {"hall": "failed"}
    assert outcomes(folder, "--update") == {"hall": "updated"}
    assert outcomes(folder) == {"hall": "passed"}
    assert not (case / "expected.txt").exists()


def test_what_differs_within_the_tolerance_is_not_updated(folder: Path) -> None:
    assert golden(folder, "--update").status == 0
    expected = folder / "hall" / "expected.txt"
    lines = expected.read_text().splitlines()
    place = next(k for k, line in enumerate(lines) if line.strip().startswith("100:"))
    label, _, values = lines[place].partition(":")
    first, *rest = values.split()
    lines[place] = f"{label}: {float(first) + 1e-6} {' '.join(rest)}"
    expected.write_text("\n".join(lines) + "\n")
    before = expected.read_bytes()
    assert outcomes(folder) == {"hall": "failed"}
    (folder / "hall" / "case.yaml").write_text("atol: {ranges: 1.0e-5}")
    assert outcomes(folder, "--update") == {"hall": "passed"}
    assert expected.read_bytes() == before


def test_an_unreadable_expected_output(folder: Path) -> None:
    assert golden(folder, "--update").status == 0
    expected = folder / "hall" / "expected.txt"
    expected.write_text(expected.read_text().replace("  stamp", "<<<<<<< ours\n  stamp", 1))
    done = golden(folder)
    assert done.status == 2
    assert "error   hall" in done.stdout
    assert "has been changed" in done.stdout
    assert outcomes(folder, "--update") == {"hall": "updated"}
    assert outcomes(folder) == {"hall": "passed"}


def settings(folder: Path, text: str) -> Path:
    (folder / "hall" / "case.yaml").write_text(text)
    return folder


def test_one_input_for_several_cases_and_arguments(folder: Path) -> None:
    shutil.move(folder / "hall" / "input.bag", folder / "hall.bag")
    for name, argument in (("all", "--no-use-inf"), ("named", "--range-max=5")):
        shutil.copytree(folder / "hall", folder / name)
        (folder / name / "case.yaml").write_text(f"input: ../hall.bag\narguments: [-t, '/points:=/x', {argument}]\n")
    shutil.rmtree(folder / "hall")
    assert outcomes(folder, "--update") == {"all": "updated", "named": "updated"}
    assert outcomes(folder) == {"all": "passed", "named": "passed"}
    texts = [(folder / name / "expected.txt").read_text() for name in ("all", "named")]
    assert all('topic "/x" sensor_msgs/msg/LaserScan' in text for text in texts)
    assert "range_max 5.0" in texts[1]
    assert texts[0] != texts[1]


def test_arguments_that_name_files_of_the_case(folder: Path, tmp_path: Path) -> None:
    (folder / "hall" / "mount.yaml").write_text("- lidar cup 0 0 0 0 0 0\n")
    settings(folder, "arguments: [--static-tf-file, '{case}/mount.yaml', --target-frame, cup]")
    assert golden(folder, "--update").status == 0
    text = (folder / "hall" / "expected.txt").read_text()
    assert 'frame_id "cup"' in text
    # From wherever it is run.
    done = run("golden", os.path.relpath(folder, tmp_path.parent), cwd=tmp_path.parent)
    assert done.status == 0, done.stdout


#: What a case may not say, however it is spelled; and what the error names.
NOT_A_CASES = {
    "[-o, OUT]": "--output",
    "[-oOUT]": "--output",
    "[-qo, OUT]": "--output",
    "[-jo, OUT]": "is not an option",
    "[--output=OUT]": "--output",
    "[--out=OUT]": "--out",
    "['-t=/points', -oOUT]": "--output",
    "[--no-use-inf, -o, OUT]": "--output",
    "[--report, OUT]": "--report",
    "[--report=OUT]": "--report",
    "[-vqoOUT]": "--output",
    "[--overwrite]": "--overwrite",
    "[--help]": "--help",
    "[-h]": "--help",
    "[-qh]": "--help",
    "[--version]": "--version",
    "[--junit, OUT]": "--junit",
    "[--json]": "--json",
    "[-q]": "--quiet",
    "[other.bag]": "'other.bag' is not an option",
    "[--, -o, OUT]": "'-o' is not an option",
    "[--topic]": "--topic",
}


@pytest.mark.parametrize("arguments", NOT_A_CASES)
@pytest.mark.parametrize("status", [0, 2])
def test_a_case_does_not_choose_where_anything_is_written(
    arguments: str, status: int, folder: Path, tmp_path: Path
) -> None:
    assert golden(folder, "--update").status == 0
    out = tmp_path / "OUT"
    out.write_text("years of work")
    settings(folder, f"arguments: {arguments.replace('OUT', str(out))}\nexit_status: {status}\n")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for options in ((), ("--update",)):
        done = golden(folder, *options)
        assert done.status == 2, done.stdout
        assert "error   hall" in done.stdout
        assert f"{folder / 'hall' / 'case.yaml'}: arguments: " in done.stdout
        assert NOT_A_CASES[arguments] in done.stdout
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_value_that_looks_like_an_option_is_a_value(folder: Path) -> None:
    settings(folder, "arguments: [--drop, '-o', --ros-distro, humble, --profile, ros1]")
    assert outcomes(folder, "--update") == {"hall": "updated"}
    assert 'topic "/scan"' in (folder / "hall" / "expected.txt").read_text()


def test_an_expected_exit_status(folder: Path) -> None:
    # No point is so far away: all scans are empty.
    (folder / "hall" / "params.yaml").write_text(PARAMS + "    range_min: 90.0\n")
    done = golden(folder, "--update")
    assert done.status == 1
    assert "ended with exit status 4, expected was 0" in done.stdout
    assert "5 of 5 scans on /scan have no return" in done.stdout
    assert outcomes(settings(folder, "exit_status: 4"), "--update") == {"hall": "updated"}
    assert outcomes(folder) == {"hall": "passed"}
    (folder / "hall" / "params.yaml").write_text(PARAMS)
    assert outcomes(folder) == {"hall": "failed"}


def test_a_failure_that_is_expected_needs_no_output(folder: Path) -> None:
    (folder / "hall" / "params.yaml").write_text(PARAMS.replace("min_height: -0.3", "min_height: 2.0"))
    assert outcomes(folder) == {"hall": "failed"}
    assert outcomes(settings(folder, "exit_status: 2")) == {"hall": "passed"}
    # Without a transform for the frame no cloud can be converted.
    (folder / "hall" / "params.yaml").write_text(PARAMS + "    target_frame: map\n")
    assert outcomes(folder) == {"hall": "failed"}
    assert outcomes(settings(folder, "exit_status: 1")) == {"hall": "passed"}


def test_everything_that_is_written(folder: Path) -> None:
    settings(folder, "all_topics: true")
    assert outcomes(folder, "--update") == {"hall": "updated"}
    found = json.loads(golden(folder, "--json").stdout)
    (case,) = found["cases"]
    assert case["outcome"] == "passed"
    names = [topic["topic_a"] for topic in case["difference"]["topics"]]
    assert names == ["/scan", "/tf", "/tf_static"]
    settings(folder, "all_topics: true\narguments: [--drop, /tf]")
    assert outcomes(folder) == {"hall": "failed"}


def test_junit_and_patterns(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "hall", folder / "broken")
    (folder / "broken" / "input.bag").write_bytes(b"#ROSBAG V2.0\nand nothing more")
    assert outcomes(folder, "--update", "-k", "hall") == {"hall": "updated"}
    done = golden(folder, "--junit", tmp_path / "report.xml", "-q")
    assert done.status == 1
    assert "passed  hall" not in done.stdout
    (suite,) = ET.parse(tmp_path / "report.xml").getroot()
    assert {case.get("name"): [part.tag for part in case] for case in suite} == {"broken": ["failure"], "hall": []}
    assert golden(folder, "-k", "ha*").status == 0


def test_wrong_usage(folder: Path, tmp_path: Path) -> None:
    for arguments, told in (
        ((tmp_path / "nowhere",), "does not exist"),
        ((HALL,), "not a folder"),
        ((folder, "-k", "nothing"), "none of its 1 cases"),
        ((folder, "--junit", tmp_path / "no" / "report.xml"), "directory does not exist"),
        ((), "DIR"),
    ):
        done = golden(*arguments)
        assert done.status == 2, arguments
        assert told in done.stderr
    done = golden(settings(folder, "tolerance: 3"))
    assert done.status == 2
    assert "unknown key 'tolerance'" in done.stdout
    assert "hint: the keys are" in done.stdout


def test_an_unwritable_report(folder: Path, tmp_path: Path) -> None:
    assert golden(folder, "--update").status == 0
    (tmp_path / "report.xml").mkdir()
    done = golden(folder, "--junit", tmp_path / "report.xml")
    assert done.status == 2
    assert "cannot be written" in done.stderr


def test_the_text_is_the_same_wherever_it_is_made(folder: Path) -> None:
    texts: list[Any] = []
    for environment in ({"TZ": "Asia/Tokyo", "PYTHONHASHSEED": "1"}, {"TZ": "UTC", "LANG": "C", "LC_ALL": "C"}):
        (folder / "hall" / "expected.txt").unlink(missing_ok=True)
        before = dict(os.environ)
        os.environ.update(environment)
        try:
            assert run("golden", folder, "--update").status == 0
        finally:
            os.environ.clear()
            os.environ.update(before)
        texts.append((folder / "hall" / "expected.txt").read_bytes())
    assert texts[0] == texts[1]
