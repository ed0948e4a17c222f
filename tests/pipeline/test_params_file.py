"""Parameter files of ROS 2 and ROS 1: read, refused, written."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import ParameterError
from pc2scan.options.table import PARAMETERS
from pc2scan.pipeline.parameters import Setting, resolve
from pc2scan.pipeline.params_file import ParamsFile, load_params_file
from pipeline.param_settings import failure, params_of, yaml_like
from support import GOLDEN, sampled
from support.params_files import render_params_file
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.pipeline.parameters import Direction

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


@pytest.mark.parametrize("case", sampled(sorted(path.name for path in GOLDEN.iterdir() if path.is_dir()), 5))
def test_the_golden_files_load(case: str) -> None:
    file = load_params_file(GOLDEN / case / "params.yaml")
    assert file.direction == ("laserscan_to_pointcloud" if case.startswith("scan_") else P2L)
    assert not file.ignored
    origin = resolve(file.settings, direction=file.direction).origin
    text = (GOLDEN / case / "params.yaml").read_text()
    assert {name for name, source in origin.items() if source != "default"} == {
        name for name in PARAMETERS if f" {name}:" in text
    }


def test_a_golden_file_gives_the_values_in_it() -> None:
    assert params_of(load_params_file(GOLDEN / "launch_sample" / "params.yaml")) == ProjectionParams(
        transform_tolerance=0.01, min_height=0.0, max_height=1.0, angle_min=-1.5708, angle_max=1.5708,
        angle_increment=0.0087, scan_time=0.3333, range_min=0.45, range_max=4.0, use_inf=True, inf_epsilon=1.0,
    )  # fmt: skip
    extreme = params_of(load_params_file(GOLDEN / "nan_and_inf_points" / "params.yaml"))
    assert extreme == ProjectionParams(min_height=-2.0, max_height=2.0, range_max=1e300)


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
        "several have only their parameters; found /front, /rear",
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


# Writing


finite = st.floats(allow_nan=False, allow_infinity=False)
pairs = st.tuples(st.floats(allow_nan=False), st.floats(allow_nan=False)).map(sorted)


@st.composite
def any_params(draw: st.DrawFn) -> ProjectionParams:
    (min_height, max_height), (range_min, range_max) = draw(pairs), draw(pairs)
    angle_min = draw(st.floats(-3, 6.1))
    return ProjectionParams(
        target_frame=draw(st.text()),
        transform_tolerance=draw(st.floats(0)),
        min_height=min_height,
        max_height=max_height,
        angle_min=angle_min,
        angle_max=draw(st.floats(angle_min + 0.1, min(angle_min + 6.28, 6.28))),
        angle_increment=draw(st.floats(1e-4, 1e-1)),
        scan_time=draw(st.floats(0)),
        range_min=range_min,
        range_max=range_max,
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
def test_a_rendered_file_reads_back_to_the_bit(load: Load, params: ProjectionParams) -> None:
    file = load(render_params_file(params))
    assert file.direction == P2L
    assert asdict(params_of(file)) == asdict(params)


FRAMES = ["1", "true", "null", "", "a: b", "# a", 'say "hi" \\', "a\tb\nc", "日本", "\u2028\x85"]


@pytest.mark.parametrize("params", [ProjectionParams(), *(ProjectionParams(target_frame=frame) for frame in FRAMES)])
def test_defaults_and_frames_of_every_kind_read_back(load: Load, params: ProjectionParams) -> None:
    assert params_of(load(render_params_file(params))) == params


def test_what_a_rendered_file_looks_like(load: Load) -> None:
    params = ProjectionParams(target_frame="base_link", range_max=math.inf, max_height=1e300, use_inf=False)
    lines = render_params_file(params).splitlines()
    assert lines[:3] == [f"{P2L}:", "  ros__parameters:", '    target_frame: "base_link"']
    assert {"    range_max: .inf  # m", "    max_height: 1.0e+300  # m", "    use_inf: false"} < set(lines)
    assert not any("queue_size" in line or "geometry" in line for line in lines)
    assert "    queue_size: 3" in render_params_file(ProjectionParams(queue_size=3)).splitlines()
    # What follows from other parameters is not said again.
    params = ProjectionParams(beams=720, no_return="nan", use_inf=False, scan_time="auto", reduce="kth", kth=3)
    text = render_params_file(params)
    assert "beams" not in text
    assert "use_inf" not in text
    assert params_of(load(text)) == replace(params, beams=0, use_inf=True)


def test_a_rendered_file_of_the_way_back(load: Load) -> None:
    params = ProjectionParams(target_frame="odom", transform_tolerance=0.5, queue_size=7)
    file = load(render_params_file(params, direction=BACK))
    assert (file.direction, params_of(file)) == (BACK, params)
