"""The errors for stores and web servers that refuse, hang, fail or cut a transfer off."""

from __future__ import annotations

import json
import os
import threading
import time
from contextlib import suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING

import pytest

import pc2scan
from pc2scan.errors import OutputError, Pc2ScanError, RecordingError
from pc2scan.files import store
from support import ROOT, sampled
from support.batches import batch
from support.command import run

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytest.importorskip("fsspec")

HALL = (ROOT / "fixtures" / "hall.bag").read_bytes()

#: Environment for S3: nothing of the user's own.
S3 = {"AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing-secret", "AWS_DEFAULT_REGION": "us-east-1"}


class Handler(BaseHTTPRequestHandler):
    """Answers as the first part of the path says."""

    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        """Log nothing."""

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def do_PUT(self) -> None:
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self._answer(with_body=False)

    def _answer(self, *, with_body: bool) -> None:
        kind = self.path.split("/")[1]
        if kind.isdigit():
            self.send_response(int(kind))
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        if kind == "trickles_heads":
            self._trickle(b"HTTP/1.1 200 OK\r\nX: " + bytes(100).replace(b"\0", b"x"))
            return
        if kind == "silent":
            self.server.ended.wait(20)  # type: ignore[attr-defined]
            self.close_connection = True
            return
        self.send_response(200)
        self.send_header("Content-Length", str(len(HALL)))
        self.send_header("ETag", '"1"')
        self.end_headers()
        if with_body and kind == "trickles":
            self._trickle(HALL)
        elif with_body:
            self.wfile.write(HALL[: len(HALL) // 2])
            self.wfile.flush()
            if kind == "stalls":
                self.server.ended.wait(20)  # type: ignore[attr-defined]
            self.close_connection = True

    def _trickle(self, data: bytes) -> None:
        """Send a byte now and then, so that the server is never silent for long."""
        with suppress(OSError):
            for byte in data:
                if self.server.ended.wait(0.1):  # type: ignore[attr-defined]
                    break
                self.wfile.write(bytes([byte]))
                self.wfile.flush()
        self.close_connection = True


@pytest.fixture(scope="module")
def place() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.ended = threading.Event()  # type: ignore[attr-defined]
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{server.server_port}"
        server.ended.set()  # type: ignore[attr-defined]
        server.shutdown()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_READ_SECONDS", 1)
    monkeypatch.setattr(store, "_CONNECT_SECONDS", 1)


#: What a web server does, the exit status and a part of the message.
WEB = {
    "403": (1, "access is refused (403"),
    "404": (2, "does not exist"),
    "401": (1, "access is refused (401"),
    "cuts": (1, "the download was cut off"),
    "500": (1, "the store reports an internal error (status 500)"),
    "silent": (1, "the store does not answer in time"),
    "stalls": (1, "the store does not answer in time"),
}


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("kind", sampled(WEB, 6))
def test_a_web_server_that_fails_leaves_nothing(kind: str, place: str, tmp_path: Path) -> None:
    pytest.importorskip("aiohttp", reason="aiohttp reads https")
    status, message = WEB[kind]
    scratch, report = tmp_path / "scratch", tmp_path / "report.json"
    scratch.mkdir()
    url = f"http://me:secret@{place}/{kind}/hall.bag?token=geheim"
    done = run("convert", url, "-o", tmp_path / "x.bag", "--scratch", scratch, "--report", report)
    assert (done.status, json.loads(report.read_text())["exit_status"]) == (status, status)
    assert done.stderr.startswith(f"error: http://{place}/{kind}/hall.bag: {message}")
    assert "\nhint: " in done.stderr
    for hidden in ("Traceback", "secret", "geheim"):
        assert hidden not in done.stderr + report.read_text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.json", "scratch"]
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize(
    ("kind", "call"),
    sampled([(kind, call) for kind in ("trickles", "trickles_heads") for call in ("convert", "info")], 1),
)
def test_a_server_that_sends_a_byte_now_and_then_is_too_slow(
    kind: str, call: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("aiohttp", reason="aiohttp reads https")
    monkeypatch.setattr(store, "SLOWEST_SECONDS", 1)
    url = f"http://me:secret@{place}/{kind}/hall.bag?token=geheim"
    read = partial(pc2scan.info, url) if call == "info" else partial(pc2scan.convert, url, tmp_path / "x.bag")
    with pytest.raises(RecordingError) as caught:
        read()
    assert caught.value.message == "the transfer is too slow to finish: fewer than 65,536 bytes arrived in 1 seconds"
    assert caught.value.path == f"http://{place}/{kind}/hall.bag"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("impatient")
def test_a_batch_goes_on(place: str, tmp_path: Path) -> None:
    pytest.importorskip("aiohttp", reason="aiohttp reads https")
    (tmp_path / "good.bag").write_bytes(HALL)
    sources = [f"http://me:secret@{place}/{kind}/{kind}.bag?token=geheim" for kind in ("cuts", "stalls")]
    report = batch([*sources, str(tmp_path / "good.bag")], tmp_path / "out")
    assert [outcome.outcome for outcome in report.outcomes] == ["failed", "converted", "failed"]
    errors = {outcome.key: outcome.error for outcome in report.outcomes}
    assert "cut off" in errors["cuts/cuts.bag"]
    assert "does not answer in time" in errors["stalls/stalls.bag"]
    manifest = (tmp_path / "out" / "manifest.jsonl").read_text()
    assert "secret" not in manifest
    assert "geheim" not in manifest


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("endpoint", "message"),
    sampled(
        [
            ("http://{place}/403", "access is refused (403"),
            ("http://{place}/500", "the store reports an internal error"),
            ("http://{place}/silent", "does not answer in time"),
            ("http://127.0.0.1:9", "the host cannot be reached"),
        ],
        1,
    ),
)
def test_an_s3_server(endpoint: str, message: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    s3fs = pytest.importorskip("s3fs", reason="s3fs reads S3")
    monkeypatch.setattr(s3fs.S3FileSystem, "retries", 2)
    for name, value in {**S3, "AWS_ENDPOINT_URL": endpoint.format(place=place)}.items():
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    (tmp_path / "a.bag").write_bytes(HALL)
    began = time.monotonic()
    for call in (
        lambda: pc2scan.info("s3://bucket/hall.bag"),
        lambda: batch("s3://bucket/in", tmp_path / "out"),
        lambda: batch(tmp_path / "a.bag", "s3://bucket/out"),
        lambda: pc2scan.convert(tmp_path / "a.bag", "s3://bucket/x.bag"),
    ):
        with pytest.raises(Pc2ScanError) as caught:
            call()
        assert message in caught.value.message
        assert isinstance(caught.value, RecordingError | OutputError)
        assert caught.value.exit_status == 1
        assert str(caught.value.path).startswith("s3://bucket")
    assert time.monotonic() - began < 60
    s3fs.S3FileSystem.clear_instance_cache()


def test_no_credentials(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    s3fs = pytest.importorskip("s3fs", reason="s3fs reads S3")
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    nothing = tmp_path / "none"
    settings = {"AWS_EC2_METADATA_DISABLED": "true", "AWS_ENDPOINT_URL": "http://127.0.0.1:9"}
    for name in ("AWS_SHARED_CREDENTIALS_FILE", "AWS_CONFIG_FILE"):
        settings[name] = str(nothing)
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(RecordingError, match=r"s3://bucket/a\.bag: access is refused \(403, or no credentials\)"):
        pc2scan.info("s3://bucket/a.bag")
    s3fs.S3FileSystem.clear_instance_cache()
