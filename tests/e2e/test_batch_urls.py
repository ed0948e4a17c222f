"""``pc2scan batch`` where sources and results are at URLs: in an S3 server on this computer, and in its folders."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from batch.datasets import contents
from pc2scan.errors import DestinationError, MissingError, RecordingError, UsageError
from support.builders import CONTENT, write_mcap, write_rosbag1, write_rosbag2
from support.command import COMMAND, INTERRUPTED
from support.command import environment as plain_environment

if TYPE_CHECKING:
    from pathlib import Path

fsspec = pytest.importorskip("fsspec")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and locks of POSIX")

HEIGHTS = ("--min-height", "-2", "--max-height", "2")
KEYWORDS: dict[str, Any] = {"min_height": -2, "max_height": 2}


@pytest.fixture
def s3(s3_server: dict[str, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """A file system with an empty bucket of the test's own, and an environment that leads there."""
    for name, value in s3_server.items():
        monkeypatch.setenv(name, value)
    fs = fsspec.filesystem("s3", skip_instance_cache=True)
    fs.bucket = tmp_path.name.replace("_", "-").lower()
    fs.mkdir(fs.bucket)
    return fs


def make_drives(folder: Path) -> Path:
    """Recordings of all containers, two parts of one, and files that are not recordings."""
    (folder / "robot1").mkdir(parents=True)
    write_rosbag1(folder / "a.bag", CONTENT)
    write_mcap(folder / "b.mcap", CONTENT)
    write_rosbag2(folder / "robot1" / "c", CONTENT)
    for number, part in enumerate(CONTENT.halves()):
        write_mcap(folder / "robot1" / f"drive_{number}.mcap", part)
    (folder / "robot1" / "notes.txt").write_text("no recording")
    (folder / "empty.bag").write_bytes(b"")
    return folder


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    return make_drives(tmp_path / "drives")


@pytest.fixture
def scratch(tmp_path: Path) -> Path:
    folder = tmp_path / "scratch"
    folder.mkdir()
    return folder


def upload(fs: Any, folder: Path, key: str) -> str:
    fs.put(f"{folder}/", f"{fs.bucket}/{key}/", recursive=True)
    return f"s3://{fs.bucket}/{key}"


def download(fs: Any, key: str, folder: Path) -> dict[str, bytes]:
    fs.invalidate_cache()
    folder.mkdir()
    for path in fs.find(f"{fs.bucket}/{key}"):
        below = folder / path.removeprefix(f"{fs.bucket}/{key}/")
        below.parent.mkdir(parents=True, exist_ok=True)
        fs.get_file(path, str(below))
    return contents(folder)


def batch(*words: str | Path, timeout: float = 120) -> subprocess.CompletedProcess[str]:
    command = [*COMMAND, "batch", *map(str, words), *HEIGHTS]
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout,
        env=plain_environment() | dict(os.environ),
    )


def lines_of(data: bytes) -> dict[str, dict[str, Any]]:
    return {line["key"]: line for line in map(json.loads, data.splitlines())}


