"""The readers that web tools use, from npm."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

__all__ = ["needs_npm", "node"]

MODULES = os.environ.get("PC2SCAN_NODE_MODULES", "")


def needs_npm(*packages: str) -> pytest.MarkDecorator:
    """Skip a test where node or one of the packages is not there."""
    missing = shutil.which("node") is None or not all((Path(MODULES) / name).is_dir() for name in packages)
    return pytest.mark.skipif(
        missing, reason=f"needs node, and PC2SCAN_NODE_MODULES: a node_modules folder with {' and '.join(packages)}"
    )


def node(script: Path, path: Path) -> Any:
    """Run a script with the packages on a recording; returns the JSON that it prints."""
    done = subprocess.run(
        ["node", str(script), MODULES, str(path)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
