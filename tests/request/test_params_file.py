"""Parameter files of ROS 2 and ROS 1: read and refused; the transcripts have what is said of wrong ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import ParameterError
from pc2scan.request.params_file import ParamsFile, load_params_file
from pc2scan.request.precedence import resolve
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable

    Load = Callable[..., ParamsFile]

TABLES = Path(__file__).parent


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Write a file and load it."""

    def write_and_load(text: str, node: str | None = None) -> ParamsFile:
        path = tmp_path / "params.yaml"
        path.write_text(text)
        return load_params_file(path, node=node)

    return write_and_load


@pytest.mark.parametrize(("text", "node", "values"), rows(TABLES / "params_files.txt", "files", text=True))
def test_a_file_has_the_parameters_of_its_node(load: Load, text: str, node: str, values: dict[str, Any]) -> None:
    file = load(text)
    assert (file.node, file.options.given) == (node, values)
    assert file.reverse is not True
    assert {name: type(value) for name, value in file.options.given.items()} == {
        name: type(value) for name, value in values.items()
    }
    assert resolve([file.options])[0] == ProjectionParams(**values)


@pytest.mark.parametrize(("text", "chosen", "node"), rows(TABLES / "params_files.txt", "chosen", text=True))
def test_one_of_several_nodes_can_be_chosen(load: Load, text: str, chosen: str, node: str) -> None:
    file = load(text, chosen)
    assert (file.node, resolve([file.options])[0].min_height) == (node, -2)


@pytest.mark.parametrize(("text", "ignored"), rows(TABLES / "params_files.txt", "ignored", text=True))
def test_what_is_left_aside_is_told(load: Load, text: str, ignored: list[str]) -> None:
    assert [origin.replace(".", " ").split()[-1] for origin in load(text).ignored] == ignored


@pytest.mark.parametrize(("written", "value"), rows(TABLES / "values.txt", "angles of ROS 1", text=True))
def test_angles_of_ros1_to_the_last_bit(load: Load, written: str, value: float) -> None:
    assert load(f"angle_max: {written}").options.given["angle_max"] == value


@pytest.mark.parametrize("line", ["a{0}: &a{0} {{p: *a{1}, q: *a{1}}}", "a{0}: &a{0} [*a{1}, *a{1}]"])
def test_aliases_do_not_multiply(load: Load, line: str) -> None:
    lines = "\n".join(line.format(number, number - 1) for number in range(40)).replace("*a-1", "x")
    with pytest.raises(ParameterError, match="its aliases multiply"):
        load(f"{lines}\nrange_min: *a39")


def test_the_way_back_has_parameters_of_its_own(load: Load) -> None:
    file = load("/ns/laserscan_to_pointcloud: {ros__parameters: {target_frame: odom, queue_size: 4}}")
    assert file.reverse
    assert resolve([file.options])[0] == ProjectionParams(target_frame="odom", queue_size=4)