def test_a_bucket_becomes_what_a_folder_becomes(s3: Any, drives: Path, scratch: Path, tmp_path: Path) -> None:
    source, out = upload(s3, drives, "in"), f"s3://{s3.bucket}/out"
    words = (source, "-o", out, "--scratch", scratch, "--report", tmp_path / "report.json")
    done = batch(*words)
    assert done.returncode == 1, done.stderr
    assert "failed: empty.bag: is empty" in done.stderr
    assert list(scratch.iterdir()) == []
    local = batch(drives, "-o", tmp_path / "local")
    assert local.returncode == 1
    assert download(s3, "out", tmp_path / "got") == contents(tmp_path / "local")

    manifest = s3.cat_file(f"{s3.bucket}/out/manifest.jsonl")
    assert str(scratch) not in manifest.decode() + (tmp_path / "report.json").read_text() + done.stdout + done.stderr
    lines = lines_of(manifest)
    assert lines["robot1/drive_0.mcap"]["source"]["paths"] == [f"{source}/robot1/drive_{n}.mcap" for n in (0, 1)]
    assert lines["a.bag"]["report"]["destination"] == f"{out}/a_scan.bag"
    etag = s3.info(f"{s3.bucket}/in/a.bag")["ETag"].strip('"')
    assert lines["a.bag"]["source"]["files"] == [["a.bag", (drives / "a.bag").stat().st_size, etag]]
    assert not s3.exists(f"{s3.bucket}/out/.pc2scan-begun.json")
    assert not s3.exists(f"{s3.bucket}/out/.pc2scan-lock")

    # Only what is missing, changed or failed is done again.
    (tmp_path / "report.json").unlink()
    again = batch(*words)
    assert "4 unchanged" in again.stderr, again.stderr
    s3.rm_file(f"{s3.bucket}/out/a_scan.bag")
    s3.pipe_file(f"{s3.bucket}/out/b_scan.mcap", b"edited")
    s3.put_file(str(drives / "a.bag"), f"{s3.bucket}/in/b.mcap")
    write_rosbag2(tmp_path / "new", CONTENT.halves()[0])
    s3.put(f"{tmp_path / 'new'}/", f"{s3.bucket}/in/robot1/c/", recursive=True)
    (tmp_path / "report.json").unlink()
    again = batch(*words)
    assert "1 its output is missing" in again.stderr, again.stderr
    assert "2 the source was changed" in again.stderr
    whole = pc2scan.info(tmp_path / "local" / "robot1" / "c_scan").as_dict()
    assert pc2scan.info(f"{out}/robot1/c_scan").as_dict()["duration_ns"] < whole["duration_ns"]


def test_one_end_at_a_url(s3: Any, drives: Path, scratch: Path, tmp_path: Path) -> None:
    source = upload(s3, drives, "in")
    pc2scan.batch(drives, tmp_path / "local", **KEYWORDS)
    expected = contents(tmp_path / "local")
    pc2scan.batch(f"{source}/", tmp_path / "here", scratch=scratch, scratch_size="1GB", **KEYWORDS)
    assert contents(tmp_path / "here") == expected
    pc2scan.batch(drives, f"s3://{s3.bucket}/out", scratch=scratch, **KEYWORDS)
    assert download(s3, "out", tmp_path / "got") == expected
    assert list(scratch.iterdir()) == []


def test_globs_single_files_and_lists(s3: Any, drives: Path, tmp_path: Path) -> None:
    source = upload(s3, drives, "in")

    def keys(*sources: str | Path) -> set[str]:
        report = pc2scan.batch([*map(str, sources)], tmp_path / "out", dry_run=True, **KEYWORDS)
        return {outcome.key for outcome in report.outcomes}

    assert keys(f"{source}/*.bag") == {"a.bag", "empty.bag"}
    assert keys(f"{source}/**/*.mcap") == {"b.mcap", "robot1/drive_0.mcap"} | {
        key for key in keys(f"{source}/**/*.mcap") if key.startswith("robot1/c/")
    }
    assert keys(f"{source}/a.bag", f"{source}/robot1/c") == {"a.bag", "c"}
    assert keys(f"{source}/a.bag", drives / "b.mcap") == {"a.bag", "b.mcap"}
    (tmp_path / "list.txt").write_text(f"# drives\n{source}/a.bag\n{drives}/b.mcap\n")
    assert keys(tmp_path / "list.txt") == {"a.bag", "b.mcap"}
    s3.pipe_file(f"{s3.bucket}/in/list.txt", b"a.bag\nrobot1/c\n")
    assert keys(f"{source}/list.txt") == {"a.bag", "robot1/c"}
    with pytest.raises(UsageError, match="matches nothing"):
        keys(f"{source}/*.db3")
    with pytest.raises(MissingError, match="does not exist"):
        keys(f"{source}/none.bag")


