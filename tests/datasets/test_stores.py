"""Batches whose sources and results are in a store: in memory, and (slow) in an S3 server on this computer."""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from datasets.cluster import cluster
from pc2scan.datasets import folder as batch_folder
from pc2scan.datasets.run import BatchCallbacks, BatchOptions
from pc2scan.datasets.run import run_batch as run_batch_in_process
from pc2scan.errors import DestinationError, MissingError, RecordingError, UsageError
from pc2scan.files.store import _open_files
from pc2scan.files.urls import path_or_url
from support.batches import HEIGHTS, KEYWORDS, batch, contents, place, run_batch
from support.builders import CONTENT, write_mcap, write_rosbag1, write_rosbag2
from support.command import COMMAND, INTERRUPTED
from support.command import environment as plain_environment
from support.stores import memory_store, s3_server

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

fsspec = pytest.importorskip("fsspec")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and locks of POSIX")


class Store:
    """A bucket of the test's own."""

    def __init__(self, fs: Any, scheme: str, bucket: str) -> None:
        self.fs = fs
        self.bucket = bucket
        self.url = f"{scheme}://{bucket}"
        fs.mkdir(bucket)

    def upload(self, folder: Path) -> str:
        """Put a folder into the bucket as ``in``; return its URL."""
        self.fs.put(f"{folder}/", f"{self.bucket}/in/", recursive=True)
        return f"{self.url}/in"

    def put(self, key: str, data: bytes) -> None:
        self.fs.pipe_file(f"{self.bucket}/{key}", data)

    def remove(self, key: str) -> None:
        self.fs.rm_file(f"{self.bucket}/{key}")

    def contents(self, key: str) -> dict[str, bytes]:
        """The bytes below a key; not the manifest."""
        self.fs.invalidate_cache()
        found = {
            path.lstrip("/").removeprefix(f"{self.bucket}/"): path for path in self.fs.find(f"{self.bucket}/{key}")
        }
        return {
            name.removeprefix(f"{key}/"): self.fs.cat_file(path)
            for name, path in found.items()
            if not name.endswith("manifest.jsonl")
        }

    def manifest(self) -> bytes:
        data: bytes = self.fs.cat_file(f"{self.bucket}/out/manifest.jsonl")
        return data

    def line(self, key: str) -> dict[str, Any]:
        """The last line of a recording."""
        lines: list[dict[str, Any]] = [json.loads(line) for line in self.manifest().splitlines()]
        return {line["key"]: line for line in lines}[key]


@pytest.fixture(scope="module")
def s3() -> Iterator[dict[str, str]]:
    with s3_server() as variables:
        yield variables


@pytest.fixture(params=["memory", pytest.param("s3", marks=pytest.mark.slow)])
def store(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Store]:
    bucket = tmp_path.name.replace("_", "-").lower()
    if request.param == "s3":
        for name, value in request.getfixturevalue("s3").items():
            monkeypatch.setenv(name, value)
        yield Store(fsspec.filesystem("s3", skip_instance_cache=True), "s3", bucket)
    else:
        with memory_store(monkeypatch) as fs:
            yield Store(fs, "memory", bucket)
    # A process that runs batch after batch keeps nothing of what was there.
    gc.collect()
    assert not _open_files


#: Tests that start processes, which have no memory in common.
only_s3 = pytest.mark.parametrize("store", [pytest.param("s3", marks=pytest.mark.slow)], indirect=True)


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    """Recordings of all containers, two parts of one, and files that are not recordings."""
    folder = place(tmp_path / "drives", "a.bag", "b.mcap", "robot1/c")
    for number, part in enumerate(CONTENT.halves()):
        write_mcap(folder / "robot1" / f"drive_{number}.mcap", part)
    (folder / "robot1" / "notes.txt").write_text("no recording")
    (folder / "empty.bag").write_bytes(b"")
    return folder


@pytest.fixture
def scratch(tmp_path: Path) -> Path:
    folder = tmp_path / "scratch"
    folder.mkdir()
    return folder


def why(report: Any) -> dict[str, str]:
    return {each.key: each.why for each in report.outcomes if each.action != "refuse"}


