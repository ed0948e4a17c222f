"""A conversion that cannot go on leaves nothing behind: signals, full disks, forbidden folders."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import zstandard

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.errors import RecordingError
from support import ROOT
from support.builders import CONTENT, POINTS, T0, Recording, cloud, item, write_db3, write_rosbag1, write_rosbag2
from support.command import COMMAND, INTERRUPTED, run, run_process

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

#: Random points do not compress: what is written is about as large as what is read.
CLOUDS, SIZE = 40, 60_000


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of some 30 MB, of which bzip2 has seconds of work."""
    points = np.random.default_rng(1).normal(0, 5, (SIZE, 3)).astype(np.float32)
    items = [item(POINTS, T0 + step, lambda g, s: cloud(np.roll(points, s), g, seq=s), step) for step in range(CLOUDS)]
    return write_rosbag1(tmp_path_factory.mktemp("large") / "drive.bag", Recording((POINTS,), tuple(items)))


def half_done(process: subprocess.Popen[str], folder: Path) -> bool:
    """Wait until the output is being written; False if the command ended before."""
    deadline = time.monotonic() + 60
    while process.poll() is None:
        assert time.monotonic() < deadline, "nothing was written within a minute"
        files = [path for path in folder.rglob("*") if path.is_file() and "partial" in str(path)]
        if any(path.stat().st_size > 1_000_000 for path in files):
            return True
        time.sleep(0.005)
    return False


DESTINATIONS = {
    "bag": ("out.bag", "--compression", "bz2"),
    "mcap": ("out.mcap", "--compression", "zstd", "--angle-increment", "0.00001"),
    "sqlite3": ("out", "--storage", "sqlite3", "--compression", "zstd", "--angle-increment", "0.000004"),
}


@pytest.mark.parametrize("kind", DESTINATIONS)
@pytest.mark.parametrize(("number", "statuses"), [(signal.SIGINT, INTERRUPTED), (signal.SIGTERM, (143,))])
def test_a_signal_leaves_nothing(
    number: int, statuses: tuple[int, ...], kind: str, large: Path, tmp_path: Path
) -> None:
    name, *options = DESTINATIONS[kind]
    command = [*COMMAND, "convert", str(large), "-o", str(tmp_path / name), "--keep-clouds", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert half_done(process, tmp_path), "the command ended before it could be interrupted"
        process.send_signal(number)
        stdout, stderr = process.communicate(timeout=60)
    assert process.returncode in statuses, stderr
    assert list(tmp_path.iterdir()) == []
    assert stdout == ""
    assert "Traceback" not in stderr
    # Who pressed Ctrl-C reads the terminal; who sent SIGTERM reads the exit status.
    assert number == signal.SIGTERM or "nothing was written" in stderr


def test_an_interrupted_overwrite_keeps_what_was_there(large: Path, tmp_path: Path) -> None:
    destination = tmp_path / "out.bag"
    destination.write_bytes(b"precious")
    command = [
        *COMMAND,
        "convert",
        str(large),
        "-o",
        str(destination),
        "--overwrite",
        "--keep-clouds",
        "--compression",
        "bz2",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert half_done(process, tmp_path)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    assert process.returncode in INTERRUPTED
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"out.bag": b"precious"}


def test_what_a_killed_run_left_is_no_obstacle(large: Path, tmp_path: Path) -> None:
    command = [
        *COMMAND,
        "convert",
        str(large),
        "-o",
        str(tmp_path / "out.bag"),
        "--keep-clouds",
        "--compression",
        "bz2",
    ]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True) as process:
        assert half_done(process, tmp_path)
        process.kill()
    assert list(tmp_path.iterdir()) != []
    done = run("convert", large, "-o", tmp_path / "out.bag")
    assert done.status == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["out.bag"]


@pytest.mark.parametrize("kind", DESTINATIONS)
def test_what_a_killed_run_left_is_recovered(kind: str, large: Path, tmp_path: Path) -> None:
    name, *options = DESTINATIONS[kind]
    command = [*COMMAND, "convert", str(large), "-o", str(tmp_path / name), "--keep-clouds", *options]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True) as process:
        assert half_done(process, tmp_path)
        process.kill()
    repaired = tmp_path / ("repaired" + (tmp_path / name).suffix)
    done = run("repair", tmp_path / f"{name}.pc2scan-partial", "-o", repaired)
    # A database that ends with a transaction is sound: nothing in it says that there was to be more.
    assert done.status == 3 or (kind == "sqlite3" and done.status == 0), done.stderr
    with closing(open_recording(repaired)) as reader:
        assert len(list(reader.messages())) > 0


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
    assert done.status == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert "No space left" in done.stderr or "full" in done.stderr
    assert str(small_disk / name) in done.stderr
    assert done.stdout == ""
    assert list(small_disk.iterdir()) == []


