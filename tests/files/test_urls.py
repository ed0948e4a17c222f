"""Which paths are URLs, what of them is shown, and how they behave as paths."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import pytest

from pc2scan.files.urls import CopyPath, UrlPath, is_url, path_or_url


@pytest.mark.parametrize("url", ["s3://bucket/a/b.mcap", "gs://b/c", "az://b/c", "https://h/x.bag?s=1", "memory://b/c"])
def test_a_url_survives_a_path(url: str) -> None:
    for path in (path_or_url(url), path_or_url(Path(url)), pickle.loads(pickle.dumps(path_or_url(url)))):
        assert isinstance(path, UrlPath)
        assert os.fspath(path) == url


@pytest.mark.parametrize("path", ["s3", "a/s3://b", "./s3:/b", "C:/b", "ftp://h/b", "drive.mcap"])
def test_other_paths_are_none(path: str) -> None:
    local = Path(path).absolute() if path.startswith(".") else Path(path)
    assert not is_url(local)
    assert not isinstance(path_or_url(local), UrlPath)


def test_secrets_are_not_shown(tmp_path: Path) -> None:
    path = path_or_url("https://me:secret@h:8/in/x.bag?token=1#f")
    assert isinstance(path, UrlPath)
    assert (str(path), path.name, path.suffix) == ("https://h:8/in/x.bag", "x.bag", ".bag")
    # A new name has no signature; the folder still has the password.
    assert os.fspath(path.with_name("y.bag")) == "https://me:secret@h:8/in/y.bag"
    copy = CopyPath.of(path, str(tmp_path))
    assert (str(copy), os.fspath(copy)) == ("https://h:8/in/x.bag", str(tmp_path / "x.bag"))
    (tmp_path / "x.bag").mkdir()
    (tmp_path / "x.bag" / "part").touch()
    shown = [*map(str, copy.iterdir()), str(copy.with_name("y"))]
    assert shown == ["https://h:8/in/x.bag/part", "https://h:8/in/y"]


def test_one_object_has_one_identity() -> None:
    urls = ["s3://b/x/../hall.bag", "s3://b//hall.bag"]
    assert {UrlPath(url).identity for url in urls} == {UrlPath("s3://b/hall.bag")}
