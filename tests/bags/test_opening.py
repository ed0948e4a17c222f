"""Formats are detected by content."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
import zstandard

import pc2scan.bags
from bags.kinds import KINDS, make
from pc2scan.bags.opening import open_recording, sniff
from pc2scan.errors import RecordingError, UsageError
from support import RECORDINGS, needs_shared


@pytest.mark.parametrize("name", ["misleading.bag", "misleading.mcap", "misleading.db3", "misleading.zip", "none"])
@pytest.mark.parametrize("kind", list(KINDS))
def test_content_decides_not_the_name(tmp_path: Path, kind: str, name: str) -> None:
    path = make(tmp_path, kind).rename(tmp_path / name)
    assert sniff(path) == kind
    with closing(open_recording(path)) as reader:
        assert reader.path == path
        assert reader.summary.container == kind
        assert [m.log_time_ns for m in reader.messages()] == [5]


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
    with pytest.raises(RecordingError, match="does not exist"):
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
    (tmp_path / "x.bag").unlink()
    make(tmp_path, "mcap")
    assert sniff(tmp_path) == "rosbag2"
    (tmp_path / "only metadata").mkdir()
    (tmp_path / "only metadata" / "metadata.yaml").touch()
    assert sniff(tmp_path / "only metadata") == "rosbag2"


def test_directories_with_several_recordings(tmp_path: Path) -> None:
    make(tmp_path, "rosbag1")
    make(tmp_path, "mcap")
    with pytest.raises(UsageError, match=r"holds 2 recordings, not one: x\.bag, x\.mcap"):
        sniff(tmp_path)
    (tmp_path / "metadata.yaml").touch()
    assert sniff(tmp_path) == "rosbag2"


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
