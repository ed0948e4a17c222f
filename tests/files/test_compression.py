"""Compressing and decompressing by name, within bounds; as much of broken data as can be decompressed."""

from __future__ import annotations

import bz2
import random
from typing import Any

import lz4.frame
import pytest
import zstandard

from pc2scan.files.compression import (
    MAX_UNPACKED,
    CompressionError,
    allowed_bytes,
    compress,
    decompress,
    decompressed_prefix,
)
from pc2scan.options.table import options_of

DATA = bytes(range(256)) * 400 + bytes(50_000)


def unpacked(name: str, packed: bytes | memoryview, size: int) -> bytes:
    out = bytearray(size)
    decompress(name, memoryview(packed), memoryview(out))
    return bytes(out)


#: Every compression that can be asked for.
NAMES = [name for name in options_of("convert")["compression"].value.words if name != "none"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("data", [b"x", DATA], ids=len)
def test_there_and_back(name: str, data: bytes) -> None:
    assert unpacked(name, bytes(compress(name, data)), len(data)) == data


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("size", "cut"), [(1, 0), (1_000, 0), (len(DATA) - 1, 0), (len(DATA) + 1, 0), (len(DATA), 5)])
def test_another_size_is_an_error_and_so_is_a_cut(name: str, size: int, cut: int) -> None:
    packed = bytes(compress(name, DATA))
    with pytest.raises(CompressionError):
        unpacked(name, packed[: len(packed) - cut], size)


def test_zstd_without_its_size() -> None:
    silent = zstandard.ZstdCompressor(write_content_size=False).compress(DATA)
    assert unpacked("zstd", silent, len(DATA)) == DATA


WORDS = (b"alpha ", b"bravo ", b"charlie ", b"delta ", b"echo ")
TEXT = b"".join(random.Random(7).choices(WORDS, k=120_000))

LZ4_FRAMES: dict[str, dict[str, Any]] = {
    "linked": {},
    "independent": {"block_linked": False},
    "as ROS 1": {"block_linked": False, "store_size": False, "content_checksum": True},
    "block checksums": {"block_checksum": True},
    "large blocks": {"block_size": lz4.frame.BLOCKSIZE_MAX4MB},
}
PACKED = {
    **{f"lz4 {name}": ("lz4", lz4.frame.compress(TEXT, **options)) for name, options in LZ4_FRAMES.items()},
    "bz2": ("bz2", bz2.compress(TEXT, 1)),
    "zstd": ("zstd", zstandard.ZstdCompressor(write_checksum=True).compress(TEXT)),
    "none": ("none", TEXT),
}


@pytest.mark.parametrize("name", PACKED)
def test_whole_data_come_out_whole(name: str) -> None:
    compression, data = PACKED[name]
    assert decompressed_prefix(data, compression, len(TEXT)) == TEXT


@pytest.mark.parametrize("name", PACKED)
def test_of_cut_data_the_front_comes_out(name: str) -> None:
    compression, data = PACKED[name]
    for share in (0.3, 0.6, 0.95):
        found = decompressed_prefix(data[: int(len(data) * share)], compression, len(TEXT))
        assert TEXT.startswith(found)
        # All but what the last block would have given: of lz4 not even that.
        missing = 1000 if compression in ("lz4", "none") else 150_000
        assert len(found) > len(TEXT) * share * 0.95 - missing, share


@pytest.mark.parametrize("compression", ["lz4", "bz2", "zstd"])
def test_what_comes_out_is_bounded(compression: str) -> None:
    zeros = bytes(4 * MAX_UNPACKED)
    pack = {"lz4": lz4.frame.compress, "bz2": bz2.compress, "zstd": zstandard.compress}[compression]
    packed = pack(zeros)
    assert len(decompressed_prefix(packed, compression, 10)) == allowed_bytes(len(packed))
