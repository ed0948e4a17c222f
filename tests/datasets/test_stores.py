"""Batches whose sources and results are in a store: in memory, and (slow) in an S3 server on this computer."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from datasets.cluster import cluster
from pc2scan.datasets import folder as batch_folder
from pc2scan.datasets.run import BatchCallbacks, BatchOptions
from pc2scan.datasets.run import run_batch as run_batch_in_process
from pc2scan.errors import DestinationError, MissingError, RecordingError, UsageError
from pc2scan.files.urls import path_or_url
from support.batches import HEIGHTS, KEYWORDS, batch, contents, place, run_batch
from support.builders import CONTENT, write_mcap, write_rosbag1
from support.command import COMMAND, INTERRUPTED
from support.command import environment as plain_environment
from support.stores import memory_store, s3_server, web_server

if TYPE_CHECKING:
    from collections.abc import Iterator
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

    def contents(self, key: str) -> dict[str, bytes]:
        """The bytes below a key; not the manifest."""
        self.fs.invalidate_cache()
        found = {path.partition(f"{self.bucket}/{key}/")[2]: path for path in self.fs.find(f"{self.bucket}/{key}")}
        return {name: self.fs.cat_file(path) for name, path in found.items() if name != "manifest.jsonl"}

    def manifest(self) -> bytes:
        data: bytes = self.fs.cat_file(f"{self.bucket}/out/manifest.jsonl")
        return data


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
def scratch(tmp_path: Path) -> Iterator[Path]:
    """The folder for local copies; nothing may stay there."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    yield folder
    assert list(folder.iterdir()) == []


def test_a_bucket_becomes_what_a_folder_becomes(store: Store, drives: Path, scratch: Path, tmp_path: Path) -> None:
    source, out = store.upload(drives), f"{store.url}/out"
    done = run_batch(source, "-o", out, "--scratch", scratch, "--report", tmp_path / "report.json")
    assert done.status == 1, done.stderr
    assert "failed: empty.bag: is empty" in done.stderr
    assert batch(drives, tmp_path / "local").exit_status == 1
    batch(f"{source}/", tmp_path / "here", scratch=scratch)
    # No note is left there.
    assert store.contents("out") == contents(tmp_path / "here") == contents(tmp_path / "local")
    assert str(scratch) not in store.manifest().decode() + (tmp_path / "report.json").read_text() + str(done)
    line = {each["key"]: each for each in map(json.loads, store.manifest().splitlines())}["robot1/drive_0.mcap"]
    assert line["source"]["paths"] == [f"{source}/robot1/drive_{number}.mcap" for number in (0, 1)]

    # Only what is missing, changed or failed is done again.
    assert batch(source, out).unchanged == 4
    store.fs.rm_file(f"{store.bucket}/out/a_scan.bag")
    store.put("in/b.mcap", (drives / "a.bag").read_bytes())
    write_mcap(tmp_path / "half.mcap", CONTENT.halves()[0])
    store.put("in/robot1/c/c_0.mcap", (tmp_path / "half.mcap").read_bytes())
    found = {each.key: each.why for each in batch(source, out).outcomes if each.action != "refuse"}
    assert found["a.bag"] == "its output is missing"
    assert all(found[key].startswith("the source was changed") for key in ("b.mcap", "robot1/c"))
    assert found["robot1/drive_0.mcap"] == "unchanged"


def test_globs_single_files_and_lists(store: Store, drives: Path, tmp_path: Path) -> None:
    source = store.upload(drives)
    (tmp_path / "list.txt").write_text(f"# drives\n{source}/a.bag\n{drives}/b.mcap\n")
    store.put("in/list.txt", b"a.bag\nrobot1/c\n")
    # In a bucket, the signs of queries and fragments are parts of names; `?` is also a pattern, which matches itself.
    for name in ("drive#1.bag", "drive?3.bag"):
        store.put(f"signs/{name}", (drives / "a.bag").read_bytes())

    def keys(*sources: str | Path) -> set[str]:
        report = batch([*map(str, sources)], tmp_path / "out", dry_run=True)
        return {outcome.key for outcome in report.outcomes}

    assert keys(f"{source}/*.bag") == {"a.bag", "empty.bag"}
    assert {key for key in keys(f"{source}/**/*.mcap") if "/c/" not in key} == {"b.mcap", "robot1/drive_0.mcap"}
    assert keys(f"{source}/a.bag", f"{source}/robot1/c") == {"a.bag", "c"}
    assert keys(f"{source}/a.bag", drives / "b.mcap") == {"a.bag", "b.mcap"}
    assert keys(tmp_path / "list.txt") == {"a.bag", "b.mcap"}
    assert keys(f"{source}/list.txt") == {"a.bag", "robot1/c"}
    assert keys(f"{store.url}/signs") == {"drive#1.bag", "drive?3.bag"}
    assert keys(f"{store.url}/signs/drive#1.bag", f"{store.url}/signs/drive?3.bag") == {"drive#1.bag", "drive?3.bag"}
    for wrong, error, why in (("*.db3", UsageError, "matches nothing"), ("none.bag", MissingError, "does not exist")):
        with pytest.raises(error, match=why):
            keys(f"{source}/{wrong}")


