"""Launch files, mostly Python ones: what is read, what is refused, files made to harm. None is executed."""

from __future__ import annotations

import re
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from pc2scan.errors import ParameterError
from pc2scan.options.call import Options
from pc2scan.request.params_file import load_params_file
from pc2scan.request.scans_file import read_output
from support.tables import rows

TABLE = Path(__file__).parent / "launch_files.txt"

ALONE = "Node(package='pointcloud_to_laserscan', executable='pointcloud_to_laserscan_node', "
PLUGIN = (
    "ComposableNode(package='pointcloud_to_laserscan', plugin='pointcloud_to_laserscan::PointCloudToLaserScanNode', "
)

#: What stands above generate_launch_description(), which begins in line 12.
ABOVE = """
import math, os, sys
from ament_index_python.packages import get_package_share_directory
from launch import *
from launch_ros.actions import ComposableNodeContainer, Node
sys.exit(77)
y = 1.0
d = {'min_height': 1.0}; l = [d]
LOW: float = -0.5
FRAME = 'base'
SHARE = get_package_share_directory('my_robot')
"""


def package(folder: Path) -> Path:
    """Make a ROS package with a file of parameters, and return the path of its launch file."""
    for name in ("launch", "config"):
        (folder / "robot_ws" / name).mkdir(parents=True, exist_ok=True)
    (folder / "robot_ws" / "package.xml").write_text("<package><name>my_robot</name></package>")
    file = "pointcloud_to_laserscan: {ros__parameters: {max_height: 1.5}}\n"
    (folder / "robot_ws" / "config" / "p2l.yaml").write_text(file)
    return folder / "robot_ws" / "launch" / "scan.launch.py"


def described(folder: Path, body: str) -> Path:
    """Write a launch file, in which N and C begin nodes of pointcloud_to_laserscan."""
    path = package(folder)
    text = "def generate_launch_description():\n    " + body.replace("\n", "\n    ")
    path.write_text(ABOVE + re.sub(r"\b([NC])\(", lambda found: {"N": ALONE, "C": PLUGIN}[found[1]], text) + "\n")
    return path


@pytest.mark.parametrize(("body", "node", "remaps", "values"), rows(TABLE, "read", text=True))
def test_what_is_read(body: str, node: str, remaps: dict[str, str], values: dict[str, Any], tmp_path: Path) -> None:
    found = load_params_file(described(tmp_path, body))
    assert (found.node, found.remaps) == (node, remaps)
    assert found.options.given == values


@pytest.mark.parametrize(("body", "said", "hint"), rows(TABLE, "refused", text=True))
def test_what_is_not_read_is_refused_by_name(body: str, said: str, hint: str | None, tmp_path: Path) -> None:
    path = described(tmp_path, body)
    with pytest.raises(ParameterError) as caught:
        read_output(Options("convert", {"params_file": path}), [])
    assert said.format(path=path) in caught.value.message
    assert (caught.value.hint or "").startswith((hint or "").format(path=path))


@pytest.mark.parametrize("body", [body for (body,) in rows(TABLE, "doubtful", text=True)])
def test_a_node_that_may_not_be_launched_once_is_read_if_it_is_named(body: str, tmp_path: Path) -> None:
    path = described(tmp_path, body)
    with pytest.raises(ParameterError) as caught:
        load_params_file(path)
    assert "/a is under a condition, or not plainly launched once" in caught.value.message
    assert caught.value.hint == "`node=/a`"
    assert load_params_file(path, node="a").node == "/a"


@pytest.mark.parametrize(("pieces", "said"), rows(TABLE, "hostile"))
def test_files_made_to_harm(pieces: tuple[str, str, str, int], said: str, tmp_path: Path) -> None:
    first, repeated, last, count = pieces
    path = described(tmp_path, "")
    path.write_text(path.read_text().rstrip() + "\n    " + re.sub(r"\bN\(", ALONE, first + repeated * count + last))
    start = time.process_time()
    with pytest.raises(ParameterError, match=said) if said else nullcontext():
        load_params_file(path)
    assert time.process_time() - start < 5