def test_keys_with_the_signs_of_queries_and_fragments(s3: Any, drives: Path, tmp_path: Path) -> None:
    """In a bucket they are parts of the name; `?` is also a pattern, which matches itself."""
    for name in ("drive#1.bag", "drive#2.bag", "drive?3.bag"):
        s3.put_file(str(drives / "a.bag"), f"{s3.bucket}/signs/{name}")
    single = [f"s3://{s3.bucket}/signs/drive{sign}.bag" for sign in ("#1", "#2", "?3")]
    pc2scan.batch(single, tmp_path / "out", **KEYWORDS)
    expected = {f"drive{sign}_scan.bag" for sign in ("#1", "#2", "?3")}
    assert {path.name for path in (tmp_path / "out").glob("*.bag")} == expected
    pc2scan.batch(f"s3://{s3.bucket}/signs", tmp_path / "folder", **KEYWORDS)
    assert {path.name for path in (tmp_path / "folder").glob("*.bag")} == expected
    pc2scan.convert(single[0], f"s3://{s3.bucket}/made #1?.bag", min_height=-0.3)
    assert pc2scan.info(f"s3://{s3.bucket}/made #1?.bag").topics
    with pytest.raises(MissingError, match=r"signs/drive#9\.bag: does not exist"):
        pc2scan.info(f"s3://{s3.bucket}/signs/drive#9.bag")


def test_the_results_of_a_run_are_no_sources(s3: Any, drives: Path) -> None:
    source = upload(s3, drives, "in")
    for expected in (0, 4):
        report = pc2scan.batch(source, f"{source}/scans", **KEYWORDS)
        assert (len(report.outcomes), report.unchanged) == (5, expected)
    with pytest.raises(UsageError, match="is a source, and"):
        pc2scan.batch(source, source, **KEYWORDS)


def test_what_is_not_of_a_batch_is_not_replaced(s3: Any, drives: Path) -> None:
    source = upload(s3, drives, "in")
    s3.pipe_file(f"{s3.bucket}/out/a_scan.bag", b"mine")
    report = pc2scan.batch(f"{source}/a.bag", f"s3://{s3.bucket}/out", **KEYWORDS)
    assert "exists already" in report.outcomes[0].error
    assert s3.cat_file(f"{s3.bucket}/out/a_scan.bag") == b"mine"
    assert pc2scan.batch(f"{source}/a.bag", f"s3://{s3.bucket}/out", overwrite=True, **KEYWORDS).exit_status == 0


def test_numbered_files(s3: Any, drives: Path, tmp_path: Path) -> None:
    source, out = upload(s3, drives, "in"), f"s3://{s3.bucket}/out"
    report = pc2scan.batch(f"{source}/a.bag", out, split="20ms", **KEYWORDS)
    count = len(s3.ls(f"{s3.bucket}/out", refresh=True)) - 1
    assert report.outcomes[0].output == "a_scan_0.bag"
    assert count > 2
    assert pc2scan.batch(f"{source}/a.bag", out, split="20ms", **KEYWORDS).unchanged == 1
    s3.rm_file(f"{s3.bucket}/out/a_scan_1.bag")
    assert pc2scan.batch(f"{source}/a.bag", out, split="20ms", **KEYWORDS).unchanged == 0
    # All are replaced, those too many are removed.
    pc2scan.batch(f"{source}/a.bag", out, split="1h", **KEYWORDS)
    assert sorted(download(s3, "out", tmp_path / "got")) == ["a_scan_0.bag"]


