"""A destination appears whole or not at all, and is no input; what is refused is in `transcripts/ownership.txt`."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager, nullcontext
from itertools import product
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import pytest

from pc2scan.bags.rosbag2.read import recorded_in
from pc2scan.errors import DestinationError, OutputError
from pc2scan.files.outputs import InputPath, files_output, refuse_overlap
from pc2scan.files.outputs import staged_output as output_anywhere
from support.rosbag2_files import write_metadata

if TYPE_CHECKING:
    from collections.abc import Callable


def staged_output(destination: Path, *, overwrite: bool) -> AbstractContextManager[Path]:
    return output_anywhere(destination, overwrite=overwrite, record_in=recorded_in)


def seen(folder: Path) -> dict[str, Any]:
    """Everything in a folder: what files have, where links lead, and kinds of others."""

    def state(path: Path) -> Any:
        if path.is_symlink():
            return path.readlink()
        return path.read_bytes() if path.is_file() else path.is_fifo()

    return {path.relative_to(folder).as_posix(): state(path) for path in folder.rglob("*")}


def refused(destination: Path, message: str, *, overwrite: bool = True) -> DestinationError:
    """Assert that it is refused before anything is made, and changes nothing."""
    before = seen(destination.parent)
    with pytest.raises(DestinationError, match=message) as caught, staged_output(destination, overwrite=overwrite):
        pytest.fail("the body must not run")
    assert seen(destination.parent) == before
    return caught.value


def make_file(path: Path) -> None:
    path.write_text("new")


def make_directory(path: Path) -> None:
    path.mkdir()
    (path / "metadata.yaml").write_text("new")
    (path / "x_0.db3").write_text("new")


def make_recording(path: Path, *names: str) -> None:
    """What may be replaced: a directory that is a recording, and nothing else."""
    path.mkdir()
    write_metadata(path, 8, ["x_0.db3"])
    for name in ("x_0.db3", *names):
        (path / name).mkdir() if name.endswith("/") else (path / name).write_text("old")


MAKE = (make_file, make_directory)
make = pytest.mark.parametrize("make", MAKE)

#: What is there before, and why it is not replaced; empty if it may be.
EXISTING: dict[str, tuple[Callable[[Path], Any], str]] = {
    "nothing": (lambda _: None, ""),
    "file": (lambda path: path.write_text("old"), ""),
    "recording": (make_recording, ""),
    "link": (lambda path: path.symlink_to("target"), ""),
    "dangling link": (lambda path: path.symlink_to("missing"), ""),
    "empty directory": (Path.mkdir, ""),
    "directory": (make_directory, "is not understood"),
    "pipe": (os.mkfifo, "neither a file"),
}
ENDINGS: tuple[type[BaseException] | None, ...] = (None, ValueError, KeyboardInterrupt, SystemExit)


@make
@pytest.mark.parametrize("existing", EXISTING)
def test_all_or_nothing_appears(existing: str, make: Callable[[Path], None], tmp_path: Path) -> None:
    """An oracle says what is there afterwards, however the run ends."""
    prepare, why_not = EXISTING[existing]
    for number, (overwrite, ending) in enumerate(product((False, True), ENDINGS)):
        folder, expected = tmp_path / str(number), tmp_path / f"expected {number}"
        for each in (folder, expected):
            each.mkdir()
            (each / "target").write_text("old")
        prepare(folder / "out")
        before = seen(folder)
        if existing != "nothing" and (why_not or not overwrite):
            error = refused(folder / "out", why_not if overwrite else "exists already", overwrite=overwrite)
            assert overwrite or "`overwrite=True`" in (error.hint or "")
            continue
        make(expected / "out")
        ends: AbstractContextManager[Any] = pytest.raises(ending) if ending else nullcontext()
        with ends, staged_output(folder / "out", overwrite=overwrite) as partial:
            assert partial == folder / "out.pc2scan-partial"
            assert not partial.exists()
            make(partial)
            assert {name: state for name, state in seen(folder).items() if ".pc2scan-" not in name} == before
            if ending:
                raise ending
        assert seen(folder) == (seen(expected) if ending is None else before)


@pytest.mark.parametrize("foreign", ["thesis.tex", "other.mcap", "x_1.db3", "x_0.db3-notes", "sub/"])
def test_a_directory_with_other_things_is_never_replaced(foreign: str, tmp_path: Path) -> None:
    make_recording(tmp_path / "out", foreign)
    refused(tmp_path / "out", f"because of {foreign.rstrip('/')}: no record names it")


def test_a_failing_rename_brings_the_old_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_recording(tmp_path / "out")
    before, rename = seen(tmp_path), Path.rename

    def fail_once(self: Path, target: Path) -> Path:
        if self.name.endswith("-partial"):
            raise OSError(5, "Input/output error")
        return rename(self, target)

    def run() -> None:
        with staged_output(tmp_path / "out", overwrite=True) as partial:
            make_directory(partial)

    monkeypatch.setattr(Path, "rename", fail_once)
    with pytest.raises(OutputError, match="cannot be renamed to its final name: Input/output error"):
        run()
    assert seen(tmp_path) == before


# --- What dead runs have left ---


@pytest.mark.parametrize("is_complete", [False, True])
def test_what_an_interrupted_overwrite_left_comes_back(is_complete: bool, tmp_path: Path) -> None:
    # Killed between moving the old away and moving the new in, or behind that.
    make_recording(tmp_path / "out.pc2scan-old")
    if is_complete:
        make_directory(tmp_path / "out")
    expected = seen(tmp_path / ("out" if is_complete else "out.pc2scan-old"))
    with pytest.raises(DestinationError, match="exists already"), staged_output(tmp_path / "out", overwrite=False):
        pytest.fail("the body must not run")
    assert seen(tmp_path / "out") == expected
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@make
@pytest.mark.parametrize("left", [*MAKE, lambda path: path.symlink_to("precious")])
def test_what_a_dead_run_left_is_removed(
    make: Callable[[Path], None], left: Callable[[Path], None], tmp_path: Path
) -> None:
    make_directory(tmp_path / "precious")
    make(tmp_path / "expected")
    expected = seen(tmp_path / "precious"), seen(tmp_path / "expected")
    left(tmp_path / "out.pc2scan-partial")
    (tmp_path / "out.pc2scan-partial.lock").touch()
    with staged_output(tmp_path / "out", overwrite=False) as partial:
        assert not os.path.lexists(partial)
        make(partial)
    # A link is not followed.
    assert (seen(tmp_path / "precious"), seen(tmp_path / "out")) == expected
    assert sorted(path.name for path in tmp_path.iterdir()) == ["expected", "out", "precious"]


# --- Several files ---


@pytest.mark.parametrize("failing", [0, 1, 2, 3])
def test_several_files_appear_all_or_none(failing: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened, calls = Path.open, iter(range(1, 4))

    def fails(self: Path, mode: str) -> IO[Any]:
        if mode == "wb" and next(calls) == failing:
            raise OSError(28, "no space")
        return opened(self, mode)

    monkeypatch.setattr(Path, "open", fails)
    paths = [tmp_path / name for name in "abc"]

    def run() -> None:
        with files_output(paths, overwrite=False) as write:
            assert not any(path.exists() for path in paths)
            write(["1", b"2", [b"", b"3"]])

    if failing:
        with pytest.raises(OutputError, match="no space") as caught:
            run()
        assert caught.value.path == paths[failing - 1]
    else:
        run()
    assert seen(tmp_path) == ({} if failing else {"a": b"1", "b": b"2", "c": b"3"})


# --- Inputs ---


def test_what_has_nothing_to_do_with_each_other(tmp_path: Path) -> None:
    for name in ("bag", "bag/metadata.yaml", "bag/x_0.db3", "a.db3"):
        (tmp_path / name).mkdir() if name == "bag" else (tmp_path / name).touch()
    (tmp_path / "loop").symlink_to("loop")
    inputs = [InputPath(tmp_path / name) for name in ("bag", "a.db3", "loop", "missing", "missing/deeper")]
    outputs = [tmp_path / name for name in ("new", "bag2", "a.db", "no/where", "loop2", "bag.pc2scan-old")]
    refuse_overlap(inputs, outputs)
    refuse_overlap([InputPath(Path())], [Path("../new")])


def test_names_that_differ_in_case_may_be_two_files(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").touch()
    if (tmp_path / "DRIVE.mcap").exists():
        pytest.skip("this file system ignores case")
    refuse_overlap([InputPath(tmp_path / "drive.mcap")], [tmp_path / "DRIVE.mcap"])
