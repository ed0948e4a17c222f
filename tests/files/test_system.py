"""Locks, and what other operating systems lack, taken away from this one."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, NoReturn

import pytest

from pc2scan.errors import DestinationError, OutputError
from pc2scan.files import staging, system
from pc2scan.files.staging import staged_output
from support import ROOT, sampled
from support.batches import contents
from support.command import environment, run

if TYPE_CHECKING:
    from collections.abc import Callable

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


def test_places_are_read_without_pread(tmp_path: Path) -> None:
    data = os.urandom(1 << 20)
    (tmp_path / "file").write_bytes(data)
    descriptor = os.open(tmp_path / "file", os.O_RDONLY | system.BINARY)
    places = [(length, offset) for offset in range(0, len(data) + 5, 997) for length in (0, 1, 4096)]
    try:
        with ThreadPoolExecutor(4) as pool:
            found = pool.map(lambda place: system.seek_and_read(descriptor, *place), places)
            assert list(found) == [data[offset : offset + length] for length, offset in places]
    finally:
        os.close(descriptor)


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
def test_names_that_windows_cannot_have_are_refused(
    name: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / name)
    (tmp_path / name).unlink()
    monkeypatch.setattr(system, "os", SimpleNamespace(**{**vars(os), "name": "nt"}))
    if reason:
        with pytest.raises(DestinationError, match=reason):
            write(tmp_path / name)
    else:
        write(tmp_path / name)


# --- A destination is written by one run at a time ---


def write(path: Path) -> None:
    with staged_output(path, overwrite=False) as partial:
        partial.touch()


def test_a_second_run_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    program = (
        "import sys, pathlib\n"
        "from pc2scan.files.staging import staged_output\n"
        "with staged_output(pathlib.Path(sys.argv[1]), overwrite=True) as partial:\n"
        "    partial.write_text('other'); print('ready', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path / "out")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(Path(staging.__file__).parents[2])},
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


def refuse(number: int) -> Callable[..., NoReturn]:
    def raises(*_: object) -> NoReturn:
        raise OSError(number, os.strerror(number))

    return raises


def test_a_run_goes_on_where_files_cannot_be_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(fcntl, "flock", refuse(errno.ENOLCK))
    write(tmp_path / "file system")
    monkeypatch.setitem(sys.modules, "fcntl", None)
    write(tmp_path / "windows")
    assert sorted(contents(tmp_path)) == ["file system", "windows"]
    monkeypatch.setattr(staging, "_acquire", refuse(errno.EROFS))
    with pytest.raises(OutputError, match="Read-only file system"):
        write(tmp_path / "out")


def test_windows_locks_a_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    locked: list[tuple[int, int]] = []

    def windows(locking: Callable[..., object]) -> None:
        monkeypatch.setitem(sys.modules, "fcntl", None)
        monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(LK_NBLCK=2, locking=locking))

    windows(lambda _, kind, size: locked.append((kind, size)))
    write(tmp_path / "out")
    assert locked == [(2, 1)]
    windows(refuse(errno.EACCES))
    with pytest.raises(DestinationError, match="by another run"):
        write(tmp_path / "other")


def test_an_open_lock_cannot_be_removed_on_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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

    monkeypatch.setattr(staging, "_open_lock", opened)
    monkeypatch.setattr(os, "close", closed)
    monkeypatch.setattr(Path, "unlink", unlinked)
    write(tmp_path / "out")
    assert removed == [False, True]
    assert contents(tmp_path) == {"out": b""}