def test_a_full_disk_under_an_export(small_disk: Path) -> None:
    """Scans that are shorter than what a file buffers: what could not be written is still there at the end."""
    room = os.statvfs(small_disk)
    (small_disk / "others").write_bytes(bytes(room.f_bavail * room.f_frsize - 8_192))
    out = small_disk / "scans.npz"
    hall = ROOT / "fixtures" / "hall.bag"
    done = run("export", hall, "-o", out, "--min-height=-1", "--angle-increment", "0.007")
    assert done.status == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert f"error: {out}" in done.stderr
    assert "No space left" in done.stderr
    assert [path.name for path in small_disk.iterdir()] == ["others"]


def packed(folder: Path) -> Path:
    """A recording that is compressed as a whole, and unpacks to 10 MB."""
    path = folder / "drive.bag.zst"
    path.write_bytes(zstandard.compress(b"#ROSBAG V2.0\n" + bytes(10_000_000)))
    return path


def with_log(folder: Path) -> Path:
    """A database of 10 MB with a write-ahead log."""
    live, path = folder / "live.db3", write_db3(folder / "drive.db3", CONTENT)
    shutil.copyfile(path, live)
    with closing(sqlite3.connect(live)) as database:
        database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 1, zeroblob(10000000))")
        database.commit()
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 2, x'00')")
        database.commit()
        shutil.copyfile(live, path)
        shutil.copyfile(f"{live}-wal", f"{path}-wal")
    return path


def unsorted(folder: Path) -> Path:
    """A database with many messages and no index that has them in order."""
    path = write_db3(folder / "drive.db3", CONTENT)
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "DROP INDEX timestamp_idx; INSERT INTO messages(topic_id, timestamp, data) WITH RECURSIVE n(i) AS "
            "(SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 400000) SELECT 1, i * 7919 % 400000, x'00' FROM n;"
        )
    return path


@pytest.mark.parametrize("source", [packed, with_log, unsorted])
def test_no_room_for_temporary_files(
    source: Callable[[Path], Path], small_disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = source(tmp_path)
    before = sorted(tmp_path.iterdir())
    monkeypatch.setenv("TMPDIR", str(small_disk))
    # Python and SQLite look the folder up once in a process.
    done = run_process("convert", path, "-o", tmp_path / "out.mcap")
    assert done.status == 1, done.stderr
    assert str(path) in done.stderr
    assert str(small_disk) in done.stderr
    assert "TMPDIR" in done.stderr
    assert list(small_disk.iterdir()) == []
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("kind", FULL)
def test_a_file_that_may_not_grow(kind: str, large: Path, tmp_path: Path) -> None:
    # Like a full disk or a quota, and needs no rights.
    name, *options = FULL[kind]
    command = [*COMMAND, "convert", str(large), "-o", str(tmp_path / name), "--keep-clouds", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (4_000_000, 4_000_000))
        stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 1, stderr
    assert "Traceback" not in stderr
    assert stderr.startswith("error: ")
    assert name in stderr
    assert stdout == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(hasattr(os, "geteuid") and os.geteuid() == 0, reason="root may write anywhere")
@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out"])
def test_a_folder_that_may_not_be_written(name: str, large: Path, tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o555)
    done = run("convert", large, "-o", folder / name)
    folder.chmod(0o755)
    assert done.status == 1
    assert "not writable" in done.stderr
    assert list(folder.iterdir()) == []


def started(large: Path, destination: Path, *options: str) -> subprocess.Popen[str]:
    """A conversion that takes a while."""
    command = [
        *COMMAND,
        "convert",
        str(large),
        "-o",
        str(destination),
        "--keep-clouds",
        "--compression",
        "bz2",
        *options,
    ]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_folder_that_vanishes(large: Path, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    with started(large, folder / "out.bag") as process:
        assert half_done(process, tmp_path)
        folder.rename(tmp_path / "elsewhere")
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in stderr
    assert stderr.startswith("error: ")
    assert not folder.exists()
    assert not (tmp_path / "elsewhere" / "out.bag").exists()


def overwritten(path: Path, *, set_back: bool) -> None:
    """Write over the first bytes in place; the modification time can be what it was before."""
    before = path.stat()
    with path.open("rb+") as file:
        file.write(b"more")
    if set_back:
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


@pytest.mark.parametrize("change", ["appended", "cut", "written over", "written over, time set back", "removed"])
def test_a_source_that_changes_while_it_is_read(change: str, large: Path, tmp_path: Path) -> None:
    source = tmp_path / "source" / "drive.bag"
    source.parent.mkdir()
    shutil.copy(large, source)
    output = tmp_path / "output"
    output.mkdir()
    with started(source, output / "out.bag") as process:
        assert half_done(process, output)
        if change == "removed":
            source.unlink()
        elif change.startswith("written over"):
            overwritten(source, set_back="set back" in change)
        else:
            with source.open("rb+") as file:
                if change == "appended":
                    file.seek(0, os.SEEK_END)
                    file.write(b"more")
                else:
                    file.truncate(2_000_000)
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 1, stderr
    assert "Traceback" not in stderr
    assert "drive.bag" in stderr
    assert list(output.iterdir()) == []


def test_a_log_that_grows_while_its_database_is_read(large: Path, tmp_path: Path) -> None:
    assert run("repair", large, "-o", tmp_path / "drive", "--storage", "sqlite3").status == 0
    (database,) = (tmp_path / "drive").glob("*.db3")
    source = database.rename(tmp_path / "drive.db3")
    output = tmp_path / "output"
    output.mkdir()
    with closing(sqlite3.connect(source)) as recorder:
        recorder.execute("PRAGMA journal_mode = WAL")
        recorder.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 1, x'00')")
        recorder.commit()
        with started(source, output / "out.bag") as process:
            assert half_done(process, output)
            recorder.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 2, x'00')")
            recorder.commit()
            _, stderr = process.communicate(timeout=60)
    assert process.returncode == 1, stderr
    assert "was changed while it was read" in stderr
    assert list(output.iterdir()) == []


