"""Parameters of the projection: how they are written, and which setting of one wins."""

from __future__ import annotations

import math
import subprocess
import sys
from contextlib import suppress
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.errors import ParameterError, UsageError, visible
from pc2scan.pipeline.options import ConvertOptions, TimeBound
from pc2scan.pipeline.param_assignment import parse_param
from pc2scan.pipeline.param_sources import resolve_sources
from pc2scan.pipeline.parameters import PARAMETERS, Setting, preset_settings, resolve
from pc2scan.pipeline.scan_spec import TopicRequest
from pipeline.param_settings import failure, yaml_like
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path


def test_the_table_has_every_parameter_in_order() -> None:
    assert list(PARAMETERS) == [field.name for field in fields(ProjectionParams)]
    assert {name: p.default for name, p in PARAMETERS.items()} == asdict(ProjectionParams())
    for number, (name, parameter) in enumerate(PARAMETERS.items()):
        assert (parameter.name, parameter.option) == (name, "--" + name.replace("_", "-"))
        assert parameter.upstreams == (number < 13)
        assert parameter.help.endswith(".")
        assert 20 < len(parameter.help) < 150
    assert "rejects z <= 0" in PARAMETERS["min_height"].help
    reverse = {name for name, p in PARAMETERS.items() if "laserscan_to_pointcloud" in p.directions}
    assert reverse == {"target_frame", "transform_tolerance", "queue_size"}
    units = {name: parameter.unit for name, parameter in PARAMETERS.items()}
    assert {name for name in units if units[name] == "rad"} == {"angle_min", "angle_max", "angle_increment"}
    assert {name for name in units if units[name] == "s"} == {"transform_tolerance", "scan_time", "time_increment"}
    assert all(units[name] == "m" for name in units if "range_" in name or "height" in name)
    assert set(units.values()) == {"", "m", "rad", "s"}


# name:=value


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("range_max:=30", "range_max", 30),
        ("range_max:=30.0", "range_max", 30.0),
        ("range_max:=1e5", "range_max", 1e5),
        ("range_max:=1e+300", "range_max", 1e300),
        ("range_max:=.5", "range_max", 0.5),
        ("range_max:=5.", "range_max", 5.0),
        ("range_max:=+5", "range_max", 5),
        ("range_max:=.inf", "range_max", math.inf),
        ("range_max:=inf", "range_max", math.inf),
        ("min_height:=-.Inf", "min_height", -math.inf),
        ("min_height:=-0.5", "min_height", -0.5),
        ("range_max:= 5 ", "range_max", 5),
        ("queue_size:=0x10", "queue_size", 16),
        ("queue_size:=010", "queue_size", 8),
        ("queue_size:=08", "queue_size", 8.0),
        ("use_inf:=true", "use_inf", True),
        ("use_inf:=False", "use_inf", False),
        ("use_inf:=no", "use_inf", False),
        ("use_inf:='no'", "use_inf", "no"),
        ('target_frame:="base_link"', "target_frame", "base_link"),
        ("target_frame:=base_link", "target_frame", "base_link"),
        ("target_frame:='1'", "target_frame", "1"),
        ("target_frame:=1", "target_frame", 1),
        ("target_frame:=2024-01-01", "target_frame", "2024-01-01"),
        ("target_frame:=", "target_frame", ""),
        ("target_frame:=''", "target_frame", ""),
        ("target_frame:=~", "target_frame", None),
        ("target_frame:=# nothing", "target_frame", None),
        ("target_frame:=a:=b", "target_frame", "a:=b"),
        ("angle_min:=rad(-pi/2)", "angle_min", -math.pi / 2),
        ("angle_max:=deg(90)", "angle_max", math.pi / 2),
        ("angle_max:='deg(90)'", "angle_max", "deg(90)"),
        ("angle_max:=rad(__import__('os'))", "angle_max", "rad(__import__('os'))"),
        ("_range_min:=1.5", "range_min", 1.5),
        ("~range_min:=1.5", "range_min", 1.5),
        ("pointcloud_to_laserscan:range_min:=1.5", "range_min", 1.5),
        ("/ns/front:range_min:=1.5", "range_min", 1.5),
    ],
)
def test_an_assignment_is_read_as_ros_reads_it(text: str, name: str, value: object) -> None:
    setting = parse_param(text)
    assert (setting.name, setting.value, setting.origin) == (name, value, f"--param {text}")
    assert type(setting.value) is type(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("range_min", "`param` 'range_min' has no ':='"),
        ("range_min=5", "`param` 'range_min=5' has no ':='"),
        ("range_max: =5", "`param` 'range_max: =5' has no ':='"),
        ("", "`param` '' has no ':='"),
        (":=5", "`param` ':=5' has no name before ':='"),
        (" :=5", "`param` ' :=5' has no name before ':='"),
        ("node::=5", "`param` 'node::=5' has no name before ':='"),
        ("range_min:=[1, 2]", "range_min: expected a number, got a list ({from})"),
        ("use_inf:={a: 1}", "use_inf: expected true or false, got a mapping ({from})"),
        ("other:=[1]", "other: expected a value, got a list ({from})"),
        ("target_frame:=!!python/name:os", "target_frame: the YAML tag !!python/name:os is not supported ({from})"),
        ("range_min:=.nan", "range_min is NaN ({from})"),
        ("cloud_in:=/points", "unknown parameter 'cloud_in' ({from})"),
        ("useinf:=1", "unknown parameter 'useinf' ({from}); did you mean 'use_inf'?"),
        ("fps:=30", "unknown parameter 'fps' ({from})"),
        ("scan_time:=never", "scan_time: expected a number or auto, got 'never' ({from})"),
        ("range_min:=auto", "range_min: expected a number, got 'auto' ({from})"),
        ("no_return:=1.5", "no_return: expected inf, range-max-plus, range-max-minus, nan, zero, got 1.5 ({from})"),
        ("geometry:=.inf", "geometry: expected upstream, centered, half-open, symmetric, got inf ({from})"),
        ("reduce:=best", "reduce: expected min, max, mean, median, kth, surface, got 'best' ({from})"),
        ("beams:=1.5", "beams: expected a whole number or auto, got 1.5 ({from})"),
        ("use_inf:=1", "use_inf: expected true or false, got 1 ({from})"),
        ("use_inf:='true'", "use_inf: expected true or false, got 'true' ({from})"),
        ("queue_size:=1.0", "queue_size: expected a whole number, got 1.0 ({from})"),
        ("queue_size:=false", "queue_size: expected a whole number, got false ({from})"),
        ("concurrency_level:=x", "concurrency_level: expected a whole number, got 'x' ({from})"),
        ("target_frame:=true", "target_frame: expected text, got true ({from})"),
        ("target_frame:=~", "target_frame: expected text, got nothing ({from})"),
        ("range_min:=true", "range_min: expected a number, got true ({from})"),
    ],
)
def test_a_wrong_assignment_is_refused(text: str, message: str) -> None:
    err = failure(lambda: resolve([parse_param(text)]))
    assert str(err) == message.replace("{from}", f"from --param {text}")


