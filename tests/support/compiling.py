"""Compiles the C++ programs that tests compare with, once for all workers of a run."""

from __future__ import annotations

import fcntl
import os
import subprocess
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pytest

__all__ = ["compiled_once", "folder_of_the_run"]


def folder_of_the_run(factory: pytest.TempPathFactory) -> Path:
    """The temporary folder that the workers of a run share."""
    own = factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


def compiled_once(program: Path, source: Path, options: Sequence[str], libraries: Sequence[str]) -> Path:
    """Compile a program if it is not there; a worker that comes meanwhile waits for it."""
    with program.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not program.exists():
            made = program.with_suffix(".made")
            linked = [f"-l{name}" for name in libraries]
            subprocess.run(["g++", *options, "-o", str(made), str(source), *linked], check=True)
            made.rename(program)
    return program
