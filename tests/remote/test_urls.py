"""Which paths are URLs, and what of them is shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from pc2scan.remote.urls import UrlNames, is_url, shown_path, url_of


@pytest.mark.parametrize("url", ["s3://bucket/a/b.mcap", "gs://b/c", "az://b/c", "https://h/x.bag?s=1", "memory://b/c"])
def test_a_url_survives_a_path(url: str) -> None:
    assert is_url(Path(url))
    assert url_of(Path(url)) == url


@pytest.mark.parametrize("path", ["s3", "a/s3://b", "./s3:/b", "C:/b", "ftp://h/b", "drive.mcap"])
def test_other_paths_are_none(path: str) -> None:
    assert not is_url(Path(path).absolute() if path.startswith(".") else Path(path))


def test_secrets_are_not_shown() -> None:
    assert shown_path(Path("https://me:secret@h:8/x.bag?token=1#f")) == "https://h:8/x.bag"
    assert shown_path(Path("a/b")) == str(Path("a/b"))


def test_folders_become_urls() -> None:
    names = UrlNames()
    names.add(Path("/t/0"), "s3://b/in")
    assert names.of(["/t/0/x.mcap: damaged", ("/t/0", 1), {"a": Path("/t/0/x")}]) == [
        "s3://b/in/x.mcap: damaged",
        ("s3://b/in", 1),
        {"a": "s3://b/in/x"},
    ]
