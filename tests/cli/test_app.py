from __future__ import annotations

import pytest
from typer.testing import CliRunner

import pc2scan
from pc2scan.cli.app import app
from pc2scan.core import kernel


@pytest.mark.parametrize("compiled", [True, False])
def test_the_version_says_if_the_loops_are_not_compiled(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "COMPILED", compiled)
    done = CliRunner().invoke(app, ["--version"])
    assert done.exit_code == 0
    version, *rest = done.stdout.strip().split(" (")
    assert version == f"pc2scan {pc2scan.__version__}"
    assert bool(rest) != compiled
