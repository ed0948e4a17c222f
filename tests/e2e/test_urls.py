"""Recordings at URLs: in memory, on a web server and on an S3 server of this computer. Cases are in ``urls.txt``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.errors import Pc2ScanError
from pc2scan.files import urls
from support import ROOT
from support.command import run, run_process
from support.stores import memory_store, s3_server, web_server
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Iterator

fsspec = pytest.importorskip("fsspec")

FIXTURES, CASES = ROOT / "fixtures", Path(__file__).with_name("urls.txt")
NAMES = ["hall.bag", "hall.mcap", "hall"]
HEIGHTS: dict[str, Any] = {"min_height": -0.3}
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
    times = [[scan.stamp_ns for scan in pc2scan.scans(place, **HEIGHTS)] for place in (url, local)]
    assert (times[0], len(times[0])) == (times[1], 5)


def test_every_command_does_at_urls_what_it_does_with_files(bucket: Any, tmp_path: Path) -> None:
    local, url = f"{tmp_path}/out/", "memory://out/"
    (tmp_path / "out").mkdir()
    for typed, status in rows(CASES, "everywhere"):
        here = run(*typed.replace("SRC", str(FIXTURES / "hall.bag")).replace("OUT", local).split())
        there = run(*typed.replace("SRC", HALL).replace("OUT", url).split())
        assert (here.status, there.status) == (status, status), (typed, there)
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


@pytest.mark.parametrize(("words", "why"), rows(CASES, "refused"))
def test_what_is_refused_changes_nothing(words: str, why: str, bucket: Any) -> None:
    hall = bucket.cat_file("/bucket/hall.bag")
    for name, data in {"x.bag": hall, "x_scan.bag": b"", "mine/thesis.tex": b""}.items():
        bucket.pipe_file(f"/out/{name}", data)
    before = contents(bucket)
    typed = words.replace("HALL", HALL).replace("FIXTURES", str(FIXTURES))
    done = run("convert", *typed.split(), "--min-height", "0.1")
    assert (done.status, why.replace("HALL", HALL) in done.stderr) == (2, True), done.stderr
    assert contents(bucket) == before


@pytest.mark.parametrize(("method", "name", "others"), rows(CASES, "transfers"))
@pytest.mark.parametrize("failure", [OSError("gone"), KeyboardInterrupt()])
def test_a_transfer_that_fails_leaves_nothing_of_its_own(
    failure: BaseException, method: str, name: str, others: list[str], bucket: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    transfer = getattr(bucket, method)

    def failing(source: str, target: str, **options: Any) -> None:
        transfer(source, target, **options)
        if source.endswith(name):
            bucket.pipe(dict.fromkeys(others, b""))
            raise failure

    monkeypatch.setattr(type(bucket), method, staticmethod(failing))
    with pytest.raises((Pc2ScanError, KeyboardInterrupt)):
        pc2scan.convert("memory://bucket/hall", "memory://out/x", **HEIGHTS)
    assert bucket.find("/out") == others


def test_s3_gives_up_soon_and_reads_in_one_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(fsspec.config.conf, "s3", {"config_kwargs": {"region_name": "here", "read_timeout": 9}})
    monkeypatch.setattr(fsspec, "url_to_fs", lambda url, **options: (options, url))
    options, _ = urls.UrlPath("s3://drives/hall.bag").store
    settings = {"connect_timeout": 10, "read_timeout": 9, "retries": {"max_attempts": 0}, "region_name": "here"}
    assert (options["max_concurrency"], options["config_kwargs"]) == (1, settings)


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("fsspec", "fsspec.core"):
        monkeypatch.setitem(sys.modules, name, None)
    done = run("info", "s3://bucket/a.mcap")
    assert done.status == 2
    assert 'pip install "pc2scan[remote]" s3fs' in done.stderr


def test_the_memory_of_a_command_is_no_destination() -> None:
    done = run_process("convert", str(FIXTURES / "hall.bag"), "-o", "memory://x.bag", "--min-height", "0.1")
    assert (done.status, "gone when it ends" in done.stderr) == (2, True), done


@pytest.fixture(scope="module")
def web() -> Iterator[str]:
    with web_server(FIXTURES) as place:
        yield place


def test_a_web_server_is_read_only(web: str, tmp_path: Path) -> None:
    source, out = f"http://me:secret@{web}/hall.bag?token=geheim", tmp_path / "out"
    out.mkdir()
    written = ("-o", out / "x.bag", "--report", out / "r.json", "--min-height", "0.1")
    moved = source.replace("/hall.bag", "/redirects/hall.bag")
    typed = (("info", source), ("info", moved), ("convert", source, *written), ("convert", source))
    done = [run(*words) for words in typed]
    assert [each.status for each in done] == [0, 0, 0, 2], done
    assert "can only be read" in done[3].stderr
    for secret in ("secret", "geheim"):
        assert secret not in str(done) + (out / "r.json").read_text()


@pytest.mark.parametrize(("kind", "status", "message"), rows(CASES, "web"))
def test_a_web_server_that_fails_leaves_nothing(
    kind: str, status: int, message: str, web: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(urls, "MINUTE", 2)
    out, report = tmp_path / "x.bag", tmp_path / "report.json"
    done = run("convert", f"http://me:secret@{web}/{kind}/hall.bag?token=geheim", "-o", out, "--report", report)
    assert (done.status, json.loads(report.read_text())["exit_status"]) == (status, status), done
    assert done.stderr.startswith(f"error: http://{web}/{kind}/hall.bag: {message}")
    assert "\nhint: " in done.stderr
    for hidden in ("Traceback", "secret", "geheim"):
        assert hidden not in done.stderr + report.read_text()
    assert not out.exists()


@pytest.mark.slow
def test_an_s3_server(monkeypatch: pytest.MonkeyPatch) -> None:
    with s3_server() as variables:
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        s3 = fsspec.filesystem("s3", skip_instance_cache=True)
        s3.mkdir("drives")
        s3.put_file(str(FIXTURES / "hall.bag"), "drives/in/hall.bag")
        for words, status, said in rows(CASES, "s3"):
            done = run(*words.split(), *("--min-height", "0.1") * words.startswith("convert"))
            assert (done.status, said in done.stdout + done.stderr) == (status, True), done
            assert "testing-secret" not in done.stdout + done.stderr
    for endpoint, said in (("http://127.0.0.1:9", "the transfer failed"), ("", "NoCredentialsError")):
        monkeypatch.setenv("AWS_ENDPOINT_URL", endpoint or "http://127.0.0.1:9")
        if not endpoint:
            monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
            monkeypatch.delenv("AWS_ACCESS_KEY_ID")
        type(s3).clear_instance_cache()
        done = run("info", "s3://drives/in/hall.bag")
        assert (done.status, said in done.stderr) == (1, True), done
    type(s3).clear_instance_cache()
