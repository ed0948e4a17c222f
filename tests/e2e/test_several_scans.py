"""Several scans of one recording, by ``--scans`` or several nodes: each as a conversion of its own would write it."""

from __future__ import annotations

import json
import shlex
import shutil
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.errors import SeveralNodesError, UsageError
from support import ROOT, sampled
from support.command import run
from support.outputs import opened

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
PARAMS = """\
/front/pointcloud_to_laserscan:
  ros__parameters: {min_height: 0.1, max_height: 1.0, target_frame: base_link}
/rear/pointcloud_to_laserscan:
  ros__parameters: {min_height: -0.3, angle_increment: 0.03}
/**:
  ros__parameters: {range_max: 20.0}
"""
RENAMED = "near:\n  ros__parameters: {range_max: 3.0}\nfar:\n  ros__parameters: {range_min: 3.0}\n"
LAUNCH = """\
<launch>
  <node pkg="pointcloud_to_laserscan" exec="pointcloud_to_laserscan_node" name="high">
    <param name="min_height" value="0.2"/>
    <remap from="cloud_in" to="/points"/>
    <remap from="scan" to="/scan_high"/>
  </node>
  <node pkg="pointcloud_to_laserscan" exec="pointcloud_to_laserscan_node" name="low">
    <param name="min_height" value="-0.4"/>
    <param name="max_height" value="0.2"/>
    <remap from="scan" to="/scan_low"/>
  </node>
</launch>
"""
FILES = {"scans.yaml": SCANS, "robot.yaml": PARAMS, "renamed.yaml": RENAMED, "robot.launch.xml": LAUNCH}

