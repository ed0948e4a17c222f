"""Launch files are their command line; `tests/transcripts/ros_notation.txt` has what else ROS users type."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

    from support.command import Finished

ROS1 = """<?xml version="1.0"?>
<launch>
  <arg name="points" />
  <arg name="low" default="-0.3"/>
  <arg name="use_driver" default="false"/>
  <include if="$(arg use_driver)" file="$(find velodyne)/driver.launch"/>
  <group ns="front">
    <node pkg="pointcloud_to_laserscan" type="pointcloud_to_laserscan_node" name="scanner">
      <remap from="cloud_in" to="$(arg points)"/>
      <remap from="scan" to="flat"/>
      <rosparam subst_value="true">
        min_height: $(arg low)
        angle_min: deg(-90)
        angle_max: 1.5707963267948966
      </rosparam>
      <param name="range_max" type="double" value="30"/>
      <param name="use_inf" value="1" type="bool"/>
    </node>
  </group>
  <node pkg="rviz" type="rviz" name="rviz" args="-d $(find nothing)/x.rviz"/>
</launch>
"""
GROUP = ROS1[ROS1.index("<group") : ROS1.index("</group>") + len("</group>")]

ROS2 = """<launch>
  <arg name="points"/>
  <let name="low" value="-0.3"/>
  <node_container pkg="rclcpp_components" exec="component_container" name="box" namespace="">
    <composable_node pkg="pointcloud_to_laserscan" plugin="pointcloud_to_laserscan::PointCloudToLaserScanNode"
                     name="scanner" namespace="front">
      <remap from="cloud_in" to="$(var points)"/>
      <remap from="scan" to="flat"/>
      <param from="$(dirname)/params.yaml"/>
      <param name="min_height" value="$(var low)"/>
    </composable_node>
  </node_container>
</launch>
"""

PARAMS = """
/**:
  ros__parameters:
    angle_min: -1.5707963267948966
    angle_max: 1.5707963267948966
    range_max: 30.0
    min_height: 5.0
"""

PLAIN = "--min-height=-0.3 --angle-min=-90deg --angle-max=90deg --range-max=30 -t /points:=/front/flat"
FILES = {
    "params.yaml": PARAMS,
    "ros1.launch": ROS1,
    "ros2.launch.xml": ROS2,
    "two.launch": ROS1.replace(GROUP, GROUP + GROUP.replace("front", "rear")),
}


@pytest.fixture
def place(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path)
    return tmp_path


def convert(place: Path, words: str) -> Finished:
    return run("convert", "hall.bag", "-o", "made.mcap", "--overwrite", *words.split(), cwd=place)


@pytest.mark.parametrize("file", ["ros1.launch", "ros2.launch.xml"])
def test_a_launch_file_is_its_command_line(place: Path, file: str) -> None:
    assert run("convert", "hall.bag", "-o", "plain.mcap", *PLAIN.split(), cwd=place).status == 0
    asked = convert(place, f"--params-file {file}")
    assert asked.status == 2
    assert f"{file}: needs a value for its argument 'points'" in asked.stderr
    assert "hint: --arg points:=VALUE" in asked.stderr
    assert convert(place, f"--params-file {file} --arg points:=/points").status == 0
    assert run("diff", "plain.mcap", "made.mcap", "--all-topics", cwd=place).status == 0
    # What is typed beats what is in the file.
    lower = convert(place, f"--params-file {file} --arg points:=/points -v --min-height=-1m -t /points")
    rows = [line.split() for line in lower.stdout.splitlines()]
    assert ["min_height", "-1.0", "--min-height"] in rows
    assert f"{'ros1.launch' if file == 'ros1.launch' else 'params.yaml'}, line" in lower.stdout


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        ("ros1.launch --arg points:=/points --arg lwo:=1", 2, ("it has no argument 'lwo'", "did you mean low?")),
        ("two.launch --arg points:=/points", 0, ("/front/flat", "/rear/flat")),
        ("two.launch --arg points:=/points --node /rear/scanner", 0, ("/rear/flat",)),
        ("two.launch --arg points:=/points --node /raer/scanner", 2, ("did you mean /rear/scanner?",)),
        # A file in the launch file is never written over.
        ("ros2.launch.xml --arg points:=/points --report params.yaml", 2, ("params.yaml",)),
    ],
)
def test_arguments_and_nodes_are_chosen_by_name(place: Path, words: str, status: int, said: tuple[str, ...]) -> None:
    done = convert(place, f"--params-file {words}")
    assert done.status == status
    assert all(text in done.stdout + done.stderr for text in said), done
    assert (place / "params.yaml").read_text() == PARAMS
