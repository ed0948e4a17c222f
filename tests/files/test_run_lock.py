"""A destination is written by one run at a time; where files cannot be locked, runs go on without a lock."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pc2scan.errors import DestinationError, OutputError
from pc2scan.files import run_lock
from pc2scan.files.staging import staged


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_a_second_run_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    program = (
        "import sys, pathlib\n"
        "from pc2scan.files.staging import staged\n"
        "with staged(pathlib.Path(sys.argv[1]), overwrite=True) as partial:\n"
        "    partial.write_text('other'); print('ready', flush=True); sys.stdin.read()\n"
    )
    source = str(Path(run_lock.__file__).parents[2])
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path / "out")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": source},
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"ready\n"
        with (
            pytest.raises(DestinationError, match="being written by another run"),
            staged(tmp_path / "out", overwrite=True),
        ):
            pytest.fail("the body must not run")
        assert (tmp_path / "out.pc2scan-partial").read_text() == "other"
        other.kill()
    assert names(tmp_path) == ["out.pc2scan-partial", "out.pc2scan-partial.lock"]
    with staged(tmp_path / "out", overwrite=False) as partial:
        partial.write_text("new")
    assert names(tmp_path) == ["out"]


def test_a_run_goes_on_where_files_cannot_be_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fcntl = pytest.importorskip("fcntl")

    def refuse(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with staged(tmp_path / "file system", overwrite=False) as partial:
        partial.write_text("new")
    monkeypatch.setitem(sys.modules, "fcntl", None)
    with staged(tmp_path / "windows", overwrite=False) as partial:
        partial.write_text("new")
    assert names(tmp_path) == ["file system", "windows"]


def test_a_file_system_that_refuses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(run_lock, "_locked", refuse)
    with pytest.raises(OutputError, match="Read-only file system"), staged(tmp_path / "out", overwrite=False):
        pytest.fail("the body must not run")
