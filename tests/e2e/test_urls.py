"""Recordings at URLs: in memory, at files, and on an S3 server and a web server of this computer."""

from __future__ import annotations

import shutil
import sqlite3
import sys
import threading
from contextlib import closing
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zstandard

import pc2scan
from pc2scan.errors import MissingError, Pc2ScanError, RecordingError
from support import ROOT
from support.builders import CONTENT, write_db3, write_rosbag1
from support.command import run, run_process
from support.stores import memory_store, s3_server
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Iterator

fsspec = pytest.importorskip("fsspec")

FIXTURES = ROOT / "fixtures"
NAMES = ["hall.bag", "hall.mcap", "hall"]
HEIGHTS: dict[str, Any] = {"min_height": 0.1}
HALL = "memory://bucket/hall.bag"


@pytest.fixture(autouse=True)
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    with memory_store(monkeypatch) as fs:
        for name in NAMES[:2]:
            fs.put_file(str(FIXTURES / name), f"/bucket/{name}")
        fs.put(f"{FIXTURES / 'hall'}/", "/bucket/hall/", recursive=True)
        yield fs


@pytest.fixture(autouse=True)
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder for temporary files; nothing may stay there."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def contents(fs: Any) -> dict[str, bytes]:
    return {name: fs.cat_file(name) for name in fs.find("/")}


@pytest.mark.parametrize("name", NAMES)
def test_what_is_at_a_url_is_as_the_file(name: str, bucket: Any, scratch: Path, tmp_path: Path) -> None:
    url, local = f"memory://bucket/{name}", str(FIXTURES / name)
    assert str(pc2scan.info(url)) == str(pc2scan.info(local)).replace(local, url)
    assert pc2scan.tf(url).as_dict() == pc2scan.tf(local).as_dict()
    report = pc2scan.convert(url, f"memory://out/{name}", report=tmp_path / "r.json", **HEIGHTS)
    assert (report.sources, report.destination) == ([url], f"memory://out/{name}")
    said = (tmp_path / "r.json").read_text()
    assert str(scratch) not in said
    assert f'"destination": "memory://out/{name}"' in said
    expected = tmp_path / name
    pc2scan.convert(local, expected, **HEIGHTS)
    files = sorted(expected.iterdir()) if expected.is_dir() else [expected]
    made = {key: data for key, data in contents(bucket).items() if key.startswith("/out")}
    assert made == {f"/out/{file.relative_to(tmp_path)}": file.read_bytes() for file in files}


#: What is typed, with SRC and OUT; OUT is the beginning of the names of what is written.
EVERYWHERE = [
    "check OUTscans.mcap",
    "diff SRC OUTscans.mcap",
    "view SRC -o OUTpage.html --min-height 0.1",
    "view SRC -o OUTpage.html --overwrite",
    "map SRC -o OUTmap.yaml --min-height 0.1",
    "export SRC -o OUTscans.csv --min-height 0.1",
    "export SRC -o OUTscans.csv --min-height 0.1",
    "export SRC -o OUTclouds --format pcd",
    "repair SRC -o OUTrepaired.bag",
    "convert SRC -o OUTagain.bag --report OUTreport.json",
    "convert SRC -o OUTx.bag --report OUTscans.csv",
    "convert SRC -o OUTy.bag --dry-run",
    "convert SRC -o OUTcut.bag --start 0.1s --end 0.3s",
    "convert SRC SRC -o OUTz.bag",
    "info SRC OUTnone.bag",
]


def test_every_command_does_at_urls_what_it_does_with_files(bucket: Any, tmp_path: Path) -> None:
    local, url = f"{tmp_path}/out/", "memory://out/"
    (tmp_path / "out").mkdir()
    for typed in ("convert SRC -o OUTscans.mcap --min-height 0.1", *EVERYWHERE):
        here = run(*typed.replace("SRC", str(FIXTURES / "hall.bag")).replace("OUT", local).split())
        there = run(*typed.replace("SRC", HALL).replace("OUT", url).split())
        assert there.status == here.status, (typed, there)
        shown = here.stdout.replace(str(FIXTURES / "hall.bag"), HALL).replace(local, url)
        # The columns of tables are as wide as the paths.
        assert words_of(there.stdout) == words_of(shown), typed
    made = {key.removeprefix("/out/"): data for key, data in contents(bucket).items() if key.startswith("/out/")}
    files = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    expected = {path.relative_to(tmp_path / "out").as_posix(): path.read_bytes() for path in files}
    assert made.keys() == expected.keys()
    # Pages, reports and records of folders have names and times in them.
    exact = (".bag", ".mcap", ".csv", ".pgm", ".pcd")
    assert [name for name in made if name.endswith(exact) and made[name] != expected[name]] == []


