# The annotations of groups must be objects, so this module does without the import that makes them text.
import inspect
from dataclasses import fields
from typing import Annotated, Any

import pytest
import typer
from typer.testing import CliRunner

import pc2scan
from pc2scan.cli.convert import convert
from pc2scan.cli.groups import Group, flat
from pc2scan.cli.options.parameters import ParameterOptions
from pc2scan.core.params import ProjectionParams
from pc2scan.pipeline.parameters import PARAMETERS


class Inner(Group):
    words: Annotated[list[str], typer.Option("--word", "-w")]
    count: Annotated[int, typer.Option(min=0)] = 3


class Outer(Group):
    inner: Inner
    loud: Annotated[bool, typer.Option("--loud")] = False


def run(*arguments: str) -> tuple[str, Outer | None]:
    called: list[tuple[str, Outer]] = []

    def command(name: str, *, outer: Outer) -> None:
        """Do it."""
        called.append((name, outer))

    app = typer.Typer(rich_markup_mode=None)
    app.command()(flat(command))
    done = CliRunner().invoke(app, list(arguments))
    assert (done.exit_code == 0) == (len(called) == 1 or "--help" in arguments)
    return (called[0][0], called[0][1]) if called else (done.output, None)


def test_a_command_takes_groups_and_typer_sees_options() -> None:
    assert run("x") == ("x", Outer(inner=Inner(words=[], count=3), loud=False))
    expected = Outer(inner=Inner(words=["a", "b"], count=7), loud=True)
    assert run("x", "-w", "a", "--word", "b", "--count", "7", "--loud") == ("x", expected)


def test_the_rules_of_options_in_groups_hold() -> None:
    output, nothing = run("x", "--count", "-1")
    assert nothing is None
    assert "--count" in output
    text, _ = run("--help")
    assert all(name in text for name in ("Do it.", "--word", "--count", "--loud", "[default: 3"))
    assert "--inner" not in text


def test_an_option_without_a_default_is_required_unless_it_is_a_list() -> None:
    class Strict(Group):
        count: Annotated[int, typer.Option()]
        words: Annotated[list[str], typer.Option()]

    assert {p.name: p.default for p in Strict.parameters()} == {"count": inspect.Parameter.empty, "words": []}
    nothing = [p for p in inspect.signature(flat(convert)).parameters.values() if p.default is p.empty]
    assert [p.name for p in nothing] == ["sources"]


def test_lists_are_not_shared_between_calls() -> None:
    first, second = run("x")[1], run("x")[1]
    assert first is not None
    assert second is not None
    assert first.inner.words is not second.inner.words


def test_every_parameter_of_the_projection_is_an_option() -> None:
    names = set(inspect.signature(flat(convert)).parameters)
    assert set(PARAMETERS) == {spec.name for spec in fields(ProjectionParams)}
    assert set(PARAMETERS) <= names


def test_the_command_and_the_library_take_the_same() -> None:
    library = set(inspect.signature(pc2scan.convert).parameters)
    command = set(inspect.signature(flat(convert)).parameters)
    # The library says the opposite, has several in one object, or takes parameters by name; its topics are plural.
    only_here = {"ros_args", "no_verify", "quiet", "verbose", "each", "tf_topic", *PARAMETERS}
    only_there = {"params", "frames", "filters", "verify", "progress", "tf_topics", "parameters"}
    assert command - only_here == library - only_there


@pytest.mark.parametrize(("typed", "value"), [("--use-inf", True), ("--no-use-inf", False)])
def test_a_setting_has_the_spelling_that_was_typed(typed: str, value: bool) -> None:
    values: dict[str, Any] = dict.fromkeys(PARAMETERS)
    given = ParameterOptions.gathered({**values, "use_inf": value})
    assert [(s.name, s.value, s.origin) for s in given.settings] == [("use_inf", value, typed)]


def test_a_word_or_a_number_of_an_option_is_what_it_looks_like() -> None:
    values: dict[str, Any] = dict.fromkeys(PARAMETERS)
    given = ParameterOptions.gathered({**values, "scan_time": "0.1", "time_increment": "auto"})
    assert [(s.name, s.value) for s in given.settings] == [("scan_time", 0.1), ("time_increment", "auto")]


@pytest.mark.parametrize(("text", "value"), [("030", 30.0), ("1e2", 100.0), (".inf", float("inf")), ("x", "x")])
def test_a_number_is_read_as_python_does_or_else_as_ros_does(text: str, value: object) -> None:
    values: dict[str, Any] = dict.fromkeys(PARAMETERS)
    given = ParameterOptions.gathered({**values, "angle_max": text, "target_frame": "010"})
    assert [(s.name, s.value) for s in given.settings] == [("target_frame", "010"), ("angle_max", value)]