def test_objects_of_others_stay(s3: Any, drives: Path, tmp_path: Path) -> None:
    """Numbered files that no run wrote, and objects in the folder of a result."""
    words = (drives / "a.bag", "-o", f"s3://{s3.bucket}/out")
    assert batch(*words, "--split", "10ms").returncode == 0
    parts = sorted(name.rpartition("/")[2] for name in s3.find(f"{s3.bucket}/out") if name.endswith(".bag"))
    assert len(parts) > 2
    mine = f"{s3.bucket}/out/a_scan_{len(parts)}.bag"
    s3.pipe_file(mine, b"mine")
    assert batch(*words, "--split", "1h").returncode == 0
    s3.invalidate_cache()
    left = [name for name in s3.find(f"{s3.bucket}/out") if name.endswith(".bag")]
    assert left == sorted([f"{s3.bucket}/out/a_scan_0.bag", mine])
    line = lines_of(s3.cat_file(f"{s3.bucket}/out/manifest.jsonl"))["a.bag"]
    assert any("named like a part of a_scan.bag" in text for text in line["report"]["warnings"])

    export = (drives / "a.bag", "-o", f"s3://{s3.bucket}/arrays", "--export")
    assert batch(*export, "npz").returncode == 0
    s3.pipe_file(f"{s3.bucket}/arrays/a/labels.npz", b"mine")
    before = download(s3, "arrays/a", tmp_path / "before")
    for more in ((), ("--overwrite",)):
        done = batch(*export, "csv", *more)
        assert (done.returncode, "a/labels.npz" in done.stderr) == (1, True), done.stderr
    assert download(s3, "arrays/a", tmp_path / "after") == before
    s3.rm_file(f"{s3.bucket}/arrays/a/labels.npz")
    assert batch(*export, "csv").returncode == 0
    assert set(download(s3, "arrays/a", tmp_path / "done")) == {"scan.csv", ".pc2scan-files.json"}


def test_exported_files(s3: Any, drives: Path, tmp_path: Path) -> None:
    source = upload(s3, drives, "in")
    pc2scan.batch(f"{source}/a.bag", f"s3://{s3.bucket}/out", export="pcd")
    pc2scan.batch(drives / "a.bag", tmp_path / "local", export="pcd")
    assert download(s3, "out", tmp_path / "got") == contents(tmp_path / "local")
    assert pc2scan.batch(f"{source}/a.bag", f"s3://{s3.bucket}/out", export="pcd").unchanged == 1


def test_the_room_is_bounded(s3: Any, drives: Path, scratch: Path, tmp_path: Path) -> None:
    source = upload(s3, drives, "in")
    sizes = {path.name: path.stat().st_size for path in drives.glob("*.*")}
    most = sizes["a.bag"] - 1
    report = pc2scan.batch(
        [f"{source}/a.bag", f"{source}/b.mcap"], tmp_path / "out", scratch=scratch, scratch_size=f"{most}B", **KEYWORDS
    )
    by_key = {outcome.key: outcome for outcome in report.outcomes}
    assert f" may have {most:,}" in by_key["a.bag"].error
    assert by_key["b.mcap"].outcome == "converted"
    # The result, too.
    report = pc2scan.batch(
        f"{source}/a.bag",
        f"s3://{s3.bucket}/out",
        scratch=scratch,
        scratch_size=f"{sizes['a.bag'] + 1}B",
        keep_clouds=True,
        **KEYWORDS,
    )
    assert "take more than" in report.outcomes[0].error
    assert not s3.exists(f"{s3.bucket}/out/a_scan.bag")
    with pytest.raises(pc2scan.Pc2ScanError, match="take more than"):
        pc2scan.convert(
            f"{source}/a.bag",
            f"s3://{s3.bucket}/x.bag",
            scratch=scratch,
            scratch_size=f"{sizes['a.bag'] + 1}B",
            keep_clouds=True,
            **KEYWORDS,
        )
    assert not s3.exists(f"{s3.bucket}/x.bag")
    assert list(scratch.iterdir()) == []


