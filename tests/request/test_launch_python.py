"""Launch files, mostly Python ones: what is read, what is refused, files made to harm. None is executed."""

from __future__ import annotations

import re
import time
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import pc2scan
from pc2scan.errors import ParameterError, SeveralNodesError
from pc2scan.options.table import PARAMETERS
from pc2scan.request.param_sources import resolve_sources
from pc2scan.request.params_file import ParamsFile, load_params_file
from support import ROOT
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Mapping

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
raise SystemExit(77)
LOW: float = -0.5
FRAME = 'base'
PARAMS = {'range_max': 9.0}
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


def described(folder: Path, body: str, above: str = ABOVE) -> Path:
    """Write a launch file, in which N and C begin nodes of pointcloud_to_laserscan."""
    path = package(folder)
    text = "def generate_launch_description():\n    " + body.replace("\n", "\n    ")
    path.write_text(above + re.sub(r"\b([NC])\(", lambda found: {"N": ALONE, "C": PLUGIN}[found[1]], text) + "\n")
    return path


@pytest.mark.parametrize(("body", "node", "remaps", "values"), rows(TABLE, "read", text=True))
def test_what_is_read(body: str, node: str, remaps: tuple[str, ...], values: dict[str, Any], tmp_path: Path) -> None:
    found = load_params_file(described(tmp_path, body))
    assert (found.node, found.remaps) == (node, remaps)
    assert {setting.name: setting.value for setting in found.settings} == values
    assert [type(setting.value) for setting in found.settings] == [type(value) for value in values.values()]


@pytest.mark.parametrize(("change", "name"), rows(TABLE, "values", text=True))
@pytest.mark.parametrize("is_before", [True, False])
def test_no_value_is_read_that_a_file_may_change(
    change: str,
    name: Any,
    is_before: bool,
    tmp_path: Path,
) -> None:
    params = {"y": "[{'min_height': y}]", "d": "[d]", "l": "l"}[name]
    above = "y = 1.0\nd = {'min_height': 1.0}\nl = [{'min_height': 1.0}]\n"
    node = f"node = N(parameters={params})"
    lines = [change, node] if is_before else [node, change]
    path = described(tmp_path, "\n".join([*lines, "return LaunchDescription([node])"]), above)
    with pytest.raises(ParameterError, match=r"(min_height|parameters): .* is not read"):
        load_params_file(path, node="pointcloud_to_laserscan")


@pytest.mark.parametrize(("body", "said", "hint"), rows(TABLE, "refused", text=True))
def test_what_is_not_read_is_refused_by_name(body: str, said: str, hint: str | None, tmp_path: Path) -> None:
    path = described(tmp_path, body)
    with pytest.raises(ParameterError) as caught:
        resolve_sources((), file=path)
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


def test_two_nodes_are_two_conversions(tmp_path: Path) -> None:
    path = described(tmp_path, "return LaunchDescription([N(name='a'), N(name='b')])")
    with pytest.raises(SeveralNodesError) as caught:
        load_params_file(path)
    assert caught.value.nodes == ("/a", "/b")


def test_what_is_given_is_not_needed_from_the_file(tmp_path: Path) -> None:
    body = (
        "return LaunchDescription([N(parameters=[{'min_height': lowest(), 'range_max': 30.0}], "
        "remappings=[('cloud_in', topic()), ('scan', '/flat')])])"
    )
    path = described(tmp_path, body)
    found = resolve_sources((), assignments=["min_height:=-0.5"], file=path, remapped=["cloud_in"])
    assert (found.params.min_height, found.params.range_max) == (-0.5, 30.0)
    hall = ROOT / "fixtures" / "hall.bag"
    report = pc2scan.convert(hall, params_file=path, dry_run=True, remap="cloud_in:=/points", min_height=-0.5)
    assert [topic.target for topic in report.topics if topic.action == "converted"] == ["/flat"]


def test_arguments_are_given(tmp_path: Path) -> None:
    body = (
        "return LaunchDescription([DeclareLaunchArgument('low'), N(name=LaunchConfiguration('who', default='a'), "
        "parameters=[{'min_height': LaunchConfiguration('low')}])])"
    )
    path = described(tmp_path, body)
    found = load_params_file(path, arguments={"low": "-0.5", "who": "b"})
    assert (found.node, [setting.value for setting in found.settings]) == ("/b", [-0.5])
    with pytest.raises(ParameterError, match="it has no argument 'lwo'"):
        load_params_file(path, arguments={"low": "1", "lwo": "2"})


