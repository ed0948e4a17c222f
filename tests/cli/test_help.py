"""What the command says of itself: its help, its examples, its completions, and the options that texts name."""

from __future__ import annotations

import ast
import os
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest

import pc2scan
from pc2scan.cli import app, completion
from pc2scan.cli.app import parse
from pc2scan.cli.commands import COMMANDS
from pc2scan.options.table import options_of, spellings
from support import HALL, ROOT
from support.command import run
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Iterator

TABLES = Path(__file__).with_name("help.txt")
PACKAGE = ROOT / "src" / "pc2scan"


@pytest.mark.parametrize("compiled", [True, False])
def test_the_version_says_if_loops_are_not_compiled(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "COMPILED", compiled)
    version, *rest = run("--version").stdout.strip().split(" (")
    assert version == f"pc2scan {pc2scan.__version__}"
    assert bool(rest) != compiled


@pytest.mark.parametrize(("typed", "offered"), rows(TABLES, "completions"))
def test_the_shell_completes_options_and_their_values(
    typed: str, offered: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(completion, "_PATIENCE", 60)
    assert completed(typed.replace("HALL", str(HALL)).replace("ROOT", str(ROOT))) == offered.split()


def completed(typed: str) -> list[str]:
    """What bash offers."""
    shell = {"_PC2SCAN_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split(" ")) - 1)}
    with patch.dict(os.environ, shell):
        done = run()
    assert (done.status, done.stderr) == (0, "")
    return sorted(done.stdout.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_examples_and_says_each_default_once(name: str) -> None:
    text = run(name, "--help").stdout
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    assert 2 <= sum(line.startswith("pc2scan ") for line in lines[1:7]) <= 3
    assert max(map(len, text.splitlines())) <= 80
    assert not re.search(r"\[default:\s[^]]*\]\s+\[default:\s", text)
    for typed in COMMANDS[name].examples:
        program, *words = shlex.split(typed)
        assert (program, words[0]) == ("pc2scan", name)
        assert parse(words)


def test_defaults_are_for_people() -> None:
    text = " ".join(run("convert", "--help-all").stdout.split())
    for default in ("above 0 m", "no limit", "-pi rad", "pi rad", "pi/180 rad, 1 degree", "1/30 s"):
        assert f"[default: {default}]" in text
    assert "e+308" not in text
    assert "e-308" not in text
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


@pytest.mark.slow
def test_the_library_names_options_and_the_command_spells_them() -> None:
    known = {spelling for each in COMMANDS.values() for own in each.arguments for spelling in own.spellings}
    known |= {option.spelling for name in COMMANDS for option in options_of(name).values()}
    named, spelled = set(), set()
    for path, text in texts_of_the_library():
        if not path.startswith("cli/"):
            # An f-string's parts are looked at one by one, so the closing backtick may be in another.
            named |= set(re.findall(r"`([a-z_]+)(?:=|`)", text))
        if not path.startswith(("cli/", "pytest_plugin")) and re.search(r"--([a-z]|$)", text):
            spelled.add(path)
    assert {"overwrite", "topics", "angle_min", "target_frame"} <= named
    assert {name for name in named if spellings().get(name) not in known} == set()
    assert spelled == dict(rows(TABLES, "options below the command line")).keys()