def test_two_runs_into_one_folder(s3: Any, drives: Path) -> None:
    out = f"s3://{s3.bucket}/out"
    lock = {"host": os.uname().nodename, "pid": os.getppid(), "run": "other", "sign": 1}
    s3.pipe_file(f"{s3.bucket}/out/.pc2scan-lock", json.dumps(lock).encode())
    with pytest.raises(DestinationError, match="another batch is writing into this folder"):
        pc2scan.batch(drives, out, **KEYWORDS)
    # The process that held it was killed.
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    s3.pipe_file(f"{s3.bucket}/out/.pc2scan-lock", json.dumps(lock | {"pid": child.pid}).encode())
    assert pc2scan.batch(drives / "a.bag", out, **KEYWORDS).exit_status == 0
    assert not s3.exists(f"{s3.bucket}/out/.pc2scan-lock")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_run_leaves_no_copies_and_goes_on(
    how: signal.Signals, s3: Any, scratch: Path, tmp_path: Path
) -> None:
    drives = tmp_path / "many"
    drives.mkdir()
    for number in range(12):
        write_rosbag1(drives / f"d{number:02}x.bag", CONTENT)
    source, out = upload(s3, drives, "in"), f"s3://{s3.bucket}/out"
    command = [*COMMAND, "batch", source, "-o", out, "--scratch", str(scratch), *HEIGHTS]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, env=plain_environment() | dict(os.environ)
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if b" -> " in line:
                break
        process.send_signal(how)
        process.stderr.read()
    if how == signal.SIGINT:
        assert process.returncode in INTERRUPTED
        assert list(scratch.iterdir()) == []
        # What was done is known.
        assert s3.cat_file(f"{s3.bucket}/out/manifest.jsonl")
    done = batch(source, "-o", out, "--scratch", scratch)
    assert done.returncode == 0, done.stderr
    assert "not written by this batch" not in done.stderr
    assert list(scratch.iterdir()) == []
    pc2scan.batch(drives, tmp_path / "local", **KEYWORDS)
    assert download(s3, "out", tmp_path / "got") == contents(tmp_path / "local")


def test_a_web_server_has_single_files(tmp_path: Path, drives: Path) -> None:
    pytest.importorskip("aiohttp", reason="aiohttp reads https")
    import threading
    from functools import partial
    from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(drives))) as web:
        threading.Thread(target=web.serve_forever, daemon=True).start()
        place = f"127.0.0.1:{web.server_port}"
        done = batch(f"http://me:secret@{place}/a.bag?token=geheim", "-o", tmp_path / "out", "-v")
        web.shutdown()
    assert done.returncode == 0, done.stderr
    manifest = (tmp_path / "out" / "manifest.jsonl").read_text()
    assert f"http://{place}/a.bag" in manifest
    for secret in ("secret", "geheim"):
        assert secret not in manifest + done.stdout + done.stderr


def test_a_bucket_that_is_not_there(s3: Any, tmp_path: Path) -> None:
    with pytest.raises((MissingError, RecordingError)):
        pc2scan.batch("s3://no-such-bucket-here/in", tmp_path / "out", **KEYWORDS)
    with pytest.raises(pc2scan.Pc2ScanError, match="no such bucket"):
        pc2scan.batch("s3://no-such-bucket-here/in", "s3://no-such-bucket-here/out", **KEYWORDS)
    assert s3.exists(s3.bucket)


def test_words_about_urls_without_one(drives: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no source and no destination is a URL"):
        pc2scan.batch(drives, tmp_path / "out", scratch_size="1GB", **KEYWORDS)


def test_workers_of_a_cluster_copy_for_themselves(
    s3: Any, s3_server: dict[str, str], drives: Path, scratch: Path, tmp_path: Path
) -> None:
    pytest.importorskip("psutil", reason="distributed needs it")
    pytest.importorskip("distributed", reason="distributed is not installed")
    from batch.test_cluster import cluster

    source, out = upload(s3, drives, "in"), f"s3://{s3.bucket}/out"
    with cluster(tmp_path, **s3_server) as address:
        done = batch(source, "-o", out, "--scratch", scratch, "--dask", address)
        again = batch(source, "-o", out, "--dask", address)
    assert done.returncode == 1, done.stderr
    assert "failed: empty.bag: is empty" in done.stderr
    assert "4 unchanged" in again.stderr, again.stderr
    assert list(scratch.iterdir()) == []
    batch(drives, "-o", tmp_path / "local")
    assert download(s3, "out", tmp_path / "got") == contents(tmp_path / "local")
    logs = "".join(path.read_text(errors="replace") for path in tmp_path.glob("*.log"))
    assert "testing-secret" not in logs + done.stderr
