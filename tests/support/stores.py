"""Stores for recordings: one in memory, and an S3 server and a web server on this computer."""

from __future__ import annotations

import hashlib
import threading
from contextlib import contextmanager, suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def memory_store(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Empty ``memory://`` at the end; its objects have versions, as those of other stores do. Yields it."""
    fs = pytest.importorskip("fsspec").filesystem("memory")
    kind, info, ls, find = type(fs), type(fs).info, type(fs).ls, type(fs).find

    def versioned(entry: dict[str, Any]) -> dict[str, Any]:
        if entry["type"] != "file":
            return entry
        return entry | {"ETag": hashlib.sha256(fs.store[entry["name"]].getvalue()).hexdigest()}

    def listed(self: Any, path: str, detail: bool = True, **options: Any) -> list[Any]:
        return [versioned(entry) if detail else entry for entry in ls(self, path, detail=detail, **options)]

    monkeypatch.setattr(kind, "info", lambda self, path, **options: versioned(info(self, path, **options)))

    def found(self: Any, path: str, detail: bool = False, **options: Any) -> Any:
        entries = find(self, path, detail=detail, **options)
        return {name: versioned(entry) for name, entry in entries.items()} if detail else entries

    monkeypatch.setattr(kind, "ls", listed)
    monkeypatch.setattr(kind, "find", found)
    yield fs
    fs.rm("/", recursive=True)


@contextmanager
def s3_server() -> Iterator[dict[str, str]]:
    """Run an S3 server; yields the environment variables for it."""
    moto = pytest.importorskip("moto.server", reason="moto's server stands in for S3")
    pytest.importorskip("s3fs", reason="s3fs reads S3")
    running = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    running.start()
    host, port = running.get_host_and_port()
    yield {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing-secret",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    running.stop()


class _Handler(SimpleHTTPRequestHandler):
    """Sends the files of a folder, without ranges; a folder in the path says what it does instead."""

    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        """Log nothing."""

    def do_HEAD(self) -> None:
        self._answer(b"")

    def do_GET(self) -> None:
        self._answer(bytes(50_000))

    def _answer(self, body: bytes) -> None:
        kind, _, name = self.path[1:].partition("/")
        ended: threading.Event = self.server.ended  # type: ignore[attr-defined]
        # Another host gets no password.
        if not name and not (self.headers["Host"].startswith("localhost") and "Authorization" in self.headers):
            super().do_GET() if body else super().do_HEAD()
            return
        self.close_connection = True
        with suppress(OSError):
            if kind == "silent":
                ended.wait(20)
            elif kind.isdigit() or kind == "redirects":
                self.send_response(int(kind) if kind.isdigit() else 302)
                self.send_header("Location", f"http://localhost:{self.server.server_port}/hall.bag")  # type: ignore[attr-defined]
                self.send_header("Content-Length", "0")
                self.end_headers()
            else:
                self.send_response(200)
                self.send_header("Content-Length", str(10**14 if kind == "declares" else 100_000))
                self.end_headers()
                # A byte now and then, so that the server is never silent for long.
                while kind == "trickles" and body and not ended.wait(0.1):
                    self.wfile.write(b"x")
                    self.wfile.flush()
                self.wfile.write(body)
                self.wfile.flush()


@contextmanager
def web_server(folder: Path) -> Iterator[str]:
    """Serve a folder; yields host and port."""
    pytest.importorskip("aiohttp", reason="aiohttp reads http")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Handler, directory=str(folder))) as server:
        server.daemon_threads = True
        server.ended = threading.Event()  # type: ignore[attr-defined]
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{server.server_port}"
        server.ended.set()  # type: ignore[attr-defined]
        server.shutdown()
