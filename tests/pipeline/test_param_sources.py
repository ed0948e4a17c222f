from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.errors import ParameterError, UsageError
from pc2scan.pipeline.param_sources import resolve_sources
from pc2scan.pipeline.parameters import Setting

if TYPE_CHECKING:
    from pathlib import Path

FORWARD = (
    "pointcloud_to_laserscan:\n  ros__parameters:\n    range_min: 1.0\n    range_max: 20.0\n    cloud_in: /points\n"
)
BACK = "laserscan_to_pointcloud:\n  ros__parameters:\n    target_frame: base\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "params.yaml"
    path.write_text(FORWARD, "utf-8")
    return path


def test_the_stronger_place_wins(file: Path) -> None:
    everything = resolve_sources(
        [Setting("range_min", 4.0, "--range-min")],
        assignments=["range_min:=2.0", "range_max:=30.0", "range_max:=40.0"],
        file=file,
        preset="slam_toolbox",
    )
    assert (everything.params.range_min, everything.params.range_max) == (4.0, 40.0)
    assert everything.params.geometry == "centered"
    assert everything.origin["range_min"] == "--range-min"
    assert everything.origin["range_max"] == "--param range_max:=40.0"
    assert everything.origin["geometry"] == "--preset slam_toolbox"
    assert everything.origin["angle_min"] != "--range-min"
    without = resolve_sources([], file=file)
    assert (without.params.range_min, without.params.range_max) == (1.0, 20.0)
    assert without.origin["range_max"].startswith(f"{file}, line 4")


def test_what_is_no_parameter_is_returned(file: Path) -> None:
    (ignored,) = resolve_sources([], file=file).ignored
    assert "cloud_in" in ignored
    assert not resolve_sources([]).ignored


def test_the_section_of_a_file_decides_the_direction(file: Path) -> None:
    assert not resolve_sources([], file=file).reverse
    with pytest.raises(UsageError, match="is for pointcloud_to_laserscan"):
        resolve_sources([], file=file, reverse=True)
    file.write_text(BACK, "utf-8")
    back = resolve_sources([], file=file)
    assert back.reverse
    assert back.params.target_frame == "base"
    with pytest.raises(ParameterError, match="has no parameter 'range_min'"):
        resolve_sources([Setting("range_min", 1.0, "--range-min")], file=file)


def test_advice_is_spelled_as_the_user_did(file: Path) -> None:
    # A parameter that is measured in metres but infinite: float32 makes it so.
    needed = [Setting("no_return", "range-max-plus", "--no-return")]

    def hint(*settings: Setting, assignments: tuple[str, ...] = (), given: Path | None = None) -> str | None:
        with pytest.raises(ParameterError) as caught:
            resolve_sources([*needed, *settings], assignments=assignments, file=given)
        return caught.value.hint

    assert hint() == "say how far the sensor sees: `range_max=100.0`"
    assert hint(Setting("range_max", 1e300, "--range-max")) == "say how far the sensor sees: `range_max=100.0`"
    assert hint(assignments=("range_max:=1e300",)) == "say how far the sensor sees: --param range_max:=100.0"
    file.write_text(FORWARD.replace("20.0", "1e300"), "utf-8")
    place = f"{file}, line 4, pointcloud_to_laserscan.ros__parameters.range_max"
    assert hint(given=file) == f"say how far the sensor sees: range_max: 100.0 ({place})"
