"""Whatever is wrong with a command line, it is reported in one form."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from pc2scan.cli.app import application
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

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
            "did you mean --min-height or --max-height or --min-height-slope?",
        ),
        (
            ["convert", HALL, "-o", "a.bag", "--output=b.bag"],
            "-o is given twice, but there is only one destination",
            "type only one of them",
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
            "--jobs: -2 is not 0 or more",
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
        (["--beams", "3.5"], "beams: expected a whole number or auto, got 3.5 (from --beams)"),
        (["--scan-time", "abc"], "scan_time: expected a number or auto, got 'abc' (from --scan-time)"),
        (
            ["--geometry", "abc"],
            "geometry: expected upstream, centered, half-open, symmetric, got 'abc' (from --geometry)",
        ),
        (["--queue-size", "-1"], "queue_size is -1, it must not be negative (from --queue-size)"),
    ],
    ids=str,
)
def test_a_parameter_is_checked_alike_wherever_it_is_given(arguments: list[str], error: str) -> None:
    assert said("convert", HALL, *arguments).splitlines()[0] == f"error: {error}"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--end", "soon"], "error: --end: 'soon' is not a time\nhint: give seconds from the beginning (12.5)"),
        (["--only-scans", "--keep", "/x"], "error: --only-scans contradicts --keep and --keep-clouds\n"),
        (["--range-cutoff", "3"], "error: --channel and --range-cutoff need --reverse\n"),
        (["--reverse", "--deskew"], "such as --target-frame odom\n"),
        (["--write-static-tf"], "hint: give one with --static-tf\n"),
        (["-o", HALL], "sources are never changed"),
        (["-o", "scan.bag", "--storage", "mcap"], "--storage is for rosbag2 directories"),
        (
            ["-o", "scan.bag", "--compression", "zstd"],
            "--compression zstd is not possible here; allowed: none, bz2, lz4",
        ),
        (["-p", "cloud_in:=/x"], "hint: topics are not parameters here; --topic chooses them\n"),
        (["--no-return", "zero", "--no-use-inf"], "(use_inf from --no-use-inf; no_return from --no-return)"),
        (["--no-return", "nan", "-p", "range_mx:=1"], "did you mean 'range_max'?"),
        (
            ["--no-return", "range-max-plus", "-p", "range_max:=1e300"],
            "hint: say how far the sensor sees: --param range_max:=100.0\n",
        ),
        (["--no-return", "range-max-plus"], "hint: say how far the sensor sees: --range-max 100.0\n"),
    ],
    ids=str,
)
def test_what_the_library_finds_wrong_is_said_with_the_options_that_were_typed(
    arguments: list[str], message: str
) -> None:
    text = said("convert", HALL, *arguments)
    assert text.startswith("error: ")
    assert message in text
    assert "`" not in text


def test_no_arguments_show_the_help() -> None:
    done = CliRunner().invoke(application(), [], prog_name="pc2scan")
    assert done.exit_code == 2
    assert "Usage: pc2scan [OPTIONS] COMMAND" in done.output
    assert "error:" not in done.output


def test_what_a_parameter_file_has_besides_is_reported(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("pointcloud_to_laserscan:\n  ros__parameters:\n    cloud_in: /points\n", "utf-8")
    text = said("convert", HALL, "--params-file", str(file), "-o", HALL)
    assert text.startswith(f"warning: ignored, because it is not a parameter of the projection: {file}, line 3, ")
