"""A destination appears whole or not at all."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.rosbag2.metadata import recorded_in
from pc2scan.errors import DestinationError, OutputError
from pc2scan.files.staging import staged as staged_anywhere
from support.rosbag2_files import compress_file, write_metadata

if TYPE_CHECKING:
    from collections.abc import Callable

staged = partial(staged_anywhere, record_in=recorded_in)


def names(folder: str | Path) -> list[str]:
    return sorted(entry.name for entry in Path(folder).iterdir())


def make_file(path: Path) -> None:
    path.write_text("new")


def make_directory(path: Path) -> None:
    path.mkdir()
    (path / "metadata.yaml").write_text("new")
    (path / "x_0.db3").write_text("new")


def make_recording(path: Path) -> None:
    """What may be replaced: a directory that is a recording, and nothing else."""
    path.mkdir()
    write_metadata(path, 8, ["x_0.db3"])
    (path / "x_0.db3").write_text("old")


def is_new(path: Path) -> bool:
    return (path / "metadata.yaml" if path.is_dir() else path).read_text() == "new"


make = pytest.mark.parametrize("make", [make_file, make_directory])


@make
def test_success(tmp_path: Path, make: Callable[[Path], None]) -> None:
    dst = tmp_path / "out.mcap"
    with staged(dst, overwrite=False) as partial:
        assert partial == tmp_path / "out.mcap.pc2scan-partial"
        assert not partial.exists()
        make(partial)
        assert not dst.exists()
    assert is_new(dst)
    assert names(tmp_path) == ["out.mcap"]


@make
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("existing", ["nothing", "file", "directory"])
def test_failure_leaves_everything_as_it_was(
    tmp_path: Path, make: Callable[[Path], None], error: type[BaseException], existing: str
) -> None:
    dst = tmp_path / "out"
    if existing == "file":
        dst.write_text("old")
    if existing == "directory":
        make_recording(dst)

    def run() -> None:
        with staged(dst, overwrite=True) as partial:
            make(partial)
            raise error

    with pytest.raises(error):
        run()
    assert names(tmp_path) == ([] if existing == "nothing" else ["out"])
    assert existing == "nothing" or not is_new(dst)


@make
@pytest.mark.parametrize("existing", ["nothing", "file", "directory", "dangling link"])
def test_overwriting(tmp_path: Path, make: Callable[[Path], None], existing: str) -> None:
    dst = tmp_path / "out"
    if existing == "file":
        dst.write_text("old")
    if existing == "directory":
        make_recording(dst)
    if existing == "dangling link":
        dst.symlink_to(tmp_path / "missing")
    with staged(dst, overwrite=True) as partial:
        make(partial)
        assert os.path.lexists(dst) == (existing != "nothing")
    assert is_new(dst)
    assert not dst.is_symlink()
    assert names(tmp_path) == ["out"]


def test_overwriting_a_link_leaves_its_target(tmp_path: Path) -> None:
    (tmp_path / "target").write_text("old")
    (tmp_path / "out").symlink_to(tmp_path / "target")
    with staged(tmp_path / "out", overwrite=True) as partial:
        make_file(partial)
    assert (tmp_path / "target").read_text() == "old"
    assert (tmp_path / "out").read_text() == "new"


@pytest.mark.parametrize("existing", ["file", "directory", "dangling link"])
def test_what_exists_is_not_overwritten_unasked(tmp_path: Path, existing: str) -> None:
    dst = tmp_path / "out"
    if existing == "file":
        dst.write_text("old")
    elif existing == "directory":
        dst.mkdir()
    else:
        dst.symlink_to(tmp_path / "missing")
    with pytest.raises(DestinationError, match="exists already") as caught, staged(dst, overwrite=False):
        pytest.fail("the body must not run")
    assert "`overwrite=True`" in (caught.value.hint or "")
    assert names(tmp_path) == ["out"]


@make
@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("rival", [make_file, make_directory])
def test_what_appears_meanwhile_is_not_overwritten(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    make: Callable[[Path], None],
    rival: Callable[[Path], None],
    links: bool,
) -> None:
    dst = tmp_path / "out"
    if not links:
        monkeypatch.setattr(os, "link", no_links)

    def run() -> None:
        with staged(dst, overwrite=False) as partial:
            make(partial)
            rival(dst)
            (dst / "x_0.db3" if dst.is_dir() else dst).write_text("rival")

    with pytest.raises(DestinationError, match="exists already"):
        run()
    assert (dst / "x_0.db3" if dst.is_dir() else dst).read_text() == "rival"
    assert names(tmp_path) == ["out"]


def no_links(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_file_systems_without_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "link", no_links)
    with staged(tmp_path / "out", overwrite=False) as partial:
        make_file(partial)
    assert is_new(tmp_path / "out")
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("foreign", ["thesis.tex", "other.mcap", "x_1.db3", "x_0.db3-notes", "sub/"])
def test_a_directory_with_other_things_is_never_replaced(tmp_path: Path, foreign: str) -> None:
    dst = tmp_path / "out"
    make_recording(dst)
    if foreign.endswith("/"):
        (dst / foreign).mkdir()
    else:
        (dst / foreign).touch()
    with (
        pytest.raises(DestinationError, match=f"its metadata.yaml does not name {foreign.rstrip('/')}"),
        staged(dst, overwrite=True),
    ):
        pytest.fail("the body must not run")
    assert (dst / foreign).exists()


def test_what_is_put_into_a_directory_meanwhile_stays(tmp_path: Path) -> None:
    dst = tmp_path / "out"
    make_recording(dst)

    def run() -> None:
        with staged(dst, overwrite=True) as partial:
            make_directory(partial)
            (dst / "thesis.tex").write_text("years of work")

    with pytest.raises(DestinationError, match="does not name thesis"):
        run()
    assert names(dst) == ["metadata.yaml", "thesis.tex", "x_0.db3"]
    assert names(tmp_path) == ["out"]


def test_a_recording_with_its_logs_and_packed_files_is_replaced(tmp_path: Path) -> None:
    dst = tmp_path / "out"
    make_recording(dst)
    write_metadata(dst, 3, ["x_0.db3", "x_1.db3", "gone.db3"])
    for name in ("x_0.db3-wal", "x_0.db3-shm", "x_1.db3"):
        (dst / name).write_text("old")
    compress_file(dst / "x_1.db3")
    with staged(dst, overwrite=True) as partial:
        make_directory(partial)
    assert is_new(dst)


@pytest.mark.parametrize("text", ["", "notes: about the robot", "{", "rosbag2_bagfile_information: {}"])
def test_a_directory_whose_metadata_is_no_recordings_is_never_replaced(text: str, tmp_path: Path) -> None:
    dst = tmp_path / "out"
    make_recording(dst)
    (dst / "metadata.yaml").write_text(text)
    with pytest.raises(DestinationError, match="is not understood"), staged(dst, overwrite=True):
        pytest.fail("the body must not run")
    assert names(dst) == ["metadata.yaml", "x_0.db3"]


def test_special_files_are_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "out")
    with pytest.raises(DestinationError, match="neither a file"), staged(tmp_path / "out", overwrite=True):
        pytest.fail("the body must not run")


def test_a_failing_rename_brings_the_old_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dst = tmp_path / "out"
    make_recording(dst)
    rename = Path.rename

    def fail_once(self: Path, target: Path) -> Path:
        if self.name.endswith("-partial"):
            raise OSError(5, "Input/output error")
        return rename(self, target)

    def run() -> None:
        with staged(dst, overwrite=True) as partial:
            make_directory(partial)

    monkeypatch.setattr(Path, "rename", fail_once)
    with pytest.raises(OutputError, match="cannot be renamed to its final name: Input/output error"):
        run()
    assert (dst / "x_0.db3").read_text() == "old"
    assert names(tmp_path) == ["out"]


def test_what_an_interrupted_overwrite_left_comes_back(tmp_path: Path) -> None:
    # Killed between moving the old away and moving the new in.
    (tmp_path / "out.pc2scan-old").mkdir()
    (tmp_path / "out.pc2scan-old" / "metadata.yaml").write_text("old")
    with pytest.raises(DestinationError, match="exists already"), staged(tmp_path / "out", overwrite=False):
        pytest.fail("the body must not run")
    assert (tmp_path / "out" / "metadata.yaml").read_text() == "old"
    assert names(tmp_path) == ["out"]


def test_what_was_replaced_goes_even_if_the_run_that_did_it_died(tmp_path: Path) -> None:
    make_directory(tmp_path / "out")
    make_directory(tmp_path / "out.pc2scan-old")
    with pytest.raises(DestinationError, match="exists already"), staged(tmp_path / "out", overwrite=False):
        pytest.fail("the body must not run")
    assert names(tmp_path) == ["out"]


@make
@pytest.mark.parametrize("left", [make_file, make_directory])
def test_what_a_dead_run_left_is_removed(
    tmp_path: Path, make: Callable[[Path], None], left: Callable[[Path], None]
) -> None:
    left(tmp_path / "out.pc2scan-partial")
    (tmp_path / "out.pc2scan-partial.lock").touch()
    with staged(tmp_path / "out", overwrite=False) as partial:
        assert not partial.exists()
        make(partial)
    assert names(tmp_path) == ["out"]


def test_a_left_link_is_removed_and_not_followed(tmp_path: Path) -> None:
    make_directory(tmp_path / "precious")
    (tmp_path / "out.pc2scan-partial").symlink_to(tmp_path / "precious")
    with staged(tmp_path / "out", overwrite=False) as partial:
        make_file(partial)
    assert is_new(tmp_path / "precious")


def test_a_body_that_makes_nothing(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file"), staged(tmp_path / "out", overwrite=False):
        pass
    assert names(tmp_path) == []
