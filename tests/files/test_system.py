"""Locks, and what other operating systems lack, taken away from this one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pc2scan.errors import DestinationError
from pc2scan.files import outputs
from pc2scan.files.outputs import staged_output
from support import ROOT, sampled
from support.batches import contents
from support.command import environment, run

HALL = ROOT / "fixtures" / "hall.mcap"

#: Takes away what Windows and macOS do not have, and what some network file systems cannot do; then runs the command.
POOR = """
import os, signal, sys
for name in ("pread", "preadv", "posix_fadvise", "RWF_NOWAIT", "sched_getaffinity", "O_NOFOLLOW", "O_CLOEXEC",
             "O_NONBLOCK", "pathconf", "link"):
    if hasattr(os, name):
        delattr(os, name)
def link(*_, **__):
    raise OSError(1, "not permitted")
os.link = link
for name in ("SIGPIPE", "SIGALRM", "setitimer"):
    if hasattr(signal, name):
        delattr(signal, name)
sys.modules["fcntl"] = sys.modules["msvcrt"] = None
from pc2scan.cli import main
sys.argv[0] = "pc2scan"
main()
"""


@pytest.mark.parametrize("name", sampled(["out.bag", "out.mcap", "out"], 1))
def test_a_poor_system_makes_the_same_bytes(name: str, tmp_path: Path) -> None:
    ours, poor = tmp_path / "ours", tmp_path / "poor"
    for folder in (ours, poor):
        folder.mkdir()
    options = ["--min-height", "-0.3", "--jobs", "2"]
    assert run("convert", HALL, "-o", ours / name, *options).status == 0
    command = [sys.executable, "-c", POOR, "convert", str(HALL), "-o", str(poor / name), *options]
    for status in (0, 2):
        done = subprocess.run(command, capture_output=True, text=True, env=environment(), check=False)
        assert done.returncode == status, done.stderr
    assert "exists already" in done.stderr
    assert contents(poor) == contents(ours)


# --- A destination is written by one run at a time ---


def write(path: Path) -> None:
    with staged_output(path, overwrite=False) as partial:
        partial.touch()


def test_a_second_run_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    program = (
        "import sys, pathlib\n"
        "from pc2scan.files.outputs import staged_output\n"
        "with staged_output(pathlib.Path(sys.argv[1]), overwrite=True) as partial:\n"
        "    partial.write_text('other'); print('ready', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path / "out")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(Path(outputs.__file__).parents[2])},
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"ready\n"
        with pytest.raises(DestinationError, match="being written by another run"):
            write(tmp_path / "out")
        assert (tmp_path / "out.pc2scan-partial").read_text() == "other"
        other.kill()
    assert sorted(contents(tmp_path)) == ["out.pc2scan-partial", "out.pc2scan-partial.lock"]
    write(tmp_path / "out")
    assert contents(tmp_path) == {"out": b""}