def words_of(text: str) -> list[str]:
    """The words of a text, without lines and numbers, such as times."""
    return [word for word in text.split() if word.strip("-0123456789.")]


def test_all_kinds_of_recordings_are_read(bucket: Any, tmp_path: Path) -> None:
    """Also those that a library reads by itself, is compressed as a whole, damaged, or has a log beside it."""
    write_db3(tmp_path / "a.db3", CONTENT)
    write_rosbag1(tmp_path / "b.bag", CONTENT)
    data = (tmp_path / "b.bag").read_bytes()
    (tmp_path / "cut.bag").write_bytes(data[: len(data) * 2 // 3])
    (tmp_path / "cut.db3").write_bytes((tmp_path / "a.db3").read_bytes()[:-5000])
    (tmp_path / "two.bag").write_bytes(data + data)
    (tmp_path / "b.bag.zst").write_bytes(zstandard.compress(data))
    shutil.copy(tmp_path / "a.db3", tmp_path / "hot.db3")
    with closing(sqlite3.connect(tmp_path / "hot.db3", isolation_level=None)) as live:
        live.execute("PRAGMA journal_mode = WAL")
        live.execute("PRAGMA wal_autocheckpoint = 0")
        live.execute("DELETE FROM messages WHERE id = 1")
        for end in ("", "-wal"):
            shutil.copy(tmp_path / f"hot.db3{end}", tmp_path / f"logged.db3{end}")
    (tmp_path / "hot.db3").unlink()
    bucket.put(f"{tmp_path}/", "/kinds/", recursive=True)
    names = {path.name for path in tmp_path.iterdir() if path.is_file() and not path.name.endswith("-wal")}
    assert len(names) == 7
    for name in names:
        found = [pc2scan.info(place).as_dict() for place in (f"memory://kinds/{name}", tmp_path / name)]
        shown = [str(each).replace(str(tmp_path), "memory://kinds") for each in found]
        assert shown[0] == shown[1]
        report, expected = (
            pc2scan.convert(source, tmp_path / "x.mcap", overwrite=True, min_height=-2.0, max_height=2.0)
            for source in (f"memory://kinds/{name}", tmp_path / name)
        )
        assert report.bytes_written == expected.bytes_written
        assert [each.what for each in report.damage] == [each.what for each in expected.damage]


@pytest.mark.parametrize("name", NAMES)
def test_loops_read_urls(name: str) -> None:
    times = [[scan.stamp_ns for scan in pc2scan.scans(place, **HEIGHTS)] for place in places(name)]
    assert times[0] == times[1]
    assert len(times[0]) == 5
    points = [[cloud.points().shape for cloud in pc2scan.clouds(place)] for place in places(name)]
    assert points[0] == points[1]


def places(name: str) -> tuple[str, Path]:
    return f"memory://bucket/{name}", FIXTURES / name


def test_results_go_next_to_the_source_or_into_a_folder(bucket: Any) -> None:
    assert pc2scan.convert(HALL, **HEIGHTS).destination == "memory://bucket/hall_scan.bag"
    assert bucket.exists("/bucket/hall_scan.bag")
    pc2scan.convert(HALL, "memory://out/", **HEIGHTS)
    assert bucket.find("/out") == ["/out/hall_scan.bag"]


@pytest.mark.parametrize(("words", "why"), rows(Path(__file__).with_name("urls.txt"), "refused"))
def test_what_is_refused_changes_nothing(words: str, why: str, bucket: Any) -> None:
    hall = bucket.cat_file("/bucket/hall.bag")
    for name, data in {"x.bag": hall, "x_scan.bag": b"", "mine/thesis.tex": b""}.items():
        bucket.pipe_file(f"/out/{name}", data)
    before = contents(bucket)
    typed = words.replace("HALL", HALL).replace("FIXTURES", str(FIXTURES))
    done = run("convert", *typed.split(), "--min-height", "0.1")
    assert (done.status, why.replace("HALL", HALL) in done.stderr) == (2, True), done.stderr
    assert contents(bucket) == before


def test_overwriting_replaces_what_it_writes(bucket: Any) -> None:
    bucket.pipe_file("/out/x.bag", b"mine")
    pc2scan.convert(HALL, "memory://out/x.bag", overwrite=True, **HEIGHTS)
    assert bucket.cat_file("/out/x.bag").startswith(b"#ROSBAG")
    assert bucket.find("/out") == ["/out/x.bag"]


def test_what_is_missing_is_named() -> None:
    for call in (pc2scan.info, pc2scan.tf, pc2scan.check):
        with pytest.raises(MissingError, match=r"memory://bucket/none\.bag: does not exist"):
            call("memory://bucket/none.bag")


def test_a_source_that_changes_meanwhile_is_an_error(bucket: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    cat_file = bucket.cat_file

    def changing(key: str, **options: Any) -> bytes:
        data: bytes = cat_file(key, **options)
        bucket.pipe_file(key, cat_file(key) + b"more")
        return data

    monkeypatch.setattr(type(bucket), "cat_file", staticmethod(changing))
    with pytest.raises(RecordingError, match="was changed while it was read"):
        pc2scan.convert(HALL, "memory://out/x.bag", **HEIGHTS)
    assert not bucket.exists("/out/x.bag")


@pytest.mark.parametrize("failure", [OSError("gone"), KeyboardInterrupt()])
def test_an_upload_that_fails_leaves_nothing(
    failure: BaseException, bucket: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    put_file = bucket.put_file

    def failing(source: str, key: str, **options: Any) -> None:
        if source.endswith("metadata.yaml"):
            raise failure
        put_file(source, key, **options)

    monkeypatch.setattr(type(bucket), "put_file", staticmethod(failing))
    with pytest.raises((Pc2ScanError, KeyboardInterrupt)):
        pc2scan.convert(HALL, "memory://out/x", **HEIGHTS)
    assert bucket.find("/out") == []


# --- The command ---


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("fsspec", "fsspec.core"):
        monkeypatch.setitem(sys.modules, name, None)
    done = run("info", "s3://bucket/a.mcap")
    assert done.status == 2
    assert 'pip install "pc2scan[remote]" s3fs' in done.stderr
    assert "Traceback" not in done.stderr


def test_a_web_server_is_read_only(tmp_path: Path) -> None:
    pytest.importorskip("aiohttp", reason="aiohttp reads https")

    class Handler(SimpleHTTPRequestHandler):
        """Knows no ranges, like `python -m http.server`."""

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(FIXTURES))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        source = f"http://me:secret@127.0.0.1:{server.server_port}/hall.bag?token=geheim"
        for command in (("info",), ("tf",), ("export", "-o", tmp_path / "x.csv", "--min-height", "0.1")):
            assert run(command[0], source, *command[1:]).status == 0
        done = run("convert", source, "-o", tmp_path / "x.bag", "--report", tmp_path / "r.json")
        refused = run("convert", source)
        server.shutdown()
    assert done.status == 0, done.stderr
    assert (refused.status, "can only be read" in refused.stderr) == (2, True)
    said = done.stdout + done.stderr + (tmp_path / "r.json").read_text() + refused.stderr
    for secret in ("secret", "geheim"):
        assert secret not in said


def test_the_memory_of_a_command_is_no_destination() -> None:
    done = run_process("convert", str(FIXTURES / "hall.bag"), "-o", "memory://x.bag", "--min-height", "0.1")
    assert (done.status, "gone when it ends" in done.stderr) == (2, True), done


def test_an_s3_server(monkeypatch: pytest.MonkeyPatch) -> None:
    with s3_server() as variables:
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        s3 = fsspec.filesystem("s3", skip_instance_cache=True)
        s3.mkdir("drives")
        s3.put_file(str(FIXTURES / "hall.bag"), "drives/in/hall.bag")
        expected = [
            ("info s3://drives/in/hall.bag", 0, "s3://drives/in/hall.bag: rosbag1"),
            ("convert s3://drives/in/hall.bag -o s3://drives/out/x.bag", 0, "s3://drives/out/x.bag"),
            ("convert s3://drives/in/hall.bag -o s3://drives/out/x", 0, "s3://drives/out/x"),
            ("convert s3://drives/in/hall.bag -o s3://drives/out/x.bag", 2, "exists already"),
            ("info s3://drives/out/x", 0, "s3://drives/out/x: rosbag2 mcap"),
            ("info s3://drives/none.bag", 2, "does not exist"),
            ("batch s3://no-such-bucket/in -o s3://no-such-bucket/out", 2, "no such bucket"),
        ]
        for words, status, said in expected:
            done = run(*words.split())
            assert (done.status, said in done.stdout + done.stderr) == (status, True), done
            assert "testing-secret" not in done.stdout + done.stderr
