"""Runs the command: in this process, or in one of its own for what only a process shows."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import traceback
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.cli import app

if TYPE_CHECKING:
    from collections.abc import Iterator

COMMAND = (sys.executable, "-m", "pc2scan")

#: How an interrupted command may end; a shell calls both 130. Python ends by the signal itself if the interruption
#: comes while it begins, or while a module that is loaded makes a named tuple, even though the command handles it.
INTERRUPTED = (130, -signal.SIGINT)


#: Seconds after which a command hangs.
_SECONDS = 120


class Finished(NamedTuple):
    """A command's exit status and what it printed."""

    status: int
    stdout: str
    stderr: str


def run(*args: str | Path, cwd: Path | None = None) -> Finished:
    """Run ``pc2scan`` in this process, with standard output and error that are no terminals, as a script would."""
    words = [str(arg) for arg in args]
    stdout, stderr = (TextIOWrapper(BytesIO(), "utf-8", write_through=True) for _ in range(2))
    status = 0
    with _guarded(), _inside(cwd), redirect_stdout(stdout), redirect_stderr(stderr):
        try:
            status = app.run(words)
        except SystemExit as err:
            status = err.code if isinstance(err.code, int) else 1
        except AssertionError:
            raise
        except Exception:  # noqa: BLE001  # as the interpreter shows it
            status = 1
            traceback.print_exc()
    return Finished(status, *(each.buffer.getvalue().decode() for each in (stdout, stderr)))


@contextmanager
def _guarded() -> Iterator[None]:
    """Raise if the command hangs, for example on a FIFO that nobody writes to."""

    def hangs(*_: object) -> None:
        raise AssertionError(f"the command has not ended after {_SECONDS} s")

    previous = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(_SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


@contextmanager
def _inside(folder: Path | None) -> Iterator[None]:
    """Let this process be in a folder."""
    before = Path.cwd()
    os.chdir(folder or before)
    try:
        yield
    finally:
        os.chdir(before)


def environment() -> dict[str, str]:
    """This process's environment; a relative ``PYTHONPATH`` would mean another place in another folder."""
    paths = [str(Path(path).resolve()) for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)} if paths else dict(os.environ)


def run_process(*args: str | Path, cwd: Path | None = None, timeout: float = 120) -> Finished:
    """Run ``pc2scan`` in a process of its own, with pipes for its output."""
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
