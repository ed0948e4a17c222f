"""The file of a recording: read at given places, or written from start to end."""

from __future__ import annotations

import os
import random
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.errors import RecordingError
from pc2scan.files.new_file import NewFile
from pc2scan.files.source_file import SourceFile

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "file"
    path.write_bytes(bytes(range(100)))
    return path


@pytest.fixture
def file(path: Path) -> Iterator[SourceFile]:
    with closing(SourceFile(path)) as opened:
        yield opened


LARGE = random.Random(1).randbytes(3 << 20)


@pytest.fixture
def large(tmp_path: Path) -> Path:
    path = tmp_path / "large"
    path.write_bytes(LARGE)
    return path


@pytest.mark.parametrize("system", ["as it is", "without preadv", "with short answers"])
@pytest.mark.parametrize(
    ("offset", "length"),
    [(0, 3 << 20), (12_345, 1 << 20), (3 << 20, 0), (5, (1 << 18) - 1), (5, 1 << 18), (9, (1 << 20) + 1)],
)
def test_what_is_borrowed_is_what_would_be_read(
    offset: int, length: int, system: str, large: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    preadv = getattr(os, "preadv", None)
    if system == "without preadv":
        monkeypatch.delattr(os, "preadv", raising=False)
    elif system == "with short answers" and preadv is not None:
        monkeypatch.setattr(os, "preadv", lambda fd, views, offset: preadv(fd, [views[0][:99_999]], offset))
    with closing(SourceFile(large)) as file:
        for _ in range(2):
            data = file.borrow(offset, length)
            assert (data.readonly, bytes(data)) == (True, LARGE[offset : offset + length])
            assert data == file.read(offset, length)


def test_what_is_not_there_is_an_error(file: SourceFile, path: Path, large: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="2 bytes are declared from byte 99 on, but the file has 100 bytes"):
        file.read(99, 2)
    os.truncate(path, 60)
    with pytest.raises(RecordingError, match="ended at byte 60 while it was read; it had 100 bytes") as caught:
        file.read(50, 20)
    assert caught.value.path == path
    file.close()
    file.close()
    with pytest.raises(RecordingError, match="cannot be read at byte 3: Bad file descriptor"):
        file.read(3, 1)
    closed = SourceFile(large)
    closed.close()
    for length in (10, 1 << 20):
        with pytest.raises(RecordingError, match="cannot be read"):
            closed.borrow(0, length)
    with pytest.raises(RecordingError, match="cannot be opened: No such file"):
        SourceFile(tmp_path / "none")


def test_a_new_file_tells_where_everything_is(tmp_path: Path) -> None:
    file = NewFile(tmp_path / "new")
    assert file.put(b"head", memoryview(b"er")) == 0
    assert file.put(b"body") == 6
    assert file.position == 10
    file.replace(0, b"HEAD")
    file.finish()
    assert (tmp_path / "new").read_bytes() == b"HEADerbody"
