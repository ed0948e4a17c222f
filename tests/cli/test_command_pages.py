"""The pages of the commands are those that the table of options makes."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

from pc2scan.cli.commands import COMMANDS
from support import ROOT
from support.command import environment

if TYPE_CHECKING:
    from pathlib import Path

PAGES = ROOT / "docs" / "commands"


def test_the_committed_pages_are_those_of_the_table(tmp_path: Path) -> None:
    script = [sys.executable, str(ROOT / "docs" / "site" / "commands.py"), str(tmp_path)]
    subprocess.run(script, check=True, env=environment())
    made = {path.name: path.read_text("utf-8") for path in tmp_path.iterdir()}
    assert made.keys() == {"index.md", *(f"{name}.md" for name in COMMANDS)}
    committed = {path.name: path.read_text("utf-8") for path in PAGES.iterdir()}
    assert committed == made, "python docs/site/commands.py"
    site = (ROOT / "mkdocs.yml").read_text("utf-8")
    assert all(f"- commands/{name}\n" in site for name in made)
