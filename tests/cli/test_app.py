from __future__ import annotations

import re
import shlex

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

import pc2scan
from pc2scan.cli.app import COMMANDS, application
from pc2scan.cli.examples import EXAMPLES
from pc2scan.core import kernel
from support import ROOT

HALL = ROOT / "fixtures" / "hall.bag"


@pytest.mark.parametrize("compiled", [True, False])
def test_the_version_says_if_the_loops_are_not_compiled(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "COMPILED", compiled)
    done = CliRunner().invoke(application(), ["--version"])
    assert done.exit_code == 0
    version, *rest = done.stdout.strip().split(" (")
    assert version == f"pc2scan {pc2scan.__version__}"
    assert bool(rest) != compiled


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("pc2scan rep", {"repair"}),
        ("pc2scan convert --min-", {"--min-height", "--min-height-slope", "--min-points", "--min-used"}),
        ("pc2scan convert hall.bag --storage ", {"mcap", "sqlite3"}),
        ("pc2scan convert --beams x --use", {"--use-inf"}),
        ("pc2scan convert x.bag --preset sl", {"slam_toolbox"}),
        ("pc2scan convert x.bag --geometry up", {"upstream"}),
        (f"pc2scan convert {HALL} --topic ", {"/points"}),
        (f"pc2scan convert {HALL} --keep /tf", {"/tf", "/tf_static"}),
        (f"pc2scan convert {HALL} --target-frame ", {"base_link", "lidar", "odom"}),
        (f"pc2scan convert -o x.bag {HALL} --source-frame l", {"lidar"}),
        (f"pc2scan tf {HALL} --lookup base_link l", {"lidar"}),
        (f"pc2scan check {HALL} --base-frame b", {"base_link"}),
        (f"pc2scan check {HALL} --topic ", set[str]()),
        (f"pc2scan diff {HALL} {HALL} --topic /p", {"/points"}),
        ("pc2scan convert nothing.bag --topic ", set[str]()),
        (f"pc2scan convert {ROOT} --topic ", set[str]()),
        (f"pc2scan convert {ROOT}/README.md --target-frame ", set[str]()),
        (f"pc2scan convert '{HALL} --topic ", set[str]()),
    ],
)
def test_the_shell_completes_commands_options_and_choices(typed: str, offered: set[str]) -> None:
    shell = {"_PC2SCAN_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split(" ")) - 1)}
    done = CliRunner().invoke(application(), [], prog_name="pc2scan", env=shell)
    assert done.exit_code == 0, done.output
    assert set(done.output.split()) == offered


@pytest.mark.parametrize("name", COMMANDS)
def test_help_begins_with_examples(name: str) -> None:
    shown = CliRunner().invoke(application(name), [name, "--help"], prog_name="pc2scan").stdout
    lines = [line.strip() for line in shown.splitlines() if line.strip()]
    examples = [line for line in lines[1:7] if line.startswith("pc2scan ")]
    assert 2 <= len(examples) <= 3
    assert max(map(len, shown.splitlines())) <= 80
    group = get_command(application(name))
    command = group.commands[name]  # type: ignore[attr-defined]
    for typed, _ in EXAMPLES[name]:
        program, called, *rest = shlex.split(typed)
        assert (program, called) == ("pc2scan", name)
        values, _, _ = command.make_parser(typer.Context(command)).parse_args(rest)
        assert values


@pytest.mark.parametrize("name", COMMANDS)
def test_a_default_is_said_once(name: str) -> None:
    shown = " ".join(CliRunner().invoke(application(name), [name, "--help"]).stdout.split())
    assert not re.search(r"\[default: [^]]*\] \[default: ", shown)


def test_defaults_are_for_people() -> None:
    shown = " ".join(CliRunner().invoke(application("convert"), ["convert", "--help-all"]).stdout.split())
    for default in ("above 0 m", "no limit", "-pi rad", "pi rad", "pi/180 rad, 1 degree", "1/30 s"):
        assert f"[default: {default}]" in shown
    assert "e+308" not in shown
    assert "e-308" not in shown


def test_a_command_alone_is_the_same_command() -> None:
    for name in COMMANDS:
        alone = CliRunner().invoke(application(name), [name, "--help"])
        assert alone.stdout == CliRunner().invoke(application(), [name, "--help"]).stdout
    everything = CliRunner().invoke(application("no-such"), ["--help"]).stdout
    assert all(f"  {name}" in everything for name in COMMANDS)
