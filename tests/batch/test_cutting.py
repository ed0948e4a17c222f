"""Recordings that several processes convert in pieces: byte for byte what one conversion writes."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from batch.datasets import contents
from pc2scan.batch import cutting
from support.builders import (
    CHARGE,
    CHATTER,
    MOUNT,
    SECOND,
    T0,
    Mcap,
    Recording,
    battery,
    fixed,
    item,
    odometry,
    points,
    string,
    write_db3,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

WORDS: dict[str, Any] = {
    "jobs": 2,
    "to": "rosbag2",
    "split": "0.5s",
    "min_height": -2,
    "max_height": 2,
    "target_frame": "odom",
}


def drive(steps: int = 60, *, silent: range = range(0), unplaced: range = range(0)) -> Recording:
    """Clouds, transforms and other messages, ten a second.

    In steps of ``silent`` there is nothing, in those of ``unplaced`` clouds are older than all transforms.
    """
    items = [fixed(MOUNT, T0, "lidar", 0.5)]
    for step in range(steps):
        if step in silent:
            continue
        at = T0 + step * SECOND // 10

        # Between two transforms, so that the next one counts.
        stamp_ns = T0 - SECOND if step in unplaced else at + 30_000_000

        def charge(g: int, s: int, at: int = at) -> bytes:
            return battery(g, seq=s, stamp_ns=at)

        items += [
            odometry(at + 2, at, 0.1 * step, step),
            points(at + 5_000_003, stamp_ns, step),
            item(CHATTER, at + 6_000_000, lambda g, s: string(f"hello {s}", g), step),
            item(CHARGE, at + 6_000_000, charge, step),
        ]
    return Recording(tuple(dict.fromkeys(each.stream for each in items)), tuple(items))


def converted(
    source: Path, out: Path, pieces: int, monkeypatch: pytest.MonkeyPatch, **words: Any
) -> tuple[dict[str, bytes], dict[str, Any]]:
    """What a batch writes for one recording, and its line of the manifest; several pieces, or one."""
    size = sum(file.stat().st_size for file in source.rglob("*")) if source.is_dir() else source.stat().st_size
    monkeypatch.setattr(cutting, "PIECE_BYTES", size // pieces if pieces > 1 else 1 << 62)
    pc2scan.batch(source, out, **{**WORDS, **words})
    lines = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    assert len(lines) == 1
    return contents(out), lines[0]


def same(
    source: Path,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    pieces: int = 4,
    *,
    is_cut: bool = True,
    **words: Any,
) -> dict[str, Any]:
    """Assert that pieces are the whole, and that there are some; return the line of the manifest."""
    whole, line = converted(source, folder / "whole", 1, monkeypatch, **words)
    submit, submitted = cutting._Recording._submit, list[int]()

    def recorded(recording: Any, numbers: Sequence[int]) -> None:
        submitted.extend(numbers)
        submit(recording, numbers)

    with monkeypatch.context() as patched:
        patched.setattr(cutting._Recording, "_submit", recorded)
        cut, line_of_cut = converted(source, folder / "cut", pieces, patched, **words)
    assert (len(submitted) > 1) == is_cut
    assert cut.keys() == whole.keys()
    assert cut == whole
    reports = [each.pop("report") for each in (line, line_of_cut)]
    for each in (line, line_of_cut):
        for name in ("started", "seconds"):
            del each[name]
        if each["output"]:
            each["output"]["files"] = [file[:2] for file in each["output"]["files"]]
    for report in filter(None, reports):
        for name in ("seconds", "destination", "files"):
            del report[name]
    assert reports[0] == reports[1]
    return line_of_cut


CONTAINERS: dict[str, Callable[[Path, Recording], Path]] = {
    "bag": lambda folder, content: write_rosbag1(folder / "drive.bag", content, "lz4", chunk_size=4_000),
    "mcap": lambda folder, content: write_mcap(folder / "drive.mcap", content, Mcap(chunk_size=4_000)),
    "db3": lambda folder, content: write_db3(folder / "drive.db3", content),
    "rosbag2": lambda folder, content: write_rosbag2(folder / "drive", content),
}


@pytest.mark.parametrize("container", CONTAINERS)
@pytest.mark.parametrize("keeps", [False, True])
def test_pieces_are_what_one_conversion_writes(
    container: str, keeps: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = CONTAINERS[container](tmp_path, drive(silent=range(22, 38)))
    line = same(source, tmp_path, monkeypatch, keep_clouds=keeps, only_scans=not keeps)
    # The last cloud is behind the last transform; ten parts of half a second, and their metadata.
    assert line["outcome"] == "incomplete"
    assert len(line["output"]["files"]) == 11


@pytest.mark.parametrize(
    "words",
    [
        {"storage": "sqlite3"},
        {"target_frame": "", "keep_clouds": True},
        {"start": 1.2, "end": 4.3, "static_tf": "lidar far 0 0 1 0 0 0"},
        {"jobs": 1},
        {"split": "0.15s"},
    ],
    ids=str,
)
def test_pieces_with_other_options_are_what_one_conversion_writes(
    words: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    same(CONTAINERS["mcap"](tmp_path, drive()), tmp_path, monkeypatch, **words)


@pytest.mark.parametrize("unplaced", [range(12), range(20, 32), range(60)], ids=str)
def test_files_have_their_numbers_where_nothing_is_written_of_a_stretch(
    unplaced: range, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = CONTAINERS["mcap"](tmp_path, drive(unplaced=unplaced))
    line = same(source, tmp_path, monkeypatch, only_scans=True)
    assert line["outcome"] == ("failed" if len(unplaced) == 60 else "incomplete"), line["error"]


@pytest.mark.parametrize("container", ["bag", "mcap", "db3"])
@pytest.mark.parametrize("place", [0.2, 0.5, 0.8])
def test_damage_in_one_piece_is_reported_as_by_one_conversion(
    container: str, place: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = CONTAINERS[container](tmp_path, drive())
    data = bytearray(source.read_bytes())
    at = int(len(data) * place)
    data[at : at + 60] = bytes(60)
    source.write_bytes(data)
    # Where damage of a database is found when it is opened, the recording is not cut.
    line = same(source, tmp_path, monkeypatch, is_cut=container != "db3" or place == 0.5, keep_clouds=True)
    assert line["outcome"] == "incomplete"


@pytest.mark.parametrize(
    "words", [{"repeat_latched": True}, {"accumulate": 3}, {"split": "20kB"}, {"split": None}], ids=str
)
def test_recordings_that_are_not_cut(words: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    same(CONTAINERS["mcap"](tmp_path, drive()), tmp_path, monkeypatch, is_cut=False, **words)


def test_an_error_in_one_piece_is_that_of_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = CONTAINERS["mcap"](tmp_path, drive(unplaced=range(40, 41)))
    line = same(source, tmp_path, monkeypatch, on_error="fail")
    assert line["outcome"] == "failed"
    assert "transform" in line["error"]["message"]
    assert [path.name for path in (tmp_path / "cut").iterdir()] == ["manifest.jsonl"]