@pytest.mark.parametrize("value", ["'", '"a', "*alias", "@a", "[1", "a: b: c", "\x07"])
def test_a_value_that_is_no_yaml_is_refused(value: str) -> None:
    err = failure(parse_param, f"target_frame:={value}")
    assert f"--param target_frame:={visible(value)}, line 1, column " in str(err)
    assert "not valid YAML" in str(err)
    assert err.name == "target_frame"


@given(text=st.one_of(yaml_like, st.text()))
def test_no_assignment_whatever_raises_anything_else(text: str) -> None:
    with suppress(ParameterError):
        resolve([parse_param(f"range_min:={text}")])


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
        ("range_max:=30", 30.0),
        ("concurrency_level:=3", 3),
    ],
)
def test_values_have_the_type_of_their_parameter(written: str, expected: object) -> None:
    found = getattr(
        resolve([parse_param(written)]).params, written.partition(":=")[0].replace("concurrency_level", "queue_size")
    )
    assert (found, type(found)) == (expected, type(expected))


@pytest.mark.parametrize(
    ("name", "value", "message", "hint"),
    [
        ("range_min", "1.5", "expected a number, got '1.5' (from here)", "the quotes make it text; remove them"),
        ("range_min", "deg(180)", "", "write metres (0.5, 0.5m), centimetres (50cm) or millimetres (500mm)"),
        ("range_min", "", "", None),
        ("range_min", [1.0], "range_min: expected a number, got a list (from here)", None),
        ("range_max", 10**400, "range_max: expected a number, got 1000", None),
        ("range_max", "1" * 5000, "range_max: expected a number, got '1111", None),
        ("target_frame", 1, "expected text, got 1", "YAML reads it as a number or a truth value; put it in quotes"),
        ("angle_min", "5m", "", "write radians (1.5708, pi/2) or degrees (90deg)"),
        ("scan_time", "1m", "", "write seconds (0.1, 0.1s) or milliseconds (100ms)"),
        ("cloud_in", "/points", "unknown parameter", "topics are not parameters here; `topics` chooses them"),
        ("min_heigth", 1, "did you mean 'min_height'?", f"the parameters are {', '.join(PARAMETERS)}"),
        ("queue_size", -1, "queue_size is -1, it must not be negative (from here)", None),
        ("angle_increment", -0.1, "angle_increment is -0.1 rad, it must be positive (from here)", None),
        ("angle_max", math.inf, "angle_max is inf, it must be finite (from here)", None),
        (
            "max_height",
            -1.0,
            "2.2250738585072014e-308 m is above max_height -1.0 m (min_height is the default; max_height from here)",
            None,
        ),
        ("angle_increment", 1e-9, "(from here)", None),
        ("angle_max", 1e30, "(from here)", None),
    ],
)
def test_a_wrong_value_is_explained(name: str, value: object, message: str, hint: str | None) -> None:
    err = failure(resolve, [Setting(name, value, "here")])
    assert message in str(err)
    assert len(str(err)) < 165
    assert err.name in {name, "min_height"}
    assert hint is None or err.hint == hint


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"angle_min": 1.0, "angle_max": 0.5},
            "angle_min 1.0 rad is not below angle_max 0.5 rad (angle_min from --angle_min; angle_max from --angle_max)",
        ),
        (
            {"range_min": 5, "range_max": 1},
            "range_min 5.0 m is above range_max 1.0 m (range_min from --range_min; range_max from --range_max)",
        ),
    ],
)
def test_values_that_contradict_each_other(given: dict[str, object], message: str) -> None:
    err = failure(resolve, [Setting(name, value, f"--{name}") for name, value in given.items()])
    assert str(err) == message
    assert isinstance(err.__cause__, ParameterError)


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
        assert "for degrees write `" in str(failure(resolve, given).hint)
    else:
        resolve(given)


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


