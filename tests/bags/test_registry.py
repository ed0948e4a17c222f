"""Formats are told by content, destinations by name."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zstandard

import pc2scan.bags
from pc2scan.bags.registry import (
    Destination,
    default_destination,
    default_storage,
    open_recording,
    open_writer,
    plan_destination,
    sniff,
)
from pc2scan.errors import DestinationError, RecordingError
from pc2scan.model import Connection, Definition, Summary
from support import RECORDINGS, needs_shared

CONNECTIONS = {
    1: Connection(1, "/a", "std_msgs/String", "ros1", Definition("ros1msg", b"string data\n"), "0" * 32),
    2: Connection(1, "/a", "std_msgs/msg/String", "cdr", Definition("ros2msg", b"string data\n")),
}
KINDS = {
    "rosbag1": ("x.bag", None),
    "mcap": ("x.mcap", None),
    "rosbag2": ("x", "mcap"),
    "sqlite3": ("x", "sqlite3"),
}


def names(folder: str | Path) -> list[str]:
    return sorted(entry.name for entry in Path(folder).iterdir())


def make(folder: Path, kind: str) -> Path:
    """Write a recording with one message; ``sqlite3`` gives the bare file."""
    name, storage = KINDS[kind]
    destination = plan_destination(folder / name, storage=storage, source_generation=None)
    writer = open_writer(destination, destination.path, destination.path.stem)
    handle = writer.add_connection(CONNECTIONS[destination.generation])
    writer.write(handle, 5, b"\0\1\0\0\2\0\0\0x\0", 5)
    writer.finish()
    return destination.path / "x_0.db3" if kind == "sqlite3" else destination.path


@pytest.mark.parametrize("name", ["misleading.bag", "misleading.mcap", "misleading.db3", "misleading.zip", "none"])
@pytest.mark.parametrize("kind", list(KINDS))
def test_content_decides_not_the_name(tmp_path: Path, kind: str, name: str) -> None:
    path = make(tmp_path, kind).rename(tmp_path / name)
    assert sniff(path) == kind
    with closing(open_recording(path)) as reader:
        assert reader.path == path
        assert reader.summary.container == kind
        assert [m.log_time_ns for m in reader.messages()] == [5]


@pytest.mark.parametrize("kind", ["rosbag1", "mcap", "sqlite3"])
def test_compressed_files_are_unpacked(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "packed"
    path.write_bytes(zstandard.compress(make(tmp_path, kind).read_bytes()))
    assert sniff(path) == f"{kind}+zstd"
    reader = open_recording(path)
    temporary = reader._temporary  # type: ignore[attr-defined]
    assert names(temporary.name) == ["packed"]
    assert [m.log_time_ns for m in reader.messages(reader.connections, 5, 6)] == [5]
    assert reader.path == path
    assert reader.summary.container == kind
    assert "zstd" in reader.summary.compression
    assert "none" not in reader.summary.compression
    assert reader.summary.size_bytes == path.stat().st_size
    assert 0 <= reader.bytes_read <= reader.summary.size_bytes
    assert list(reader.attachments()) == []
    assert list(reader.metadata()) == []
    reader.close()
    assert not Path(temporary.name).exists()


def test_a_damaged_compressed_file_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "tmp").mkdir()
    path = tmp_path / "packed"
    path.write_bytes(zstandard.compress(make(tmp_path, "sqlite3").read_bytes()[:600]))
    with pytest.raises(RecordingError):
        open_recording(path)
    assert names(tmp_path / "tmp") == []


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"#ROSBAG V1.2\n", r"version '1\.2', only 2\.0 can be read"),
        (b"#ROSBAG V2.", "is cut off after 11 bytes: there is nothing to recover"),
        (b"\x89MC", "is cut off after 3 bytes"),
        (b"\x1b[31mred\x00\xff", r"begins with '\\x1b\[31mred\\x00\\xff'"),
        (b"\x1f\x8b\x08\x00", "gzip-compressed"),
        (b"PK\x03\x04rest", "a ZIP archive"),
        (b"version https://git-lfs.github.com/spec/v1", "Git LFS pointer"),
        (b"rosbag2_bagfile_information:\n  version: 5", r"metadata\.yaml of a rosbag2"),
        (b"\x89MCAP1\r\n", "unknown version"),
        (zstandard.compress(b"PK\x03\x04rest"), r"a ZIP archive \(after zstd"),
        (zstandard.compress(b""), r"is empty \(after zstd"),
        (b"\x28\xb5\x2f\xfdgarbage", "cannot be decompressed"),
    ],
)
def test_what_is_no_recording(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "x.bag"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=message) as caught:
        sniff(path)
    assert caught.value.path == path
    assert str(caught.value).isprintable()


def test_an_unknown_file_is_told_what_is_readable(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"hello")
    with pytest.raises(RecordingError) as caught:
        open_recording(tmp_path / "x")
    for word in ("ROS 1 bags", "rosbag2", ".db3", "MCAP"):
        assert word in (caught.value.hint or "")


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="there is nothing of this name"):
        open_recording(tmp_path / "x.bag")


def test_special_files_are_refused_without_opening_them(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.bag")
    with pytest.raises(RecordingError, match="neither a file nor a directory"):
        open_recording(tmp_path / "x.bag")
    with pytest.raises(RecordingError, match="neither a file nor a directory"):
        open_recording(Path("/dev/null"))


def test_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.bag"
    path.touch(mode=0)
    if os.access(path, os.R_OK):
        # Root may read everything.
        def refuse(*_: object) -> None:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(RecordingError, match="Permission denied"):
        sniff(path)


def test_directories_without_a_recording(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="without a rosbag2 recording"):
        sniff(tmp_path)
    make(tmp_path, "rosbag1")
    with pytest.raises(RecordingError) as caught:
        sniff(tmp_path)
    assert "x.bag" in (caught.value.hint or "")
    make(tmp_path, "mcap")
    assert sniff(tmp_path) == "rosbag2"
    (tmp_path / "only metadata").mkdir()
    (tmp_path / "only metadata" / "metadata.yaml").touch()
    assert sniff(tmp_path / "only metadata") == "rosbag2"


@needs_shared
def test_real_recordings() -> None:
    found = {path.name: sniff(path) for path in RECORDINGS.iterdir() if path.suffix in {".bag", ".mcap"}}
    assert found == {name: {".bag": "rosbag1", ".mcap": "mcap"}[Path(name).suffix] for name in found}
    assert len(found) >= 6


def test_importing_the_package_imports_no_format() -> None:
    program = "import sys, pc2scan.bags; print(*sys.modules)"
    source = str(Path(pc2scan.bags.__file__).parents[2])
    result = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": source},
    )
    loaded = set(result.stdout.split())
    assert not loaded & {"rosbags", "mcap", "sqlite3", "lz4", "zstandard", "ruamel.yaml"}
    for name in pc2scan.bags.__all__:
        assert hasattr(pc2scan.bags, name)


# --- Destinations ---


def plan(name: str, generation: int | None = 2, **options: Any) -> Destination:
    return plan_destination(Path(name), source_generation=generation, **options)


@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("x.bag", {}, ("rosbag1", "", "lz4", "", 1)),
        ("x.BAG", {"compression": "bz2"}, ("rosbag1", "", "bz2", "", 1)),
        ("x.bag", {"compression": "none"}, ("rosbag1", "", "none", "", 1)),
        ("x.mcap", {}, ("mcap", "", "zstd", "ros2", 2)),
        ("x.mcap", {"generation": 1}, ("mcap", "", "zstd", "ros1", 1)),
        ("x.mcap", {"generation": None}, ("mcap", "", "zstd", "ros2", 2)),
        ("x.mcap", {"generation": 1, "profile": "ros2"}, ("mcap", "", "zstd", "ros2", 2)),
        ("x.mcap", {"profile": "ros1", "compression": "lz4"}, ("mcap", "", "lz4", "ros1", 1)),
        ("x", {}, ("rosbag2", "mcap", "zstd", "", 2)),
        ("2024-01-01-12.30", {"generation": 1}, ("rosbag2", "mcap", "zstd", "", 2)),
        ("x", {"storage": "sqlite3"}, ("rosbag2", "sqlite3", "none", "", 2)),
        ("x", {"storage": "sqlite3", "compression": "zstd"}, ("rosbag2", "sqlite3", "zstd", "", 2)),
    ],
)
def test_plans(name: str, options: dict[str, Any], expected: tuple[str, str, str, str, int]) -> None:
    found = plan(name, **options)
    assert (found.container, found.storage, found.compression, found.profile, found.generation) == expected
    assert found.path == Path(name)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (
            "x.bag",
            {"compression": "zstd"},
            "`compression=zstd` is not possible here; allowed: none, bz2, lz4",
        ),
        ("x.mcap", {"compression": "bz2"}, "allowed: none, lz4, zstd"),
        ("x", {"compression": "bz2"}, "allowed: none, lz4, zstd"),
        ("x", {"storage": "sqlite3", "compression": "lz4"}, "allowed: none, zstd"),
        ("x", {"storage": "leveldb"}, "`storage=leveldb` is not possible here; allowed: mcap, sqlite3"),
        ("x.bag", {"storage": "mcap"}, "`storage` is for rosbag2 directories"),
        ("x.mcap", {"storage": "mcap"}, "`storage` is for rosbag2 directories"),
        ("x.bag", {"profile": "ros1"}, r"`profile` is for \.mcap files"),
        ("x", {"profile": "ros2"}, r"`profile` is for \.mcap files"),
        ("x.mcap", {"profile": "ros3"}, "allowed: ros1, ros2"),
        ("x", {"metadata_version": 7}, "metadata version 7 cannot be written, only 8 and 9"),
        ("x.db3", {}, r"\.db3 is not a destination"),
        ("x.YAML", {}, r"\.yaml is not a destination"),
        ("x.zip", {}, r"\.zip is not a destination"),
        ("x.bag.gz", {}, r"\.gz is not a destination"),
        ("x.mcap.zst", {}, r"\.zst is not a destination"),
    ],
)
def test_impossible_plans(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(DestinationError, match=message) as caught:
        plan(name, **options)
    assert caught.value.path == Path(name)
    if "is not a destination" in message:
        assert "NAME.bag" in (caught.value.hint or "")


def summary(container: str, storage: str = "") -> Summary:
    return Summary(container, storage, (), 0, None, None, None)


@pytest.mark.parametrize(
    ("source", "of", "expected", "storage"),
    [
        ("a/x.bag", summary("rosbag1"), "a/x_scan.bag", None),
        ("a/x.bag.active", summary("rosbag1"), "a/x_scan.bag", None),
        ("a/x", summary("rosbag1"), "a/x_scan.bag", None),
        ("a/x.mcap", summary("mcap"), "a/x_scan.mcap", None),
        ("a/x.mcap.zst", summary("mcap"), "a/x_scan.mcap", None),
        ("a/2024.01", summary("mcap"), "a/2024.01_scan.mcap", None),
        ("a/x", summary("rosbag2", "mcap"), "a/x_scan", "mcap"),
        ("a/x/", summary("rosbag2", "sqlite3"), "a/x_scan", "sqlite3"),
        ("a/2024-01-01-12.30.15", summary("rosbag2", "sqlite3"), "a/2024-01-01-12.30.15_scan", "sqlite3"),
        ("a/x_0.db3", summary("sqlite3"), "a/x_0_scan", "sqlite3"),
        (".mcap", summary("mcap"), ".mcap_scan.mcap", None),
    ],
)
def test_default_destinations(source: str, of: Summary, expected: str, storage: str | None) -> None:
    found = default_destination([Path(source), Path("elsewhere/y.bag")], [of, summary("rosbag1")])
    assert found == Path(expected)
    assert default_storage([of]) == storage
    assert plan_destination(found, storage=storage, source_generation=2).container == (
        of.container if of.container != "sqlite3" else "rosbag2"
    )


def test_the_default_destination_of_the_current_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bag").mkdir()
    monkeypatch.chdir(tmp_path / "bag")
    found = default_destination([Path()], [summary("rosbag2", "mcap")])
    assert found == tmp_path.resolve() / "bag_scan"