def test_a_bucket_becomes_what_a_folder_becomes(store: Store, drives: Path, scratch: Path, tmp_path: Path) -> None:
    source, out = store.upload(drives), f"{store.url}/out"
    done = run_batch(source, "-o", out, "--scratch", scratch, "--report", tmp_path / "report.json")
    assert done.status == 1, done.stderr
    assert "failed: empty.bag: is empty" in done.stderr
    assert list(scratch.iterdir()) == []
    assert batch(drives, tmp_path / "local").exit_status == 1
    # No note is left there.
    assert store.contents("out") == contents(tmp_path / "local")
    said = store.manifest().decode() + (tmp_path / "report.json").read_text() + done.stdout + done.stderr
    assert str(scratch) not in said
    assert store.line("robot1/drive_0.mcap")["source"]["paths"] == [
        f"{source}/robot1/drive_{number}.mcap" for number in (0, 1)
    ]
    assert store.line("a.bag")["report"]["destination"] == f"{out}/a_scan.bag"
    name, size, version = store.line("a.bag")["source"]["files"][0]
    assert (name, size) == ("a.bag", (drives / "a.bag").stat().st_size)
    if store.url.startswith("s3"):
        assert version == store.fs.info(f"{store.bucket}/in/a.bag")["ETag"].strip('"')

    # Only what is missing, changed or failed is done again.
    assert batch(source, out).unchanged == 4
    store.remove("out/a_scan.bag")
    store.put("in/b.mcap", (drives / "a.bag").read_bytes())
    write_rosbag2(tmp_path / "new", CONTENT.halves()[0])
    store.fs.put(f"{tmp_path / 'new'}/", f"{store.bucket}/in/robot1/c/", recursive=True)
    found = why(batch(source, out))
    assert found["a.bag"] == "its output is missing"
    assert all(found[key].startswith("the source was changed") for key in ("b.mcap", "robot1/c"))
    assert found["robot1/drive_0.mcap"] == "unchanged"
    whole = pc2scan.info(tmp_path / "local" / "robot1" / "c_scan").as_dict()
    assert pc2scan.info(f"{out}/robot1/c_scan").as_dict()["duration_ns"] < whole["duration_ns"]


def test_one_end_is_in_a_store(store: Store, drives: Path, scratch: Path, tmp_path: Path) -> None:
    source = store.upload(drives)
    batch(drives, tmp_path / "local")
    batch(f"{source}/", tmp_path / "here", scratch=scratch)
    batch(drives, f"{store.url}/out", scratch=scratch)
    assert contents(tmp_path / "here") == store.contents("out") == contents(tmp_path / "local")
    assert list(scratch.iterdir()) == []


def test_globs_single_files_and_lists(store: Store, drives: Path, tmp_path: Path) -> None:
    source = store.upload(drives)
    (tmp_path / "list.txt").write_text(f"# drives\n{source}/a.bag\n{drives}/b.mcap\n")
    store.put("in/list.txt", b"a.bag\nrobot1/c\n")

    def keys(*sources: str | Path) -> set[str]:
        report = batch([*map(str, sources)], tmp_path / "out", dry_run=True)
        return {outcome.key for outcome in report.outcomes}

    assert keys(f"{source}/*.bag") == {"a.bag", "empty.bag"}
    assert {key for key in keys(f"{source}/**/*.mcap") if "/c/" not in key} == {"b.mcap", "robot1/drive_0.mcap"}
    assert keys(f"{source}/a.bag", f"{source}/robot1/c") == {"a.bag", "c"}
    assert keys(f"{source}/a.bag", drives / "b.mcap") == {"a.bag", "b.mcap"}
    assert keys(tmp_path / "list.txt") == {"a.bag", "b.mcap"}
    assert keys(f"{source}/list.txt") == {"a.bag", "robot1/c"}
    with pytest.raises(UsageError, match="matches nothing"):
        keys(f"{source}/*.db3")
    with pytest.raises(MissingError, match="does not exist"):
        keys(f"{source}/none.bag")


def test_names_have_the_signs_of_queries_and_fragments(store: Store, drives: Path, tmp_path: Path) -> None:
    """In a bucket they are parts of the name; `?` is also a pattern, which matches itself."""
    signs = ("#1", "#2", "?3")
    for sign in signs:
        store.put(f"signs/drive{sign}.bag", (drives / "a.bag").read_bytes())
    single = [f"{store.url}/signs/drive{sign}.bag" for sign in signs]
    for out, sources in (("out", single), ("folder", f"{store.url}/signs")):
        batch(sources, tmp_path / out)
        assert contents(tmp_path / out).keys() == {f"drive{sign}_scan.bag" for sign in signs}
    # fsspec cannot rename to such a name in memory.
    made = f"{store.url}/made #1{'?' if store.url.startswith('s3') else ''}.bag"
    pc2scan.convert(single[0], made, min_height=-0.3)
    assert pc2scan.info(made).topics
    with pytest.raises(MissingError, match=r"signs/drive#9\.bag: does not exist"):
        pc2scan.info(f"{store.url}/signs/drive#9.bag")


def test_the_results_of_a_run_are_no_sources(store: Store, drives: Path) -> None:
    source = store.upload(drives)
    for expected in (0, 4):
        report = batch(source, f"{source}/scans")
        assert (len(report.outcomes), report.unchanged) == (5, expected)
    with pytest.raises(UsageError, match="is a source, and"):
        batch(source, source)


def test_objects_of_others_stay(store: Store, drives: Path) -> None:
    source, out = f"{store.upload(drives)}/a.bag", f"{store.url}/out"
    store.put("out/a_scan.bag", b"mine")
    assert "exists already" in batch(source, out).outcomes[0].error
    assert store.contents("out") == {"a_scan.bag": b"mine"}
    assert batch(source, out, overwrite=True).exit_status == 0


