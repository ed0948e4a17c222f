"""Parameters of the projection: how they are written, and which value of one wins."""

from __future__ import annotations

from pathlib import Path

import pytest

from pc2scan.core.params import ProjectionParams
from pc2scan.options.call import Options
from pc2scan.options.moment import TimeBound
from pc2scan.request.precedence import resolve
from pc2scan.request.scans_file import parse_params, read_output
from support.tables import rows

VALUES = Path(__file__).parent / "values.txt"


@pytest.mark.parametrize(("text", "name", "value"), rows(VALUES, "assignments", text=True))
def test_an_assignment_is_read_as_ros_reads_it(text: str, name: str, value: object) -> None:
    given = parse_params([text])
    assert (given.given, given.origins) == ({name: value}, {name: f"--param {text}"})
    assert type(given.given[name]) is type(value)


@pytest.mark.parametrize(("written", "expected"), rows(VALUES, "values", text=True))
def test_values_have_the_type_of_their_parameter(written: str, expected: object) -> None:
    name = written.partition(":=")[0].replace("concurrency_level", "queue_size")
    found = getattr(resolve([parse_params([written])])[0], name)
    assert (found, type(found)) == (expected, type(expected))


def test_the_stronger_of_two_that_say_the_same_wins() -> None:
    here, there = Options("convert", {"beams": 720}, {"beams": "here"}), Options("convert", {"angle_increment": 0.1})
    params, origins = resolve([here, there])
    assert params == ProjectionParams(beams=720)
    assert origins["angle_increment"] == "follows from here"


def test_the_stronger_place_wins(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("pointcloud_to_laserscan:\n  ros__parameters:\n    range_min: 1.0\n    min_height: -1.0\n")
    assigned = parse_params(["range_min:=2.0", "range_max:=30.0", "range_max:=40.0"])
    values = {"range_min": 4.0, "params_file": file, "preset": "slam_toolbox"}
    call = Options("convert", values, {"range_min": "--range-min"})
    (spec,) = read_output(call, [call, assigned]).specs
    assert (spec.params.range_min, spec.params.range_max, spec.params.min_height) == (4.0, 40.0, -1.0)
    names = ("range_min", "range_max", "geometry", "max_height")
    origins = ("--range-min", "--param range_max:=40.0", "--preset slam_toolbox", "default")
    assert tuple(spec.origins[name] for name in names) == origins
    assert spec.origins["min_height"].startswith(f"{file}, line 4")


@pytest.mark.parametrize(("text", "time_ns", "absolute"), rows(VALUES, "times", text=True))
def test_times_are_seconds_after_the_beginning_or_of_a_clock(text: str, time_ns: int, absolute: bool) -> None:
    assert TimeBound.parse(text) == TimeBound(time_ns, absolute=absolute)
