"""Damaged recordings, as a user meets them: converted all the same, refused when asked to, and repaired."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

import pc2scan
from fuzz.mutants import at_each
from fuzz.seeds import Seed
from pc2scan.bags.opening import open_recording
from pc2scan.errors import RecordingError
from support import sampled
from support.builders import CONTENT, SOURCES, T0, Recording
from support.command import run
from support.outputs import opened
from support.rosbag1_files import ROS1, SCRIPT, ros1, ros1_missing

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def recording() -> Recording:
    """The usual content twenty times over, so that there is something in front of every damage."""
    span = 400_000_000
    items = (
        replace(item, log_time_ns=item.log_time_ns + number * span) for number in range(20) for item in CONTENT.items
    )
    return replace(CONTENT, items=tuple(items))


def cut(source: Path, share: float) -> None:
    """Cut off a source's file of messages; of a split one the last."""
    files = [source] if source.is_file() else [path for path in source.iterdir() if path.name != "metadata.yaml"]
    with max(files).open("r+b") as stream:
        stream.truncate(int(max(files).stat().st_size * share))


def read_all(path: Path) -> tuple[list[tuple[str, int, bytes]], int]:
    """Every message that there is, and the number of damaged places."""
    with closing(open_recording(path)) as reader:
        rows = [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()]
        return rows, len(reader.damage)


# Where indexes are a large part of these small files, more has to go.
@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("bag-none", 0.5),
        ("bag-lz4", 0.33),
        ("mcap-zstd", 0.6),
        ("rosbag2-sqlite3-v8", 0.8),
        ("rosbag2-mcap-split", 0.6),
    ],
)
def test_a_cut_recording_is_converted_as_far_as_it_goes(
    name: str, share: float, recording: Recording, tmp_path: Path
) -> None:
    source = SOURCES[name](tmp_path, recording)
    cut(source, share)
    report_file = tmp_path / "report.json"
    done = run("convert", source, "-o", tmp_path / "out.mcap", "--min-height", "-1", "--report", report_file)
    assert done.status == 3, done.stderr
    assert all(word in done.stderr for word in ("damaged: ", "recovered: "))
    report = json.loads(report_file.read_text())
    assert report["exit_status"] == 3
    assert report["damage"]
    keys = {"what", "path", "offset", "bytes_lost", "messages_lost", "first_ns", "last_ns"}
    assert set(report["damage"][0]) == keys
    assert 0 < report["messages_read"] < len(recording.items)
    output = opened(tmp_path / "out.mcap")
    assert len(output.messages) == report["messages_read"]

    strict = run("convert", source, "-o", tmp_path / "strict.mcap", "--strict")
    assert strict.status == 1
    assert strict.stderr.startswith("error: ")
    assert "hint: copy the recording again" in strict.stderr
    assert not (tmp_path / "strict.mcap").exists()


@pytest.mark.parametrize("name", sampled(SOURCES, 7))
def test_repair_of_a_sound_recording_is_a_copy(name: str, recording: Recording, tmp_path: Path) -> None:
    source = SOURCES[name](tmp_path, recording)
    before, _ = read_all(source)
    report = pc2scan.repair(source)
    assert report.exit_status == 0
    (destination,) = [path for path in tmp_path.iterdir() if "_repaired" in path.name]
    after, damage = read_all(destination)
    assert (after, damage) == (before, 0)
    assert report.messages_read == report.messages_declared == len(before)
    with closing(open_recording(source)) as old, closing(open_recording(destination)) as new:
        container = "rosbag2" if old.summary.container == "sqlite3" else old.summary.container
        assert new.summary.container == container
        if new.summary.storage:
            assert new.summary.storage == (old.summary.storage or "sqlite3")
    assert len(opened(destination).messages) == len(before)


# --- Never fewer messages than others ---


def files_of(folder: Path, name: str, data: bytes, count: int) -> list[Path]:
    """The sound file, and copies that are cut off or of which a byte is another, evenly spread."""
    seed = Seed(name, {name: data}, name)
    places = range(len(data) // 20, len(data), len(data) // count)
    versions = (data, *(made.data for made in at_each(seed, places)))
    paths = [folder / f"{number:02}_{name}" for number in range(2 * len(places) + 1)]
    for path, version in zip(paths, versions, strict=True):
        path.write_bytes(version)
    return paths


def count_of(path: Path) -> int:
    try:
        return len(read_all(path)[0])
    except RecordingError:
        return 0


def reindexed(paths: list[Path]) -> list[int]:
    if reason := ros1_missing():
        pytest.skip(f"ROS 1's own rosbag (Debian: python3-rosbag, python3-std-msgs) is not here: {reason[0]}")
    done = ros1(ROS1, SCRIPT, "reindexed", *paths)
    assert done.returncode == 0, done.stderr
    found: list[int] = json.loads(done.stdout)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("compression", sampled(["none", "lz4", "bz2"], 1))
def test_never_fewer_messages_than_rosbag_reindex(compression: str, tmp_path: Path) -> None:
    # Its own recorder's bags: of those that rosbags writes, its reindex finds nothing even where they are sound.
    reindexed([])
    rows = [(f"/chatter{number % 3}", T0 + number * 1_000_000, f"{number} " * 20) for number in range(300)]
    stdin = "\n".join(json.dumps(row) for row in rows)
    written = ros1(ROS1, SCRIPT, "write", tmp_path / "drive.bag", compression, "2000", stdin=stdin)
    assert written.returncode == 0, written.stderr
    paths = files_of(tmp_path, "drive.bag", (tmp_path / "drive.bag").read_bytes(), 18)
    # Before: it writes into the files.
    ours = list(map(count_of, paths))
    theirs = reindexed(paths)
    assert theirs[0] == len(rows)
    assert sum(theirs) > 2 * len(rows)
    assert [(path.name, a, b) for path, a, b in zip(paths, ours, theirs, strict=True) if a < b] == []
