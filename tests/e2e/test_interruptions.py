"""A conversion that cannot go on leaves nothing behind: signals, full disks, forbidden folders."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import time
from contextlib import closing, contextmanager
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.errors import Pc2ScanError
from support import ROOT, sampled
from support.batches import manifest_of
from support.builders import POINTS, T0, Recording, cloud, item, write_rosbag1
from support.command import COMMAND, INTERRUPTED, Finished, run

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


def recorded(path: Path, clouds: int, size: int) -> Path:
    """Random points do not compress: what is written is about as large as what is read."""
    points = np.random.default_rng(1).normal(0, 5, (size, 3)).astype(np.float32)
    items = [item(POINTS, T0 + step, lambda g, s: cloud(np.roll(points, s), g, seq=s), step) for step in range(clouds)]
    return write_rosbag1(path, Recording((POINTS,), tuple(items)))


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of some 46 MB: when the first are written, there are seconds of work left, also for fast machines."""
    return recorded(tmp_path_factory.mktemp("large") / "drive.bag", 64, 60_000)


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 3 MB, in the midst of which progress is told."""
    return recorded(tmp_path_factory.mktemp("many") / "drive.bag", 200, 1_200)


@contextmanager
def half_done(source: Path, destination: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own, whose output is being written."""
    command = [*COMMAND, "convert", str(source), "-o", str(destination), "--keep-clouds", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60
        # More than the first transaction of a database, which has 1 MB, and is undone if it is not complete.
        while not any(
            "partial" in str(path) and path.is_file() and path.stat().st_size > 3_000_000
            for path in destination.parent.rglob("*")
        ):
            assert process.poll() is None, "the command ended before it could be interrupted"
            assert time.monotonic() < deadline, "nothing was written within a minute"
            time.sleep(0.005)
        yield process


def ended(process: subprocess.Popen[str]) -> Finished:
    stdout, stderr = process.communicate(timeout=60)
    assert "Traceback" not in stderr
    return Finished(process.returncode, stdout, stderr)


DESTINATIONS = {
    "mcap": ("out.mcap", "--compression", "zstd", "--angle-increment", "0.00001"),
    "bag": ("out.bag", "--compression", "bz2"),
    "sqlite3": ("out", "--storage", "sqlite3", "--compression", "zstd", "--angle-increment", "0.000004"),
}
SIGNALS = [("mcap", signal.SIGINT, INTERRUPTED), ("bag", signal.SIGTERM, (143,)), ("sqlite3", signal.SIGHUP, (129,))]


@pytest.mark.parametrize(("kind", "sent", "statuses"), sampled(SIGNALS, 1))
def test_a_signal_leaves_nothing(kind: str, sent: int, statuses: tuple[int, ...], large: Path, tmp_path: Path) -> None:
    name, *options = DESTINATIONS[kind]
    with half_done(large, tmp_path / name, *options) as process:
        process.send_signal(sent)
        done = ended(process)
    assert done.status in statuses, done.stderr
    assert list(tmp_path.iterdir()) == []
    assert done.stdout == ""
    # Who pressed Ctrl-C reads the terminal; who sent another signal reads the exit status.
    assert sent != signal.SIGINT or "interrupted" in done.stderr


@pytest.mark.parametrize("kind", sampled(DESTINATIONS, 1))
def test_what_a_killed_run_left_is_recovered_and_no_obstacle(kind: str, large: Path, tmp_path: Path) -> None:
    name, *options = DESTINATIONS[kind]
    (tmp_path / "out").mkdir()
    destination = tmp_path / "out" / name
    with half_done(large, destination, *options) as process:
        process.kill()
    repaired = tmp_path / ("repaired" + destination.suffix)
    done = run("repair", destination.with_name(f"{name}.pc2scan-partial"), "-o", repaired)
    # A database that ends with a transaction is sound: nothing in it says that there was to be more.
    assert done.status == 3 or (kind == "sqlite3" and done.status == 0), done.stderr
    with closing(open_recording(repaired)) as reader:
        assert len(list(reader.messages())) > 0
    done = run("convert", ROOT / "fixtures" / "hall.bag", "-o", destination)
    assert done.status == 0, done.stderr
    assert [path.name for path in destination.parent.iterdir()] == [name]


# --- No room ---


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system with room for 4 MB."""
    mount, unmount = shutil.which("mount"), shutil.which("umount")
    if os.name != "posix" or os.geteuid() != 0 or mount is None or unmount is None:
        pytest.skip("only root may mount a small file system")
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        [mount, "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(folder)], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"a small file system cannot be mounted here: {mounted.stderr.strip()}")
    yield folder
    subprocess.run([unmount, str(folder)], check=True)


FULL = {
    "bag": ("out.bag", "--compression", "none"),
    "mcap": ("out.mcap", "--compression", "none"),
    "rosbag2": ("out", "--compression", "none"),
    "sqlite3": ("out", "--storage", "sqlite3"),
}


@pytest.mark.parametrize("kind", FULL)
def test_a_full_disk(kind: str, large: Path, small_disk: Path) -> None:
    name, *options = FULL[kind]
    done = run("convert", large, "-o", small_disk / name, "--keep-clouds", *options)
    assert (done.status, done.stdout) == (1, ""), done.stderr
    assert "Traceback" not in done.stderr
    assert "No space left" in done.stderr or "full" in done.stderr
    assert str(small_disk / name) in done.stderr
    assert done.stderr.endswith("hint: make room on that disk\n")
    assert list(small_disk.iterdir()) == []


def test_a_full_disk_ends_a_batch(small_disk: Path, tmp_path: Path) -> None:
    """Without room, all that follow would fail one after the other. With room, the same command converts them."""
    count = 4
    (tmp_path / "in").mkdir()
    for number in range(count):
        shutil.copyfile(ROOT / "fixtures" / "hall.bag", tmp_path / "in" / f"{number}.bag")
    out, others, report = small_disk / "out", small_disk / "others", tmp_path / "report.json"
    others.write_bytes(bytes(3_300_000))
    # Each result has some 300 kB.
    words: list[str | Path] = ["batch", tmp_path / "in", "-o", out, "--jobs", "2", "--min-height=-1", "--keep-clouds"]
    done = run(*words, "--report", report)
    assert (done.status, done.stdout) == (5, ""), done.stderr
    assert "failed" not in done.stderr
    said = " ".join(done.stderr.split())
    assert re.search(f"error: {out}/.*No space left", said), said
    assert "hint: make room on that disk, and run the same command again" in said
    lines = manifest_of(out)
    assert {line["outcome"] for line in lines.values()} <= {"begun", "converted", "stopped"}
    converted = [line for line in lines.values() if line["outcome"] == "converted"]
    assert not report.exists()
    assert [path for path in small_disk.rglob("*") if "partial" in path.name] == []
    others.unlink()
    done = run(*words, "--report", report)
    assert done.status == 0, done.stderr
    unchanged = f"; {len(converted)} unchanged since" if converted else "\n"
    assert f"{count} recordings: {count} converted{unchanged}" in done.stdout
    assert len(list(out.glob("?_scan*"))) == count


# --- What changes meanwhile ---


def failed(source: Path, destination: Path, meanwhile: Callable[[], object], **options: Any) -> str:
    """The error of a conversion in the midst of which something happens, and after which nothing is left."""
    happened: list[object] = []

    def progress(*_: int) -> None:
        if not happened:
            happened.append(meanwhile())

    with pytest.raises(Pc2ScanError) as caught:
        pc2scan.convert(source, destination, keep_clouds=True, progress=progress, **options)
    assert happened
    assert not destination.parent.exists() or list(destination.parent.iterdir()) == []
    return str(caught.value)


@pytest.fixture
def output(tmp_path: Path) -> Path:
    (tmp_path / "output").mkdir()
    return tmp_path / "output" / "out.bag"


def overwritten(path: Path, *, set_back: bool) -> None:
    """Write over the first bytes in place; the modification time can be what it was before."""
    before = path.stat()
    with path.open("rb+") as file:
        file.write(b"more")
    if set_back:
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def appended(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"more")


CHANGES: dict[str, Callable[[Path], object]] = {
    "appended": appended,
    "cut": lambda path: os.truncate(path, 200_000),
    "written over": lambda path: overwritten(path, set_back=False),
    "written over, time set back": lambda path: overwritten(path, set_back=True),
    "removed": lambda path: path.unlink(),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_source_that_changes_while_it_is_read(change: str, many: Path, output: Path, tmp_path: Path) -> None:
    source = tmp_path / "drive.bag"
    shutil.copy(many, source)
    assert "drive.bag" in failed(source, output, lambda: CHANGES[change](source))


def fifth(work: Callable[..., Any], happen: Callable[[], object]) -> Callable[..., Any]:
    """A function at whose fifth call something else happens before."""
    calls = []

    def working(*args: Any) -> Any:
        calls.append(1)
        if len(calls) == 5:
            happen()
        return work(*args)

    return working


FAILING = list(product([RuntimeError, MemoryError, KeyboardInterrupt], [1, 4]))


@pytest.mark.parametrize(("error", "jobs"), sampled(FAILING, 2))
def test_a_worker_that_fails(
    error: type[BaseException], jobs: int, many: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bug in a worker is not hidden, and leaves nothing."""
    from pc2scan.conversion.steps import CloudToScan

    def fail() -> None:
        raise error

    monkeypatch.setattr(CloudToScan, "_make_scan", fifth(CloudToScan._make_scan, fail))
    with pytest.raises(error):
        pc2scan.convert(many, tmp_path / "out.mcap", jobs=jobs)
    assert list(tmp_path.iterdir()) == []


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def lose(*_: object, **_options: object) -> None:
        raise FileNotFoundError(2, "No such file or directory", "lost")

    monkeypatch.setattr("pc2scan.show.info.info", lose)
    assert "Traceback" in run("info", "hall.bag").stderr
