"""Whatever is wrong with a command line, it is reported in one form."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from pc2scan.cli.app import application
from support import ROOT

HALL = str(ROOT / "fixtures" / "hall.bag")


def said(*arguments: str) -> str:
    done = CliRunner().invoke(application(*arguments[:1]), list(arguments), prog_name="pc2scan")
    assert done.exit_code == 2
    assert done.stdout == ""
    return done.stderr


@pytest.mark.parametrize(
    ("arguments", "error", "hint"),
    [
        (["convrt", HALL], "no such command 'convrt'", "did you mean 'convert'?"),
        (["nothing-like-it"], "no such command 'nothing-like-it'", "pc2scan --help shows what it takes"),
        (["--foo"], "there is no option --foo", "pc2scan --help shows what it takes"),
        (["convert"], "SRC... is missing", "pc2scan convert --help shows what it takes"),
        (["diff"], "A is missing", "pc2scan diff --help shows what it takes"),
        (["repair", "a", "b"], "got unexpected extra argument(s) (b)", "pc2scan repair --help shows what it takes"),
        (
            ["convert", HALL, "--min-hight", "3"],
            "there is no option --min-hight",
            "did you mean --max-height or --min-height or --min-points?",
        ),
        (["convert", HALL, "--start"], "--start requires an argument", "pc2scan convert --help shows what it takes"),
        (["tf", HALL, "--lookup", "a"], "--lookup requires 2 arguments", "pc2scan tf --help shows what it takes"),
        (
            ["convert", HALL, "--strict=3"],
            "--strict does not take a value",
            "pc2scan convert --help shows what it takes",
        ),
        (["convert", HALL, "-jx"], "-j: 'x' is not a whole number", "pc2scan convert --help shows what it takes"),
        (
            ["convert", HALL, "--jobs=x"],
            "--jobs: 'x' is not a whole number",
            "pc2scan convert --help shows what it takes",
        ),
        (
            ["convert", HALL, "--jobs", "-2"],
            "--jobs: -2 is not in the range x>=0",
            "pc2scan convert --help shows what it takes",
        ),
        (
            ["convert", HALL, "--storage", "bag"],
            "--storage: 'bag' is not one of 'mcap', 'sqlite3'",
            "pc2scan convert --help shows what it takes",
        ),
        (
            ["diff", HALL, "--allow-beams", "x is not y"],
            "--allow-beams: 'x is not y' is not a number",
            "pc2scan diff --help shows what it takes",
        ),
    ],
    ids=str,
)
def test_what_typer_finds_wrong_looks_like_all_else(arguments: list[str], error: str, hint: str) -> None:
    assert said(*arguments) == f"error: {error}\nhint: {hint}\n"


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--min-height", "abc"], "min_height: expected a number, got 'abc' (from --min-height)"),
        (["-p", "min_height:=abc"], "min_height: expected a number, got 'abc' (from --param min_height:=abc)"),
        (["--beams", "3.5"], "beams: expected a whole number, got 3.5 (from --beams)"),
        (["--scan-time", "abc"], "scan_time: expected a number or auto, got 'abc' (from --scan-time)"),
        (["--geometry", "abc"], "geometry: expected upstream, centered, got 'abc' (from --geometry)"),
        (["--queue-size", "-1"], "queue_size is -1, it must not be negative (from --queue-size)"),
    ],
    ids=str,
)
def test_a_parameter_is_checked_alike_wherever_it_is_given(arguments: list[str], error: str) -> None:
    assert said("convert", HALL, *arguments) == f"error: {error}\n"


def test_no_arguments_show_the_help() -> None:
    done = CliRunner().invoke(application(), [], prog_name="pc2scan")
    assert done.exit_code == 2
    assert "Usage: pc2scan [OPTIONS] COMMAND" in done.output
    assert "error:" not in done.output
