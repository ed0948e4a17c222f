"""Compressing and decompressing by name, within bounds."""

from __future__ import annotations

import pytest
import zstandard

from pc2scan.files import compression as codecs
from pc2scan.files.compression import (
    CompressionError,
    compress,
    decoder,
    decompress,
    zstd_content_size,
)
from pc2scan.options.table import options_of

DATA = bytes(range(256)) * 400 + bytes(50_000)


def test_every_compression_that_can_be_asked_for_is_known() -> None:
    assert set(options_of("convert")["compression"].value.words) == codecs._COMPRESS.keys() == codecs._DECOMPRESS.keys()


@pytest.mark.parametrize("name", ["none", "bz2", "lz4", "zstd"])
@pytest.mark.parametrize("data", [b"", b"x", DATA], ids=len)
def test_there_and_back(name: str, data: bytes) -> None:
    packed = compress(name, data)
    assert decompress(name, memoryview(bytes(packed)), len(data)) == (data, True)


def test_levels_of_zstd() -> None:
    assert compress("zstd", DATA) == zstandard.ZstdCompressor().compress(DATA)
    assert compress("zstd", DATA, 1) == zstandard.ZstdCompressor(level=1).compress(DATA)


@pytest.mark.parametrize("name", ["bz2", "lz4"])
@pytest.mark.parametrize("size", [0, 1, 1_000, len(DATA) - 1])
def test_one_byte_more_shows_an_excess(name: str, size: int) -> None:
    assert decompress(name, compress(name, DATA), size) == (DATA[: size + 1], False)
    # What is cut is not complete.
    data, complete = decompress(name, bytes(compress(name, DATA))[:-5], len(DATA))
    assert not complete
    assert DATA.startswith(data)


def test_zstd_does_not_believe_another_size() -> None:
    with pytest.raises(CompressionError, match=f"the compressed data declare {len(DATA)} bytes"):
        decompress("zstd", compress("zstd", DATA), 1_000)
    silent = zstandard.ZstdCompressor(write_content_size=False).compress(DATA)
    assert zstd_content_size(silent) == -1
    assert decompress("zstd", silent, len(DATA)) == (DATA, True)
    for size in (1_000, len(DATA) - 1):
        with pytest.raises(CompressionError):
            decompress("zstd", silent, size)
    with pytest.raises(CompressionError):
        decompress("zstd", silent[:-5], len(DATA))


def test_lz4_does_not_allocate_what_cannot_come() -> None:
    # A terabyte is not there to be allocated.
    data, complete = decompress("lz4", compress("lz4", DATA), 1 << 40)
    assert (data, complete) == (DATA, True)


def test_a_decoder_of_bz2_keeps_to_its_bound() -> None:
    assert len(decoder("bz2").feed(compress("bz2", DATA), 1_000)) == 1_000
