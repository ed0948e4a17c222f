"""``--split``: recordings in several files, read by the readers of others."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from mcap.reader import make_reader
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag2 import Reader as Rosbag2Reader
from ruamel.yaml import YAML

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.errors import DestinationError, OutputError, UsageError
from pc2scan.files import staged_parts
from pc2scan.files.staging import rename_file
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from collections.abc import Iterable

HALL = ROOT / "fixtures" / "hall.bag"
HEIGHTS: dict[str, Any] = {"min_height": -0.3}

#: Name of the destination, and options.
KINDS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("out.bag", {}),
    ("out.mcap", {}),
    ("out", {"storage": "mcap"}),
    ("out", {"storage": "sqlite3"}),
)


def parts_of(folder: Path) -> list[Path]:
    found = [path for path in folder.rglob("*") if path.is_file() and path.name != "metadata.yaml"]
    return sorted(found, key=lambda path: int(path.stem.rpartition("_")[2]))


def messages(paths: Path | Iterable[Path]) -> list[tuple[str, int, bytes]]:
    """The messages of recordings, in order."""
    found = []
    for path in [paths] if isinstance(paths, Path) else paths:
        reader = open_recording(path)
        try:
            found += [(each.connection.topic, each.log_time_ns, bytes(each.data)) for each in reader.messages()]
        finally:
            reader.close()
    return found


def elsewhere_read(path: Path) -> list[tuple[str, int, bytes]]:
    """The messages of one file or directory, by a reader that is not ours."""
    if path.suffix == ".mcap":
        with path.open("rb") as file:
            return [(channel.topic, each.log_time, each.data) for _, channel, each in make_reader(file).iter_messages()]
    with (Rosbag1Reader if path.suffix == ".bag" else Rosbag2Reader)(path) as reader:
        return [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]


@pytest.mark.parametrize(("name", "form"), KINDS, ids=str)
@pytest.mark.parametrize("split", ["0.15s", "20kB"])
def test_the_parts_together_are_the_whole(name: str, form: dict[str, Any], split: str, tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    pc2scan.convert(HALL, tmp_path / name, keep_clouds=split != "0.15s", **HEIGHTS, **form)
    report = pc2scan.convert(
        HALL, tmp_path / "parts" / name, split=split, keep_clouds=split != "0.15s", **HEIGHTS, **form
    )
    whole = messages(tmp_path / name)
    files = parts_of(tmp_path / "parts")
    assert report.files == [str(path) for path in files]
    assert len(files) > 2
    stem = Path(name).stem
    assert [path.stem for path in files] == [f"{stem}_{number}" for number in range(len(files))]
    parts = [messages(path) for path in files]
    assert [message for part in parts for message in part] == whole
    if split == "0.15s":
        first_ns = whole[0][1]
        for part in parts:
            assert len({(time - first_ns) // 150_000_000 for _, time, _ in part}) == 1
    # The readers of others read them, too.
    if name == "out":
        assert elsewhere_read(tmp_path / "parts" / name) == whole
    for path, part in zip(files, parts, strict=True):
        if path.suffix != ".db3":
            assert elsewhere_read(path) == part
    # Together they are one recording again.
    if name != "out":
        pc2scan.repair(files[0], tmp_path / f"first{path.suffix}")
        assert messages(tmp_path / f"first{path.suffix}") == parts[0]
        found = [(each.topic, each.log_time_ns) for each in pc2scan.scans(files[::-1])]
        assert found == [(topic, time) for topic, time, _ in whole if topic == "/scan"]


@pytest.mark.parametrize(("name", "form"), KINDS, ids=str)
def test_every_part_stands_alone_with_what_lasts(name: str, form: dict[str, Any], tmp_path: Path) -> None:
    pc2scan.convert(HALL, tmp_path / name, split="0.1s", repeat_latched=True, **HEIGHTS, **form)
    files = parts_of(tmp_path)
    static = messages(files[0])[0]
    assert static[0] == "/tf_static"
    for number, path in enumerate(files):
        found = messages(path)
        assert [data for topic, _, data in found if topic == "/tf_static"] == [static[2]]
        # It has the time of the message that it is repeated for, so that players do not wait.
        assert found[0][0] == "/tf_static"
        assert number == 0 or found[0][1] == found[1][1]
        mount = pc2scan.tf(path).lookup("base_link", "lidar")
        assert mount.pose == pc2scan.tf(HALL).lookup("base_link", "lidar").pose


def test_metadata_says_what_is_in_each_file(tmp_path: Path) -> None:
    pc2scan.convert(HALL, tmp_path / "out", split="0.2s", repeat_latched=True, **HEIGHTS)
    text = (tmp_path / "out" / "metadata.yaml").read_text()
    metadata = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
    with Rosbag2Reader(tmp_path / "out") as reader:
        found = [messages(tmp_path / "out" / path) for path in metadata["relative_file_paths"]]
        assert len(found) == len(metadata["files"]) == 3
        for file, part in zip(metadata["files"], found, strict=True):
            times = [time for _, time, _ in part]
            assert file["message_count"] == len(part)
            assert file["starting_time"]["nanoseconds_since_epoch"] == min(times)
            assert file["duration"]["nanoseconds"] == max(times) - min(times)
        every = [message for part in found for message in part]
        assert reader.message_count == len(every)
        assert {topic: info.msgcount for topic, info in reader.topics.items()} == {
            topic: sum(each[0] == topic for each in every) for topic in {each[0] for each in every}
        }


@pytest.mark.parametrize(("name", "form"), KINDS, ids=str)
@pytest.mark.parametrize("split", ["0.1s", "30kB"])
def test_the_files_do_not_depend_on_threads(name: str, form: dict[str, Any], split: str, tmp_path: Path) -> None:
    found = []
    for jobs in (1, 4):
        (tmp_path / f"{jobs}").mkdir()
        pc2scan.convert(
            HALL,
            tmp_path / f"{jobs}" / name,
            split=split,
            repeat_latched=True,
            keep_clouds=True,
            jobs=jobs,
            **HEIGHTS,
            **form,
        )
        found.append([(path.name, path.read_bytes()) for path in parts_of(tmp_path / f"{jobs}")])
    assert found[0] == found[1]


# --- harmless ---


@pytest.fixture
def existing(tmp_path: Path) -> Path:
    """Three parts of an older recording."""
    for number in (0, 1, 7):
        (tmp_path / f"out_{number}.bag").write_text(f"old {number}")
    (tmp_path / "out_x.bag").write_text("no part")
    return tmp_path / "out.bag"


def state(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_existing_parts_are_refused_before_anything_is_written(existing: Path) -> None:
    before = state(existing.parent)
    for how in ({}, {"dry_run": True}):
        with pytest.raises(DestinationError, match="exists already") as caught:
            pc2scan.convert(HALL, existing, split="0.2s", **HEIGHTS, **how)  # type: ignore[arg-type]
        assert caught.value.path == existing.with_name("out_0.bag")
    # Even one that would not be written over: it would be read as a part.
    for number in (0, 1):
        existing.with_name(f"out_{number}.bag").unlink()
    with pytest.raises(DestinationError, match="exists already"):
        pc2scan.convert(HALL, existing, split="0.2s", **HEIGHTS)
    assert state(existing.parent).items() <= before.items()


def test_only_what_is_written_is_replaced_if_asked(existing: Path) -> None:
    for how in ({"dry_run": True}, {}):
        report = pc2scan.convert(HALL, existing, split="0.2s", overwrite=True, **HEIGHTS, **how)  # type: ignore[arg-type]
        # No record says that the last one is ours: it is a name that rosbag gives, too.
        (warning,) = (text for text in report.warnings if "out_7.bag" in text)
        assert "it stays" in warning
    names = ["out_0.bag", "out_1.bag", "out_2.bag", "out_7.bag", "out_x.bag"]
    assert sorted(state(existing.parent)) == names
    assert existing.with_name("out_7.bag").read_text() == "old 7"
    assert len(messages(existing.with_name("out_2.bag"))) == 2


def test_a_directory_of_several_files_is_replaced_as_a_whole(tmp_path: Path) -> None:
    pc2scan.convert(HALL, tmp_path / "out", split="0.1s", **HEIGHTS)
    assert len(parts_of(tmp_path)) == 5
    pc2scan.convert(HALL, tmp_path / "out", split="0.2s", overwrite=True, **HEIGHTS)
    assert len(parts_of(tmp_path)) == 3
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(DestinationError, match="notes"):
        pc2scan.convert(HALL, tmp_path / "out", split="0.2s", overwrite=True, **HEIGHTS)


def test_a_source_is_never_replaced(tmp_path: Path) -> None:
    pc2scan.convert(HALL, tmp_path / "drive.bag", split="0.2s", keep_clouds=True, **HEIGHTS)
    files = parts_of(tmp_path)
    before = state(tmp_path)
    with pytest.raises(DestinationError, match="is a source"):
        pc2scan.convert(files, tmp_path / "drive.bag", split="0.1s", overwrite=True, topics="/points:=/b", **HEIGHTS)
    assert state(tmp_path) == before


@pytest.mark.parametrize("overwrite", [False, True])
def test_all_parts_appear_or_none(
    existing: Path, overwrite: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if not overwrite:
        for number in (0, 1, 7):
            existing.with_name(f"out_{number}.bag").unlink()
    before = state(tmp_path)
    calls = [0]

    def failing(partial: Path, dst: Path) -> None:
        calls[0] += 1
        if calls[0] == 3:
            raise OSError(5, "Input/output error")
        rename_file(partial, dst)

    monkeypatch.setattr(staged_parts, "rename_file", failing)
    with pytest.raises(OutputError, match="its parts cannot be renamed"):
        pc2scan.convert(HALL, existing, split="0.2s", overwrite=overwrite, **HEIGHTS)
    assert state(tmp_path) == before


@pytest.mark.parametrize("killed_at", range(1, 12))
def test_what_a_killed_run_leaves_is_put_right_by_the_next(killed_at: int, existing: Path, tmp_path: Path) -> None:
    """Kill a child process at each of the system calls that put parts in place."""
    before = state(tmp_path)
    child = os.fork()
    if child == 0:
        calls = [0]

        def counted(name: str) -> None:
            real = getattr(os, name)

            def call(*args: Any, **kwargs: Any) -> Any:
                if any(f"{tmp_path}/out_" in str(arg) for arg in args):
                    calls[0] += 1
                    if calls[0] == killed_at:
                        os._exit(9)
                return real(*args, **kwargs)

            setattr(os, name, call)

        for name in ("rename", "link", "unlink"):
            counted(name)
        try:
            pc2scan.convert(HALL, existing, split="0.2s", overwrite=True, jobs=1, **HEIGHTS)
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) in (0, 9)
    # The next run looks, and fails for another reason: what it finds is the old set, or the new one.
    with pytest.raises(DestinationError, match="exists already"):
        pc2scan.convert(HALL, existing, split="0.2s", **HEIGHTS)
    found = {name: data for name, data in state(tmp_path).items() if not name.endswith(".lock")}
    is_old = found == before
    names = ["out_0.bag", "out_1.bag", "out_2.bag", "out_7.bag", "out_x.bag"]
    is_new = sorted(found) == names and found["out_0.bag"] != b"old 0" and found["out_7.bag"] == b"old 7"
    assert is_old or is_new, sorted(found)


# --- asking ---


@pytest.mark.parametrize("split", ["60", "0s", "ten", "5 parsecs", "-3s", ""])
def test_what_is_no_time_and_no_size(split: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="a time or a size") as caught:
        pc2scan.convert(HALL, tmp_path / "out.bag", split=split, **HEIGHTS)
    assert "60s" in str(caught.value.hint)


def test_repeating_goes_with_splitting(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="`repeat_latched` needs `split`"):
        pc2scan.convert(HALL, tmp_path / "out.bag", repeat_latched=True, **HEIGHTS)


@pytest.mark.parametrize("name", ["out.bag", "out"])
def test_the_command(name: str, tmp_path: Path) -> None:
    words = ("convert", HALL, "-o", tmp_path / name, "--min-height", "-0.3", "--split", "200ms")
    done = run(*words, "--dry-run")
    assert done.status == 0, done.stderr
    assert "3 files" in done.stdout
    assert not list(tmp_path.iterdir())
    done = run(*words, "--report", tmp_path / "report.json")
    assert done.status == 0, done.stderr
    files = json.loads((tmp_path / "report.json").read_text())["files"]
    assert f"\n{tmp_path / name}: 3 files, {files[0]} to {files[2]}: " in done.stdout
    assert [Path(file).is_file() for file in files] == [True] * 3
    if name == "out.bag":
        assert done.stdout.splitlines()[-1] == f"next: rosbag play --clock {' '.join(files)}"
    done = run("convert", HALL, "-o", tmp_path / "b.bag", "--min-height", "-0.3", "--split", "60")
    assert (done.status, "--split is '60'" in done.stderr) == (2, True)
