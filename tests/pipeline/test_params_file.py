"""Parameter files of ROS 2 and ROS 1: read, refused, written."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import ParameterError
from pc2scan.pipeline.param_assignment import parse_param
from pc2scan.pipeline.parameters import PARAMETERS, Direction, Setting, resolve
from pc2scan.pipeline.params_file import ParamsFile, load_params_file, render_params_file
from pipeline.param_settings import Load, failure, params_of, ros2, values, yaml_like
from support import GOLDEN

if TYPE_CHECKING:
    from pathlib import Path

#: Upstream's launch/sample_pointcloud_to_laserscan_launch.py.
SAMPLE = {
    "target_frame": "cloud",
    "transform_tolerance": 0.01,
    "min_height": 0.0,
    "max_height": 1.0,
    "angle_min": -1.5708,
    "angle_max": 1.5708,
    "angle_increment": 0.0087,
    "scan_time": 0.3333,
    "range_min": 0.45,
    "range_max": 4.0,
    "use_inf": True,
    "inf_epsilon": 1.0,
}


# Files: what real ones look like


@pytest.mark.parametrize("case", sorted(p.name for p in GOLDEN.iterdir() if p.is_dir()))
def test_the_golden_files_load(case: str) -> None:
    file = load_params_file(GOLDEN / case / "params.yaml")
    assert file.direction == ("laserscan_to_pointcloud" if case.startswith("scan_") else "pointcloud_to_laserscan")
    assert not file.ignored
    origin = resolve(file.settings, direction=file.direction).origin
    text = (GOLDEN / case / "params.yaml").read_text()
    assert {name for name, source in origin.items() if source != "default"} == {
        name for name in PARAMETERS if f" {name}:" in text
    }


def test_a_golden_file_gives_the_values_written_in_it() -> None:
    params = params_of(load_params_file(GOLDEN / "launch_sample" / "params.yaml"))
    assert params == ProjectionParams(**{**SAMPLE, "target_frame": ""})  # type: ignore[arg-type]
    extreme = params_of(load_params_file(GOLDEN / "nan_and_inf_points" / "params.yaml"))
    assert extreme == ProjectionParams(min_height=-2.0, max_height=2.0, range_max=1e300)


def test_upstreams_launch_parameters_as_a_ros2_file(load: Load) -> None:
    file = load(ros2(dict(SAMPLE)))
    assert file.direction == "pointcloud_to_laserscan"
    assert file.node == "/pointcloud_to_laserscan"
    assert params_of(file) == ProjectionParams(**SAMPLE)  # type: ignore[arg-type]


#: Upstream's config for ROS 1 reads like this: topics among the parameters, comments, ROS 1's queue.
ROS1_SAMPLE = """\
target_frame: hokuyo3d # Leave disabled to output scan in pointcloud frame
cloud_in: /hokuyo3d/hokuyo_cloud2 # input topic
scan: /hokuyo3d/scan
transform_tolerance: 0.01
min_height: 0.0
max_height: 1

