"""Parameters of the projection: how they are written, and which setting of one wins."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import pc2scan
from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.errors import ParameterError, UsageError
from pc2scan.options.moment import TimeBound
from pc2scan.options.table import PARAMETERS
from pc2scan.request.param_sources import resolve_sources
from pc2scan.request.parameters import Setting, preset_settings, resolve
from pc2scan.request.yaml_nodes import parse_param
from request.param_settings import failure, yaml_like
from support import ROOT
from support.tables import rows

VALUES = Path(__file__).parent / "values.txt"


# name:=value


@pytest.mark.parametrize(("text", "name", "value"), rows(VALUES, "assignments", text=True))
def test_an_assignment_is_read_as_ros_reads_it(text: str, name: str, value: object) -> None:
    setting = parse_param(text)
    assert (setting.name, setting.value, setting.origin) == (name, value, f"--param {text}")
    assert type(setting.value) is type(value)


@given(text=st.one_of(yaml_like, st.text()))
def test_no_assignment_whatever_raises_anything_else(text: str) -> None:
    with suppress(ParameterError):
        resolve([parse_param(f"range_min:={text}")])


@pytest.mark.parametrize(("written", "expected"), rows(VALUES, "values", text=True))
def test_values_have_the_type_of_their_parameter(written: str, expected: object) -> None:
    found = getattr(
        resolve([parse_param(written)]).params, written.partition(":=")[0].replace("concurrency_level", "queue_size")
    )
    assert (found, type(found)) == (expected, type(expected))


METRES = "write metres (0.5, 0.5m), centimetres (50cm) or millimetres (500mm)"


@pytest.mark.parametrize(
    ("name", "value", "message", "hint"),
    [
        ("range_min", "deg(180)", "", METRES),
        ("range_min", "", "", None),
        ("range_min", [1.0], "range_min: expected a number, got a list (from here)", None),
        ("range_max", 10**400, "range_max: expected a number, got 1000", None),
        ("range_max", "1" * 5000, "range_max: expected a number, got '1111", METRES),
        ("cloud_in", "/points", "unknown parameter", "topics are not parameters here; `topics` chooses them"),
        ("min_heigth", 1, "did you mean 'min_height'?", f"the parameters are {', '.join(PARAMETERS)}"),
    ],
)
def test_a_wrong_value_is_explained(name: str, value: object, message: str, hint: str | None) -> None:
    err = failure(resolve, [Setting(name, value, "here")])
    assert message in str(err)
    assert len(str(err)) < 160
    assert (err.name, err.hint) == (name, hint)


@pytest.mark.parametrize(
    "settings",
    [
        {"angle_min": -5, "angle_max": 5},
        {"angle_min": -3.15, "angle_max": 3.1416, "geometry": "centered"},
        {"angle_min": 0, "angle_max": 6.2832},
        {"angle_min": 1, "angle_max": 1 + 2 * math.pi},
    ],
)
def test_a_full_turn_is_not_in_degrees(settings: dict[str, float | str]) -> None:
    resolve([Setting(name, value, f"--{name}") for name, value in settings.items()])


# Which setting wins


@pytest.mark.parametrize(("one", "other"), [("beams", "angle_increment"), ("no_return", "use_inf")])
def test_of_two_that_say_the_same_the_stronger_wins(one: str, other: str) -> None:
    values: dict[str, Any] = {"beams": 720, "angle_increment": 0.1, "no_return": "nan", "use_inf": False}
    for strong, weak in ((one, other), (other, one)):
        winner, loser = Setting(strong, values[strong], "here"), Setting(weak, values[weak], "there", "file")
        resolved = resolve([winner, loser])
        assert resolved.params == ProjectionParams(**{strong: values[strong]})
        assert resolved.origin[strong] == "here"
        assert resolved.origin[weak] == ("follows from here" if strong == "beams" else "default")
        err = failure(resolve, (winner, loser._replace(source="option")))
        assert str(err) == (
            f"{strong} and {weak} set the same thing in two ways; give one of them "
            f"({strong} from here; {weak} from there)"
        )


@pytest.mark.parametrize("consumer", PRESETS)
def test_a_preset_has_the_parameters_of_its_consumer(consumer: str) -> None:
    resolved = resolve([Setting("range_min", 0.5, "here"), *preset_settings(consumer)])
    assert (resolved.origin["geometry"], resolved.origin["min_height"]) == (f"--preset {consumer}", "default")
    geometry = {"gmapping": "half-open", "mrpt": "symmetric"}.get(consumer, "centered")
    assert (resolved.params.geometry, resolved.params.range_min) == (geometry, 0.5)
    assert resolve(preset_settings(consumer)).params == ProjectionParams.preset(consumer)


def test_what_loses_is_checked_all_the_same() -> None:
    err = failure(resolve, [Setting("range_min", 1.0, "--range-min"), Setting("range_min", "abc", "params.yaml")])
    assert "got 'abc' (from params.yaml)" in str(err)
    err = failure(preset_settings, "slamtoolbox")
    assert str(err) == "there is no preset 'slamtoolbox'; did you mean slam_toolbox?"
    assert err.hint == "the presets are slam_toolbox, cartographer, gmapping, amcl, nav2, mrpt"


FORWARD = (
    "pointcloud_to_laserscan:\n  ros__parameters:\n    range_min: 1.0\n    range_max: 20.0\n    cloud_in: /points\n"
)


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
    origins = ("--range-min", "--param range_max:=40.0", "--preset slam_toolbox", "default")
    assert tuple(everything.origin[name] for name in ("range_min", "range_max", "geometry", "min_height")) == origins
    assert list(everything.origin) == list(PARAMETERS)
    without = resolve_sources([], file=file)
    assert (without.params.range_min, without.params.range_max) == (1.0, 20.0)
    assert without.origin["range_max"].startswith(f"{file}, line 4")
    # What is no parameter is returned.
    (ignored,) = without.ignored
    assert "cloud_in" in ignored
    nothing = resolve_sources([])
    assert (nothing.ignored, nothing.params, set(nothing.origin.values())) == ((), ProjectionParams(), {"default"})


def test_the_section_of_a_file_decides_the_direction(file: Path) -> None:
    assert not resolve_sources([], file=file).reverse
    with pytest.raises(UsageError, match="is for pointcloud_to_laserscan"):
        resolve_sources([], file=file, reverse=True)
    file.write_text("laserscan_to_pointcloud:\n  ros__parameters:\n    target_frame: base\n", "utf-8")
    back = resolve_sources([], file=file)
    assert (back.reverse, back.params.target_frame) == (True, "base")
    with pytest.raises(ParameterError, match="has no parameter 'range_min'"):
        resolve_sources([Setting("range_min", 1.0, "--range-min")], file=file)


# Other options


@pytest.mark.parametrize(("text", "time_ns", "absolute"), rows(VALUES, "times", text=True))
def test_times_are_seconds_after_the_beginning_or_of_a_clock(text: str, time_ns: int, absolute: bool) -> None:
    assert TimeBound.parse(text) == TimeBound(time_ns, absolute=absolute)
    assert TimeBound.parse(text).resolve(1000) == time_ns + (0 if absolute else 1000)


@pytest.mark.parametrize("options", [{"jobs": -1}, {"only_scans": True, "keep_clouds": True}])
def test_contradictions_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=next(iter(options))):
        pc2scan.convert(ROOT / "fixtures" / "hall.bag", **options)
