"""Parameter files of ROS 2 and ROS 1: read, refused, written."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import ParameterError
from pc2scan.request.parameters import Setting, resolve
from pc2scan.request.params_file import ParamsFile, load_params_file
from request.param_settings import failure, params_of, yaml_like
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.request.parameters import Direction

    Load = Callable[..., ParamsFile]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Write a file and load it."""

    def write_and_load(text: str | bytes, node: str | None = None) -> ParamsFile:
        path = tmp_path / "params.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_params_file(path, node=node)

    return write_and_load


def ros2(node: str = "pointcloud_to_laserscan", /, **parameters: object) -> str:
    """One node's section, in a line."""
    return f"{node}: {{ros__parameters: {{{', '.join(f'{name}: {value}' for name, value in parameters.items())}}}}}\n"


P2L, HERE = "pointcloud_to_laserscan", "/pointcloud_to_laserscan"
TWO = ros2(f"/a{HERE}", min_height=-1) + ros2(f"/b{HERE}", min_height=-2)
GEOMETRY = ros2("/**", geometry="{width: 0.5}", beams=4, range_min=1)
TABLES = Path(__file__).parent
READ = rows(TABLES / "params_files.txt", "files", text=True)
READ.append((b"\xef\xbb\xbf%YAML 1.1\r\n---\r\nmin_height: -1\r\n", "/", {"min_height": -1}))


@pytest.mark.parametrize(("text", "node", "values"), READ)
def test_a_file_has_the_parameters_of_its_node(load: Load, text: str, node: str, values: dict[str, Any]) -> None:
    file = load(text)
    assert (file.node, {setting.name: setting.value for setting in file.settings}) == (node, values)
    assert file.direction == P2L
    assert [type(setting.value) for setting in file.settings] == [type(value) for value in values.values()]
    assert params_of(file) == ProjectionParams(**values)


@pytest.mark.parametrize(
    ("text", "chosen", "node", "height"),
    [
        (TWO, f"/b{HERE}", f"/b{HERE}", -2),
        (TWO, f"b{HERE}", f"/b{HERE}", -2),
        (ros2("/a/front", min_height=-1) + ros2("/b/rear", min_height=-2), "rear", "/b/rear", -2),
        (ros2("/**", min_height=-1) + ros2("camera", fps=1), "/deep/down/my_scan", "/deep/down/my_scan", -1),
        (ros2("/**/my_scan", min_height=-1), "my_scan", "/**/my_scan", -1),
    ],
)
def test_one_of_several_nodes_can_be_chosen(load: Load, text: str, chosen: str, node: str, height: float) -> None:
    file = load(text, chosen)
    assert (file.node, params_of(file).min_height) == (node, height)


@pytest.mark.parametrize(
    ("text", "ignored"),
    [
        (ros2("/**", robot_name="r2", range_min=1) + ros2(min_height=-1), ["robot_name"]),
        (ros2(point_cloud_topic="/points", scan_topic="/scan", min_height=-1), ["point_cloud_topic", "scan_topic"]),
        (ros2(queue_size=1, concurrency_level=2), ["concurrency_level"]),
        (ros2(concurrency_level=2, queue_size=1), ["concurrency_level"]),
        (GEOMETRY + ros2(min_height=-1), ["width", "beams"]),
        ("target_frame: a # of the cloud\ncloud_in: /a # the input\nscan: /b\n", ["cloud_in", "scan"]),
    ],
)
def test_what_is_left_aside_is_told(load: Load, text: str, ignored: list[str]) -> None:
    file = load(text)
    assert [origin.replace(".", " ").split()[-1] for origin in file.ignored] == ignored
    assert all("params.yaml, line 1" in origin or "\n" in text for origin in file.ignored)
    assert params_of(file).queue_size in {0, 1}


@pytest.mark.parametrize(("written", "value"), rows(TABLES / "values.txt", "angles of ROS 1", text=True))
def test_angles_of_ros1_to_the_last_bit(load: Load, written: str, value: float) -> None:
    assert load(f"angle_max: {written}").settings[0].value == value


@pytest.mark.parametrize("written", ["rad(pi/2)", "deg(90)", "90deg", "pi/2", "'90deg'"])
def test_angles_in_a_ros2_file(load: Load, written: str) -> None:
    assert params_of(load(ros2(angle_max=written))).angle_max == math.pi / 2


BACK: Direction = "laserscan_to_pointcloud"

#: Files that no transcript has, parts of what is said, and of the hint.
REFUSED: list[tuple[str | bytes, str, str]] = [
    (f"range_min: 1\nangle_max: rad({'9*' * 500}9)", "angle_max: expected a number, got ", ""),
    (TWO, f"several nodes match: /a{HERE}, /b{HERE}", f"`node=/a{HERE}`"),
    (ros2() + ros2(BACK), f"{HERE}, /{BACK}", ""),
    (
        ros2("front", min_height=1) + ros2("rear", min_height=2),
        "several nodes match: /front, /rear",
        "choose one, for example `node=/front`",
    ),
    ("x" * 1_000_001, "params.yaml: larger than 1,000,000 bytes", ""),
    ("".join(f"a{i}: &a{i} {{p: *a{i - 1}, q: *a{i - 1}}}\n" for i in range(40)).replace("*a-1", "x"), "multiply", ""),
    # Lists are never expanded.
    (
        "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(40)).replace("*a-1", "1") + "range_min: *a39",
        "unknown parameter 'a0'",
        "",
    ),
    ("range_min: !!python/object/apply:os.system [ls]", "range_min: expected a number, got a list (from ", ""),
]


@pytest.mark.parametrize(("text", "message", "hint"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_wrong_is_refused_with_its_place(load: Load, text: str | bytes, message: str, hint: str) -> None:
    err = failure(lambda: params_of(load(text)))
    assert message in str(err)
    assert "params.yaml" in str(err)
    assert hint in (err.hint or "")


def test_the_way_back_has_parameters_of_its_own(load: Load) -> None:
    file = load(ros2(f"/ns/{BACK}", target_frame="odom", queue_size=4))
    assert file.direction == BACK
    assert params_of(file) == ProjectionParams(target_frame="odom", queue_size=4)
    option = Setting("min_height", -1.0, "--min-height")
    err = failure(resolve, [option], direction=BACK)
    assert str(err) == f"{BACK} has no parameter 'min_height' (from --min-height)"
    # Only parameters that both have.
    assert load(ros2("my_node", target_frame="odom")).direction is None


def test_the_place_of_a_value_in_nested_names(load: Load) -> None:
    (setting,) = load(f"robot:\n  front:\n    {P2L}:\n      ros__parameters:\n        min_height: -0.5\n").settings
    assert setting.origin.endswith(f"params.yaml, line 5, robot.front.{P2L}.ros__parameters.min_height")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.one_of(yaml_like, st.text(), st.binary(max_size=60)))
def test_no_text_whatever_raises_anything_else(load: Load, text: str | bytes) -> None:
    with suppress(ParameterError):
        params_of(load(text if isinstance(text, bytes) else text.encode("utf-8", "replace")))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_are_read_to_the_bit(load: Load, value: float) -> None:
    (setting,) = load(ros2("/**", inf_epsilon=value)).settings
    assert repr(setting.value) == repr(value)
