"""Python launch files: which forms are read, what is refused, files made to harm. None is executed."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import pc2scan
from pc2scan.errors import ParameterError, SeveralNodesError
from pc2scan.options.table import PARAMETERS
from pc2scan.pipeline.param_sources import resolve_sources
from pc2scan.pipeline.params_file import ParamsFile, load_params_file
from support import ROOT
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Mapping

TABLE = Path(__file__).parent / "launch_files.txt"

ALONE = "Node(package='pointcloud_to_laserscan', executable='pointcloud_to_laserscan_node', "
PLUGIN = (
    "ComposableNode(package='pointcloud_to_laserscan', plugin='pointcloud_to_laserscan::PointCloudToLaserScanNode', "
)

#: What stands above generate_launch_description() in the files of the tables.
ABOVE = """
import math, os, pathlib, sys
from launch import *
sys.exit(77)
raise SystemExit(77)
SIDE, LOW = 'left', -0.5
REMAPPINGS = [('cloud_in', '/points')]
OTHERS = {'range_min': 0.45}
SHARE = get_package_share_directory('my_robot')
def setup(context, *args, **kwargs):
    made = []
    for side in ('front', 'rear'):
        made.append(Node(package='pointcloud_to_laserscan', executable='pointcloud_to_laserscan_node', name=side))
    return made
"""

#: The arguments of the files that nodes are read from.
ARGUMENTS = """
    arguments = [
        DeclareLaunchArgument('side', default_value='left', description='front or rear'),
        DeclareLaunchArgument(name='low', default_value='-0.25'),
        DeclareLaunchArgument('map', default_value=os.path.join(get_package_share_directory('nav2_bringup'), 'a.yaml')),
        DeclareLaunchArgument('params_file', default_value=os.path.join(SHARE, 'config', 'p2l.yaml')),
    ]