@pytest.mark.parametrize("name", ["metadata.yaml", "drive_0.mcap"])
def test_a_directory_whose_file_is_written_over(name: str, large: Path, tmp_path: Path) -> None:
    source = tmp_path / "drive"
    pc2scan.convert(large, source, compression="none", keep_clouds=True)
    output = tmp_path / "output"
    output.mkdir()
    with started(source, output / "out.bag", "--drop", "/scan") as process:
        assert half_done(process, output)
        overwritten(source / name, set_back=True)
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 1, stderr
    assert "drive: was changed while it was read" in stderr
    assert list(output.iterdir()) == []


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("compression", [None, "zstd"])
def test_a_source_that_is_cut_under_its_reader(
    compression: str | None, jobs: int, large: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While its bytes are decompressed or projected."""
    from pc2scan.files import compression as codecs
    from pc2scan.pipeline.cloud_to_scan import CloudToScan

    source = tmp_path / ("drive.mcap" if compression else "drive.bag")
    if compression:
        pc2scan.convert(large, source, compression=compression, keep_clouds=True)
    else:
        shutil.copy(large, source)
    calls = []

    def cut(work: Callable[..., Any]) -> Callable[..., Any]:
        def cutting(*args: Any) -> Any:
            calls.append(1)
            if len(calls) == 5:
                os.truncate(source, 5_000)
            return work(*args)

        return cutting

    if compression:
        monkeypatch.setitem(codecs._DECOMPRESS, compression, cut(codecs._DECOMPRESS[compression]))
    else:
        monkeypatch.setattr(CloudToScan, "_projected", cut(CloudToScan._projected))
    with pytest.raises(RecordingError, match=r"drive.*ended at byte \d+ while it was read; it had"):
        pc2scan.convert(source, tmp_path / "out.mcap", jobs=jobs, only_scans=True, topics=["/points:=/again"])
    assert list(tmp_path.iterdir()) == [source]


@pytest.mark.parametrize("jobs", [1, 4])
@pytest.mark.parametrize("error", [RuntimeError, MemoryError, KeyboardInterrupt])
def test_a_worker_that_fails(
    error: type[BaseException], jobs: int, large: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bug in a worker is not hidden, and leaves nothing."""
    from pc2scan.pipeline.cloud_to_scan import CloudToScan

    work, calls = CloudToScan._projected, []

    def fail(self: CloudToScan, *args: Any) -> Any:
        calls.append(1)
        if len(calls) == 5:
            raise error
        return work(self, *args)

    monkeypatch.setattr(CloudToScan, "_projected", fail)
    with pytest.raises(error):
        pc2scan.convert(large, tmp_path / "out.mcap", jobs=jobs)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["itself", "a link", "a hard link", "through a linked folder"])