#: How one command makes several scans, and what makes each of them alone.
TOGETHER: dict[str, dict[str, str]] = {
    "--scans scans.yaml": {
        "/scan": "--target-frame base_link --min-height 0.05 --max-height 1.0 --preset slam_toolbox",
        "/low": "--target-frame base_link --min-height 0.05 --max-height 0.3 --reduce median",
        "/own": "--min-height -0.5 --where 'ring in (3, 4, 5)' --intensity-field intensity",
        "/coarse": "--target-frame base_link --min-height 0.05 --angle-increment 5deg --no-return nan",
    },
    "--params-file robot.yaml --where ring>1": {
        "/front/scan": "--params-file robot.yaml --node /front/pointcloud_to_laserscan --where ring>1",
        "/rear/scan": "--params-file robot.yaml --node /rear/pointcloud_to_laserscan --where ring>1",
    },
    "--params-file renamed.yaml": {
        "/near/scan": "--params-file renamed.yaml --node /near",
        "/far/scan": "--params-file renamed.yaml --node /far",
    },
    "--params-file robot.launch.xml": {
        "/scan_high": "--params-file robot.launch.xml --node /high",
        "/scan_low": "--params-file robot.launch.xml --node /low",
    },
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    shutil.copy(HALL, tmp_path)
    return tmp_path


def made(folder: Path, words: str, name: str = "made.mcap") -> dict[str, list[Any]]:
    """Convert, and return the messages of each topic."""
    done = run("convert", "hall.mcap", "-o", name, *shlex.split(words), "--only-scans", "--overwrite", cwd=folder)
    assert done.status == 0, done.stderr
    output = opened(folder / name)
    return {topic: output.of(topic) for topic in output.topics()}


@pytest.mark.parametrize("words", TOGETHER)
@pytest.mark.parametrize(
    ("name", "jobs"), sampled([("all.mcap", 4), ("all.bag", 1), ("all", 4), ("all.mcap", 1), ("all.bag", 4)], 1)
)
def test_several_scans_are_as_many_conversions(words: str, name: str, jobs: int, folder: Path) -> None:
    together = made(folder, f"{words} -j {jobs}", name)
    assert together.keys() == TOGETHER[words].keys()
    for topic, alone in TOGETHER[words].items():
        assert made(folder, f"{alone} -t /points:={topic}", f"one_{name}") == {topic: together[topic]}


@pytest.mark.parametrize("source", ["hall.bag", "hall"])
def test_every_container_gives_the_same_scans(source: str, folder: Path) -> None:
    expected, found = folder / "expected.mcap", folder / "found.mcap"
    for each, name in ((expected, "hall.mcap"), (found, source)):
        pc2scan.convert(HALL.with_name(name), each, profile="ros2", scans=folder / "scans.yaml", only_scans=True)
    one, other = ([(m.topic, m.data) for m in opened(each).messages] for each in (expected, found))
    assert one == other


def test_the_report_has_each_scan(folder: Path) -> None:
    done = run("convert", "hall.mcap", "-o", "a.mcap", "--scans", "scans.yaml", "--report", "r.json", "-v", cwd=folder)
    assert done.status == 0
    assert "scans.yaml, line 3, min_height" in done.stdout
    written = json.loads((folder / "r.json").read_text())
    assert [each["name"] for each in written["scans"]] == ["/scan", "/low", "/own", "/coarse"]
    assert [each["params"]["max_height"] for each in written["scans"][:2]] == [1.0, 0.3]
    assert written["scans"][2]["filters"] == [{"name": "where", "condition": "ring in (3, 4, 5)"}]
    topics = [topic for topic in written["topics"] if topic["action"] == "converted"]
    assert [topic["scan"] for topic in topics] == ["/scan", "/low", "/own", "/coarse"]
    assert len({topic["points"]["used"] for topic in topics}) == 4


@pytest.mark.parametrize(
    ("words", "count"),
    [
        ("--scans scans.yaml --range-max 3 --param scan_time:=0.5", 4),
        ("--params-file robot.yaml --range-max 9 -p scan_time:=0.5 --preset gmapping", 2),
    ],
)
def test_options_count_for_all_scans(words: str, count: int, folder: Path) -> None:
    shown = run("convert", "hall.mcap", "-n", "-v", *words.split(), cwd=folder).stdout
    assert shown.count("--param scan_time:=0.5") == shown.count("--range-max") == count
    assert ("--preset gmapping" in shown) == ("gmapping" in words)


def test_remappings_are_for_one_node(folder: Path) -> None:
    words = "-r /rear/pointcloud_to_laserscan:scan:=/behind -r cloud_in:=/points"
    assert made(folder, f"--params-file robot.yaml {words}").keys() == {"/front/scan", "/behind"}


def test_python_has_the_same(folder: Path) -> None:
    made(folder, "--params-file robot.yaml", "typed.mcap")
    called, file = folder / "called.mcap", folder / "robot.yaml"
    report = pc2scan.convert(HALL, called, params_file=file, only_scans=True)
    assert called.read_bytes() == (folder / "typed.mcap").read_bytes()
    nodes = ["/front/pointcloud_to_laserscan", "/rear/pointcloud_to_laserscan"]
    assert [spec.place for spec in report.scans] == [f"{file}, {node}" for node in nodes]
    assert pc2scan.convert(HALL, folder / "a.mcap", scans={"/a": {"min_height": -1}}).exit_status == 0
    refused: list[tuple[str, dict[str, Any]]] = [
        ("`preset`, `deskew` cannot be combined", {"scans": {"/a": {}}, "preset": "gmapping", "deskew": True}),
        ("`topics` does not name a node", {"params_file": file, "topics": "/points"}),
    ]
    for message, options in refused:
        with pytest.raises(UsageError, match=message):
            pc2scan.convert(HALL, folder / "none.mcap", **options)
    with pytest.raises(SeveralNodesError, match="several nodes match"):
        pc2scan.ProjectionParams.from_file(file)
    file.write_text(
        "pointcloud_to_laserscan:\n  ros__parameters: {}\nlaserscan_to_pointcloud:\n  ros__parameters: {}\n"
    )
    with pytest.raises(UsageError, match="several nodes match"):
        pc2scan.convert(HALL, folder / "none.mcap", params_file=file)


@pytest.mark.parametrize(
    ("words", "note"),
    [
        ("--scans scans.yaml", "only the first of 4 outputs is shown: /scan"),
        ("--params-file robot.yaml", "only the first of 2 outputs is shown: /front/scan"),
    ],
)
def test_view_shows_the_first_scan(words: str, note: str, folder: Path) -> None:
    done = run("view", "hall.mcap", "-o", "page.html", *words.split(), cwd=folder)
    assert done.status == 0
    assert note in done.stdout + done.stderr
