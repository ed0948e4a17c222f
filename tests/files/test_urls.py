"""Which paths are URLs, what of them is shown, and how they behave as paths."""

from __future__ import annotations

import os
import pickle
from contextlib import ExitStack
from pathlib import Path

import pytest

from pc2scan.files.paths import is_url, path_or_url
from pc2scan.files.urls import CopyPath, UrlPath


@pytest.mark.parametrize("url", ["s3://b/a/b", "gs://b/c", "az://b/c", "https://h/x.bag?s=../1", "memory://b/c"])
def test_a_url_survives_a_path(url: str) -> None:
    for path in (path_or_url(url), path_or_url(Path(url)), pickle.loads(pickle.dumps(path_or_url(url)))):
        assert isinstance(path, UrlPath)
        assert os.fspath(path) == url


@pytest.mark.parametrize("path", ["s3", "a/s3://b", "./s3:/b", "C:/b", "ftp://h/b", "drive.mcap"])
def test_other_paths_are_none(path: str) -> None:
    local = Path(path).absolute() if path.startswith(".") else Path(path)
    assert not is_url(local)
    assert not isinstance(path_or_url(local), UrlPath)


def test_secrets_are_not_shown() -> None:
    path = UrlPath("https://me:secret@h:8/in/x.bag?token=1#f")
    assert (str(path), path.name, path.suffix) == ("https://h:8/in/x.bag", "x.bag", ".bag")
    # A new name has no signature; the folder still has the password.
    assert os.fspath(path.with_name("y.bag")) == "https://me:secret@h:8/in/y.bag"
    with ExitStack() as stack:
        copy = CopyPath.of(path, stack)
        Path(copy, "part").mkdir(parents=True)
        shown = [*copy.iterdir(), copy.with_name("y")]
    assert list(map(str, shown)) == ["https://h:8/in/x.bag/part", "https://h:8/in/y"]
    assert (str(copy), copy.parent.exists()) == ("https://h:8/in/x.bag", False)


def test_one_object_has_one_name() -> None:
    assert path_or_url("s3://b/x/../hall.bag") == path_or_url("s3://b//hall.bag") == UrlPath("s3://b/hall.bag")