def test_a_destination_that_is_the_source(kind: str, tmp_path: Path) -> None:
    source = write_rosbag1(
        tmp_path / "drive.bag",
        Recording((POINTS,), (item(POINTS, T0, lambda g, _: cloud(np.ones((9, 3), np.float32), g)),)),
    )
    before = source.read_bytes()
    destination = {
        "itself": source,
        "a link": tmp_path / "link.bag",
        "a hard link": tmp_path / "hard.bag",
        "through a linked folder": tmp_path / "folder" / "drive.bag",
    }[kind]
    (tmp_path / "link.bag").symlink_to(source)
    (tmp_path / "hard.bag").hardlink_to(source)
    (tmp_path / "folder").symlink_to(tmp_path)
    done = run("convert", source, "-o", destination, "--overwrite")
    assert done.status == 2
    assert "is a source" in done.stderr
    assert source.read_bytes() == before


def test_a_destination_inside_the_source(tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", CONTENT)
    done = run("convert", source, "-o", source / "out.mcap")
    assert done.status == 2
    assert "is inside the source" in done.stderr
    assert sorted(path.name for path in source.iterdir()) == ["drive_0.db3", "metadata.yaml"]


@pytest.mark.parametrize("module", ["typer._click", "pc2scan.errors", "pc2scan.core.presets", "numpy"])
def test_an_interruption_while_modules_are_loaded(module: str, large: Path, tmp_path: Path) -> None:
    """Quiet from the first modules on; what the interpreter itself loads before is not ours."""
    command = [sys.executable, "-X", "importtime", *COMMAND[1:], "convert", str(large), "-o", str(tmp_path / "out.bag")]
    loaded = re.compile(rf"import time:.*\b{re.escape(module)}$")
    ours = False
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            # The line comes when the module has been loaded.
            ours = ours or line.rstrip().endswith("pc2scan.cli")
            if ours and loaded.match(line.rstrip()):
                break
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=60)
    assert ours
    assert process.returncode == 130, stderr
    said = [line for line in stderr.splitlines() if not line.startswith("import time:")]
    assert said in ([], ["interrupted: nothing was written"])
    assert stdout == ""
    assert list(tmp_path.iterdir()) == []


#: The command, in which SIGINT comes right behind a function's n-th call.
_INTERRUPTED_BEHIND = """
import os, signal, sys
module, name, number = sys.argv.pop(1), sys.argv.pop(1), int(sys.argv.pop(1))
from pc2scan.files import staging
owner = {"os": os, "staging": staging}[module]
original, calls = getattr(owner, name), []
def called(*args, **options):
    result = original(*args, **options)
    calls.append(name)
    if len(calls) == number:
        os.kill(os.getpid(), signal.SIGINT)
    return result
setattr(owner, name, called)
from pc2scan.cli import main
main()
"""


@pytest.mark.parametrize(
    ("moment", "name", "written"),
    [
        (("staging", "sync", 1), "out.mcap", []),
        (("os", "link", 1), "out.mcap", ["out.mcap"]),
        (("staging", "sync_directory", 1), "out.mcap", ["out.mcap"]),
        (("staging", "_rename_directory", 1), "out", ["out"]),
        (("os", "link", 2), "out.mcap", ["out.mcap", "report.json"]),
    ],
    ids=str,
)
@pytest.mark.parametrize("overwrite", [False, True])
def test_an_interruption_says_what_was_written(
    moment: tuple[str, str, int], name: str, written: list[str], overwrite: bool, tmp_path: Path
) -> None:
    source = write_rosbag1(tmp_path / "drive.bag", CONTENT)
    out = tmp_path / "out"
    out.mkdir()
    if overwrite and moment[1] in {"sync", "sync_directory"}:
        (out / name).write_bytes(b"old")
    options = ["-o", str(out / name), "--report", str(out / "report.json"), *["--overwrite"] * overwrite]
    command = [sys.executable, "-c", _INTERRUPTED_BEHIND, *map(str, moment), "repair", str(source), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 130, done.stderr
    said = f"{', '.join(str(out / each) for each in written)} {'is' if len(written) == 1 else 'are'} complete"
    assert done.stderr.splitlines()[-1] == f"interrupted: {said if written else 'nothing was written'}"
    left = {path.name: path for path in out.iterdir()}
    assert sorted(left) == sorted(written or ([name] if overwrite and moment[1] == "sync" else []))
    if written:
        assert run("info", out / name).status == 0
    elif left:
        assert left[name].read_bytes() == b"old"
