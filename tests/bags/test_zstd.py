"""Zstandard around files and messages."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest
import zstandard

from pc2scan.bags import zstd
from pc2scan.bags.damage import DamageLog
from pc2scan.errors import DamageError, RecordingError

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("told", [True, False])
def test_messages_are_unpacked(told: bool, tmp_path: Path) -> None:
    data = random.Random(1).randbytes(20_000)
    frame = zstandard.ZstdCompressor(write_content_size=told).compress(data)
    assert zstd.decompress_message(memoryview(frame), tmp_path, "/a") == data
    for wrong in (frame[:-1], b"nonsense"):
        with pytest.raises(RecordingError, match="a message cannot be decompressed") as caught:
            zstd.decompress_message(wrong, tmp_path, "/a")
        assert (caught.value.path, caught.value.topic) == (tmp_path, "/a")


def test_a_file_may_not_unpack_to_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zstd, "MAX_UNPACKED", 1_000)
    (tmp_path / "a.mcap.zst").write_bytes(zstandard.compress(bytes(10_000_000)))
    (tmp_path / "unpacked").mkdir()
    with pytest.raises(RecordingError, match="1000 times its size"):
        zstd.decompress_file(tmp_path / "a.mcap.zst", tmp_path / "unpacked", DamageLog())


def test_of_a_damaged_file_the_front_is_kept(tmp_path: Path) -> None:
    content = random.Random(1).randbytes(400_000).hex().encode()
    packed, folder = tmp_path / "a.db3.zstd", tmp_path / "unpacked"
    folder.mkdir()
    whole = zstandard.ZstdCompressor(write_checksum=True).compress(content)
    broken = bytearray(whole)
    broken[len(whole) // 2 : len(whole) // 2 + 200] = bytes(200)
    for damaged, least in ((whole[: len(whole) * 3 // 4], 0.5), (bytes(broken), 0.25)):
        packed.write_bytes(damaged)
        log = DamageLog()
        unpacked = zstd.decompress_file(packed, folder, log).read_bytes()
        assert content.startswith(unpacked[: int(len(content) * least)])
        assert len(content) >= len(unpacked) > least * len(content)
    # Whoever reads what is left of a file that was cut off sees that its end is missing.
    (damage,) = log.places
    assert damage.path == packed
    assert "cannot be decompressed" in damage.what
    with pytest.raises(DamageError):
        zstd.decompress_file(packed, folder, DamageLog(strict=True))
