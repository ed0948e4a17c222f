"""Zstandard around files and messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import zstandard

from pc2scan.bags import zstd
from pc2scan.bags.damage import DamageLog
from pc2scan.errors import DamageError, RecordingError
from pc2scan.files import limits

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("name", ["a.mcap", "a.mcap.zst", "a.mcap.zstd"])
def test_names_without_the_suffix(name: str) -> None:
    assert zstd.without_suffix(name) == "a.mcap"


def test_compressions_around_others() -> None:
    assert zstd.compressions(["none"]) == ("zstd",)
    assert zstd.compressions(["zstd", "lz4"]) == ("lz4", "zstd")


def test_files_are_recognised_by_content_and_unpacked(tmp_path: Path) -> None:
    plain, packed = tmp_path / "a.mcap", tmp_path / "b.mcap.zst"
    plain.write_bytes(b"content")
    packed.write_bytes(zstandard.compress(b"con") + zstandard.compress(b"tent"))
    assert not zstd.is_zstd(plain)
    assert zstd.is_zstd(packed)
    folder = tmp_path / "unpacked"
    folder.mkdir()
    assert zstd.unpacked_file(packed, folder, DamageLog(strict=True)) == folder / "b.mcap"
    assert (folder / "b.mcap").read_bytes() == b"content"


def test_messages(tmp_path: Path) -> None:
    frame = zstandard.compress(b"data" * 100)
    assert zstd.unpacked_message(memoryview(frame), tmp_path, "/a") == b"data" * 100
    with pytest.raises(RecordingError, match="full frame") as caught:
        zstd.unpacked_message(frame[:-1], tmp_path, "/a")
    assert (caught.value.path, caught.value.topic) == (tmp_path, "/a")
    with pytest.raises(RecordingError, match="a message cannot be decompressed"):
        zstd.unpacked_message(b"nonsense", tmp_path, "/a")


def test_messages_that_do_not_tell_their_size(tmp_path: Path) -> None:
    data = np.random.default_rng(1).bytes(20_000)
    frame = zstandard.ZstdCompressor(write_content_size=False).compress(data)
    assert zstd.unpacked_message(frame, tmp_path, "/a") == data
    with pytest.raises(RecordingError, match="frame is cut off"):
        zstd.unpacked_message(frame[:-1], tmp_path, "/a")


@pytest.mark.parametrize("told", [True, False])
def test_a_message_may_not_unpack_to_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told: bool) -> None:
    monkeypatch.setattr(limits, "MAX_UNPACKED", 1_000)
    compress = zstandard.ZstdCompressor(write_content_size=told).compress
    assert zstd.unpacked_message(compress(bytes(1_000)), tmp_path, "/a") == bytes(1_000)
    with pytest.raises(RecordingError, match="unpacks to more than"):
        zstd.unpacked_message(compress(bytes(300_000)), tmp_path, "/a")


def test_a_file_may_not_unpack_to_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zstd, "MAX_UNPACKED", 1_000)
    (tmp_path / "a.mcap.zst").write_bytes(zstandard.compress(bytes(10_000_000)))
    (tmp_path / "unpacked").mkdir()
    with pytest.raises(RecordingError, match="1000 times its size"):
        zstd.unpacked_file(tmp_path / "a.mcap.zst", tmp_path / "unpacked", DamageLog())


def test_of_a_damaged_file_the_front_is_kept(tmp_path: Path) -> None:
    import random

    content = random.Random(1).randbytes(400_000).hex().encode()
    packed, folder = tmp_path / "a.db3.zstd", tmp_path / "unpacked"
    folder.mkdir()
    whole = zstandard.ZstdCompressor(write_checksum=True).compress(content)
    broken = bytearray(whole)
    broken[len(whole) // 2 : len(whole) // 2 + 200] = bytes(200)
    for damaged, least in ((whole[: len(whole) * 3 // 4], 0.5), (bytes(broken), 0.25)):
        packed.write_bytes(damaged)
        log = DamageLog()
        unpacked = zstd.unpacked_file(packed, folder, log).read_bytes()
        assert content.startswith(unpacked[: int(len(content) * least)])
        assert len(content) >= len(unpacked) > least * len(content)
        (damage,) = log.found
        assert damage.path == packed
        assert "cannot be decompressed" in damage.what
        with pytest.raises(DamageError):
            zstd.unpacked_file(packed, folder, DamageLog(strict=True))
