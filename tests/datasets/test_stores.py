"""Batches whose sources are in a store in memory, or on a web server."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.errors import DestinationError, MissingError, RecordingError
from support.batches import batch, contents, place, run_batch
from support.builders import CONTENT, write_mcap
from support.stores import memory_store, web_server

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and locks of POSIX")


class Store:
    """A bucket of the test's own."""

    def __init__(self, fs: Any, bucket: str) -> None:
        self.fs, self.bucket, self.url = fs, bucket, f"memory://{bucket}"
        fs.mkdir(bucket)

    def upload(self, folder: Path) -> str:
        """Put a folder into the bucket as ``in``; return its URL."""
        self.fs.put(f"{folder}/", f"{self.bucket}/in/", recursive=True)
        return f"{self.url}/in"

    def put(self, key: str, data: bytes) -> None:
        self.fs.pipe_file(f"{self.bucket}/{key}", data)


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Store]:
    with memory_store(monkeypatch) as fs:
        yield Store(fs, tmp_path.name.replace("_", "-").lower())


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    """Recordings of all containers, two parts of one, and files that are not recordings."""
    folder = place(tmp_path / "drives", "a.bag", "b.mcap", "robot1/c")
    for number, part in enumerate(CONTENT.halves()):
        write_mcap(folder / "robot1" / f"drive_{number}.mcap", part)
    (folder / "robot1" / "notes.txt").write_text("no recording")
    (folder / "empty.bag").write_bytes(b"")
    return folder


def test_a_bucket_becomes_what_a_folder_becomes(store: Store, drives: Path, tmp_path: Path) -> None:
    source, out, scratch = store.upload(drives), tmp_path / "out", tmp_path / "scratch"
    scratch.mkdir()
    done = run_batch(source, "-o", out, "--scratch", scratch)
    assert (done.status, "failed: empty.bag: is empty" in done.stderr) == (1, True), done.stderr
    assert batch(drives, tmp_path / "local").exit_status == 1
    assert contents(out) == contents(tmp_path / "local")
    manifest = (out / "manifest.jsonl").read_text()
    assert str(scratch) not in manifest + str(done)
    assert list(scratch.iterdir()) == []
    line = {each["key"]: each for each in map(json.loads, manifest.splitlines())}["robot1/drive_0.mcap"]
    assert line["source"]["paths"] == [f"{source}/robot1/drive_{number}.mcap" for number in (0, 1)]

    # Only what is missing, changed or failed is done again.
    assert batch(source, out).unchanged == 4
    (out / "a_scan.bag").unlink()
    store.put("in/b.mcap", (drives / "a.bag").read_bytes())
    found = {each.key: each.why for each in batch(source, out).outcomes if each.action != "refuse"}
    assert found["a.bag"] == "its output is missing"
    assert found["b.mcap"].startswith("the source was changed")
    assert found["robot1/drive_0.mcap"] == found["robot1/c"] == "unchanged"


def test_single_files_and_folders(store: Store, drives: Path, tmp_path: Path) -> None:
    source = store.upload(drives)
    # In a bucket, the signs of queries and fragments are parts of names, and there are no patterns.
    store.put("signs/drive#1?.bag", (drives / "a.bag").read_bytes())

    def keys(*sources: str | Path) -> set[str]:
        report = batch([*map(str, sources)], tmp_path / "out", dry_run=True)
        return {outcome.key for outcome in report.outcomes}

    assert keys(f"{source}/a.bag", f"{source}/robot1/c", drives / "b.mcap") == {"a.bag", "b.mcap", "c"}
    assert keys(f"{store.url}/signs") == keys(f"{store.url}/signs/drive#1?.bag") == {"drive#1?.bag"}
    for wrong in ("*.bag", "none.bag"):
        with pytest.raises(MissingError, match="does not exist"):
            keys(f"{source}/{wrong}")


def test_what_is_fetched_at_once_must_have_room(
    store: Store, drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, room = store.upload(drives), (drives / "a.bag").stat().st_size + 1
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=room))
    with pytest.raises(RecordingError, match="no space for temporary copies"):
        batch(source, tmp_path / "out", jobs=3)
    with pytest.raises(DestinationError, match="a batch writes into a folder of this machine"):
        batch(source, f"{store.url}/out")


def test_a_web_server_has_single_files(tmp_path: Path, drives: Path) -> None:
    with web_server(drives) as where:
        sources = [f"http://me:secret@{where}/{name}?token=geheim" for name in ("a.bag", "cuts/b.bag")]
        done = run_batch(*sources, "-o", tmp_path / "out", "-v")
    assert (done.status, "failed: cuts/b.bag: the transfer " in done.stderr) == (1, True), done
    manifest = (tmp_path / "out" / "manifest.jsonl").read_text()
    assert f"http://{where}/a.bag" in manifest
    for secret in ("secret", "geheim"):
        assert secret not in manifest + done.stdout + done.stderr
