"""As much of broken compressed data as can be decompressed."""

from __future__ import annotations

import bz2
import random
from typing import Any

import lz4.frame
import pytest
import zstandard

from pc2scan.files.salvage import SIZE_LIMIT, decompressed_prefix

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
    zeros = bytes(4 * SIZE_LIMIT)
    pack = {"lz4": lz4.frame.compress, "bz2": bz2.compress, "zstd": zstandard.compress}[compression]
    assert len(decompressed_prefix(pack(zeros), compression, 10)) == SIZE_LIMIT
