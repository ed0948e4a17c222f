"""The page's modules, run by node."""

from __future__ import annotations

import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest

from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

MODULES = ROOT / "src" / "pc2scan" / "show" / "page"

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="needs node")


def node(folder: Path, code: str) -> str:
    """Run a module that imports the page's own by their names (``page:project.mjs``); returns what it prints."""
    script = folder / "script.mjs"
    script.write_text(code.replace("page:", f"{MODULES.as_uri()}/"))
    done = subprocess.run(["node", str(script)], capture_output=True, text=True, timeout=120, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout
