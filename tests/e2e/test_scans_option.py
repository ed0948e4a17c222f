"""``--scans``: several outputs from the command line, each as a conversion of its own would write it."""

from __future__ import annotations

import json
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.cli.app import application
from pc2scan.errors import UsageError
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.mcap"
SCANS = """\
defaults:
  target_frame: base_link
  min_height: 0.05
scans:
  /scan: {max_height: 1.0, preset: slam_toolbox}
  /low: {max_height: 0.3, reduce: median}
  /own: {target_frame: "", min_height: -0.5, where: "ring in (3, 4, 5)", intensity_field: intensity}
  /coarse: {angle_increment: 5deg, no_return: nan}
"""
#: The same, one by one, as options.
ALONE = {
    "/scan": ["--target-frame", "base_link", "--min-height", "0.05", "--max-height", "1.0", "--preset", "slam_toolbox"],
    "/low": ["--target-frame", "base_link", "--min-height", "0.05", "--max-height", "0.3", "--reduce", "median"],
    "/own": ["--min-height", "-0.5", "--where", "ring in (3, 4, 5)", "--intensity-field", "intensity"],
    "/coarse": [
        "--target-frame", "base_link", "--min-height", "0.05", "--angle-increment", "5deg", "--no-return", "nan",
    ],
}  # fmt: skip


def command(*words: object) -> Any:
    return CliRunner().invoke(application(), [str(word) for word in words])


def messages(path: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with closing(open_recording(path)) as reader:
        for message in reader.messages():
            times = message.log_time_ns, message.publish_time_ns
            found.setdefault(message.connection.topic, []).append((*times, bytes(message.data)))
    return found


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "scans.yaml"
    path.write_text(SCANS)
    return path


@pytest.mark.parametrize("jobs", [1, 4])
@pytest.mark.parametrize("name", ["all.mcap", "all.bag", "all"])
def test_four_outputs_are_four_conversions(name: str, jobs: int, file: Path, tmp_path: Path) -> None:
    done = command("convert", HALL, "-o", tmp_path / name, "--scans", file, "-j", jobs, "--only-scans")
    assert done.exit_code == 0, done.output
    together = messages(tmp_path / name)
    assert together.keys() == ALONE.keys()
    for topic, words in ALONE.items():
        one = tmp_path / f"one_{name}"
        done = command("convert", HALL, "-o", one, "-t", f"/points:={topic}", *words, "--only-scans", "--overwrite")
        assert done.exit_code == 0, done.output
        assert messages(one) == {topic: together[topic]}


@pytest.mark.parametrize("source", ["hall.bag", "hall", "hall.mcap"])
def test_every_container_gives_the_same_scans(source: str, file: Path, tmp_path: Path) -> None:
    expected = tmp_path / "expected.mcap"
    pc2scan.convert(HALL, expected, scans=file, only_scans=True)
    pc2scan.convert(HALL.with_name(source), tmp_path / "found.mcap", profile="ros2", scans=file, only_scans=True)
    made, found = (
        {topic: [data for *_, data in entries] for topic, entries in messages(path).items()}
        for path in (expected, tmp_path / "found.mcap")
    )
    assert found == made


def test_the_report_has_each_output(file: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    done = command("convert", HALL, "-o", tmp_path / "a.mcap", "--scans", file, "--report", report, "-v")
    assert done.exit_code == 0, done.output
    assert f"{file}, line 3, min_height" in done.output
    written = json.loads(report.read_text())
    assert [each["name"] for each in written["scans"]] == list(ALONE)
    assert [each["params"]["max_height"] for each in written["scans"][:2]] == [1.0, 0.3]
    assert [each["filters"] for each in written["scans"]][2] == [{"name": "where", "condition": "ring in (3, 4, 5)"}]
    topics = [topic for topic in written["topics"] if topic["action"] == "converted"]
    assert [topic["scan"] for topic in topics] == list(ALONE)
    assert len({topic["points"]["used"] for topic in topics}) == 4


def test_parameters_on_the_command_line_beat_all(file: Path, tmp_path: Path) -> None:
    done = command("convert", HALL, "-n", "--scans", file, "--range-max", "3", "--param", "scan_time:=0.5")
    assert done.exit_code == 0, done.output
    assert done.output.count("--param scan_time:=0.5") == done.output.count("--range-max") == 4
    assert not list(tmp_path.glob("*.mcap"))
    report = pc2scan.convert(HALL, tmp_path / "a.mcap", scans=file, range_max=3.0)
    assert {spec.params.range_max for spec in report.scans} == {3.0}


def test_what_else_an_output_has_is_refused_beside_the_file(file: Path, tmp_path: Path) -> None:
    done = command("convert", HALL, "--scans", file, "--preset", "gmapping", "-t", "/points", "--where", "x > 0")
    assert done.exit_code == 2
    assert "--topic, --preset, --where cannot be combined with --scans" in done.output
    with pytest.raises(UsageError, match="`preset`, `deskew` cannot be combined with"):
        pc2scan.convert(HALL, tmp_path / "a.mcap", scans=file, preset="gmapping", deskew=True)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("scans: {/a: {sources: /pints}}", "line 1, /a: no topic /pints in the recording\nhint: did you mean /points?"),
        ("scans:\n  /a: {}\n  /tf: {}\n", "/tf, which /points would be converted to"),
        ("scans: {/a: {where: rng > 1}}", "/a: `where` needs the field 'rng'"),
        ("scans: {/a: {min_hight: 1}}", "line 1: unknown key 'min_hight'\nhint: did you mean min_height?"),
    ],
)
def test_everything_is_checked_before_anything_is_written(text: str, error: str, tmp_path: Path) -> None:
    (tmp_path / "scans.yaml").write_text(text)
    done = command("convert", HALL, "-o", tmp_path / "a.mcap", "--scans", tmp_path / "scans.yaml")
    assert done.exit_code == 2
    assert error.replace("--where", "`where`") in done.output.replace("--where", "`where`")
    assert not (tmp_path / "a.mcap").exists()


def test_the_file_is_never_written_over(file: Path) -> None:
    done = command("convert", HALL, "-o", file, "--scans", file, "--overwrite")
    assert done.exit_code == 2
    assert file.read_text() == SCANS


def test_an_output_without_sources_has_the_only_topic(tmp_path: Path) -> None:
    assert pc2scan.convert(HALL, tmp_path / "a.mcap", scans={"/a": {"min_height": -1}}).exit_status == 0


def test_view_shows_the_first_output(file: Path, tmp_path: Path) -> None:
    done = command("view", HALL, "-o", tmp_path / "page.html", "--scans", file)
    assert done.exit_code == 0, done.output
    assert "only the first of 4 outputs is shown: /scan" in done.output
    alone = command("view", HALL, "-o", tmp_path / "alone.html", "-t", "/points:=/scan", *ALONE["/scan"])
    assert alone.exit_code == 0
