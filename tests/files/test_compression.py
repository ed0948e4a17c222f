"""Compressing and decompressing by name, within bounds."""

from __future__ import annotations

import pytest
import zstandard

from pc2scan.files.compression import CompressionError, compress, decompress
from pc2scan.options.table import options_of

DATA = bytes(range(256)) * 400 + bytes(50_000)


def unpacked(name: str, packed: bytes | memoryview, size: int) -> bytes:
    out = bytearray(size)
    decompress(name, memoryview(packed), memoryview(out))
    return bytes(out)


def test_every_compression_that_can_be_asked_for_is_known() -> None:
    for name in options_of("convert")["compression"].value.words:
        if name != "none":
            assert unpacked(name, compress(name, DATA), len(DATA)) == DATA


@pytest.mark.parametrize("name", ["bz2", "lz4", "zstd"])
@pytest.mark.parametrize("data", [b"x", DATA], ids=len)
def test_there_and_back(name: str, data: bytes) -> None:
    packed = compress(name, data)
    assert unpacked(name, bytes(packed), len(data)) == data


@pytest.mark.parametrize("name", ["bz2", "lz4", "zstd"])
@pytest.mark.parametrize("size", [1, 1_000, len(DATA) - 1, len(DATA) + 1])
def test_another_size_is_an_error(name: str, size: int) -> None:
    with pytest.raises(CompressionError):
        unpacked(name, bytes(compress(name, DATA)), size)


@pytest.mark.parametrize("name", ["bz2", "lz4", "zstd"])
def test_what_is_cut_is_an_error(name: str) -> None:
    with pytest.raises(CompressionError):
        unpacked(name, bytes(compress(name, DATA))[:-5], len(DATA))


def test_zstd_without_its_size() -> None:
    silent = zstandard.ZstdCompressor(write_content_size=False).compress(DATA)
    assert unpacked("zstd", silent, len(DATA)) == DATA
