"""The table of parameters, and which setting of one wins."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import asdict, fields
from functools import partial
from typing import Any

import pytest

from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.errors import ParameterError
from pc2scan.options.table import PARAMETERS
from pc2scan.pipeline.param_assignment import parse_param
from pc2scan.pipeline.parameters import Setting, preset_settings, resolve
from pipeline.param_settings import Load, failure, ros2
from support import ROOT

# The table


def test_the_table_lists_every_parameter_of_the_projection_in_order() -> None:
    assert list(PARAMETERS) == [field.name for field in fields(ProjectionParams)]
    assert {name: p.default for name, p in PARAMETERS.items()} == asdict(ProjectionParams())


@pytest.mark.parametrize("name", PARAMETERS)
def test_each_parameter_says_what_the_help_needs(name: str) -> None:
    parameter = PARAMETERS[name]
    assert parameter.name == name
    words, whole = (
        ("target_frame", "geometry", "no_return", "reduce", "intensity_field", "angle_rounding"),
        ("beams", "kth", "min_points"),
    )
    kinds = {"use_inf": "bool", "queue_size": "int", **dict.fromkeys(words, "str"), **dict.fromkeys(whole, "int")}
    assert parameter.kind == kinds.get(name, "float")
    assert parameter.unit in {"", "m", "rad", "s"}
    assert parameter.help.endswith(".")
    assert 20 < len(parameter.help) < 150
    assert parameter.upstreams == (list(PARAMETERS).index(name) < 13)
    assert parameter.spelling == "--" + name.replace("_", "-")


def test_the_units_are_upstreams() -> None:
    units = {name: parameter.unit for name, parameter in PARAMETERS.items()}
    assert {name for name, unit in units.items() if unit == "rad"} == {
        "angle_min",
        "angle_max",
        "angle_increment",
    }
    assert {name for name, unit in units.items() if unit == "s"} == {
        "transform_tolerance",
        "scan_time",
        "time_increment",
    }
    assert all(units[name] == "m" for name in units if "range_" in name or "height" in name)


def test_the_help_of_min_height_warns_of_its_default() -> None:
    assert "rejects z <= 0" in PARAMETERS["min_height"].help


def test_the_reverse_node_has_three_parameters() -> None:
    reverse = {name for name, p in PARAMETERS.items() if p.is_shared}
    assert reverse == {"target_frame", "transform_tolerance", "queue_size"}


def test_a_name_like_nothing_gets_no_suggestion() -> None:
    err = failure(lambda: resolve([Setting("fps", 30, "--param fps:=30")]))
    assert str(err) == "unknown parameter 'fps' (from --param fps:=30)"


def test_a_topic_is_no_parameter_of_the_command_line() -> None:
    err = failure(lambda: resolve([parse_param("cloud_in:=/points")]))
    assert "unknown parameter 'cloud_in'" in str(err)
    assert err.hint == "topics are not parameters here; `topics` chooses them"


# Types


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("range_min", "abc", "range_min: expected a number, got 'abc' (from here)"),
        ("range_min", True, "range_min: expected a number, got true (from here)"),
        ("range_min", None, "range_min: expected a number, got nothing (from here)"),
        ("range_min", [1.0], "range_min: expected a number, got a list (from here)"),
        ("range_max", 10**400, "range_max: expected a number, got 1000"),
        ("range_max", "1" * 5000, "range_max: expected a number, got '1111"),
        ("use_inf", 1, "use_inf: expected true or false, got 1 (from here)"),
        ("use_inf", "true", "use_inf: expected true or false, got 'true' (from here)"),
        ("queue_size", 1.0, "queue_size: expected a whole number, got 1.0 (from here)"),
        ("queue_size", False, "queue_size: expected a whole number, got false (from here)"),
        ("concurrency_level", "x", "concurrency_level: expected a whole number, got 'x' (from here)"),
        ("target_frame", 1, "target_frame: expected text, got 1 (from here)"),
        ("target_frame", True, "target_frame: expected text, got true (from here)"),
        ("target_frame", None, "target_frame: expected text, got nothing (from here)"),
    ],
)
def test_a_wrong_type_is_said_in_plain_words(name: str, value: object, message: str) -> None:
    err = failure(lambda: resolve([Setting(name, value, "here")]))
    assert str(err).startswith(message)
    assert len(str(err)) < 160
    assert err.name == {"concurrency_level": "queue_size"}.get(name, name)


@pytest.mark.parametrize(
    ("name", "value", "hint"),
    [
        ("range_min", "1.5", "the quotes make it text; remove them"),
        ("target_frame", 1, "YAML reads it as a number or a truth value; put it in quotes"),
        ("range_min", "deg(180)", "write metres (0.5, 0.5m), centimetres (50cm) or millimetres (500mm)"),
        ("angle_min", "5m", "write radians (1.5708, pi/2) or degrees (90deg)"),
        ("scan_time", "1m", "write seconds (0.1, 0.1s) or milliseconds (100ms)"),
        ("range_min", "", None),
    ],
)
def test_the_hint_tells_how_to_write_it(name: str, value: object, hint: str | None) -> None:
    assert failure(lambda: resolve([Setting(name, value, "here")])).hint == hint


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("no_return:=nan", "nan"),
        ("no_return:=.inf", "inf"),
        ("no_return:='nan'", "nan"),
        ("no_return:=zero", "zero"),
        ("scan_time:=auto", "auto"),
        ("scan_time:=1", 1.0),
        ("time_increment:=-1e-4", -1e-4),
        ("beams:=720", 720),
    ],
)
def test_words_among_numbers(written: str, expected: object) -> None:
    params = resolve([parse_param(written)]).params
    assert getattr(params, written.partition(":=")[0]) == expected


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("scan_time:=never", "scan_time: expected a number or auto, got 'never' (from --param scan_time:=never)"),
        ("range_min:=auto", "range_min: expected a number, got 'auto' (from --param range_min:=auto)"),
        ("no_return:=1.5", "no_return: expected inf, range-max-plus, range-max-minus, nan, zero, got 1.5 (from"),
        ("geometry:=.inf", "geometry: expected upstream, centered, half-open, symmetric, got inf (from"),
        (
            "reduce:=best",
            "reduce: expected min, max, mean, median, kth, surface, got 'best' (from --param reduce:=best)",
        ),
        ("beams:=1.5", "beams: expected a whole number or auto, got 1.5 (from --param beams:=1.5)"),
    ],
)
def test_words_that_are_none_of_the_choices(written: str, message: str) -> None:
    assert str(failure(lambda: resolve([parse_param(written)]))).startswith(message)


def test_whole_numbers_become_floats() -> None:
    params = resolve([Setting("range_max", 30, "here"), Setting("queue_size", 2, "here")]).params
    assert isinstance(params.range_max, float)
    assert type(params.queue_size) is int


# Precedence


def test_the_first_setting_of_a_name_wins_and_its_origin_is_kept(load: Load) -> None:
    options = [Setting("range_min", 1.0, "--range-min")]
    given = [parse_param("range_min:=2"), parse_param("range_max:=20"), parse_param("range_max:=21")]
    file = load(ros2({"range_min": 3.0, "range_max": 30.0, "min_height": -3.0}))
    resolved = resolve([*options, *reversed(given), *file.settings])
    assert resolved.params == ProjectionParams(range_min=1, range_max=21, min_height=-3)
    assert resolved.origin["range_min"] == "--range-min"
    assert resolved.origin["range_max"] == "--param range_max:=21"
    assert resolved.origin["min_height"].endswith(
        "params.yaml, line 5, pointcloud_to_laserscan.ros__parameters.min_height"
    )
    assert resolved.origin["angle_min"] == "default"
    assert list(resolved.origin) == list(PARAMETERS)


@pytest.mark.parametrize(("one", "other"), [("beams", "angle_increment"), ("no_return", "use_inf")])
def test_of_two_that_say_the_same_the_stronger_one_wins(one: str, other: str) -> None:
    values: dict[str, Any] = {"beams": 720, "angle_increment": 0.1, "no_return": "nan", "use_inf": False}
    for strong, weak in ((one, other), (other, one)):
        winner, loser = Setting(strong, values[strong], "here"), Setting(weak, values[weak], "there", "file")
        resolved = resolve([winner, loser])
        assert resolved.params == ProjectionParams(**{strong: values[strong]})
        assert resolved.origin[strong] == "here"
        assert resolved.origin[weak] in {"default", "follows from here"}
        equals = (winner, loser._replace(source="option"))
        err = failure(partial(resolve, equals))
        assert str(err) == (
            f"{strong} and {weak} set the same thing in two ways; give one of them "
            f"({strong} from here; {weak} from there)"
        )


def test_an_increment_that_follows_says_from_what() -> None:
    resolved = resolve([Setting("beams", 720, "--beams")])
    assert resolved.origin["angle_increment"] == "follows from --beams"


@pytest.mark.parametrize("consumer", PRESETS)
def test_a_preset_is_the_weakest(consumer: str, load: Load) -> None:
    file = load(ros2({"use_inf": "true", "range_max": 4.0, "scan_time": 0.3333}))
    option = Setting("range_min", 0.5, "--range-min")
    resolved = resolve([option, *file.settings, *preset_settings(consumer)])
    geometry = {"gmapping": "half-open", "mrpt": "symmetric"}.get(consumer, "centered")
    assert resolved.params == ProjectionParams(geometry=geometry, range_min=0.5, range_max=4.0, scan_time=0.3333)
    assert resolved.origin["geometry"] == f"--preset {consumer}"
    assert resolved.origin["no_return"] == "default"
    assert resolve(preset_settings(consumer)).params == ProjectionParams.preset(consumer)


def test_a_preset_that_does_not_exist() -> None:
    err = failure(lambda: preset_settings("slamtoolbox"))
    assert str(err) == "there is no preset 'slamtoolbox'; did you mean slam_toolbox?"
    assert err.hint == "the presets are slam_toolbox, cartographer, gmapping, amcl, nav2, mrpt"


def test_a_setting_that_loses_is_checked_all_the_same() -> None:
    loser = Setting("range_min", "abc", "params.yaml")
    err = failure(lambda: resolve([Setting("range_min", 1.0, "--range-min"), loser]))
    assert "got 'abc' (from params.yaml)" in str(err)


def test_nothing_set_is_upstreams_defaults() -> None:
    resolved = resolve([])
    assert resolved.params == ProjectionParams()
    assert set(resolved.origin.values()) == {"default"}


# Values that cannot be


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"angle_increment": -0.1},
            "angle_increment is -0.1 rad, it must be positive (from --angle-increment)",
        ),
        ({"queue_size": -1}, "queue_size is -1, it must not be negative (from --queue-size)"),
        ({"angle_max": math.inf}, "angle_max is inf, it must be finite (from --angle-max)"),
        (
            {"angle_min": 1.0, "angle_max": 0.5},
            (
                "angle_min 1.0 rad is not below angle_max 0.5 rad "
                "(angle_min from --angle-min; angle_max from --angle-max)"
            ),
        ),
        (
            {"range_min": 5, "range_max": 1},
            ("range_min 5.0 m is above range_max 1.0 m (range_min from --range-min; range_max from --range-max)"),
        ),
        (
            {"max_height": -1.0},
            (
                "min_height 2.2250738585072014e-308 m is above max_height -1.0 m "
                "(min_height is the default; max_height from --max-height)"
            ),
        ),
    ],
)
def test_an_impossible_value_names_its_origin(given: dict[str, object], message: str) -> None:
    settings_given = [Setting(name, value, PARAMETERS[name].spelling) for name, value in given.items()]
    err = failure(lambda: resolve(settings_given))
    assert str(err) == message
    assert err.name in PARAMETERS
    assert isinstance(err.__cause__, ParameterError)


def test_too_many_beams_name_the_increment_or_what_else_was_set() -> None:
    fine = failure(lambda: resolve([Setting("angle_increment", 1e-9, "--angle-increment")]))
    assert str(fine).endswith("(from --angle-increment)")
    wide = failure(lambda: resolve([Setting("angle_max", 1e30, "--angle-max")]))
    assert wide.name == "angle_max"
    assert str(wide).endswith("(from --angle-max)")


@pytest.mark.parametrize(
    ("settings", "refused"),
    [
        ({"angle_min": -180.0, "angle_max": 180.0}, True),
        ({"angle_max": 360}, True),
        ({"angle_min": 40, "angle_max": 45}, True),
        ({"angle_min": -5, "angle_max": 5, "geometry": "centered"}, True),
        ({"angle_min": -5, "angle_max": 5}, False),
        ({"angle_min": -3.15, "angle_max": 3.1416, "geometry": "centered"}, False),
        ({"angle_min": 0, "angle_max": 6.2832}, False),
        ({"angle_min": 1, "angle_max": 1 + 2 * math.pi}, False),
    ],
)
def test_degrees_are_refused(settings: dict[str, float | str], *, refused: bool) -> None:
    given = [Setting(name, value, f"--{name}") for name, value in settings.items()]
    if refused:
        err = failure(lambda: resolve(given))
        assert err.hint is not None
        assert "for degrees write `" in err.hint
    else:
        resolve(given)


def test_importing_the_modules_does_not_import_yaml() -> None:
    code = (
        "import sys, pc2scan.pipeline.param_assignment, pc2scan.pipeline.params_file; "
        "sys.exit('ruamel.yaml' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT / "src")
