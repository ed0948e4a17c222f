"""The real command, in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

__all__ = ["COMMAND", "INTERRUPTED", "Finished", "environment", "run"]

COMMAND = (sys.executable, "-m", "pc2scan")

#: How an interrupted command may end; a shell calls both 130. Python ends by the signal itself if the interruption
#: comes while it begins, or while a module that is loaded makes a named tuple, even though the command handles it.
INTERRUPTED = (130, -signal.SIGINT)


class Finished(NamedTuple):
    """A command's exit status and what it printed."""

    status: int
    stdout: str
    stderr: str


def environment() -> dict[str, str]:
    """This process's environment; a relative ``PYTHONPATH`` would mean another place in another folder."""
    paths = [str(Path(path).resolve()) for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)} if paths else dict(os.environ)


def run(*args: str | Path, cwd: Path | None = None, timeout: float = 120) -> Finished:
    """Run ``pc2scan`` with pipes for its output, as a script would."""
    done = subprocess.run(
        [*COMMAND, *map(str, args)],
        capture_output=True,
        text=True,
        timeout=timeout,
        cwd=cwd,
        env=environment(),
        check=False,
    )
    return Finished(done.returncode, done.stdout, done.stderr)
