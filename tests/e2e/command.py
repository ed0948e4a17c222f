"""The real command, in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["COMMAND", "Finished", "run"]

COMMAND = (sys.executable, "-m", "pc2scan")


class Finished(NamedTuple):
    """A command's exit status and what it printed."""

    status: int
    stdout: str
    stderr: str


def run(*args: str | Path, cwd: Path | None = None, timeout: float = 120) -> Finished:
    """Run ``pc2scan`` with pipes for its output, as a script would."""
    done = subprocess.run(
        [*COMMAND, *map(str, args)], capture_output=True, text=True, timeout=timeout, cwd=cwd, check=False
    )
    return Finished(done.returncode, done.stdout, done.stderr)