angle_min: -1.5708 # -M_PI/2
range_max: 4.0
use_inf: true
concurrency_level: 1
"""


def test_a_flat_ros1_file_with_topics_in_it(load: Load) -> None:
    file = load(ROS1_SAMPLE)
    assert file.node == "/"
    assert file.direction == "pointcloud_to_laserscan"
    assert params_of(file) == ProjectionParams(
        target_frame="hokuyo3d", min_height=0, max_height=1, angle_min=-1.5708, range_max=4, queue_size=1
    )
    assert [origin.rpartition(", ")[2] for origin in file.ignored] == ["cloud_in", "scan"]


@pytest.mark.parametrize(
    ("text", "node"),
    [
        ("pointcloud_to_laserscan: {min_height: -1}", "/pointcloud_to_laserscan"),
        ("/pointcloud_to_laserscan: {min_height: -1}", "/pointcloud_to_laserscan"),
        ("robot:\n  pointcloud_to_laserscan:\n    min_height: -1", "/robot/pointcloud_to_laserscan"),
        ("robot/pointcloud_to_laserscan:\n  min_height: -1", "/robot/pointcloud_to_laserscan"),
        ("/pointcloud_to_laserscan/min_height: -1", "/pointcloud_to_laserscan"),
        ("~min_height: -1", "/"),
        (
            "camera: {fps: 30}\npointcloud_to_laserscan_node: {min_height: -1}",
            "/pointcloud_to_laserscan_node",
        ),
        ("use_sim_time: true\nmy_scan: {min_height: -1}", "/my_scan"),
        ("camera: {fps: 30, roi: {x: 1}}\nmy_scan: {min_height: -1}", "/my_scan"),
        ("slam: {scan: /scan}\nmy_scan: {min_height: -1}", "/my_scan"),
    ],
)
def test_ros1_files_below_a_nodes_name(load: Load, text: str, node: str) -> None:
    file = load(text)
    assert file.node == node
    assert params_of(file) == ProjectionParams(min_height=-1)


@pytest.mark.parametrize(
    ("node", "full"),
    [
        ("pointcloud_to_laserscan", "/pointcloud_to_laserscan"),
        ("/pointcloud_to_laserscan", "/pointcloud_to_laserscan"),
        ("/robot/front/pointcloud_to_laserscan", "/robot/front/pointcloud_to_laserscan"),
        ("pointcloud_to_laserscan_node", "/pointcloud_to_laserscan_node"),
        ("front_pointcloud_to_laserscan", "/front_pointcloud_to_laserscan"),
        ("pointcloud_to_laserscan3", "/pointcloud_to_laserscan3"),
        ("/**/pointcloud_to_laserscan", "/**/pointcloud_to_laserscan"),
        ("/**", "/**"),
        ("/*", "/*"),
        ("my_scan", "/my_scan"),
        ('"*"', "/*"),
    ],
)
def test_ros2_node_names(load: Load, node: str, full: str) -> None:
    file = load(ros2({"min_height": -0.5}, node))
    assert (file.node, file.direction) == (full, "pointcloud_to_laserscan")
    assert values(file) == {"min_height": -0.5}


def test_nested_namespaces(load: Load) -> None:
    text = """
robot:
  front:
    pointcloud_to_laserscan:
      ros__parameters:
        min_height: -0.5
