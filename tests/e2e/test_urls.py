"""Recordings at URLs: in memory, at files, and on an S3 server and a web server of this computer."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.errors import DestinationError, MissingError, Pc2ScanError, RecordingError, UsageError
from pc2scan.remote.store import RemotePath
from support import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterator

fsspec = pytest.importorskip("fsspec")

FIXTURES = ROOT / "fixtures"
NAMES = ["hall.bag", "hall.mcap", "hall"]
HEIGHTS: dict[str, Any] = {"min_height": 0.1}


@pytest.fixture
def bucket() -> Iterator[Any]:
    fs = fsspec.filesystem("memory")
    for name in NAMES[:2]:
        fs.put_file(str(FIXTURES / name), f"/bucket/{name}")
    fs.put(f"{FIXTURES / 'hall'}/", "/bucket/hall/", recursive=True)
    yield fs
    fs.rm("/", recursive=True)


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for temporary files; nothing may stay there."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


@pytest.mark.usefixtures("bucket")
@pytest.mark.parametrize("name", NAMES)
def test_info_and_tf_are_those_of_the_file(name: str, scratch: Path) -> None:
    url, local = f"memory://bucket/{name}", str(FIXTURES / name)
    assert str(pc2scan.info(url)) == str(pc2scan.info(local)).replace(local, url)
    assert pc2scan.tf(url).as_dict() == pc2scan.tf(local).as_dict()
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("name", NAMES)
def test_a_conversion_is_that_of_the_file(name: str, bucket: Any, scratch: Path, tmp_path: Path) -> None:
    report = pc2scan.convert(f"memory://bucket/{name}", f"memory://out/{name}", report=tmp_path / "r.json", **HEIGHTS)
    assert report.sources == [f"memory://bucket/{name}"]
    assert report.destination == f"memory://out/{name}"
    assert str(scratch) not in (tmp_path / "r.json").read_text()
    assert json.loads((tmp_path / "r.json").read_text())["destination"] == f"memory://out/{name}"
    pc2scan.convert(FIXTURES / name, tmp_path / name, **HEIGHTS)
    bucket.get(f"/out/{name}", str(tmp_path / "got" / name), recursive=True)
    expected = tmp_path / name
    for file in sorted(expected.iterdir()) if expected.is_dir() else [expected]:
        assert (tmp_path / "got" / file.relative_to(tmp_path)).read_bytes() == file.read_bytes()
    assert list(scratch.iterdir()) == []


def test_without_a_destination_it_goes_next_to_the_source(bucket: Any) -> None:
    assert pc2scan.convert("memory://bucket/hall.bag", **HEIGHTS).destination == "memory://bucket/hall_scan.bag"
    assert bucket.exists("/bucket/hall_scan.bag")
    with pytest.raises(DestinationError, match=r"memory://bucket/hall_scan\.bag: exists already"):
        pc2scan.convert("memory://bucket/hall.bag", **HEIGHTS)


def test_a_folder_and_several_files(bucket: Any) -> None:
    pc2scan.convert("memory://bucket/hall.bag", "memory://out/", split="0.2s", **HEIGHTS)
    found = sorted(path.rpartition("/")[2] for path in bucket.find("/out"))
    assert found[:2] == ["hall_scan_0.bag", "hall_scan_1.bag"]


def test_an_existing_destination_stays(bucket: Any) -> None:
    bucket.pipe_file("/out/x.bag", b"mine")
    with pytest.raises(DestinationError, match="exists already"):
        pc2scan.convert("memory://bucket/hall.bag", "memory://out/x.bag", **HEIGHTS)
    assert bucket.cat_file("/out/x.bag") == b"mine"
    pc2scan.convert("memory://bucket/hall.bag", "memory://out/x.bag", overwrite=True, **HEIGHTS)
    assert bucket.cat_file("/out/x.bag").startswith(b"#ROSBAG")


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_of_a_store_is_never_replaced(bucket: Any, overwrite: bool) -> None:
    bucket.pipe_file("/out/mine/thesis.tex", b"mine")
    with pytest.raises(DestinationError, match="folders in a store are never replaced"):
        pc2scan.convert("memory://bucket/hall.bag", "memory://out/mine", overwrite=overwrite, **HEIGHTS)
    assert bucket.find("/out/mine") == ["/out/mine/thesis.tex"]


@pytest.mark.usefixtures("bucket")
def test_a_source_is_never_the_destination() -> None:
    with pytest.raises(DestinationError, match="is a source"):
        pc2scan.convert("memory://bucket/hall.bag", "memory://bucket/hall.bag", overwrite=True, **HEIGHTS)


@pytest.mark.usefixtures("bucket")
def test_too_little_scratch_is_refused_before_anything_is_read(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RemotePath, "download", lambda *_: pytest.fail("downloaded"))
    with pytest.raises(UsageError, match="local copies of the sources take"):
        pc2scan.convert("memory://bucket/hall.bag", "memory://out/x.bag", scratch_size="1kB", **HEIGHTS)
    assert list(scratch.iterdir()) == []


def test_scratch_without_urls_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no source and no destination is a URL"):
        pc2scan.convert(FIXTURES / "hall.bag", tmp_path / "x.bag", scratch=tmp_path, **HEIGHTS)


def test_a_source_that_changes_meanwhile_is_an_error(
    bucket: Any, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    get_file = bucket.get_file

    def changing(key: str, target: str, **options: Any) -> None:
        get_file(key, target, **options)
        bucket.pipe_file(key, Path(target).read_bytes() + b"more")

    monkeypatch.setattr(type(bucket), "get_file", staticmethod(changing))
    with pytest.raises(RecordingError, match="was changed while it was read"):
        pc2scan.convert("memory://bucket/hall.bag", "memory://out/x.bag", **HEIGHTS)
    assert not bucket.exists("/out/x.bag")
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("failure", [OSError("gone"), KeyboardInterrupt()])
def test_an_upload_that_fails_leaves_nothing(
    failure: BaseException, bucket: Any, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put_file = bucket.put_file

    def failing(source: str, key: str, **options: Any) -> None:
        if source.endswith("metadata.yaml"):
            raise failure
        put_file(source, key, **options)

    monkeypatch.setattr(type(bucket), "put_file", staticmethod(failing))
    with pytest.raises((Pc2ScanError, KeyboardInterrupt)):
        pc2scan.convert("memory://bucket/hall.bag", "memory://out/x", **HEIGHTS)
    assert bucket.find("/out") == []
    assert list(scratch.iterdir()) == []


def test_only_ranges_are_read(bucket: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = ROOT.parent / "shared" / "recordings" / "luminar_highway.bag"
    if not recording.exists():
        pytest.skip("no real recordings here")
    read: list[int] = []
    bytes_at = RemotePath.bytes_at

    def counted(self: RemotePath, start: int, stop: int) -> bytes | None:
        read.append(stop - start)
        return bytes_at(self, start, stop)

    monkeypatch.setattr(RemotePath, "bytes_at", counted)
    monkeypatch.setattr(RemotePath, "download", lambda *_: pytest.fail("downloaded"))
    bucket.put_file(str(recording), "/bucket/drive.bag")
    found = pc2scan.info("memory://bucket/drive.bag", samples=1)
    assert found.as_dict()["topics"] == pc2scan.info(recording, samples=1).as_dict()["topics"]
    assert 0 < sum(read) < recording.stat().st_size * 0.8


def test_a_source_in_a_store_is_never_replaced(bucket: Any) -> None:
    before = {name: bucket.cat_file(name) for name in bucket.find("/bucket")}
    url = "memory://bucket/hall.bag"
    cases: list[tuple[str, str, dict[str, Any]]] = [
        (url, url, {}),
        (url, "memory://bucket/x/../hall.bag", {}),
        ("memory://bucket/hall.mcap", url, {"tf_from": url}),
    ]
    for source, destination, options in cases:
        with pytest.raises(DestinationError, match="is a source"):
            pc2scan.convert(source, destination, overwrite=True, **options, **HEIGHTS)
    # Nor one that has the name of a numbered file.
    bucket.pipe_file("/bucket/drive_2.bag", before["/bucket/hall.bag"])
    with pytest.raises(DestinationError, match="is a source"):
        pc2scan.convert("memory://bucket/drive_2.bag", "memory://bucket/drive.bag", split="0.1s", overwrite=True)
    bucket.rm_file("/bucket/drive_2.bag")
    assert {name: bucket.cat_file(name) for name in bucket.find("/bucket")} == before


def test_other_numbered_files_in_a_store_stay(bucket: Any) -> None:
    bucket.pipe_file("/out/drive_1.bag", b"old")
    bucket.pipe_file("/out/drive_7.bag", b"mine")
    with pytest.raises(DestinationError, match="exists already"):
        pc2scan.convert("memory://bucket/hall.bag", "memory://out/drive.bag", split="0.2s", **HEIGHTS)
    report = pc2scan.convert(
        "memory://bucket/hall.bag", "memory://out/drive.bag", split="0.2s", overwrite=True, **HEIGHTS
    )
    assert bucket.cat_file("/out/drive_7.bag") == b"mine"
    assert any("drive_7.bag" in text and "it stays" in text for text in report.warnings)
    assert sorted(bucket.find("/out")) == [f"/out/drive_{number}.bag" for number in (0, 1, 2, 7)]


@pytest.mark.usefixtures("bucket")
def test_nothing_there_and_other_commands() -> None:
    with pytest.raises(MissingError, match=r"memory://bucket/none\.bag: does not exist"):
        pc2scan.info("memory://bucket/none.bag")
    with pytest.raises(UsageError, match="only convert, info and tf read URLs"):
        pc2scan.check("https://me:secret@example.org/a.bag?token=1")


def run(*words: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pc2scan", *words]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=120, env={**os.environ, **(environment or {})}
    )


def test_a_file_url_is_the_path_that_it_names(tmp_path: Path) -> None:
    shutil.copy(FIXTURES / "hall.mcap", tmp_path)
    url = f"file://{tmp_path}"
    done = run("convert", f"{url}/hall.mcap", "-o", f"{url}/x%20y.mcap", "--min-height", "0.1")
    assert done.returncode == 0, done.stderr
    assert f"{tmp_path}/x y.mcap" in done.stdout
    shown = run("info", f"FILE://localhost{tmp_path}/x%20y.mcap")
    assert shown.stdout.startswith(f"{tmp_path}/x y.mcap: mcap")
    # Every command takes it, not only those that read stores.
    assert run("check", f"file:{tmp_path}/x y.mcap").returncode in (0, 1)


def test_a_missing_library_is_named() -> None:
    code = "import sys; sys.modules['fsspec'] = sys.modules['fsspec.core'] = None; from pc2scan.cli import main; main()"
    command = [sys.executable, "-c", code, "info", "s3://bucket/a.mcap"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "pip install 'pc2scan[remote]' s3fs" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.fixture
def web() -> Iterator[str]:
    pytest.importorskip("aiohttp", reason="aiohttp reads https")

    class Handler(SimpleHTTPRequestHandler):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args, directory=str(FIXTURES))

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{server.server_port}"
        server.shutdown()


def test_a_web_server_is_read_only(web: str, tmp_path: Path) -> None:
    source = f"http://me:secret@{web}/hall.bag?token=geheim"
    done = run("convert", source, "-o", str(tmp_path / "x.bag"), "--report", str(tmp_path / "r.json"))
    assert done.returncode == 0, done.stderr
    assert "secret" not in done.stdout + done.stderr + (tmp_path / "r.json").read_text()
    assert "geheim" not in done.stdout + done.stderr + (tmp_path / "r.json").read_text()
    refused = run("convert", source)
    assert refused.returncode == 2
    assert "can only be read" in refused.stderr
    assert "geheim" not in refused.stderr


def test_an_s3_server(s3_server: dict[str, str]) -> None:
    code = "import fsspec, sys; s3 = fsspec.filesystem('s3'); s3.mkdir('drives'); "
    code += "s3.put(sys.argv[1], 'drives/in/hall.bag')"
    command = [sys.executable, "-c", code, str(FIXTURES / "hall.bag")]
    subprocess.run(command, check=True, timeout=120, env=os.environ | s3_server)
    done = run("info", "s3://drives/in/hall.bag", environment=s3_server)
    assert done.returncode == 0, done.stderr
    for name in ("x.bag", "x"):
        done = run("convert", "s3://drives/in/hall.bag", "-o", f"s3://drives/out/{name}", environment=s3_server)
        assert done.returncode == 0, done.stderr
        assert "testing-secret" not in done.stdout + done.stderr
    done = run("convert", "s3://drives/in/hall.bag", "-o", "s3://drives/out/x.bag", environment=s3_server)
    assert done.returncode == 2
    assert "exists already" in done.stderr
    shown = run("info", "s3://drives/out/x", environment=s3_server)
    assert shown.stdout.startswith("s3://drives/out/x: rosbag2 mcap"), shown.stderr
    missing = run("info", "s3://drives/none.bag", environment=s3_server)
    assert missing.returncode == 2
    assert "does not exist" in missing.stderr
