"""The table of options: one declaration each, and what the commands, the functions and the files take of it."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import TYPE_CHECKING

import pytest

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import UsageError
from pc2scan.options.call import Options
from pc2scan.options.moment import TimeBound
from pc2scan.options.table import GROUPS, PARAMETERS, instead_of, options_of, spelling_of
from pc2scan.options.values import Instance
from support.command import run

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.options.option import Option

#: The node's parameters and others that few people use; only ``--help-all`` has them.
RARE = (
    *("use_inf", "inf_epsilon", "queue_size"),
    "angle_rounding",
)


def all_options() -> Iterator[tuple[str, Option]]:
    for command in GROUPS:
        for option in options_of(command).values():
            yield command, option


def test_every_parameter_of_the_projection_is_an_option() -> None:
    assert list(PARAMETERS) == [field.name for field in fields(ProjectionParams)]
    for command in ("convert", "batch", "export", "view", "plot", "map", "scans"):
        assert PARAMETERS.keys() <= options_of(command).keys()


def test_there_are_few_options() -> None:
    """Another one replaces one that there is: this only falls."""
    assert len({option.name for _, option in all_options()}) <= 105


def test_an_option_is_typed_in_the_same_way_everywhere() -> None:
    found: dict[str, str] = {}
    for command, option in all_options():
        if option.spelling:
            assert found.setdefault(option.name, option.spelling) == option.spelling, command


def test_helps_name_options_that_there_are() -> None:
    for _, option in all_options():
        for name in re.findall(r"`([a-z_]+)", option.help):
            assert spelling_of(name), option


def test_defaults_have_the_right_type() -> None:
    for command in GROUPS:
        values = {name: option.default for name, option in options_of(command).items() if name not in PARAMETERS}
        assert Options(command, values).given == {}


def shown(command: str, how: str) -> set[str]:
    """The options in a command's help."""
    done = run(command, how)
    assert done.status == 0
    return set(re.findall(r"^  (?:-\w, )?(--[a-z][a-z-]*)", done.stdout, re.MULTILINE))


def test_the_short_help_has_what_people_use() -> None:
    short, long = shown("convert", "--help"), shown("convert", "--help-all")
    common = {option.spelling for option in options_of("convert").values() if option.common}
    assert len(common) <= 25
    assert short == {*common, "--help-all"} | (short & {"--output", "--help"})
    assert {options_of("convert")[name].spelling for name in RARE} & short == set()
    every = {option.spelling for option in options_of("convert").values()}
    assert every - {""} <= long


@pytest.mark.parametrize("command", ["batch", "export", "view", "plot", "map"])
def test_the_short_help_leads_to_the_long_one(command: str) -> None:
    assert run(command, "--help").stdout.rstrip().endswith(f"pc2scan {command} --help-all shows all options.")
    assert shown(command, "--help") < shown(command, "--help-all")


@pytest.mark.parametrize("command", ["check", "info", "tf", "repair", "diff", "golden"])
def test_a_short_help_that_has_all_options_needs_no_other(command: str) -> None:
    known = {option.spelling for option in options_of(command).values()} - {""}
    found = shown(command, "--help")
    assert known <= found
    assert "--help-all" not in found


@pytest.mark.parametrize("command", ["export", "map", "plot", "scans", "view"])
def test_only_written_recordings_have_options_about_them(command: str) -> None:
    idle = {"keep", "drop", "keep_clouds", "only_scans", "keep_used", "write_static_tf", "fail_on", "min_used", "to"}
    assert options_of(command).keys() & idle == set()
    assert instead_of(command, "keep") == (
        f"it would have no effect, because {command} writes no recording; convert has it"
    )


def test_what_only_python_has_is_no_option_of_a_command() -> None:
    assert {option.name for _, option in all_options() if isinstance(option.value, Instance)} == {
        *("params", "filters", "progress")
    }
    assert all(not option.spelling for _, option in all_options() if isinstance(option.value, Instance))


@pytest.mark.parametrize(
    ("command", "values", "message"),
    [
        ("convert", {"fail_on": "emtpy"}, "`fail_on` is 'emtpy', it must be one of empty, warning"),
        ("convert", {"jobs": -1}, "`jobs` is -1, it must be from 0 to 1,024"),
        ("map", {"resolution": "far"}, "`resolution`: 'far' is not a number"),
        ("convert", {"min_used": "half"}, "`min_used`: 'half' is not a share"),
        (
            "convert",
            {"channels": ["stamp"]},
            "`channels` has 'stamp', its values must be among distances",
        ),
        ("convert", {"start": "soon"}, "`start`: 'soon' is not a time"),
        ("view", {"clouds": 1001}, "`clouds` is 1,001, it must be from 1 to 1,000"),
        ("diff", {"atol": ["x"]}, "`atol`: 'x' is not a tolerance"),
    ],
)
def test_a_wrong_value_is_an_error_that_names_the_option(command: str, values: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        Options(command, values)


@pytest.mark.parametrize("values", [{"x": 0.1, "y": "no"}, {"x": True}, {"x": [0.1]}])
def test_each_tolerance_is_a_number(values: dict[str, object]) -> None:
    with pytest.raises(TypeError, match="it must be a number, or a dict of numbers"):
        Options("diff", {"atol": values})


@pytest.mark.parametrize(
    ("values", "read"),
    [
        ({"start": "250us"}, TimeBound(250_000)),
        ({"min_used": "5%"}, 0.05),
        ({"topics": "/points"}, ("/points",)),
        ({"topics": ["/a", "/b:=/c"]}, ("/a", "/b:=/c")),
        ({"start": 1.5}, TimeBound(1_500_000_000)),
        ({"start": TimeBound(5, absolute=True)}, TimeBound(5, absolute=True)),
        ({"min_height": 2.2250738585072014e-308}, 2.2250738585072014e-308),
    ],
)
def test_a_value_is_read_by_its_type(values: dict[str, object], read: object) -> None:
    assert list(Options("convert", values).given.values()) == [read]