"""


def package(folder: Path) -> Path:
    """Make a ROS package with a file of parameters, and return the path of its launch file."""
    for name in ("launch", "config"):
        (folder / "robot_ws" / name).mkdir(parents=True, exist_ok=True)
    (folder / "robot_ws" / "package.xml").write_text("<package><name>my_robot</name></package>")
    file = "pointcloud_to_laserscan: {ros__parameters: {max_height: 1.5}}\n"
    (folder / "robot_ws" / "config" / "p2l.yaml").write_text(file)
    return folder / "robot_ws" / "launch" / "scan.launch.py"


def described(path: Path, body: str, above: str = "") -> Path:
    """Write a launch file, in which NODE and PLUGIN begin nodes of pointcloud_to_laserscan."""
    text = f"def generate_launch_description():\n    {body}".replace("NODE(", ALONE).replace("PLUGIN(", PLUGIN)
    path.write_text(above + text)
    return path


@pytest.mark.parametrize(("arguments", "node", "remaps", "values"), rows(TABLE, "nodes", text=True))
def test_the_forms_of_a_node(
    arguments: str, node: str, remaps: tuple[str, ...], values: dict[str, Any], tmp_path: Path
) -> None:
    path = package(tmp_path)
    made = arguments if "executable=" in arguments else f"executable='pointcloud_to_laserscan_node', {arguments}"
    body = f"return LaunchDescription(arguments + [Node(package='pointcloud_to_laserscan', {made})])"
    path.write_text(f"{ABOVE}def generate_launch_description():\n{ARGUMENTS}    {body}\n")
    found = load_params_file(path)
    assert (found.node, found.remaps, found.ignored) == (node, remaps, ())
    assert {setting.name: setting.value for setting in found.settings} == values
    assert [type(setting.value) for setting in found.settings] == [type(value) for value in values.values()]


@pytest.mark.parametrize(("body", "nodes"), rows(TABLE, "descriptions", text=True))
def test_the_nodes_of_a_description(body: str, nodes: list[str], tmp_path: Path) -> None:
    path = described(tmp_path / "scan.launch.py", body.replace("\n", "\n    "), ABOVE)
    if len(nodes) == 1:
        assert load_params_file(path).node == nodes[0]
    else:
        with pytest.raises(SeveralNodesError) as caught:
            load_params_file(path)
        assert caught.value.nodes == tuple(nodes)
    for node in nodes:
        assert load_params_file(path, node=node).node == node


@pytest.mark.parametrize(("body", "said", "hint"), rows(TABLE, "refused", text=True))
def test_what_is_not_literal_is_refused_by_name(body: str, said: str, hint: str | None, tmp_path: Path) -> None:
    path = described(tmp_path / "scan.launch.py", body.replace("\n", "\n    "))
    with pytest.raises(ParameterError) as caught:
        resolve_sources((), file=path)
    assert said.format(path=path) in caught.value.message
    if hint is not None:
        assert (caught.value.hint or "").startswith(hint)


def test_a_value_that_is_given_is_not_needed_from_the_file(tmp_path: Path) -> None:
    body = "return LaunchDescription([NODE(parameters=[{'min_height': lowest(), 'range_max': 30.0}])])"
    found = resolve_sources((), assignments=["min_height:=-0.5"], file=described(tmp_path / "a.launch.py", body))
    assert (found.params.min_height, found.params.range_max) == (-0.5, 30.0)


def test_a_topic_that_is_given_is_not_needed_from_the_file(tmp_path: Path) -> None:
    body = "return LaunchDescription([NODE(remappings=[('cloud_in', topic()), ('imu', imu()), ('scan', '/flat')])])"
    path = described(tmp_path / "a.launch.py", body)
    hall = ROOT / "fixtures" / "hall.bag"
    for report in (
        pc2scan.convert(hall, params_file=path, dry_run=True, remap="cloud_in:=/points"),
        pc2scan.convert(hall, params_file=path, dry_run=True, topics="/points:=/flat"),
    ):
        assert [topic.target for topic in report.topics if topic.action == "converted"] == ["/flat"]


def test_what_may_be_another_node_is_said(tmp_path: Path) -> None:
    path = described(tmp_path / "a.launch.py", "return LaunchDescription([NODE(name='a'), *others()])")
    assert load_params_file(path).ignored == (f"{path}, line 2, *others()",)


def test_arguments_are_given(tmp_path: Path) -> None:
    body = (
        "return LaunchDescription([DeclareLaunchArgument('low'), NODE(name=LaunchConfiguration('who', default='a'), "
        "parameters=[{'min_height': LaunchConfiguration('low')}])])"
    )
    path = described(tmp_path / "scan.launch.py", body)
    found = load_params_file(path, arguments={"low": "-0.5", "who": "b"})
    assert (found.node, [setting.value for setting in found.settings]) == ("/b", [-0.5])
    with pytest.raises(ParameterError, match="it has no argument 'lwo'"):
        load_params_file(path, arguments={"low": "1", "lwo": "2"})


def test_a_parameter_that_no_node_has_is_ignored_like_on_the_robot(tmp_path: Path) -> None:
    path = described(tmp_path / "a.launch.py", "return LaunchDescription([NODE(parameters=[{'reliability': 'x'}])])")
    assert load_params_file(path).ignored == (f"{path}, line 2, reliability",)


@pytest.mark.parametrize(("pieces", "said"), rows(TABLE, "hostile"))
def test_files_made_to_harm(pieces: tuple[str, str, str, int], said: str, tmp_path: Path) -> None:
    first, repeated, last, count = pieces
    path = described(tmp_path / "scan.launch.py", first + repeated * count + last)
    start = time.process_time()
    with pytest.raises(ParameterError) as caught:
        load_params_file(path)
    assert said in caught.value.message
    assert time.process_time() - start < 5


_PIECES = st.sampled_from(
    [
        *(
            "NODE(",
            "LaunchDescription(",
            "return ",
            "[",
            "]",
            "(",
            ")",
            "{",
            "}",
            ",",
            ":",
            "=",
            "\n    ",
            "+",
            "*",
            "**",
        ),
        *(
            "name",
            "parameters=",
            "remappings=",
            "'min_height'",
            "1",
            "-",
            ".",
            "x",
            "x = ",
            "for x in ",
            "if ",
            "else:",
        ),
        *(
            "lambda x: ",
            "def f(x):",
            "f(",
            "x.append(",
            "x[",
            "f'{",
            "'",
            "LaunchConfiguration(",
            "IfCondition(",
            "os.path.join(",
        ),
    ]
)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pieces=st.lists(_PIECES, max_size=25))
def test_any_text_is_read_or_refused(pieces: list[str], tmp_path: Path) -> None:
    path = described(tmp_path / "scan.launch.py", "".join(pieces))
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
