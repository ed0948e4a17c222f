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
from pc2scan.options.table import GROUPS, PARAMETERS, options_of, spellings
from support.command import run

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.options.option import Option


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


def test_helps_name_options_that_there_are() -> None:
    for _, option in all_options():
        for name in re.findall(r"`([a-z_]+)", option.help):
            assert spellings()[name], option


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
    every = {option.spelling for option in options_of("convert").values()}
    assert every - {""} <= long


@pytest.mark.parametrize(
    ("command", "values", "message"),
    [
        ("convert", {"fail_on": "emtpy"}, "`fail_on` is 'emtpy', it must be one of empty, warning"),
        ("map", {"resolution": "far"}, "`resolution`: 'far' is not a number"),
        ("convert", {"channels": ["stamp"]}, "`channels` has 'stamp', its values must be among distances"),
        ("convert", {"start": "soon"}, "`start`: 'soon' is not a time"),
    ],
)
def test_a_wrong_value_is_an_error_that_names_the_option(command: str, values: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        Options(command, values)


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