def test_what_is_ignored_is_said(tmp_path: Path) -> None:
    body = "return LaunchDescription([IncludeLaunchDescription('b.launch.py'), N(parameters=[{'reliability': 'x'}])])"
    path = described(tmp_path, body)
    included = f"{path}, line 13, IncludeLaunchDescription('b.launch.py')"
    assert load_params_file(path).ignored == (included, f"{path}, line 13, reliability")


@pytest.mark.parametrize(("pieces", "said"), rows(TABLE, "hostile"))
def test_files_made_to_harm(pieces: tuple[str, str, str, int], said: str, tmp_path: Path) -> None:
    first, repeated, last, count = pieces
    path = described(tmp_path, "")
    path.write_text(path.read_text().rstrip() + "\n    " + re.sub(r"\bN\(", ALONE, first + repeated * count + last))
    start = time.process_time()
    with pytest.raises(ParameterError, match=said) if said else nullcontext():
        load_params_file(path)
    assert time.process_time() - start < 5


#: The words and signs of the table.
_PIECES = sorted(
    {piece for row in rows(TABLE, "doubtful", text=True) for piece in re.findall(r"\w+\(?|\s+|[^\w\s]", row[0])}
)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pieces=st.lists(st.sampled_from(_PIECES), max_size=25))
def test_any_text_is_read_or_refused(pieces: list[str], tmp_path: Path) -> None:
    path = described(tmp_path, "".join(pieces))
    with suppress(ParameterError):
        assert isinstance(load_params_file(path), ParamsFile)


_VALUES = {
    "float": st.floats(-1000, 1000, allow_nan=False).map(lambda value: round(value, 3)),
    "bool": st.booleans(),
    "int": st.integers(1, 100),
    "str": st.sampled_from(["base_link", "", "map", "a b"]),
}
_PARAMETERS = st.fixed_dictionaries(
    {},
    optional={
        name: _VALUES[parameter.value.kind]
        for name, parameter in PARAMETERS.items()
        if parameter.upstreams and not parameter.value.words
    },
)
_TOPICS = st.sampled_from(["/points", "points", "/lidar/points", "flat"])


def python_file(values: Mapping[str, object], remaps: Mapping[str, str]) -> str:
    return (
        "def generate_launch_description():\n"
        f"    node = {ALONE}name='scanner', namespace='bot', parameters=[{dict(values)!r}], "
        f"remappings={list(remaps.items())!r})\n    return LaunchDescription([node])\n"
    )


def xml_file(values: Mapping[str, object], remaps: Mapping[str, str]) -> str:
    params = "".join(f'<param name="{name}" value="{value}"/>' for name, value in values.items())
    topics = "".join(f'<remap from="{name}" to="{topic}"/>' for name, topic in remaps.items())
    node = 'pkg="pointcloud_to_laserscan" exec="pointcloud_to_laserscan_node" name="scanner" namespace="bot"'
    return f"<launch><node {node}>{params}{topics}</node></launch>"


def yaml_file(values: Mapping[str, object]) -> str:
    words = [f"{name}: {value!r}".replace("True", "true").replace("False", "false") for name, value in values.items()]
    return f"/bot/scanner: {{ros__parameters: {{{', '.join(words)}}}}}\n"


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=_PARAMETERS, remaps=st.dictionaries(st.sampled_from(["cloud_in", "scan"]), _TOPICS))
def test_one_node_reads_the_same_from_python_xml_and_yaml(
    values: dict[str, object], remaps: dict[str, str], tmp_path: Path
) -> None:
    found = []
    for name, text in (
        ("scan.launch.py", python_file(values, remaps)),
        ("scan.launch.xml", xml_file(values, remaps)),
        ("params.yaml", yaml_file(values)),
    ):
        (tmp_path / name).write_text(text)
        found.append(load_params_file(tmp_path / name))
    read = [{setting.name: (type(setting.value), setting.value) for setting in file.settings} for file in found]
    assert read[0] == read[1] == read[2]
    assert {name: value for name, (_, value) in read[0].items()} == values
    assert {file.node for file in found} == {"/bot/scanner"}
    assert found[0].remaps == found[1].remaps