def test_advice_is_spelled_as_the_user_did(file: Path) -> None:
    # A range_max that float32 makes infinite.
    needed = Setting("no_return", "range-max-plus", "--no-return")
    file.write_text(FORWARD.replace("20.0", "1e300"), "utf-8")
    place = f"{file}, line 4, pointcloud_to_laserscan.ros__parameters.range_max"
    for own, elsewhere, written in (
        ([], {}, "`range_max=100.0`"),
        ([Setting("range_max", 1e300, "--range-max")], {}, "`range_max=100.0`"),
        ([], {"assignments": ("range_max:=1e300",)}, "--param range_max:=100.0"),
        ([], {"file": file}, f"range_max: 100.0 ({place})"),
    ):
        err = failure(resolve_sources, [needed, *own], **elsewhere)
        assert err.hint == f"say how far the sensor sees: {written}"


# Other options


@pytest.mark.parametrize(
    ("text", "time_ns", "absolute"),
    [
        ("0", 0, False),
        ("12.5", 12_500_000_000, False),
        (".25", 250_000_000, False),
        ("0.000000001", 1, False),
        ("@12.5", 12_500_000_000, True),
        # A float would lose the last digits of these.
        ("1604515190.231374463", 1604515190231374463, True),
        ("1604515190231374463", 1604515190231374463, True),
        ("@1604515190231374463", 1604515190231374463, True),
        ("2020-11-04T18:39:50.231374Z", 1604515190231374000, True),
        ("2020-11-04T19:39:50.231374463+01:00", 1604515190231374463, True),
        ("2020-11-04 19:39:50,25+0100", 1604515190250000000, True),
        ("2020-11-04 19:39:50+01:00", 1604515190000000000, True),
        ("2020-11-04T18:39:50", 1604515190000000000, True),
    ],
)
def test_times_are_seconds_after_the_beginning_or_of_a_clock(text: str, time_ns: int, absolute: bool) -> None:
    assert TimeBound.parse(text) == TimeBound(time_ns, absolute=absolute)
    assert TimeBound.parse(text).resolve(1000) == time_ns + (0 if absolute else 1000)


@pytest.mark.parametrize("text", ["", "x", "-1", "1e3", "nan", "@", "@x", "12:30"])
def test_what_is_not_a_time(text: str) -> None:
    with pytest.raises(UsageError, match="not a time"):
        TimeBound.parse(text)


def test_topics_may_be_renamed() -> None:
    assert TopicRequest.parse("/points") == TopicRequest("/points")
    assert TopicRequest.parse("/points:=/scan") == TopicRequest("/points", "/scan")
    for text in ("", ":=", "/points:=", ":=/scan"):
        with pytest.raises(UsageError, match="not a topic"):
            TopicRequest.parse(text)


@pytest.mark.parametrize("options", [{"on_error": "ignore"}, {"jobs": -1}, {"only_scans": True, "keep_clouds": True}])
def test_contradictions_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=next(iter(options))):
        ConvertOptions(**options)


def test_importing_the_modules_does_not_import_yaml() -> None:
    modules = "pc2scan.pipeline.param_assignment, pc2scan.pipeline.params_file"
    code = f"import sys, {modules}; sys.exit('ruamel.yaml' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT / "src")
