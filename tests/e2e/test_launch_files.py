"""What ROS users type and have: launch files, remappings, --ros-args, topics by globs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

    from support.command import Finished

HALL = ROOT / "fixtures" / "hall.bag"

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

PLAIN = ("--min-height=-0.3", "--angle-min=-90deg", "--angle-max=90deg", "--range-max=30", "-t", "/points:=/front/flat")


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "params.yaml").write_text(PARAMS)
    (tmp_path / "ros1.launch").write_text(ROS1)
    (tmp_path / "ros2.launch.xml").write_text(ROS2)
    return tmp_path


def convert(place: Path, *options: str, source: Path = HALL) -> Finished:
    return run("convert", source, "-o", "made.mcap", "--overwrite", *options, cwd=place)


@pytest.mark.parametrize("file", ["ros1.launch", "ros2.launch.xml"])
def test_a_launch_file_is_its_command_line(place: Path, file: str) -> None:
    assert run("convert", HALL, "-o", "plain.mcap", *PLAIN, cwd=place).status == 0
    asked = convert(place, "--params-file", file)
    assert asked.status == 2
    assert f"{file}: needs a value for its argument 'points'" in asked.stderr
    assert "hint: --arg points:=VALUE" in asked.stderr
    done = convert(place, "--params-file", file, "--arg", "points:=/points")
    assert done.status == 0, done.stderr
    assert run("diff", "plain.mcap", "made.mcap", "--all-topics", cwd=place).status == 0
    # What is typed beats what is in the file.
    lower = convert(place, "--params-file", file, "--arg", "points:=/points", "-v", "--min-height=-1m", "-t", "/points")
    assert lower.status == 0
    assert "--min-height" in lower.stdout
    assert f"{'ros1.launch' if file == 'ros1.launch' else 'params.yaml'}, line" in lower.stdout


def test_names_of_arguments_and_nodes(place: Path) -> None:
    wrong = convert(place, "--params-file", "ros1.launch", "--arg", "points:=/points", "--arg", "lwo:=1")
    assert wrong.status == 2
    assert "it has no argument 'lwo'" in wrong.stderr
    assert "did you mean low?" in wrong.stderr
    group = ROS1[ROS1.index("<group") : ROS1.index("</group>") + len("</group>")]
    (place / "two.launch").write_text(ROS1.replace(group, group + group.replace("front", "rear")))
    several = convert(place, "--params-file", "two.launch", "--arg", "points:=/points")
    assert several.status == 0, several.stderr
    assert "/front/flat" in several.stdout
    assert "/rear/flat" in several.stdout
    chosen = convert(place, "--params-file", "two.launch", "--arg", "points:=/points", "--node", "/rear/scanner")
    assert chosen.status == 0
    assert "/rear/flat" in chosen.stdout
    near = convert(place, "--params-file", "two.launch", "--arg", "points:=/points", "--node", "/raer/scanner")
    assert "did you mean /rear/scanner?" in near.stderr


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("<launch>", "line 1: not valid XML: no element found"),
        ("<robot/>", "is not a launch file: its root is <robot>"),
        ("<launch/>", "no node of pointcloud_to_laserscan in it"),
        ('<!DOCTYPE l [<!ENTITY a "aaaa">]><launch>&a;</launch>', "line 1: it declares a document type"),
        (
            '<!DOCTYPE l SYSTEM "file:///etc/passwd"><launch/>',
            "line 1: it declares a document type",
        ),
        ("<launch>" + "<group>" * 60 + "</group>" * 60 + "</launch>", "nested more than 50 levels deep"),
        (
            '<launch><node pkg="pointcloud_to_laserscan"><param name="min_hight" value="1"/></node></launch>',
            "min_height",
        ),
        (
            '<launch><node pkg="pointcloud_to_laserscan"><param name="kth" value="$(eval 1+1)"/></node></launch>',
            "'$(eval 1+1)' cannot be computed without ROS",
        ),
        (
            '<launch><node pkg="pointcloud_to_laserscan"><param name="min_height" command="date"/></node></launch>',
            "min_height: <param> has no value here",
        ),
        (
            '<launch><arg name="a" value="$(arg a)"/><node pkg="pointcloud_to_laserscan" name="$(arg a)"/></launch>',
            "needs a value for its argument 'a'",
        ),
        (
            '<launch><node pkg="pointcloud_to_laserscan"><rosparam file="me.launch"/></node></launch>',
            "is a launch file, where parameters are expected",
        ),
        (
            '<launch><node pkg="pointcloud_to_laserscan"><param name="angle_max" value="90"/></node></launch>',
            "for degrees write angle_max: 90deg",
        ),
    ],
    ids=lambda text: text[:40],
)
def test_launch_files_that_cannot_be(place: Path, text: str, error: str) -> None:
    (place / "me.launch").write_text(text)
    done = convert(place, "--params-file", "me.launch")
    assert done.status == 2
    assert error in done.stderr
    assert "Traceback" not in done.stderr


def test_python_launch_files_are_not_executed(place: Path) -> None:
    (place / "scan.launch.py").write_text("raise SystemExit(77)")
    done = convert(place, "--params-file", "scan.launch.py")
    assert done.status == 2
    assert "is a Python program, which is not executed" in done.stderr


def test_a_file_in_the_launch_file_is_never_written_over(place: Path) -> None:
    done = convert(place, "--params-file", "ros2.launch.xml", "--arg", "points:=/points", "--report", "params.yaml")
    assert done.status == 2
    assert (place / "params.yaml").read_text() == PARAMS


@pytest.mark.parametrize(
    "options",
    [
        ("-r", "cloud_in:=/points", "-r", "scan:=/front/flat"),
        ("--ros-args", "--remap", "scanner:cloud_in:=points", "-r", "scan:=front/flat", "-r", "__node:=scanner"),
        ("-r", "scan:=/front/flat"),
        ("cloud_in:=/points", "scan:=front/flat", "__name:=scanner"),
        ("-t", "/p*:=/front/flat"),
        ("--ros-args", "-r", "scan:=/front/flat", "--log-level", "scanner:=debug", "--disable-rosout-logs"),
    ],
    ids=" ".join,
)
def test_remappings(place: Path, options: tuple[str, ...]) -> None:
    done = convert(place, "_min_height:=-0.3", *options)
    assert done.status == 0, done.stderr
    assert "/front/flat" in done.stdout
    assert run("check", "made.mcap", "-t", "/front/*", "--for", "amcl", cwd=place).status != 2


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (("-r", "cloud:=/points"), "pointcloud_to_laserscan has no topic 'cloud'"),
        (("-r", "cloud_in=/points"), "'cloud_in=/points' is not a remapping"),
        (("-r", "cloud_in:=/points", "-t", "/points"), "--topic and --remap both name the topics"),
        (("-t", "/lidar*"), "no PointCloud2 topic matches /lidar*"),
        (("-t", "/points:=/scan_*"), "has more * on the right than on the left"),
        (("--arg", "a:=b"), "--arg needs a launch file, and none is given"),
        (("--params-file", "params.yaml", "--arg", "a:=b"), "only XML launch files have arguments"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_what_is_no_remapping(place: Path, options: tuple[str, ...], error: str) -> None:
    done = convert(place, *options)
    assert done.status == 2
    assert error in done.stderr


def test_transforms_may_be_remapped(place: Path) -> None:
    done = convert(place, "-r", "/tf:=/robot/tf", "--target-frame", "base_link")
    assert done.status == 2
    assert "no transforms on /robot/tf" in done.stderr


def test_globs_of_topics(tmp_path: Path) -> None:
    scans = ["-t", "/points:=/scan_left", "-t", "/points:=/scan_right", "-t", "/points:=/other"]
    assert run("convert", HALL, "-o", "scans.bag", "--preset=nav2", "--min-height=-1", *scans, cwd=tmp_path).status == 0
    one = run("convert", "scans.bag", "-o", "clouds.bag", "--reverse", "-t", "/scan_*:=/cloud_*", cwd=tmp_path)
    assert one.status == 0, one.stderr
    told = run("info", "clouds.bag", cwd=tmp_path).stdout
    assert "/cloud_left" in told
    assert "/cloud_right" in told
    assert "/other/cloud" not in told
    both = run("convert", "scans.bag", "-o", "one.bag", "--reverse", "-t", "scan_*:=/cloud", cwd=tmp_path)
    assert both.status == 2
    assert "/scan_left and /scan_right would both become /cloud" in both.stderr
    checked = run("check", "scans.bag", "--topic", "/scan_*", "--for", "nav2", cwd=tmp_path).stdout
    assert "/scan_left" in checked
    assert "/other" not in checked
