"""Parts of recordings, names of results, and what a file is recognised by; more is in `transcripts/batches.txt`."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from support.batches import batch, manifest_of, place
from support.builders import CONTENT, SECOND, Item, Recording, write_mcap, write_rosbag1
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable


def found(sources: object, out: Path | None = None, **words: Any) -> dict[str, str]:
    """The output of each recording, by its key; of what is refused the error."""
    first = sources[0] if isinstance(sources, list) else sources
    report = batch(sources, out or f"{first}/../results", dry_run=True, **words)
    return {each.key: each.error if each.action == "refuse" else each.output for each in report.outcomes}


def later(recording: Recording, seconds: int) -> Recording:
    items = tuple(Item(each.stream, each.log_time_ns + seconds * SECOND, each.data) for each in recording.items)
    return Recording(recording.streams, items)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "data" / "robot1").mkdir(parents=True)
    return tmp_path / "data"


def test_parts_are_one_recording_and_drives_are_not(folder: Path) -> None:
    first, second = CONTENT.halves()
    for number, part in enumerate((first, second)):
        write_rosbag1(folder / f"drive_2020-11-04-18-39-5{number}_{number}.bag", part)
        write_mcap(folder / f"part_{number}.mcap", part)
        # Two drives of another day, and of the same time.
        write_mcap(folder / f"run_{number}.mcap", later(CONTENT, 1000 * number))
        write_mcap(folder / f"twin_{number}.mcap", CONTENT)
    # One part is missing in between, so it is unknown what follows.
    write_mcap(folder / "hole_0.mcap", first)
    write_mcap(folder / "hole_2.mcap", later(second, 100))
    drives = ["hole_0.mcap", "hole_2.mcap", "part_0.mcap", "run_0.mcap", "run_1.mcap", "twin_0.mcap", "twin_1.mcap"]
    assert sorted(found(folder)) == ["drive_2020-11-04-18-39-50_0.bag", *drives]
    # Parts that are named, too; a part alone is what it is.
    assert list(found([folder / "part_0.mcap", folder / "part_1.mcap"], folder.parent / "out")) == ["part_0.mcap"]
    assert list(found(f"{folder}/p*.mcap", folder.parent / "out")) == ["part_0.mcap"]
    assert list(found(folder / "part_1.mcap", folder.parent / "out")) == ["part_1.mcap"]
    read = {each.key: each.bytes_read for each in batch(folder, folder.parent / "out", dry_run=True).outcomes}
    assert read["part_0.mcap"] == sum((folder / f"part_{number}.mcap").stat().st_size for number in (0, 1))


@pytest.mark.parametrize(
    ("words", "expected"),
    rows(Path(__file__).with_name("results.txt"), "options, recordings, and where their results are"),
)
def test_results_have_names_of_their_own(words: dict[str, Any], expected: dict[str, str], folder: Path) -> None:
    place(folder, *expected)
    assert found(folder, **words) == expected


# --- What a file is recognised by ---


#: What is done in a folder, and whether the recording in it is another one then.
CHANGES: dict[str, tuple[Callable[[Path], Any], bool]] = {
    "another time": (lambda folder: os.utime(folder / "metadata.yaml", ns=(1, 1 << 61)), True),
    "one more": (lambda folder: (folder / "more").write_bytes(b"4"), True),
    "a log of a database": (lambda folder: (folder / "a.db3-wal").write_bytes(b"more"), True),
    "shared memory of a database": (lambda folder: (folder / "a.db3-shm").write_bytes(b"1"), False),
    "a link to nothing": (lambda folder: (folder / "nowhere").symlink_to("gone"), False),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_folder_is_another(name: str, tmp_path: Path) -> None:
    change, is_another = CHANGES[name]
    place(tmp_path, "in/a")
    batch(tmp_path / "in", tmp_path / "out")
    change(tmp_path / "in" / "a")
    (again,) = batch(tmp_path / "in", tmp_path / "out", dry_run=True).outcomes
    assert again.why.startswith("the source was changed" if is_another else "unchanged")


def test_each_recording_has_a_line_of_json(tmp_path: Path) -> None:
    place(tmp_path / "in", "a.bag")
    for name in ("b.bag", "ü\n.bag"):
        (tmp_path / "in" / name).touch()
    batch(tmp_path / "in", tmp_path / "out")
    lines = (tmp_path / "out" / "manifest.jsonl").read_bytes().splitlines()
    keys = [(line["key"], line["outcome"]) for line in map(json.loads, lines)]
    assert keys == [("a.bag", "begun"), ("b.bag", "failed"), ("ü\n.bag", "failed"), ("a.bag", "converted")]
    line, source = manifest_of(tmp_path / "out")["a.bag"], tmp_path / "in" / "a.bag"
    assert line["source"]["paths"] == [str(source)]
    assert line["source"]["files"] == [["a.bag", source.stat().st_size, source.stat().st_mtime_ns]]
    assert (line["outcome"], line["exit_status"], line["attempts"]) == ("converted", 0, 1)
    assert line["pc2scan"] == pc2scan.__version__
    assert manifest_of(tmp_path / "out")["b.bag"]["error"]["message"] == "is empty"
