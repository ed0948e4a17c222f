"""A parameter file or a launch file with several nodes of pointcloud_to_laserscan: an output for each."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.cli.app import application
from pc2scan.errors import SeveralNodesError, UsageError
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.mcap"

PARAMS = """\
/front/pointcloud_to_laserscan:
  ros__parameters: {min_height: 0.1, max_height: 1.0, target_frame: base_link}
/rear/pointcloud_to_laserscan:
  ros__parameters: {min_height: -0.3, angle_increment: 0.03}
/**:
  ros__parameters: {range_max: 20.0}
"""

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


def command(*words: object) -> Any:
    return CliRunner().invoke(application(), [str(word) for word in words])


def messages(path: Path) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = {}
    with closing(open_recording(path)) as reader:
        for message in reader.messages():
            found.setdefault(message.connection.topic, []).append(bytes(message.data))
    return found


@pytest.mark.parametrize(
    ("name", "text", "nodes"),
    [
        (
            "robot.yaml",
            PARAMS,
            {"/front/scan": "/front/pointcloud_to_laserscan", "/rear/scan": "/rear/pointcloud_to_laserscan"},
        ),
        ("robot.launch.xml", LAUNCH, {"/scan_high": "/high", "/scan_low": "/low"}),
        (
            "renamed.yaml",
            "near:\n  ros__parameters: {range_max: 3.0}\nfar:\n  ros__parameters: {range_min: 3.0}\n",
            {"/near/scan": "/near", "/far/scan": "/far"},
        ),
    ],
    ids=["parameters", "launch", "renamed"],
)
def test_each_node_is_an_output(name: str, text: str, nodes: dict[str, str], tmp_path: Path) -> None:
    file, together = tmp_path / name, tmp_path / "all.mcap"
    file.write_text(text)
    done = command("convert", HALL, "-o", together, "--params-file", file, "--only-scans", "--where", "ring > 1")
    assert done.exit_code == 0, done.output
    found = messages(together)
    assert found.keys() == nodes.keys()
    for topic, node in nodes.items():
        one = tmp_path / "one.mcap"
        asked = {"params_file": file, "node": node, "topics": f"/points:={topic}", "where": "ring > 1"}
        pc2scan.convert(HALL, one, only_scans=True, overwrite=True, **asked)  # type: ignore[arg-type]
        assert messages(one) == {topic: found[topic]}
    in_python = tmp_path / "python.mcap"
    report = pc2scan.convert(HALL, in_python, params_file=file, only_scans=True, where="ring > 1")
    assert in_python.read_bytes() == together.read_bytes()
    assert [spec.place for spec in report.scans] == [f"{file}, {node}" for node in nodes.values()]


def test_options_count_for_all_nodes_and_remappings_for_one(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(PARAMS)
    words = ["--params-file", file, "--range-max", "9", "-p", "scan_time:=0.5", "--preset", "gmapping"]
    words += ["-r", "/rear/pointcloud_to_laserscan:scan:=/behind", "-r", "cloud_in:=/points"]
    done = command("convert", HALL, "-n", "-v", *words)
    assert done.exit_code == 0, done.output
    assert "/front/scan" in done.output
    assert "/behind" in done.output
    assert done.output.count("--param scan_time:=0.5") == 2
    assert done.output.count("--preset gmapping") >= 2


def test_topics_need_a_node(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(PARAMS)
    done = command("convert", HALL, "-n", "--params-file", file, "-t", "/points:=/scan")
    assert done.exit_code == 2
    assert "--topic does not name a node" in done.output
    assert "--node /front/pointcloud_to_laserscan" in done.output
    with pytest.raises(UsageError, match="`topics` does not name a node"):
        pc2scan.convert(HALL, tmp_path / "a.mcap", params_file=file, topics="/points")


def test_where_one_node_is_expected_one_has_to_be_named(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(PARAMS)
    with pytest.raises(SeveralNodesError, match="several nodes match"):
        pc2scan.ProjectionParams.from_file(file)
    both = "pointcloud_to_laserscan:\n  ros__parameters: {}\nlaserscan_to_pointcloud:\n  ros__parameters: {}\n"
    file.write_text(both)
    with pytest.raises(UsageError, match="several nodes match"):
        pc2scan.convert(HALL, tmp_path / "a.mcap", params_file=file)


def test_view_shows_the_first_node(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(PARAMS)
    done = command("view", HALL, "-o", tmp_path / "page.html", "--params-file", file)
    assert done.exit_code == 0, done.output
    assert "only the first of 2 outputs is shown: /front/scan" in done.output
