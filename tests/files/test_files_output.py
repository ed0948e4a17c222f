"""Several files are written together: none has its name before all are complete."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.errors import DestinationError, OutputError
from pc2scan.files.source import NewFile
from pc2scan.files.text_output import files_output

if TYPE_CHECKING:
    from pathlib import Path


def test_all_are_written(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in "abc"]
    with files_output(paths, overwrite=False) as write:
        assert not any(path.exists() for path in paths)
        write([b"1", b"2", b"3"])
    assert [path.read_bytes() for path in paths] == [b"1", b"2", b"3"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "c"]


@pytest.mark.parametrize("failing", [1, 2, 3])
def test_one_that_cannot_be_written_leaves_none(failing: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    finish, calls = NewFile.finish, iter(range(1, 4))

    def fails(self: NewFile) -> None:
        if next(calls) == failing:
            raise OutputError("cannot be written: no space")
        finish(self)

    monkeypatch.setattr(NewFile, "finish", fails)
    paths = [tmp_path / name for name in "abc"]
    with pytest.raises(OutputError, match="no space") as caught, files_output(paths, overwrite=False) as write:
        write([b"1", b"2", b"3"])
    assert caught.value.path == paths[failing - 1]
    assert list(tmp_path.iterdir()) == []


def test_one_that_is_there_leaves_none(tmp_path: Path) -> None:
    (tmp_path / "b").write_text("mine")
    paths = [tmp_path / name for name in "abc"]
    with pytest.raises(DestinationError), files_output(paths, overwrite=False):
        pytest.fail("it is not begun")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"b": "mine"}