def test_what_others_wrote_stays(store: Store, drives: Path, tmp_path: Path) -> None:
    source, out = f"{store.upload(drives)}/a.bag", f"{store.url}/out"
    with pytest.raises(UsageError, match="is a source, and"):
        batch(f"{store.url}/in", f"{store.url}/in")
    store.put("out/a_scan.bag", b"mine")
    assert "exists already" in batch(source, out).outcomes[0].error
    assert store.contents("out") == {"a_scan.bag": b"mine"}
    assert batch(source, out, overwrite=True).exit_status == 0
    store.fs.rm(f"{store.bucket}/out", recursive=True)
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


def test_a_manifest_that_changed_meanwhile_is_an_error(
    store: Store, drives: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, out = store.upload(drives), f"{store.url}/out"
    monkeypatch.setattr(batch_folder, "_PUSH_SECONDS", 0.0)
    watch = BatchCallbacks(done=lambda _: store.put("out/manifest.jsonl", b""))
    with pytest.raises(DestinationError, match="was changed meanwhile: another batch is writing into this folder"):
        run_batch_in_process([source], path_or_url(out), KEYWORDS, BatchOptions(), watch=watch)
    # It is the other one's.
    assert store.manifest() == b""


def test_what_is_fetched_at_once_must_have_room(
    store: Store, drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = store.upload(drives)
    room = (drives / "a.bag").stat().st_size + (drives / "b.mcap").stat().st_size
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(2 * room, 0, room))
    with pytest.raises(RecordingError, match="no space for local copies") as caught:
        batch(source, tmp_path / "out", jobs=3)
    assert "give fewer `jobs`" in str(caught.value.hint)
    assert batch([f"{source}/a.bag", f"{source}/b.mcap"], tmp_path / "out", jobs=1).exit_status == 0


def test_a_web_server_has_single_files(tmp_path: Path, drives: Path) -> None:
    with web_server(drives) as where:
        sources = [f"http://me:secret@{where}/{name}?token=geheim" for name in ("a.bag", "cuts/b.bag")]
        done = run_batch(*sources, "-o", tmp_path / "out", "-v")
    assert (done.status, "failed: cuts/b.bag: the download was cut off" in done.stderr) == (1, True), done
    manifest = (tmp_path / "out" / "manifest.jsonl").read_text()
    assert f"http://{where}/a.bag" in manifest
    for secret in ("secret", "geheim"):
        assert secret not in manifest + done.stdout + done.stderr


@only_s3
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_run_leaves_no_copies_and_goes_on(how: signal.Signals, store: Store, tmp_path: Path) -> None:
    drives, scratch = tmp_path / "many", tmp_path / "scratch"
    drives.mkdir()
    scratch.mkdir()
    for number in range(12):
        write_rosbag1(drives / f"d{number:02}x.bag", CONTENT)
    source, out = store.upload(drives), f"{store.url}/out"
    command = [*COMMAND, "batch", source, "-o", out, "--scratch", str(scratch), *HEIGHTS]
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
    assert (done.status, "failed: empty.bag: is empty" in done.stderr) == (1, True), done
    assert "4 unchanged" in again.stderr, again.stderr
    batch(drives, tmp_path / "local")
    assert store.contents("out") == contents(tmp_path / "local")
    logs = "".join(path.read_text(errors="replace") for path in tmp_path.glob("*.log"))
    assert "testing-secret" not in logs + done.stderr
