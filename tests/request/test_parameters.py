"""Parameters of the projection: how they are written, and which setting of one wins."""

from __future__ import annotations

from pathlib import Path

import pytest

from pc2scan.core.params import ProjectionParams
from pc2scan.options.moment import TimeBound
from pc2scan.request.param_sources import parse_param, resolve_sources
from pc2scan.request.parameters import Setting, resolve
from support.tables import rows

VALUES = Path(__file__).parent / "values.txt"


@pytest.mark.parametrize(("text", "name", "value"), rows(VALUES, "assignments", text=True))
def test_an_assignment_is_read_as_ros_reads_it(text: str, name: str, value: object) -> None:
    setting = parse_param(text)
    assert (setting.name, setting.value, setting.origin) == (name, value, f"--param {text}")
    assert type(setting.value) is type(value)


@pytest.mark.parametrize(("written", "expected"), rows(VALUES, "values", text=True))
def test_values_have_the_type_of_their_parameter(written: str, expected: object) -> None:
    name = written.partition(":=")[0].replace("concurrency_level", "queue_size")
    found = getattr(resolve([parse_param(written)]).params, name)
    assert (found, type(found)) == (expected, type(expected))


def test_the_stronger_of_two_that_say_the_same_wins() -> None:
    resolved = resolve([Setting("beams", 720, "here"), Setting("angle_increment", 0.1, "there", "file")])
    assert resolved.params == ProjectionParams(beams=720)
    assert resolved.origin["angle_increment"] == "follows from here"


def test_the_stronger_place_wins(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("pointcloud_to_laserscan:\n  ros__parameters:\n    range_min: 1.0\n    min_height: -1.0\n")
    resolved = resolve_sources(
        [Setting("range_min", 4.0, "--range-min")],
        assignments=["range_min:=2.0", "range_max:=30.0", "range_max:=40.0"],
        file=file,
        preset="slam_toolbox",
    )
    assert (resolved.params.range_min, resolved.params.range_max, resolved.params.min_height) == (4.0, 40.0, -1.0)
    names = ("range_min", "range_max", "geometry", "max_height")
    origins = ("--range-min", "--param range_max:=40.0", "--preset slam_toolbox", "default")
    assert tuple(resolved.origin[name] for name in names) == origins
    assert resolved.origin["min_height"].startswith(f"{file}, line 4")


@pytest.mark.parametrize(("text", "time_ns", "absolute"), rows(VALUES, "times", text=True))
def test_times_are_seconds_after_the_beginning_or_of_a_clock(text: str, time_ns: int, absolute: bool) -> None:
    assert TimeBound.parse(text) == TimeBound(time_ns, absolute=absolute)
