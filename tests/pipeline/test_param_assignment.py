"""``name:=value``."""

from __future__ import annotations

import math
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.errors import ParameterError, visible
from pc2scan.pipeline.param_assignment import parse_param
from pc2scan.pipeline.parameters import resolve
from pipeline.param_settings import failure, yaml_like

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
        ("range_max: =5", "", None),
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
def test_param_is_read_as_ros_reads_it(text: str, name: str, value: object) -> None:
    if not name:
        assert "has no ':='" in str(failure(lambda: parse_param(text)))
        return
    setting = parse_param(text)
    assert (setting.name, setting.value) == (name, value)
    assert type(setting.value) is type(value)
    assert setting.origin == f"--param {text}"


def test_not_a_number_is_read_and_refused_by_the_projection() -> None:
    err = failure(lambda: resolve([parse_param("range_min:=.nan")]))
    assert str(err) == "range_min is NaN (from --param range_min:=.nan)"
    assert err.name == "range_min"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("range_min", "`param` 'range_min' has no ':='"),
        ("range_min=5", "`param` 'range_min=5' has no ':='"),
        ("", "`param` '' has no ':='"),
        (":=5", "`param` ':=5' has no name before ':='"),
        (" :=5", "`param` ' :=5' has no name before ':='"),
        ("node::=5", "`param` 'node::=5' has no name before ':='"),
        ("range_min:=[1, 2]", "range_min: expected a number, got a list (from --param range_min:=[1, 2])"),
        ("use_inf:={a: 1}", "use_inf: expected true or false, got a mapping (from --param use_inf:={a: 1})"),
        ("other:=[1]", "other: expected a value, got a list (from --param other:=[1])"),
        (
            "target_frame:=!!python/name:os.system",
            (
                "target_frame: the YAML tag !!python/name:os.system is not supported "
                "(from --param target_frame:=!!python/name:os.system)"
            ),
        ),
    ],
)
def test_what_is_no_assignment_of_a_scalar_is_refused(text: str, message: str) -> None:
    assert str(failure(lambda: parse_param(text))) == message


@pytest.mark.parametrize("value", ["'", '"a', "*alias", "@a", "[1", "a: b: c", "\x07"])
def test_a_value_that_is_no_yaml_is_refused_with_its_origin(value: str) -> None:
    err = failure(lambda: parse_param(f"target_frame:={value}"))
    assert f"--param target_frame:={visible(value)}, line 1, column " in str(err)
    assert "not valid YAML" in str(err)
    assert err.name == "target_frame"


@given(text=st.one_of(yaml_like, st.text()))
def test_no_param_whatever_raises_anything_else(text: str) -> None:
    with suppress(ParameterError):
        resolve([parse_param(f"range_min:={text}")])
