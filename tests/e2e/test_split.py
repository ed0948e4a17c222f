"""``--split``: recordings in several files; what is typed and said is in ``tests/transcripts/split.txt``."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import pytest
from mcap.reader import make_reader
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag2 import Reader as Rosbag2Reader
from ruamel.yaml import YAML

import pc2scan
from pc2scan.errors import DestinationError, OutputError
from pc2scan.files import parts
from pc2scan.files.staging import rename_file
from support import ROOT, sampled
from support.containers import read

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pc2scan.pipeline.report import Report

HALL = ROOT / "fixtures" / "hall.bag"

#: Name of the destination, and options.
KINDS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("out.bag", {}),
    ("out.mcap", {}),
    ("out", {"storage": "mcap"}),
    ("out", {"storage": "sqlite3"}),
)


def convert(destination: Path, split: str | None = "0.2s", **options: Any) -> Report:
    return pc2scan.convert(HALL, destination, split=split, min_height=-0.3, **options)


def parts_of(folder: Path) -> list[Path]:
    found = [path for path in folder.rglob("*") if path.is_file() and path.name != "metadata.yaml"]
    return sorted(found, key=lambda path: int(path.stem.rpartition("_")[2]))


def read_elsewhere(path: Path) -> list[tuple[str, int, bytes]]:
    """The messages of one file or directory, by a reader that is not ours."""
    if path.suffix == ".mcap":
        with path.open("rb") as file:
            return [(channel.topic, each.log_time, each.data) for _, channel, each in make_reader(file).iter_messages()]
    with (Rosbag1Reader if path.suffix == ".bag" else Rosbag2Reader)(path) as reader:
        return [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]


@pytest.mark.parametrize(("name", "form"), KINDS, ids=str)
@pytest.mark.parametrize("split", ["0.15s", "20kB"])
def test_the_parts_together_are_the_whole(name: str, form: dict[str, Any], split: str, tmp_path: Path) -> None:
    options = {"keep_clouds": split != "0.15s", **form}
    parted, again = tmp_path / "parts", tmp_path / "again"
    for folder in (parted, again):
        folder.mkdir()
    convert(tmp_path / name, None, **options)
    report = convert(parted / name, split, jobs=1, **options)
    whole, files = read(tmp_path / name), parts_of(parted)
    assert report.files == [str(path) for path in files]
    assert len(files) > 2
    assert [path.stem for path in files] == [f"out_{number}" for number in range(len(files))]
    parts = [read(path) for path in files]
    assert [message for part in parts for message in part] == whole
    if split == "0.15s":
        for part in parts:
            assert len({(time - whole[0][1]) // 150_000_000 for _, time, _ in part}) == 1
    # The files do not depend on threads.
    convert(again / name, split, jobs=4, **options)
    assert [path.read_bytes() for path in parts_of(again)] == [path.read_bytes() for path in files]
    # The readers of others read them, too.
    for path, part in zip(files, parts, strict=True):
        if path.suffix != ".db3":
            assert read_elsewhere(path) == part
    if name == "out":
        assert read_elsewhere(parted / name) == whole
        return
    # Each is a recording, and together they are one again.
    pc2scan.repair(files[0], tmp_path / f"first{path.suffix}")
    assert read(tmp_path / f"first{path.suffix}") == parts[0]
    found = [(each.topic, each.log_time_ns) for each in pc2scan.scans(files[::-1])]
    assert found == [(topic, time) for topic, time, _ in whole if topic == "/scan"]


@pytest.mark.parametrize(("name", "form"), KINDS, ids=str)
def test_every_part_stands_alone_with_what_lasts(name: str, form: dict[str, Any], tmp_path: Path) -> None:
    convert(tmp_path / name, "0.1s", repeat_latched=True, **form)
    files = parts_of(tmp_path)
    parts = [read(path) for path in files]
    static = parts[0][0]
    for number, (path, part) in enumerate(zip(files, parts, strict=True)):
        assert [data for topic, _, data in part if topic == "/tf_static"] == [static[2]]
        # It has the time of the message that it is repeated for, so that players do not wait.
        assert part[0][0] == "/tf_static"
        assert number == 0 or part[0][1] == part[1][1]
        mount = pc2scan.tf(path).lookup("base_link", "lidar")
        assert mount.pose == pc2scan.tf(HALL).lookup("base_link", "lidar").pose
    if name != "out":
        return
    # metadata.yaml says what is in each file.
    text = (tmp_path / "out" / "metadata.yaml").read_text()
    metadata = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
    assert metadata["relative_file_paths"] == [path.name for path in files]
    for file, part in zip(metadata["files"], parts, strict=True):
        times = [time for _, time, _ in part]
        assert file["message_count"] == len(part)
        assert file["starting_time"]["nanoseconds_since_epoch"] == min(times)
        assert file["duration"]["nanoseconds"] == max(times) - min(times)
    first_ns, last_ns = parts[0][0][1], parts[-1][-1][1]
    assert metadata["starting_time"]["nanoseconds_since_epoch"] == first_ns
    assert metadata["duration"]["nanoseconds"] == last_ns - first_ns
    topics = [topic for part in parts for topic, _, _ in part]
    with Rosbag2Reader(tmp_path / "out") as reader:
        assert reader.message_count == len(topics)
        assert {name: info.msgcount for name, info in reader.topics.items()} == {
            name: topics.count(name) for name in topics
        }


# --- harmless ---

NAMES = ["out_0.bag", "out_1.bag", "out_2.bag", "out_7.bag", "out_x.bag"]


@pytest.fixture
def existing(tmp_path: Path) -> Path:
    """Three parts of an older recording."""
    for number in (0, 1, 7):
        (tmp_path / f"out_{number}.bag").write_text(f"old {number}")
    (tmp_path / "out_x.bag").write_text("no part")
    return tmp_path / "out.bag"


def state(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("overwrite", [False, True])
def test_all_parts_appear_or_none(overwrite: bool, existing: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not overwrite:
        for number in (0, 1, 7):
            existing.with_name(f"out_{number}.bag").unlink()
    before = state(existing.parent)
    calls = [0]

    def failing(partial: Path, dst: Path) -> None:
        calls[0] += 1
        if calls[0] == 3:
            raise OSError(5, "Input/output error")
        rename_file(partial, dst)

    monkeypatch.setattr(parts, "rename_file", failing)
    with pytest.raises(OutputError, match="its parts cannot be renamed"):
        convert(existing, overwrite=overwrite)
    assert state(existing.parent) == before


def killed_at(number: int, folder: Path, action: Callable[[], object]) -> int:
    """Do it in a child process that ends at one of the system calls that put parts in place."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    calls = [0]

    def counted(real: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        calls[0] += any(f"{folder}/out_" in str(arg) for arg in args)
        if calls[0] == number:
            os._exit(9)
        return real(*args, **kwargs)

    for name in ("rename", "link", "unlink"):
        setattr(os, name, counted.__get__(getattr(os, name)))
    try:
        action()
    finally:
        os._exit(0)


@pytest.mark.parametrize("number", sampled(range(1, 9), 4))
def test_the_next_run_puts_right_what_a_killed_one_left(number: int, existing: Path, tmp_path: Path) -> None:
    before = state(tmp_path)
    assert killed_at(number, tmp_path, lambda: convert(existing, overwrite=True, jobs=1)) in (
        (9,) if number < 5 else (0, 9)
    )
    # The next run looks, and fails for another reason: what it finds is the old set, or the new one.
    with pytest.raises(DestinationError, match="exists already"):
        convert(existing)
    found = {name: data for name, data in state(tmp_path).items() if not name.endswith(".lock")}
    is_new = sorted(found) == NAMES and found["out_0.bag"] != b"old 0" and found["out_7.bag"] == b"old 7"
    assert found == before or is_new, sorted(found)
