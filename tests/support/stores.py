"""Stores for recordings: one in memory, and an S3 server on this computer."""

from __future__ import annotations

import hashlib
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["memory_store", "s3_server"]


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
