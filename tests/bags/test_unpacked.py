"""Recordings that are compressed as a whole."""

from __future__ import annotations

from pathlib import Path

import pytest
import zstandard

from bags.kinds import make, names
from pc2scan.bags.opening import open_recording, sniff
from pc2scan.errors import RecordingError


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
