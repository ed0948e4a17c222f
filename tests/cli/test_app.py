from __future__ import annotations

import pytest
from typer.testing import CliRunner

import pc2scan
from pc2scan.cli.app import COMMANDS, application
from pc2scan.core import kernel


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
    ],
)
def test_the_shell_completes_commands_options_and_choices(typed: str, offered: set[str]) -> None:
    shell = {"_PC2SCAN_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split(" ")) - 1)}
    done = CliRunner().invoke(application(), [], prog_name="pc2scan", env=shell)
    assert done.exit_code == 0, done.output
    assert set(done.output.split()) == offered


def test_a_command_alone_is_the_same_command() -> None:
    for name in COMMANDS:
        alone = CliRunner().invoke(application(name), [name, "--help"])
        assert alone.stdout == CliRunner().invoke(application(), [name, "--help"]).stdout
    everything = CliRunner().invoke(application("no-such"), ["--help"]).stdout
    assert all(f"  {name}" in everything for name in COMMANDS)