"""
    file = load(text)
    assert file.node == "/robot/front/pointcloud_to_laserscan"
    [setting] = file.settings
    assert setting.origin.endswith(
        "params.yaml, line 6, robot.front.pointcloud_to_laserscan.ros__parameters.min_height"
    )


def test_a_node_may_be_there_twice_in_two_spellings(load: Load) -> None:
    text = ros2({"min_height": -1.0, "range_min": 1.0}, "/a/pointcloud_to_laserscan")
    text += "a:\n  pointcloud_to_laserscan:\n    ros__parameters:\n      min_height: -2.0\n"
    assert values(load(text)) == {"min_height": -2.0, "range_min": 1.0}


@pytest.mark.parametrize("reverse", [False, True])
def test_the_specific_beats_the_wildcard_whatever_the_order(load: Load, *, reverse: bool) -> None:
    sections = [
        ros2({"min_height": -1.0, "max_height": 1.0, "range_min": 1.0, "use_sim_time": True}, "/**"),
        ros2({"min_height": -2.0, "max_height": 2.0}, "/**/pointcloud_to_laserscan"),
        ros2({"min_height": -3.0}, "/robot/*"),
        ros2({"min_height": -4.0}, "/robot/pointcloud_to_laserscan"),
        ros2({"range_max": 9.0}, "/other/*"),
    ]
    file = load("".join(reversed(sections) if reverse else sections))
    assert file.node == "/robot/pointcloud_to_laserscan"
    assert values(file) == {"min_height": -4.0, "max_height": 2.0, "range_min": 1.0}


def test_one_star_is_one_part_of_a_name(load: Load) -> None:
    root_only = ros2({"range_min": 1.0}, "/*")
    assert values(load(root_only + ros2({}, "/pointcloud_to_laserscan"))) == {"range_min": 1.0}
    assert values(load(root_only + ros2({}, "/ns/pointcloud_to_laserscan"))) == {}


def test_what_a_wildcard_says_to_other_nodes_is_left_aside_and_told(load: Load) -> None:
    file = load(ros2({"robot_name": "r2", "range_min": 1.0}, "/**") + ros2({"min_height": -1.0}))
    assert values(file) == {"range_min": 1.0, "min_height": -1.0}
    [ignored] = file.ignored
    assert ignored.endswith("params.yaml, line 3, /**.ros__parameters.robot_name")


def test_a_file_of_many_nodes(load: Load) -> None:
    others = ros2({"fps": 30, "names": "[a, b]"}, "camera") + ros2({"plugins": "{a: {b: 1}}"}, "/nav/costmap")
    file = load(others + ros2({"min_height": -1.0}) + ros2({"rate": 5}, "/ns/slam") + "switched_off:\n")
    assert (file.node, values(file)) == ("/pointcloud_to_laserscan", {"min_height": -1.0})


def test_what_every_node_has_is_no_parameter_of_the_projection(load: Load) -> None:
    text = ros2(
        {
            "use_sim_time": True,
            "start_type_description_service": True,
            "qos_overrides": "{/scan: {publisher: {depth: 5}}}",
            "qos_overrides./tf.subscription.depth": 100,
            "min_height": -1.0,
        }
    )
    file = load(text)
    assert (values(file), file.ignored) == ({"min_height": -1.0}, ())


def test_the_names_of_topics_are_left_aside_and_told(load: Load) -> None:
    file = load(ros2({"point_cloud_topic": "/points", "scan_topic": "/scan", "min_height": -1.0}))
    assert values(file) == {"min_height": -1.0}
    assert [origin.rpartition(".")[2] for origin in file.ignored] == ["point_cloud_topic", "scan_topic"]


@pytest.mark.parametrize("text", ["pointcloud_to_laserscan:\n  ros__parameters: {}", ros2({})])
def test_a_node_without_parameters(load: Load, text: str) -> None:
    assert params_of(load(text)) == ProjectionParams()


@pytest.mark.parametrize("text", ["pointcloud_to_laserscan: {}", "pointcloud_to_laserscan:\n"])
def test_a_ros1_node_without_parameters(load: Load, text: str) -> None:
    file = load(text)
    assert (file.direction, file.settings) == ("pointcloud_to_laserscan", ())


def test_concurrency_level_is_the_queue_size(load: Load) -> None:
    file = load(ros2({"concurrency_level": 3}))
    assert values(file) == {"queue_size": 3}
    assert file.settings[0].origin.endswith(".concurrency_level")
    assert resolve([Setting("concurrency_level", 3, "--concurrency-level")]).params.queue_size == 3


@pytest.mark.parametrize("names", [("queue_size", "concurrency_level"), ("concurrency_level", "queue_size")])
def test_queue_size_beats_concurrency_level_beside_it(load: Load, names: tuple[str, str]) -> None:
    file = load(ros2({name: {"queue_size": 1, "concurrency_level": 2}[name] for name in names}))
    assert values(file) == {"queue_size": 1}
    assert len(file.ignored) == 1


def test_names_that_any_node_may_have_are_ours_only_in_our_sections(load: Load) -> None:
    others = "/**:\n  ros__parameters:\n    geometry: {width: 0.5}\n    beams: 4\n    range_min: 1.0\n"
    file = load(others + ros2({"min_height": -1.0}))
    assert values(file) == {"range_min": 1.0, "min_height": -1.0}
    assert len(file.ignored) == 2
    ours = load(ros2({"beams": 720, "reduce": "max"}, "/**/pointcloud_to_laserscan") + ros2({"geometry": "centered"}))
    assert values(ours) == {"beams": 720, "reduce": "max", "geometry": "centered"}
    assert ours.ignored == ()
    # In a file of ROS 1, too, such a name may be a whole group.
    assert values(load("geometry:\n  width: 0.5\npointcloud_to_laserscan:\n  beams: 90\n")) == {"beams": 90}


def test_a_specific_concurrency_level_beats_a_wildcards_queue_size(load: Load) -> None:
    assert values(load(ros2({"queue_size": 1}, "/**") + ros2({"concurrency_level": 2}))) == {"queue_size": 2}


def test_tabs_stand_between_values_and_comments(load: Load) -> None:
    assert values(load("min_height:\t-1.0\t# low\nmax_height: 2.0 \t\n")) == {
        "min_height": -1.0,
        "max_height": 2.0,
    }


def test_windows_line_ends_byte_order_marks_and_directives(load: Load) -> None:
    assert values(load(b"\xef\xbb\xbf%YAML 1.1\r\n---\r\nmin_height: -1.0\r\n")) == {"min_height": -1.0}


def test_aliases_are_followed(load: Load) -> None:
    text = "defaults: &d {min_height: -1}\nheight: &h 2.5\n"
    text += "pointcloud_to_laserscan: {max_height: *h}\nother: *d\n"
    assert values(load(text)) == {"max_height": 2.5}


def test_an_anchor_may_be_used_again(load: Load) -> None:
    assert values(load("min_height: &a -1\nmax_height: &a 1\nrange_max: *a")) == {
        "min_height": -1,
        "max_height": 1,
        "range_max": 1,
    }


# ROS 1's angles


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("deg(180)", math.pi),
        ("deg(-90.0)", -90.0 * math.pi / 180.0),
        ("deg(0.25)", 0.25 * math.pi / 180.0),
        ("rad(1.57)", 1.57),
        ("rad(pi)", math.pi),
        ("rad(-pi/2)", -math.pi / 2),
        ("rad(2*pi/3 - 0.1)", 2 * math.pi / 3 - 0.1),
        ("rad((pi + 1) * +2)", (math.pi + 1) * 2),
        ("!degrees 45", 45 * math.pi / 180.0),
        ("!degrees deg(45)", 45 * math.pi / 180.0),
        ("!radians pi/3", math.pi / 3),
        ("!radians rad(pi/3)", math.pi / 3),
    ],
)
def test_angles_of_ros1_to_the_last_bit(load: Load, written: str, value: float) -> None:
    assert values(load(f"angle_max: {written}")) == {"angle_max": value}


@pytest.mark.parametrize(
    "written",
    [
        "rad(1/0)",
        "rad(e)",
        "rad(2**9)",
        "rad(__import__('os').getcwd())",
        "rad(lambda:1)",
        "rad(True)",
        "rad('1')",
        "rad(1j)",
        "rad()",
        "rad(1,2)",
        "rad(" + "(" * 60 + "1" + ")" * 60 + ")",
        "rad(" + "9*" * 500 + "9)",
        "deg(x)",
        "!degrees x",
        "!radians pi pi",
    ],
)
def test_what_is_no_arithmetic_is_no_angle(load: Load, written: str) -> None:
    err = failure(lambda: params_of(load(f"range_min: 1\nangle_max: {written}")))
    assert "angle_max: expected a number, got " in str(err)
    assert "params.yaml, line 2, angle_max" in str(err)
    assert err.name == "angle_max"


@pytest.mark.parametrize("written", ["rad(pi/2)", "deg(90)", "90deg", "pi/2", "'90deg'"])
def test_angles_in_a_ros2_file(load: Load, written: str) -> None:
    assert params_of(load(ros2({"angle_max": written}))).angle_max == math.pi / 2


@pytest.mark.parametrize(("written", "value"), [("0", False), ("1", True), ("false", False), ("True", True)])
def test_ros1_takes_0_and_1_for_a_truth_value(load: Load, written: str, *, value: bool) -> None:
    assert values(load(f"use_inf: {written}"))["use_inf"] is value


@pytest.mark.parametrize("written", ["2", "-1", "1.0", "'true'", "maybe"])
def test_ros1_takes_nothing_else_for_one(load: Load, written: str) -> None:
    assert "use_inf: expected true or false" in str(failure(lambda: params_of(load(f"use_inf: {written}"))))


def test_ros2_refuses_0_and_1_for_a_truth_value(load: Load) -> None:
    err = failure(lambda: params_of(load(ros2({"use_inf": 1}))))
    assert "use_inf: expected true or false, got 1 (from " in str(err)
    assert err.hint == "write true or false"


# Which node


def two_nodes() -> str:
    return ros2({"min_height": -1.0}, "/a/pointcloud_to_laserscan") + ros2(
        {"min_height": -2.0}, "/b/pointcloud_to_laserscan"
    )


def test_several_candidates_are_listed(load: Load) -> None:
    err = failure(lambda: load(two_nodes()))
    assert "several nodes match: /a/pointcloud_to_laserscan, /b/pointcloud_to_laserscan" in str(err)
    assert "`node=/a/pointcloud_to_laserscan`" in str(err.hint)
    both = failure(lambda: load(ros2({}) + ros2({}, "laserscan_to_pointcloud")))
    assert "/pointcloud_to_laserscan, /laserscan_to_pointcloud" in str(both)


@pytest.mark.parametrize("node", ["/b/pointcloud_to_laserscan", "b/pointcloud_to_laserscan"])
def test_node_chooses(load: Load, node: str) -> None:
    file = load(two_nodes(), node=node)
    assert (file.node, values(file)) == ("/b/pointcloud_to_laserscan", {"min_height": -2.0})


def test_node_chooses_by_its_last_part_when_that_is_unique(load: Load) -> None:
    text = ros2({"min_height": -1.0}, "/a/front") + ros2({"min_height": -2.0}, "/b/rear")
    assert load(text, node="rear").node == "/b/rear"
    err = failure(lambda: load(two_nodes(), node="pointcloud_to_laserscan"))
    assert "several nodes are named 'pointcloud_to_laserscan': /a/" in str(err)
    assert "`node`" in str(err.hint)


def test_node_may_be_one_that_only_wildcards_match(load: Load) -> None:
    text = ros2({"min_height": -1.0}, "/**") + ros2({"fps": 1}, "camera")
    file = load(text, node="/deep/down/my_scan")
    assert (file.node, values(file)) == ("/deep/down/my_scan", {"min_height": -1.0})
    assert values(load(ros2({"min_height": -1.0}, "/**/my_scan"), node="my_scan")) == {"min_height": -1.0}


@pytest.mark.parametrize("node", ["/c", "c", "/laserscan", "a"])
def test_node_that_is_not_there(load: Load, node: str) -> None:
    err = failure(lambda: load(two_nodes(), node=node))
    assert f"no section is for the node {node!r} (from `node`); found /a/pointcloud_to_laserscan, /b/" in str(err)


def test_a_file_for_other_nodes_lists_them(load: Load) -> None:
    err = failure(lambda: load(ros2({"fps": 30}, "camera") + ros2({"rate": 1}, "/ns/slam")))
    assert "no section is named pointcloud_to_laserscan or laserscan_to_pointcloud" in str(err)
    assert "none has only their parameters; found /camera, /ns/slam" in str(err)
    assert "params.yaml" in str(err)
    alone = failure(lambda: load("camera: {fps: 30}"))
    assert "found /camera" in str(alone)
    many = failure(lambda: load("".join(ros2({"fps": 1}, f"camera{i:02}") for i in range(12))))
    assert "/camera09 and 2 more" in str(many)


def test_two_renamed_nodes_are_not_guessed_between(load: Load) -> None:
    err = failure(lambda: load(ros2({"min_height": 1}, "front") + ros2({"min_height": 2}, "rear")))
    assert "several have only their parameters; found /front, /rear" in str(err)
    assert err.hint == "choose one, for example `node=/front`"


def test_a_renamed_node_is_found_beside_a_wildcard(load: Load) -> None:
    file = load(ros2({"target_frame": "map"}, "/**") + ros2({"min_height": -1.0}, "front"))
    assert (file.node, values(file)) == ("/front", {"target_frame": "map", "min_height": -1.0})


# Directions


def test_the_reverse_node_resolves_with_defaults_for_the_rest(load: Load) -> None:
    file = load(ros2({"target_frame": "odom", "queue_size": 4}, "/ns/laserscan_to_pointcloud"))
    assert file.direction == "laserscan_to_pointcloud"
    resolved = resolve(file.settings, direction=file.direction)
    assert resolved.params == ProjectionParams(target_frame="odom", queue_size=4)


def test_the_reverse_node_has_no_heights(load: Load) -> None:
    err = failure(lambda: load(ros2({"min_height": -1.0}, "laserscan_to_pointcloud")))
    assert "laserscan_to_pointcloud has no parameter 'min_height' (from " in str(err)
    assert "params.yaml, line 3, laserscan_to_pointcloud.ros__parameters.min_height)" in str(err)
    assert err.hint == "the parameters are target_frame, transform_tolerance, queue_size"
    option = Setting("min_height", -1.0, "--min-height")
    again = failure(lambda: resolve([option], direction="laserscan_to_pointcloud"))
    assert str(again) == "laserscan_to_pointcloud has no parameter 'min_height' (from --min-height)"


def test_a_renamed_node_with_only_shared_parameters_could_be_either(load: Load) -> None:
    assert load(ros2({"target_frame": "odom"}, "my_node")).direction is None


# Files that are wrong


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "params.yaml: the file is empty"),
        ("# only a comment\n", "params.yaml: the file is empty"),
        ("{}", "params.yaml: the file is empty"),
        ("- 1\n", "params.yaml: expected parameters as 'name: value', got a list"),
        ("range_min 5", "params.yaml: expected parameters as 'name: value', got only a text"),
        ("a: 1\n---\nb: 2\n", "params.yaml, line 2, column 1: not valid YAML: but found another document"),
        ("a: b: c", "params.yaml, line 1, column 5: not valid YAML: mapping values are not allowed here"),
        ("range_min: [1", "params.yaml, line 1, column 14: not valid YAML: "),
        ("range_min: *x", "params.yaml, line 1, column 12: not valid YAML: found undefined alias 'x'"),
        (
            "a: 1\nb: \x00",
            "params.yaml, line 2, column 4: not valid YAML: special characters are not allowed",
        ),
        (b"a: 1\nb: \xff\xfe", "params.yaml, line 2: byte 0xff is not UTF-8 text"),
        ("a: 1".encode("utf-16"), "params.yaml, line 1: byte 0xff is not UTF-8 text"),
        (
            "range_min: 1\nrange_min: 2\n",
            "params.yaml, line 2, column 1: 'range_min' is given twice, first in line 1",
        ),
        (
            "n: {ros__parameters: {range_min: 1,\n 'range_min': 2}}",
            "params.yaml, line 2, column 2: 'range_min' is given twice",
        ),
        ("? [a]\n: 1\n", "params.yaml, line 1, column 3: a name must be plain text"),
        ("a: &a {b: *a}", "nested more than 50 levels deep"),
        ("[" * 500, "params.yaml: nested too deeply"),
        ("a: {" * 60 + "b: 1" + "}" * 60, "params.yaml, line 1, column "),
        ("x" * 1_000_001, "params.yaml: larger than 1,000,000 bytes"),
        (
            ros2({"min_height": 1}) + "range_min: 5\n",
            "'range_min' is outside of any ros__parameters (from ",
        ),
        ("pointcloud_to_laserscan:\n  ros__parameters: 5\n", "line 2, column 20: expected parameters below"),
        (
            "pointcloud_to_laserscan:\n  ros__parameters: [range_min]\n",
            "line 2, column 20: expected parameters",
        ),
        (
            "range_min: !!python/object/apply:os.system [ls]",
            "range_min: expected a number, got a list (from ",
        ),
        ("target_frame: !!python/name:os.system x", "the YAML tag !!python/name:os.system is not supported"),
        ("target_frame: !env HOME", "target_frame: the YAML tag !env is not supported (from "),
        ("target_frame: !!binary aGk=", "target_frame: the YAML tag !!binary is not supported (from "),
        (ros2({"angle_min": "!degrees 5"}), "angle_min: the YAML tag !degrees is not supported (from "),
        ("range_min: {a: 1}", "range_min: expected a number, got a mapping (from "),
        (ros2({"range_min": "{a: 1}"}), "range_min: expected a number, got a mapping (from "),
        (ros2({"range_min": "[1.0]"}), "range_min: expected a number, got a list (from "),
    ],
)
def test_a_file_that_cannot_be_is_refused_with_its_place(load: Load, text: str | bytes, message: str) -> None:
    err = failure(lambda: load(text))
    assert message in str(err)
    assert "params.yaml" in str(err)


@pytest.mark.parametrize("text", ["pointcloud_to_laserscan:\n\tmin_height: 1\n", "\tmin_height: 1\n"])
def test_tabs_in_the_indentation_are_refused(load: Load, text: str) -> None:
    err = failure(lambda: load(text))
    assert "not valid YAML" in str(err)
    assert err.hint == "indent with spaces, not with tabs"


def test_aliases_that_multiply_are_refused_quickly(load: Load) -> None:
    lines = ["a0: &a0 {x: 1, y: 2}"]
    lines += [f"a{i}: &a{i} {{p: *a{i - 1}, q: *a{i - 1}}}" for i in range(1, 40)]
    assert "its aliases multiply" in str(failure(lambda: load("\n".join(lines))))


def test_a_list_that_multiplies_is_never_expanded(load: Load) -> None:
    lines = ["a0: &a0 [1, 2]"] + [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 40)]
    err = failure(lambda: load("\n".join(lines) + "\nrange_min: *a39"))
    assert "unknown parameter 'a0'" in str(err)


def test_the_merge_key_is_named(load: Load) -> None:
    err = failure(lambda: load("d: &d {min_height: 1}\npointcloud_to_laserscan:\n  <<: *d\n  max_height: 2\n"))
    assert "unknown parameter '<</min_height'" in str(err)
    assert "merge key" in str(err.hint)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.one_of(yaml_like, st.text(), st.binary(max_size=60)))
def test_no_text_whatever_raises_anything_else(load: Load, text: str | bytes) -> None:
    with suppress(ParameterError):
        params_of(load(text if isinstance(text, bytes) else text.encode("utf-8", "replace")))


def test_files_that_are_not_there(tmp_path: Path) -> None:
    missing = failure(lambda: load_params_file(tmp_path / "none.yaml"))
    assert str(missing) == f"{tmp_path / 'none.yaml'}: does not exist"
    directory = failure(lambda: load_params_file(tmp_path))
    assert str(directory) == f"{tmp_path}: this is a directory, not a parameter file"
    (tmp_path / "file").touch()
    below = failure(lambda: load_params_file(tmp_path / "file" / "params.yaml"))
    assert "cannot be read: Not a directory" in str(below)
    assert missing.exit_status == 2


# Names that are unknown


@pytest.mark.parametrize(
    ("name", "suggestion"),
    [
        ("min_heigth", "min_height"),
        ("range-min", "range_min"),
        ("rangemax", "range_max"),
        ("concurency_level", "concurrency_level"),
        ("useinf", "use_inf"),
    ],
)
def test_a_misspelt_name_gets_a_suggestion_and_the_list(load: Load, name: str, suggestion: str) -> None:
    err = failure(lambda: resolve([parse_param(f"{name}:=1")]))
    assert str(err) == f"unknown parameter {name!r} (from --param {name}:=1); did you mean {suggestion!r}?"
    assert str(err.hint) == f"the parameters are {', '.join(PARAMETERS)}"
    assert err.name == name
    for text in (
        ros2({"range_max": 5.0, name: 1}),
        f"range_max: 5\n{name}: 1",
        ros2({name: 1, "range_max": 5.0}, "/**"),
    ):
        in_file = failure(lambda text=text: load(text))  # type: ignore[misc]
        assert f"unknown parameter {name!r} (from " in str(in_file)
        assert f"did you mean {suggestion!r}?" in str(in_file)


def test_parameters_below_a_parameters_namespace_are_unknown(load: Load) -> None:
    assert "unknown parameter 'filter.size'" in str(failure(lambda: load(ros2({"filter": "{size: 1}"}))))
    assert "unknown parameter 'filter/size'" in str(failure(lambda: load("min_height: 1\nfilter: {size: 1}")))
    assert "unknown parameter 'filter/a/b'" in str(
        failure(lambda: load("pointcloud_to_laserscan: {min_height: 1, filter: {a: {b: 1}}}"))
    )


def test_the_line_of_a_wrong_value_is_told(load: Load) -> None:
    err = failure(lambda: params_of(load("range_max: 5\n\nrange_min: abc\n")))
    assert "range_min: expected a number, got 'abc' (from " in str(err)
    assert str(err).endswith("params.yaml, line 3, range_min)")


def test_a_value_left_out_is_nothing(load: Load) -> None:
    assert "range_min: expected a number, got nothing" in str(failure(lambda: params_of(load(ros2({"range_min": ""})))))


# Writing


def reread(text: str, path: Path) -> ParamsFile:
    path.write_text(text, encoding="utf-8")
    return load_params_file(path)


finite = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def any_params(draw: st.DrawFn) -> ProjectionParams:
    heights = sorted((draw(st.floats(allow_nan=False)), draw(st.floats(allow_nan=False))))
    ranges = sorted((draw(st.floats(allow_nan=False)), draw(st.floats(allow_nan=False))))
    angle_min = draw(st.floats(-3, 6.1))
    return ProjectionParams(
        target_frame=draw(st.text()),
        transform_tolerance=draw(st.floats(0)),
        min_height=heights[0],
        max_height=heights[1],
        angle_min=angle_min,
        angle_max=draw(st.floats(angle_min + 0.1, min(angle_min + 6.28, 6.28))),
        angle_increment=draw(st.floats(1e-4, 1e-1)),
        scan_time=draw(st.floats(0)),
        range_min=ranges[0],
        range_max=ranges[1],
        use_inf=draw(st.booleans()),
        inf_epsilon=draw(finite),
        queue_size=draw(st.integers(0, 10**6)),
        geometry=draw(st.sampled_from(["upstream", "centered"])),
        reduce=draw(st.sampled_from(["min", "max", "mean", "median"])),
        min_points=draw(st.integers(1, 9)),
        intensity_field=draw(st.text()),
        time_increment=draw(st.one_of(finite, st.just("auto"))),
        angle_rounding=draw(st.sampled_from(["correct", "glibc-2.40"])),
    )


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(params=any_params())
def test_a_rendered_file_reads_back_to_the_bit(tmp_path: Path, params: ProjectionParams) -> None:
    file = reread(render_params_file(params), tmp_path / "params.yaml")
    assert file.direction == "pointcloud_to_laserscan"
    assert asdict(params_of(file)) == asdict(params)


@pytest.mark.parametrize(
    "frame", ["1", "true", "null", "", "a: b", "# a", 'say "hi" \\', "a\tb\nc", "日本", "\u2028\x85"]
)
def test_frames_of_every_kind_read_back(tmp_path: Path, frame: str) -> None:
    file = reread(render_params_file(ProjectionParams(target_frame=frame)), tmp_path / "params.yaml")
    assert params_of(file).target_frame == frame


def test_what_a_rendered_file_looks_like() -> None:
    params = ProjectionParams(target_frame="base_link", range_max=math.inf, max_height=1e300, use_inf=False)
    lines = render_params_file(params).splitlines()
    assert lines[:3] == ["pointcloud_to_laserscan:", "  ros__parameters:", '    target_frame: "base_link"']
    assert "    range_max: .inf  # m" in lines
    assert "    max_height: 1.0e+300  # m" in lines
    assert "    use_inf: false" in lines
    assert not any("queue_size" in line for line in lines)
    assert "    queue_size: 3" in render_params_file(ProjectionParams(queue_size=3)).splitlines()


def test_a_rendered_file_says_nothing_twice(tmp_path: Path) -> None:
    assert "geometry" not in render_params_file(ProjectionParams())
    params = ProjectionParams(beams=720, no_return="nan", use_inf=False, scan_time="auto", reduce="kth", kth=3)
    text = render_params_file(params)
    assert "beams" not in text
    assert "use_inf" not in text
    assert params_of(reread(text, tmp_path / "p.yaml")) == replace(params, beams=0, use_inf=True)


def test_a_rendered_file_of_the_reverse_direction(tmp_path: Path) -> None:
    direction: Direction = "laserscan_to_pointcloud"
    params = ProjectionParams(target_frame="odom", transform_tolerance=0.5, queue_size=7)
    file = reread(render_params_file(params, direction=direction), tmp_path / "params.yaml")
    assert file.direction == direction
    assert resolve(file.settings, direction=direction).params == params


def test_the_defaults_read_back_as_the_defaults(tmp_path: Path) -> None:
    assert params_of(reread(render_params_file(ProjectionParams()), tmp_path / "p.yaml")) == ProjectionParams()
