"""What other operating systems lack, taken away from this one."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import NoReturn

import pytest

from pc2scan.errors import DestinationError
from pc2scan.files import run_lock, system
from pc2scan.files.places import check_place
from pc2scan.files.staging import staged
from support import ROOT
from support.command import environment

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


def run_poorly(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", POOR, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment(), check=False)


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out"])
def test_a_poor_system_makes_the_same_bytes(tmp_path: Path, name: str) -> None:
    options = ["--min-height", "-0.3", "--jobs", "2"]
    ours, poor = tmp_path / "ours" / name, tmp_path / "poor" / name
    for folder in (ours.parent, poor.parent):
        folder.mkdir()
    run = [sys.executable, "-m", "pc2scan", "convert", str(ROOT / "fixtures" / "hall.mcap"), "-o", str(ours), *options]
    subprocess.run(run, check=True, capture_output=True, env=environment())
    done = run_poorly("convert", ROOT / "fixtures" / "hall.mcap", "-o", poor, *options)
    assert done.returncode == 0, done.stderr
    assert contents(poor) == contents(ours)
    assert [entry.name for entry in poor.parent.iterdir()] == [name]
    again = run_poorly("convert", ROOT / "fixtures" / "hall.mcap", "-o", poor, *options)
    assert again.returncode == 2
    assert "exists already" in again.stderr


def contents(path: Path) -> dict[str, bytes]:
    files = [path] if path.is_file() else sorted(path.iterdir())
    return {file.name: file.read_bytes() for file in files}


def test_reading_at_places_without_pread(tmp_path: Path) -> None:
    data = os.urandom(1 << 20)
    (tmp_path / "file").write_bytes(data)
    descriptor = os.open(tmp_path / "file", os.O_RDONLY | system.BINARY)
    places = [(length, offset) for offset in range(0, len(data) + 5, 997) for length in (0, 1, 4096)]
    try:
        with ThreadPoolExecutor(4) as pool:
            found = pool.map(lambda place: system.sought_and_read(descriptor, *place), places)
            assert list(found) == [data[offset : offset + length] for length, offset in places]
    finally:
        os.close(descriptor)


def windows(monkeypatch: pytest.MonkeyPatch, locking: object) -> None:
    monkeypatch.setitem(sys.modules, "fcntl", None)
    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(LK_NBLCK=2, locking=locking))


def test_locks_on_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    locked: list[tuple[int, int]] = []
    windows(monkeypatch, lambda _, kind, size: locked.append((kind, size)))
    with staged(tmp_path / "out", overwrite=False) as partial:
        partial.touch()
    assert locked == [(2, 1)]

    def refuse(*_: object) -> NoReturn:
        raise OSError(errno.EACCES, "Permission denied")

    windows(monkeypatch, refuse)
    with pytest.raises(DestinationError, match="by another run"), staged(tmp_path / "other", overwrite=False):
        pytest.fail("the body must not run")


def test_a_lock_that_is_open_cannot_be_removed_on_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    removed: list[bool] = []
    unlink, close = Path.unlink, os.close
    is_open = set()

    def opened(path: Path) -> int:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT)
        is_open.add(descriptor)
        return descriptor

    def closed(descriptor: int) -> None:
        is_open.discard(descriptor)
        close(descriptor)

    def unlinked(path: Path, missing_ok: bool = False) -> None:
        if path.name.endswith(".lock"):
            removed.append(not is_open)
            if is_open:
                raise PermissionError(errno.EACCES, "in use")
        unlink(path, missing_ok)

    monkeypatch.setattr(run_lock, "_open_lock", opened)
    monkeypatch.setattr(os, "close", closed)
    monkeypatch.setattr(Path, "unlink", unlinked)
    with staged(tmp_path / "out", overwrite=False) as partial:
        partial.touch()
    assert removed == [False, True]
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("nul", "device"),
        ("COM1.bag", "device"),
        ("con .mcap", "device"),
        ("10:30.bag", "has :"),
        ("what?.bag", r"has \?"),
        ("scan.", "drops"),
        ("console.bag", ""),
        ("scan.bag", ""),
    ],
)
def test_names_that_windows_cannot_have(
    name: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_place(tmp_path / name)
    monkeypatch.setattr(system, "os", SimpleNamespace(name="nt"))
    if not reason:
        check_place(tmp_path / name)
        return
    with pytest.raises(DestinationError, match=reason):
        check_place(tmp_path / name)