def test_exported_folders_are_replaced_if_all_is_known(store: Store, drives: Path, tmp_path: Path) -> None:
    source, out = f"{store.upload(drives)}/a.bag", f"{store.url}/out"
    for name in ("csv", "npz"):
        batch(source, out, format=name)
        batch(drives / "a.bag", tmp_path / name, format=name)
        assert store.contents("out") == contents(tmp_path / name)
        assert batch(source, out, format=name).unchanged == 1
    store.put("out/a/labels.npz", b"mine")
    before = store.contents("out")
    for overwrite in (False, True):
        assert "labels.npz" in batch(source, out, format="csv", overwrite=overwrite).outcomes[0].error
    assert store.contents("out") == before
    store.remove("out/a/labels.npz")
    assert batch(source, out, format="csv").exit_status == 0
    assert store.contents("out").keys() == {"a/scan.csv", "a/.pc2scan-files.json"}


def test_an_exported_folder_of_many_files_is_known(store: Store, drives: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A manifest has one entry for the files of such a folder."""
    monkeypatch.setattr("pc2scan.datasets.manifest._MOST", 1)
    source, out = f"{store.upload(drives)}/a.bag", f"{store.url}/out"
    assert batch(source, out, format="npz").exit_status == 0
    assert store.line("a.bag")["output"]["files"][0][0] == "2 files"
    assert batch(source, out, format="npz").unchanged == 1


def test_a_manifest_that_changed_meanwhile_is_an_error(
    store: Store, drives: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, out = store.upload(drives), f"{store.url}/out"
    monkeypatch.setattr(batch_folder, "_PUSH_SECONDS", 0.0)
    other: list[bool] = []

    def done(_: object) -> None:
        if not other:
            other.append(True)
            store.put("out/manifest.jsonl", b"")

    with pytest.raises(DestinationError, match="was changed meanwhile: another batch is writing into this folder"):
        run_with(source, out, done)
    # It is the other one's.
    assert store.manifest() == b""


def run_with(source: str, out: str, done: Callable[[object], None]) -> None:
    run_batch_in_process([source], path_or_url(out), KEYWORDS, BatchOptions(), watch=BatchCallbacks(done=done))


def test_a_web_server_has_single_files(tmp_path: Path, drives: Path) -> None:
    pytest.importorskip("aiohttp", reason="aiohttp reads https")

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(drives))) as web:
        threading.Thread(target=web.serve_forever, daemon=True).start()
        where = f"127.0.0.1:{web.server_port}"
        done = run_batch(f"http://me:secret@{where}/a.bag?token=geheim", "-o", tmp_path / "out", "-v")
        web.shutdown()
    assert done.status == 0, done.stderr
    manifest = (tmp_path / "out" / "manifest.jsonl").read_text()
    assert f"http://{where}/a.bag" in manifest
    for secret in ("secret", "geheim"):
        assert secret not in manifest + done.stdout + done.stderr


@only_s3
def test_a_bucket_that_is_not_there(store: Store, tmp_path: Path) -> None:
    with pytest.raises((MissingError, RecordingError)):
        batch("s3://no-such-bucket-here/in", tmp_path / "out")
    with pytest.raises(pc2scan.Pc2ScanError, match="no such bucket"):
        batch("s3://no-such-bucket-here/in", "s3://no-such-bucket-here/out")
    assert store.fs.exists(store.bucket)


def batch_process(*words: str | Path) -> list[str]:
    return [*COMMAND, "batch", *map(str, words), *HEIGHTS]


@only_s3
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_run_leaves_no_copies_and_goes_on(
    how: signal.Signals, store: Store, scratch: Path, tmp_path: Path
) -> None:
    drives = tmp_path / "many"
    drives.mkdir()
    for number in range(12):
        write_rosbag1(drives / f"d{number:02}x.bag", CONTENT)
    source, out = store.upload(drives), f"{store.url}/out"
    command = batch_process(source, "-o", out, "--scratch", scratch)
    env = plain_environment() | dict(os.environ)
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, env=env) as process:
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
        assert store.manifest()
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, env=env)
    assert done.returncode == 0, done.stderr
    assert "not written by this batch" not in done.stderr
    assert list(scratch.iterdir()) == []
    batch(drives, tmp_path / "local")
    assert store.contents("out") == contents(tmp_path / "local")


@only_s3
def test_workers_of_a_cluster_copy_for_themselves(
    store: Store, s3: dict[str, str], drives: Path, scratch: Path, tmp_path: Path
) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed")
    source, out = store.upload(drives), f"{store.url}/out"
    with cluster(tmp_path, {}, **s3) as (address, _):
        done = run_batch(source, "-o", out, "--scratch", scratch, "--dask", address)
        again = run_batch(source, "-o", out, "--dask", address)
    assert done.status == 1, done.stderr
    assert "failed: empty.bag: is empty" in done.stderr
    assert "4 unchanged" in again.stderr, again.stderr
    assert list(scratch.iterdir()) == []
    batch(drives, tmp_path / "local")
    assert store.contents("out") == contents(tmp_path / "local")
    logs = "".join(path.read_text(errors="replace") for path in tmp_path.glob("*.log"))
    assert "testing-secret" not in logs + done.stderr
