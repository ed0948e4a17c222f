"""What the command says of itself: its help, its examples, its completions, and the options that texts name."""

from __future__ import annotations

import ast
import re
import shlex
import signal
from typing import TYPE_CHECKING

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

import pc2scan
from pc2scan.cli import completion
from pc2scan.cli.app import COMMANDS, application
from pc2scan.cli.examples import EXAMPLES
from pc2scan.core import kernel
from pc2scan.options.table import spelling_of
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from collections.abc import Iterator

HALL = ROOT / "fixtures" / "hall.bag"
PACKAGE = ROOT / "src" / "pc2scan"


@pytest.mark.parametrize("compiled", [True, False])
def test_the_version_says_if_loops_are_not_compiled(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "COMPILED", compiled)
    version, *rest = run("--version").stdout.strip().split(" (")
    assert version == f"pc2scan {pc2scan.__version__}"
    assert bool(rest) != compiled


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("pc2scan rep", "repair"),
        ("pc2scan convert --min-", "--min-height --min-height-slope --min-points --min-used"),
        ("pc2scan convert hall.bag --storage ", "mcap sqlite3"),
        ("pc2scan convert --beams x --use", "--use-inf"),
        ("pc2scan convert x.bag --preset sl", "slam_toolbox"),
        ("pc2scan convert x.bag --geometry up", "upstream"),
        (f"pc2scan convert {HALL} --topic ", "/points"),
        (f"pc2scan convert {HALL} --keep /tf", "/tf /tf_static"),
        (f"pc2scan convert {HALL} --target-frame ", "base_link lidar odom"),
        (f"pc2scan convert -o x.bag {HALL} --source-frame l", "lidar"),
        (f"pc2scan tf {HALL} --lookup base_link l", "lidar"),
        (f"pc2scan check {HALL} --base-frame b", "base_link"),
        (f"pc2scan check {HALL} --topic ", ""),
        (f"pc2scan diff {HALL} {HALL} --topic /p", "/points"),
        ("pc2scan convert nothing.bag --topic ", ""),
        (f"pc2scan convert {ROOT} --topic ", ""),
        (f"pc2scan convert {ROOT}/README.md --target-frame ", ""),
        (f"pc2scan convert '{HALL} --topic ", ""),
    ],
)
def test_the_shell_completes_options_and_their_values(
    typed: str, offered: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(completion, "_PATIENCE", 60.0)
    before = signal.getsignal(signal.SIGALRM)
    assert completed(typed) == offered.split()
    assert signal.getsignal(signal.SIGALRM) == before


def completed(typed: str) -> list[str]:
    """What bash offers."""
    shell = {"_PC2SCAN_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split(" ")) - 1)}
    done = CliRunner().invoke(application(), [], prog_name="pc2scan", env=shell)
    assert done.exit_code == 0, done.output
    return sorted(done.output.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_examples_and_says_each_default_once(name: str) -> None:
    shown = run(name, "--help").stdout
    lines = [line.strip() for line in shown.splitlines() if line.strip()]
    assert 2 <= sum(line.startswith("pc2scan ") for line in lines[1:7]) <= 3
    assert max(map(len, shown.splitlines())) <= 80
    assert not re.search(r"\[default:\s[^]]*\]\s+\[default:\s", shown)
    # Alone it is the same command as among all.
    alone, among = (CliRunner().invoke(application(*only), [name, "--help"]).stdout for only in ((name,), ()))
    assert alone == among
    command = get_command(application(name)).commands[name]  # type: ignore[attr-defined]
    for typed, _ in EXAMPLES[name]:
        program, called, *rest = shlex.split(typed)
        assert (program, called) == ("pc2scan", name)
        assert command.make_parser(typer.Context(command)).parse_args(rest)[0]


def test_defaults_are_for_people() -> None:
    shown = " ".join(run("convert", "--help-all").stdout.split())
    for default in ("above 0 m", "no limit", "-pi rad", "pi rad", "pi/180 rad, 1 degree", "1/30 s"):
        assert f"[default: {default}]" in shown
    assert "e+308" not in shown
    assert "e-308" not in shown
    everything = run("--help").stdout
    assert all(f"  {name}" in everything for name in COMMANDS)


def texts_of_the_library() -> Iterator[tuple[str, str]]:
    """All text of the package that is no docstring, with the module's path."""
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
                yield str(path.relative_to(PACKAGE)), node.value


#: Modules below the command line whose texts have options, and why.
OPTIONS_BELOW = {
    "options/commands.py": "how options are typed",
    "options/conversion.py": "likewise",
    "options/option.py": "likewise",
    "options/projection.py": "likewise",
    "options/running.py": "likewise",
    "pipeline/parameters.py": "where a parameter comes from, as it was typed",
    "pipeline/yaml_nodes.py": "likewise",
    "pipeline/launch_file.py": "ROS's own options, which launch files have",
    "bags/formats.py": "the options of ROS's own players",
    "golden/case.py": "the arguments of a command, which cases have",
    "golden/check.py": "the arguments of the command that golden cases run",
    "look/command_line.py": "the command that a page shows",
    "compare/scan_text.py": "the first line of files that are kept: they stay as they are, to the byte",
}


@pytest.mark.slow
def test_the_library_names_options_and_the_command_spells_them() -> None:
    group = get_command(application())
    known = {name for command in COMMANDS for each in group.commands[command].params for name in each.opts}  # type: ignore[attr-defined]
    named, spelled = set(), set()
    for path, text in texts_of_the_library():
        if not path.startswith("cli/"):
            # An f-string's parts are looked at one by one, so the closing backtick may be in another.
            named |= set(re.findall(r"`([a-z_]+)(?:=|`)", text))
        if not path.startswith(("cli/", "pytest_plugin")) and re.search(r"--([a-z]|$)", text):
            spelled.add(path)
    assert {"overwrite", "topics", "angle_min", "target_frame"} <= named
    assert {name for name in named if spelling_of(name) not in known} == set()
    assert spelled == OPTIONS_BELOW.keys()
